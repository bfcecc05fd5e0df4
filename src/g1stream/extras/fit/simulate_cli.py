"""`g1stream simulate`: simulates the commands of a session and compares with the robot."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from g1stream.cli.command import EXIT_OK, SettingsCommand, print_result
from g1stream.cli.flags import argument, flag


@dataclass(frozen=True, kw_only=True)
class Simulate(SettingsCommand):
    """Sends the recorded commands to the embedded simulator, from the measured state, and compares.

    Each window begins with the measured state, so that differences do not accumulate. For each
    joint it prints the difference in position, velocity and torque, the noise of the session, and
    the causes: friction, inertia, weight, backlash, saturation. With --out it writes the
    session with the simulated joints, which plots and reports then show.

    Examples:
      g1stream simulate session.mcap
      g1stream simulate session.mcap -o gap.mcap --window 0.5
      g1stream simulate session.mcap --params g1.toml --json

    Exit codes:
      0  simulated, with any difference
      2  bad input: no commands or states, or unknown support of the robot
    """

    session: Path = argument("Session file.", "SESSION")
    out: Path | None = flag(None, "Write the session with the simulated joints.", "MCAP")
    force: bool = flag(False, "Replace an existing file.")
    window: float = flag(1.0, "Time between restarts from the measured state.", "SECONDS", gt=0.0)
    support: str | None = flag(
        None,
        "How the robot was held: bolted, hanging, follow, free, feet.",
        "SUPPORT",
        shown="as recorded",
    )
    json: bool = flag(False, "Print the results as JSON.")

    def run(self) -> int:
        """Simulate, print, and return the exit code."""
        from g1stream.app.session import open_session
        from g1stream.extras.fit.simulated_session import gap, robot_of
        from g1stream.files import check_not_input, check_output_path, check_suffix

        if self.out is not None:  # checked before the long computation
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
        print_result(found.model_dump(mode="json"), str(found), as_json=self.json)
        return EXIT_OK
