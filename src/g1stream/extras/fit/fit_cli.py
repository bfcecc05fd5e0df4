"""`g1stream fit`: identifies friction, armature, delay, torque and masses from sessions."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from pathlib import Path

from g1stream.cli.command import EXIT_OK, EXIT_STOPPED, SettingsCommand, print_result
from g1stream.cli.flags import flag
from g1stream.cli.progress import showing_progress
from g1stream.errors import ConfigError


@dataclass(frozen=True, kw_only=True)
class Fit(SettingsCommand):
    """Fits the parameters of a bolted or hanging robot, and writes a file for --params.

    The parameters are viscous and dry friction, armature and torque scale of each joint, the delay
    of commands, and masses added to trunk, limbs, hands and feet. Each has a 95 % interval.
    Parameters that the sessions do not determine are not written, such as the friction of a joint
    that hardly moved. The gap between robot and simulator is given before and after the fit, for a
    session or a part that was not used for fitting.

    Examples:
      g1stream fit --motion-out excite.npz
      g1stream stream excite.npz --support hanging --record excite.mcap
      g1stream fit excite.mcap -o g1.toml --hold-out dance.mcap
      g1stream sim --params g1.toml

    Exit codes:
      0  fitted and written
      1  not written: the gap does not shrink, or delay or support are impossible
      2  bad input: no commands, states or torques, or the robot stood on its feet
    """

    sessions: tuple[Path, ...] = flag(
        (), "Session files of one robot.", "SESSION...", positional=True, shown="none"
    )
    out: Path | None = flag(None, "The parameters file to write.", "TOML", shown="none")
    hold_out: Path | None = flag(
        None,
        "Session for validation, which is not used for fitting.",
        "SESSION",
        shown="the last fifth of each session",
    )
    motion_out: Path | None = flag(
        None, "Write an excitation motion for identification, to be played and recorded.", "NPZ"
    )
    seconds: float = flag(40.0, "Length of that motion.", "SECONDS", gt=0.0)
    support: str | None = flag(
        None, "How the robot was held: bolted, hanging.", "SUPPORT", shown="as recorded"
    )
    force: bool = flag(False, "Replace an existing file.")
    json: bool = flag(False, "Print the results as JSON.")

    def run(self) -> int:
        """Fit, write, print, and return the exit code."""
        from g1stream.files import check_output_path, check_suffix
        from g1stream.robot.model import G1

        config = self.resolve()
        if bool(self.sessions) == bool(self.motion_out):
            raise ConfigError(
                "Give either sessions to fit, or --motion-out for a motion to record.",
                "`g1stream fit --help` has an example of both.",
            )
        if self.motion_out:
            from g1stream.extras.fit.excite import exciting_motion

            motion = exciting_motion(G1.of_config(config), seconds=self.seconds)
            print(motion.save(self.motion_out, force=self.force))
            return EXIT_OK
        from g1stream.app.session import open_session
        from g1stream.extras.fit.identify import fit_parameters
        from g1stream.extras.fit.simulated_session import robot_of

        if self.out is not None:  # checked before the long computation
            check_suffix(self.out, "a parameters file", ".toml")
            check_output_path(self.out, force=self.force)
        sessions = [open_session(path) for path in self.sessions]
        with showing_progress() as progress:
            fit = fit_parameters(
                sessions,
                hold_out=self.hold_out,
                robot=robot_of(sessions[0], config.robot),
                support=self.support,
                progress=partial(progress, "fit"),
            )
        text = str(fit)
        if self.out is not None and not fit.refusal:
            text += f"\n\nwritten to {fit.save(self.out, force=self.force)}"
        print_result(fit.model_dump(mode="json"), text, as_json=self.json)
        return EXIT_STOPPED if fit.refusal else EXIT_OK
