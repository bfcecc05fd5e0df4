"""`g1stream simulate`: the commands of a session, simulated again."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from g1stream.cli.command import EXIT_OK, SettingsCommand, print_json, print_lines
from g1stream.cli.flags import argument, flag


@dataclass(frozen=True, kw_only=True)
class Simulate(SettingsCommand):
    """Gives the recorded commands to the embedded simulator, from the measured state, and compares.

    Each window begins with the measured state, so that differences do not add up. Printed is by
    how much position, velocity and torque of each joint differ, beside the noise of the session,
    and what explains it: friction, inertia, weight, lag, backlash, saturation. With --out, the
    session is written with the simulated joints, which plots and reports then show.

    Examples:
      g1stream simulate session.mcap
      g1stream simulate session.mcap -o gap.mcap --window 0.5
      g1stream simulate session.mcap --params g1.toml --json

    Exit codes:
      0  simulated, whatever the difference
      2  bad input: no commands or states, or it is not known how the robot was held
    """

    session: Path = argument("Session file, or directory of a split recording.", "SESSION")
    out: Path | None = flag(
        None, "Write the session with the simulated joints.", "MCAP", aliases=("-o",)
    )
    force: bool = flag(False, "Replace a file that is there.")
    window: float = flag(1.0, "Begin anew with the measured state after this.", "SECONDS", gt=0.0)
    support: str | None = flag(
        None,
        "How the robot was held: bolted, hanging, follow, free, feet.",
        "SUPPORT",
        shown="as the session says",
    )
    json: bool = flag(False, "Print what was found as JSON.")

    def run(self) -> int:
        """Simulate, print, and return the exit code."""
        from g1stream.app.session import open_session
        from g1stream.extras.fit.gap import gap, robot_of
        from g1stream.files import check_not_input, check_output_path, check_suffix

        if self.out is not None:  # refused now, and not when all is computed
            check_suffix(self.out, "a session file", ".mcap")
            check_not_input(self.out, self.session)
            check_output_path(self.out, force=self.force)
        config = self.resolve()
        session = open_session(self.session)
        found = gap(
            session,
            out=self.out,
            robot=robot_of(session, config.robot, config.params),
            support=self.support,
            window=self.window,
            force=self.force,
        )
        if self.json:
            print_json(found.model_dump(mode="json"))
        else:
            print_lines(str(found))
        return EXIT_OK
