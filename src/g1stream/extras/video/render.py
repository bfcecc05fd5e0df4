"""Renders a session as a video or a picture of the measured robot, with the reference as ghost."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import dataclass
from fractions import Fraction
from itertools import chain
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from g1stream.dds.messages import played_joints
from g1stream.errors import ConfigError, RecordingError
from g1stream.extras.meshes.meshes import with_shapes
from g1stream.extras.video.scene import PosedRobot, Scene
from g1stream.files import check_suffix, complete_file
from g1stream.input_limits import FRAMES
from g1stream.optional import import_extra
from g1stream.session.recording import Recording
from g1stream.session.streams import BaseStream, MeasuredStream, ReferenceStream, Stream
from g1stream.types import Camera, Floats, Ints, Phase
from g1stream.view.measured_base import MeasuredBase

AZIMUTHS: Final = {"front": 0.0, "oblique": 35.0, "left": 90.0, "back": 180.0, "right": 270.0}
"""The azimuth of each `Camera` around the robot, degrees: 0 in front of it, 90 on its left."""

#: A state older than this, s, is labelled with its age.
_OLD: Final = 0.1
#: Red, green, blue and opacity of the ghost, and of a reference shown alone.
_GHOST: Final = (0.1, 0.6, 1.0, 0.3)
_BLUE: Final = (0.1, 0.6, 1.0, 1.0)
#: Colour behind the text.
_GROUND: Final = (16, 20, 28, 190)
_LARGEST_SIDE, _HIGHEST_FPS = 4096, 240.0


@dataclass(frozen=True)
class Video:
    """Result of rendering."""

    path: Path  # the written file
    frames: int  # number of pictures
    start: float  # time of the first picture on the motion's clock, s
    duration: float  # s
    shown: str  # "measured and ghost", "measured", or "reference"
    meshes: bool  # whether the robot was drawn with meshes, not primitive shapes


def render(
    session: Recording,
    path: Path,
    *,
    start: float | None = None,
    duration: float | None = None,
    fps: float = 25.0,
    size: tuple[int, int] = (1280, 720),
    camera: Camera = "oblique",
    force: bool = False,
    progress: Callable[[float], None] = lambda fraction: None,
) -> Video:
    """See `Session.render`; `progress` is called with the fraction done."""
    suffix = path.suffix.lower()
    check_suffix(path, "a video", *_WRITERS)
    if suffix == ".mp4":
        import_extra("av", "video", "A video in MP4, unlike GIF and PNG, needs")
    width, height = size
    if not (16 <= width <= _LARGEST_SIDE and 16 <= height <= _LARGEST_SIDE):
        raise ConfigError(
            f"A picture cannot have {width} x {height} pixels.",
            f"Give a width and a height from 16 to {_LARGEST_SIDE}.",
        )
    if suffix == ".mp4" and (width % 2 or height % 2):
        raise ConfigError(
            f"A video cannot have {width} x {height} pixels, because H.264 needs even numbers.",
            f"Use {width + width % 2} x {height + height % 2}.",
        )
    if not 0.0 < fps <= _HIGHEST_FPS:
        raise ConfigError(
            f"A video cannot have {fps:g} frames per second.", f"Give up to {_HIGHEST_FPS:g}."
        )
    times = _frame_times(session, start, 0.0 if suffix == ".png" else duration, fps)
    poses = Poses(session, times)
    robot = with_shapes(session.robot)
    with (
        complete_file(path, force=force) as temporary,
        closing(Scene(robot, poses.robots, size, AZIMUTHS[camera])) as scene,
    ):

        def pictures() -> Iterator[Image.Image]:
            for frame in range(len(times)):
                yield _labelled(scene.draw(frame), poses.text(frame))
                progress((frame + 1) / len(times))

        _WRITERS[suffix](temporary, pictures(), fps)
    return Video(
        path=path,
        frames=len(times),
        start=float(times[0]),
        duration=len(times) / fps,
        shown=poses.shown,
        meshes=scene.meshes,
    )


def _labelled(pixels: NDArray[np.uint8], text: str) -> Image.Image:
    """A picture with lines of text in its upper left corner, on a dark background."""
    picture = Image.fromarray(pixels)
    size = max(10.0, picture.height / 24)
    font, place = ImageFont.load_default(size), (size, 0.8 * size)
    drawing = ImageDraw.Draw(picture, "RGBA")
    left, top, right, bottom = drawing.textbbox(place, text, font)
    ground = (left - size / 2, top - size / 2, right + size / 2, bottom + size / 2)
    drawing.rounded_rectangle(ground, size / 3, _GROUND)
    drawing.text(place, text, "white", font)
    return picture


def _frame_times(
    session: Recording, start: float | None, duration: float | None, fps: float
) -> Floats:
    """Times of the frames, s on the motion's clock."""
    kinds = (ReferenceStream, MeasuredStream)
    streams = [session.stream(kind) for kind in kinds if session.topics.get(kind.topic)]
    streams = [stream for stream in streams if len(stream)]
    if not streams:
        raise RecordingError(
            f"{session.path} has neither a reference nor a measured state to show.",
            "Record while a robot, or a simulator, publishes its state.",
        )
    first = float(streams[0].time.min())
    end = max(float(stream.time.max()) for stream in streams)
    start = first if start is None else start
    length = end - start if duration is None else min(duration, end - start)
    if not (np.isfinite(start) and first - _OLD <= start <= end and length >= 0.0):
        raise RecordingError(
            f"{session.path} has no data at {start:g} s"
            + (f" for {duration:g} s." if duration is not None else "."),
            f"It lasts from {first:.2f} s to {end:.2f} s on the motion's clock.",
        )
    frames = max(1, int(length * fps))
    if frames > FRAMES:
        raise RecordingError(
            f"A video of {length:.0f} s would have {frames} frames.",
            "Render a part of the session, with a start and a duration.",
        )
    return start + np.arange(frames) / fps


class Poses:
    """Robot poses at T times, s on the motion's clock, and the text of each frame.

    Attributes:
        shown: names of the shown robots.
        robots: the measured robot with its ghost, or the one of the two that is available.
    """

    def __init__(self, session: Recording, times: Floats) -> None:
        self._times = times
        present = session.topics.get
        reference = session.reference if present(ReferenceStream.topic) else None
        measured = session.measured if present(MeasuredStream.topic) else None
        self._phases: list[str] = []
        self._error = self._age = np.full(len(times), np.nan)
        if reference is not None:
            reference.read("phase", "played", "q", "root_pos", "root_quat_wxyz")
            played = played_joints(np.bitwise_or.reduce(reference.played))
            asked = reference[_latest(reference, times)]
            known = {int(phase): phase.name for phase in Phase}
            self._phases = [known.get(int(number), "?") for number in asked.phase]
            self.shown = "reference"
            self.robots = [PosedRobot(asked.q, asked.root_pos, asked.root_quat_wxyz, _BLUE)]
        if measured is None:
            return
        measured.read("q", "imu_quat_wxyz")
        if reference is not None:  # without it, the yaw offset of the IMU is unknown
            since = measured[measured.time >= reference.time.min()]
            measured = since if len(since) else measured
        done = measured[_latest(measured, times)]
        self._age = times - done.time
        pos, quat_wxyz = _pelvis(reference, session.base, done)
        self.shown = "measured"
        self.robots = [PosedRobot(done.q, pos, quat_wxyz)]
        if reference is not None:
            self.shown = "measured and ghost"
            self.robots.append(PosedRobot(asked.q, pos, quat_wxyz, _GHOST, ghost=True))
            order = np.argsort(reference.time, kind="stable")
            at_state = [
                np.interp(done.time, reference.time[order], q[order]) for q in reference.q.T
            ]
            errors = (np.stack(at_state, axis=1) - done.q)[:, played]
            self._error = np.sqrt(np.mean(errors**2, axis=1))

    def text(self, frame: int) -> str:
        """The text of a frame, a line for each value."""
        rows = {"time": f"{self._times[frame]:.2f} s"}
        if self._phases:
            rows["phase"] = self._phases[frame]
        if np.isfinite(self._error[frame]):
            rows["RMS error"] = f"{np.degrees(self._error[frame]):.2f} deg"
        if self._age[frame] > _OLD:
            rows["state"] = f"{self._age[frame]:.1f} s old"
        if len(self.robots) == 1:
            rows["shown"] = f"{self.shown} only"
        return "\n".join(f"{name}  {value}" for name, value in rows.items())


def _latest(stream: Stream, times: Floats) -> NDArray[np.intp]:
    """(T,) indices of the latest samples at these times."""
    order = np.argsort(stream.time, kind="stable")
    before = np.searchsorted(stream.time[order], times, side="right") - 1
    latest: NDArray[np.intp] = order[before.clip(0)]
    return latest


def _pelvis(
    reference: ReferenceStream | None, base: BaseStream | None, measured: MeasuredStream
) -> tuple[Floats, Floats]:
    """The measured pelvis in the world: (T, 3) m and (T, 4), as in /measured/tf."""
    pelvis = MeasuredBase()
    if reference is not None:
        pelvis.add_references(_ns(reference), reference.root_pos, reference.root_quat_wxyz)
    if base is not None:
        pelvis.add_positions(_ns(base), base.read("position").position)
    states = _ns(measured), measured.imu_quat_wxyz
    pelvis.add_states(*states)
    return pelvis.poses(*states)


def _ns(stream: Stream) -> Ints:
    return np.round(stream.time * 1e9).astype(np.int64)


def _write_mp4(path: Path, pictures: Iterator[Image.Image], fps: float) -> None:
    import av

    first = next(pictures)
    with av.open(str(path), "w", format="mp4") as container:
        rate = Fraction(fps).limit_denominator(1001)
        options = {"crf": "20", "movflags": "+faststart"}
        stream = container.add_stream("libx264", rate=rate, options=options)
        stream.width, stream.height = first.size
        stream.pix_fmt = "yuv420p"  # supported by every player
        for picture in chain([first], pictures):
            frame = av.VideoFrame.from_ndarray(np.asarray(picture), format="rgb24")
            container.mux(stream.encode(frame))
        container.mux(stream.encode())


def _write_gif(path: Path, pictures: Iterator[Image.Image], fps: float) -> None:
    first = next(pictures).quantize(128)
    # One palette for all pictures makes files smaller and avoids flicker.
    others = [one.quantize(palette=first, dither=Image.Dither.NONE) for one in pictures]
    # GIF has a resolution of a hundredth of a second; frame ends are rounded to it.
    ends = np.round(np.arange(len(others) + 2) * 100 / fps) * 10
    durations = np.diff(ends).astype(int).tolist()
    first.save(path, "GIF", save_all=True, append_images=others, duration=durations, loop=0)


def _write_png(path: Path, pictures: Iterator[Image.Image], fps: float) -> None:
    next(pictures).save(path, "PNG")


_WRITERS: Final = {".mp4": _write_mp4, ".gif": _write_gif, ".png": _write_png}
"""Functions that write pictures to a file, by suffix."""
