"""`g1stream attach`: adds the reference to a session that was recorded without it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from g1stream.cli.command import EXIT_OK, print_json, print_lines, print_warning
from g1stream.cli.flags import argument, flag
from g1stream.cli.motion_flags import MOTION, MotionPartFlags
from g1stream.cli.progress import showing_progress

if TYPE_CHECKING:
    from g1stream.session.records import AttachedInfo

#: Another place in the motion is reported only above this similarity.
_WORTH_TELLING = 0.5


@dataclass(frozen=True, kw_only=True)
class Attach(MotionPartFlags):
    """Finds when a motion was played in a session, whichever program played and recorded it. It
    compares the motion with the commands if they contain its joint targets, otherwise with the
    measured joints. The new session has the reference: /tf, the ghost and the tracking error.

    Reads sessions of `g1stream record`, bags of `ros2 bag record /lowstate /lowcmd` (MCAP; SQLite
    with the extra `ros2`), logs with joint states, and CSV logs with a time column.

    Without --out it only prints the result. `report`, `plot`, `compare`, `info` and `render` accept
    --motion, so they need no file with the reference.

    Examples:
      g1stream attach robot.mcap dance.csv
      g1stream attach robot.mcap dance.csv -o with-reference.mcap
      g1stream report robot.mcap --motion dance.csv

    Exit codes:
      0  found, and written with --out
      2  bad input: not a session, the wrong motion, or an ambiguous place
    """  # noqa: D205

    session: Path = argument("The session, bag or log.", "SESSION")
    reference: str = argument(MOTION, "MOTION")
    out: Path | None = flag(None, "The session to write.", "OUT.mcap")
    play: int = flag(1, "Which playback to use, if the motion was played several times.", "N", gt=0)
    force: bool = flag(False, "Replace an existing file.", needs=("out",))
    json: bool = flag(False, "Print the result as JSON.")

    def run(self) -> int:
        """Find the motion, print the result, write the session, and return the exit code."""
        from g1stream.app.session import open_session
        from g1stream.extras.attach.write import write_attached
        from g1stream.files import check_output_path, check_suffix

        if self.out is not None:
            check_suffix(self.out, "a session", ".mcap")
            check_output_path(self.out, force=self.force)
        session = open_session(self.session)
        motion = self.load([self.reference])
        print_warning(*motion.warnings)
        session = session.attach(motion, play=self.play)
        info = session.attached
        assert info
        if self.json:
            print_json(info.model_dump(mode="json"))
        else:
            print_lines(_told(info))
        if self.out is not None:
            with showing_progress() as progress:
                write_attached(session, self.out, force=self.force, progress=progress)
            if not self.json:
                print(self.out)
        return EXIT_OK


def _told(info: AttachedInfo) -> str:
    lines = [
        f"played      {info.first_s:.2f} to {info.last_s:.2f} s of the motion, starting "
        f"{info.starts_s[info.play - 1]:.3f} s after",
        f"            the first sample, at {info.speed:.4f} of its speed",
        f"found in    {info.by}: similarity {info.similarity:.3f}, RMS difference "
        f"{info.rmse_rad:.4f} rad",
    ]
    if info.by_robot:
        lines.append("            (a late robot looks like a later start, so its delay is unknown)")
    if info.plays > 1:
        starts = ", ".join(f"{one:.3f}" for one in info.starts_s)
        lines.append(f"times       {info.plays}, starting at {starts} s; this is {info.play}")
    if info.rival is not None and info.rival > _WORTH_TELLING:
        lines.append(f"next best   another place in the motion: similarity {info.rival:.3f}")
    heading = "from the IMU" if info.heading_from == "imu" else "from the motion (no IMU)"
    place = "from SportModeState" if info.place_from == "sportmodestate" else "from the motion"
    lines.append(f"reference   heading {heading}, position {place}, both at its first frame")
    return "\n".join(lines)
