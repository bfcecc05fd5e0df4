"""`g1stream convert`: converts motions into session or motion files, and sessions into bags."""

from __future__ import annotations

import re
import sys
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from g1stream.cli.command import (
    EXIT_OK,
    EXIT_SIGNAL,
    on_signals,
    print_result,
    print_warning,
)
from g1stream.cli.flags import argument, flag
from g1stream.cli.motion_flags import MOTIONS, MotionPartFlags
from g1stream.cli.progress import showing_progress
from g1stream.control.stop import Stop
from g1stream.errors import ConfigError
from g1stream.files import check_not_input, is_session
from g1stream.optional import extension
from g1stream.text import counted
from g1stream.types import MotionFormat, Velocities

if TYPE_CHECKING:
    from collections.abc import Callable

    from g1stream.motion.motion import Motion
    from g1stream.robot.model import G1

    _Progress = Callable[[float], None]
    #: Values, text, and warnings.
    _Result = tuple[dict[str, Any], str, tuple[str, ...]]

#: Flags of a session file.
_OF_SESSION: Any = {"advanced": True, "needs": ("files=*.mcap",), "excludes": ("to", "ros2")}


class _StoppedError(BaseException):
    """A signal was received; its number is the argument."""


@dataclass(frozen=True, kw_only=True)
class Convert(MotionPartFlags):
    """Needs no robot, no simulator and no DDS. Nothing is written if it fails.

    Log time and publish time of every message are the base time + frame / fps, rounded to the
    nearest nanosecond. With the default base time the same input always gives the same bytes.

    If the output ends in .csv or .npz, it is a motion file.

    With --to the output is a file for another program, with that program's frame rate and orders:
    NPZ training files for beyondmimic, mjlab and holosoma, a directory for sonic, a CSV for lafan1
    and a pickle for gmr. docs/formats.md describes them.

    A session and an output in .mcap, without flags, are a copy of the session, with the index that
    the recorder did not write if it was killed. Viewers such as Rerun need the index.

    With --ros2 a session becomes a ROS 2 bag: a directory with metadata.yaml and an MCAP file that
    has ROS messages only.

    Examples:
      g1stream convert dance.csv dance.mcap
      g1stream convert dance.csv part.mcap --frames 100:200 --resample 500
      g1stream convert dance.pkl dance.csv
      g1stream convert wave.csv dance.npz --blend 1 -o both.npz
      g1stream convert dance.csv motion.npz --to mjlab
      g1stream convert dance.csv reference/dance --to sonic
      g1stream convert killed.mcap whole.mcap
      g1stream convert session.mcap session_ros2 --ros2

    Exit codes:
      0        converted
      2        bad input, such as an unsupported file
      128 + n  ended by signal n, and nothing was written: 130 after Ctrl-C
    """

    files: tuple[str, ...] = argument(
        f"{MOTIONS} The last one is the output: .mcap, .csv or .npz; a directory with --ros2 and "
        "--to sonic; a .pkl with --to gmr.",
        "MOTION... FILE",
    )
    to: MotionFormat | None = flag(
        None,
        "Write a motion file for another program.",
        shown="a motion file of g1stream if FILE ends in .csv or .npz, otherwise a session",
    )
    velocities: Velocities = flag(
        "spline",
        "The velocities are derivatives of the streamed spline, or differences of "
        "the frames in the file.",
        advanced=True,
        needs=("to",),
    )
    ros2: bool = flag(
        False,
        "Convert a session into a ROS 2 bag.",
        excludes=(
            *("to", "frames", "resample", "urdf"),
            *{one.name for one in fields(MotionPartFlags)} - {"quiet"},
        ),
    )
    base_time: str = flag(
        "0",
        "Time of frame 0: ns since 1970, or ISO 8601 with a time zone (2026-03-01T12:00:00Z).",
        "TIME",
        **_OF_SESSION,
    )
    frames: str = flag(
        ":",
        "Only frames A to B - 1; either may be omitted. Each frame keeps its time.",
        "A:B",
        shown="all",
        advanced=True,
    )
    resample: float | None = flag(
        None,
        "Rate of the output, sampled from the spline with velocities and accelerations. The motion "
        "keeps its speed; --fps is the rate at which the input's frames follow each other.",
        "HZ",
        shown="the file's frames",
        gt=0,
        excludes=("to",),
    )
    no_floating_root: bool = flag(False, "Fix the root link at the world's origin.", **_OF_SESSION)
    flat: bool = flag(
        False, "Make every link a child of the world instead of its parent link.", **_OF_SESSION
    )
    urdf: Path | None = flag(
        None,
        "URDF of the robot.",
        "FILE",
        shown="the built-in 29-joint G1",
        needs=("to", "files=*.mcap"),
    )
    only: Literal["tf"] | None = flag(
        None,
        "Write the transforms alone: no joint states, scene, URDF or attached motion.",
        shown="all of them",
        **_OF_SESSION,
    )
    meshes: bool = flag(
        False,
        "Show the URDF's meshes, simplified, or the real G1's (extra `meshes`).",
        **_OF_SESSION,
    )
    out: Path | None = flag(
        None, "The output; then each argument is a motion.", "FILE", shown="the last argument"
    )
    force: bool = flag(False, "Replace an existing file.")
    json: bool = flag(False, "Print the summary as JSON on standard output.")

    @property
    def motions(self) -> tuple[str, ...]:
        """The motions to convert."""
        return self.files if self.out else self.files[:-1]

    @property
    def output(self) -> Path:
        """The file or directory to write."""
        return self.out or Path(self.files[-1])

    def run(self) -> int:
        """Convert, and return the exit code."""
        if not self.motions:
            raise ConfigError(
                "The argument MOTION or FILE is missing.",
                "Add it. `g1stream convert --help` describes it.",
            )
        check_not_input(self.output, *map(Path, self.motions))
        if self.ros2 and len(self.motions) > 1:
            raise ConfigError("--ros2 converts exactly one session.", "Give one session and FILE.")
        try:
            return self._convert()
        except _StoppedError as stopped:
            number: int = stopped.args[0]
            name = Stop.by_signal(number).text
            print(f"\nStopped by {name}; nothing was written.", file=sys.stderr)
            return EXIT_SIGNAL + number

    def _motion(self, robot: G1 | None = None) -> Motion:
        """The joined motions, cut to the frames of --frames."""
        motion = self.load(self.motions, robot)
        first, behind = _frames(self.frames)
        return motion.frames(first or 0, motion.n_frames if behind is None else behind)

    def _motion_file(self, on_progress: _Progress) -> _Result:
        from g1stream.motion.motion import DEFAULT_FPS

        motion = self._motion()
        if self.resample:
            motion = motion.resample(self.resample)
        on_progress(0.0)  # raises after a signal
        path, warnings = motion.save(self.output, force=self.force), motion.warnings
        if path.suffix.lower() == ".csv" and motion.fps != DEFAULT_FPS:
            warnings += (f"a CSV has no frame rate: read {path} with --fps {motion.fps:g}",)
        about = {"path": str(path), "frames": motion.n_frames, "fps": motion.fps}
        text = f"{path}: {counted(motion.n_frames, 'frame')} at {motion.fps:g} fps"
        return about, text, warnings

    def _convert(self) -> int:
        from g1stream.motion.motion import MOTION_SUFFIXES

        # Checked between chunks: an exception raised in a signal handler could come between the
        # creation of the temporary file and the code that removes it.
        stopped: list[int] = []
        with on_signals(stopped.append), showing_progress() as progress:

            def on_progress(fraction: float) -> None:
                if stopped:
                    raise _StoppedError(stopped[0])
                progress("converted", fraction)

            if self.ros2 or self.to:
                make = self._ros2_bag if self.ros2 else self._file_of_format
            elif self.output.suffix.lower() in MOTION_SUFFIXES:
                make = self._motion_file
            else:
                make = self._copy if self._copies() else self._session_file
            about, text, warnings = make(on_progress)
        print_warning(*warnings)
        print_result(about, text, as_json=self.json)
        return EXIT_OK

    def _copies(self) -> bool:
        """Whether the only input is a session of ours, and nothing is asked of its motion."""
        session = Path(self.motions[0])
        free = {name: getattr(self, name) for name in ("files", "out", "force", "json", "quiet")}
        plain = self.output.suffix.lower() == ".mcap" and self == Convert(**free)
        if not (plain and len(self.motions) == 1 and is_session(session)):
            return False
        from g1stream.session.motions import is_of_g1stream

        return is_of_g1stream(session)

    def _copy(self, on_progress: _Progress) -> _Result:
        from g1stream.app.session import open_session

        session = open_session(self.motions[0])
        session.save(self.output, force=self.force)
        messages, size = sum(session.topics.values()), self.output.stat().st_size
        on_progress(1.0)
        about = {"path": str(self.output), "messages": messages, "size": size}
        text = f"{self.output}: {counted(messages, 'message')}, {size / 1e6:.1f} MB"
        lost = counted(session.unread, "byte")
        end = (f"the last {lost} are an incomplete record and were left out",)
        return about, text, end if session.unread else ()

    def _ros2_bag(self, on_progress: _Progress) -> _Result:
        report = extension("write_bag")(
            Path(self.motions[0]),
            self.output,
            force=self.force,
            on_progress=on_progress,
        )
        text = (
            f"{report.path}: {counted(sum(report.counts.values()), 'message')} on "
            f"{counted(len(report.counts), 'topic')}, {report.size / 1e6:.1f} MB"
        )
        if report.left_out:
            text += f"\nomitted, not ROS messages: {', '.join(sorted(report.left_out))}"
        return report.as_dict(), text, ()

    def _file_of_format(self, on_progress: _Progress) -> _Result:
        from g1stream.robot.model import G1

        assert self.to
        robot = G1.load(self.urdf)
        motion = self._motion(robot)
        take = extension("write_motion")(
            motion,
            self.output,
            self.to,
            robot=robot,
            velocities=self.velocities,
            force=self.force,
            on_progress=on_progress,
        )
        fps = take.format.fps or motion.fps
        about = {"path": str(self.output), "format": self.to, "frames": take.n_frames, "fps": fps}
        text = f"{self.output}: {counted(take.n_frames, 'frame')} at {fps:g} fps for {self.to}"
        return about, text, motion.warnings

    def _session_file(self, on_progress: _Progress) -> _Result:
        from g1stream.app.convert import convert, parse_time
        from g1stream.robot.model import G1

        robot = G1.load(self.urdf)
        report = convert(
            self.load(self.motions, robot),
            self.output,
            robot=robot,
            base_time_ns=parse_time(self.base_time),
            frames=_frames(self.frames),
            resample=self.resample,
            floating_root=not self.no_floating_root,
            flat=self.flat,
            only_tf=self.only == "tf",
            meshes=self.meshes,
            force=self.force,
            on_progress=on_progress,
        )
        text = (
            f"{report.path}: {counted(report.frames, 'frame')} at {report.rate:g} Hz, "
            f"{(report.end_ns - report.start_ns) / 1e9:.2f} s, {report.size / 1e6:.1f} MB"
        )
        return report.as_dict(), text, report.warnings


def _frames(text: str) -> tuple[int | None, int | None]:
    match = re.fullmatch(r"([0-9]*):([0-9]*)", text)
    if not match:
        raise ConfigError(
            f"{text!r} is not a range of frames.", "Give A:B, such as 100:200, 100: or :200."
        )
    first, behind = (int(number) if number else None for number in match.groups())
    return first, behind
