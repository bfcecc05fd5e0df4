"""`g1stream render`: renders a video of a session."""

from __future__ import annotations

import time
from dataclasses import MISSING, asdict, dataclass
from functools import partial
from pathlib import Path

from g1stream.cli.command import EXIT_OK, print_result
from g1stream.cli.flags import argument, flag
from g1stream.cli.progress import showing_progress
from g1stream.cli.session_flags import SessionFlags
from g1stream.errors import ConfigError
from g1stream.optional import extension
from g1stream.text import counted
from g1stream.types import Camera


@dataclass(frozen=True, kw_only=True)
class Render(SessionFlags):
    """The ghost has the reference's joints and the measured pelvis. Each frame shows time, phase
    and RMS error of all joints. It needs EGL or OSMesa, but no display and no GPU. The extra
    `meshes` adds the real G1's meshes; MP4 needs the extra `video`.

    Examples:
      g1stream render session.mcap -o session.mp4
      g1stream render session.mcap -o wave.gif --start 3 --duration 4 --size 320x320
      g1stream render session.mcap -o pose.png --start 5.2 --camera left

    Exit codes:
      0  written
      2  bad input: not a session file, nothing to show, no OpenGL
    """  # noqa: D205

    session: Path = argument("The session file.", "SESSION")
    out: Path = flag(MISSING, "The file to write: .mp4, .gif, or .png for one frame.", "OUT")
    start: float | None = flag(
        None, "Time of the first frame on the motion's clock.", "SECONDS", shown="of the session"
    )
    duration: float | None = flag(None, "Length.", "SECONDS", shown="to the end", gt=0)
    fps: float = flag(25.0, "Frames per second.", "HZ", gt=0)
    size: str = flag("1280x720", "Width and height, pixels.", "WxH")
    camera: Camera = flag("oblique", "Position of the camera around the robot.", shown="oblique")
    force: bool = flag(False, "Replace an existing file.")
    json: bool = flag(False, "Print path, frames, and what is shown as JSON.")

    def run(self) -> int:
        """Write the video, and return the exit code."""
        started = time.monotonic()
        with showing_progress() as progress:
            video = extension("render")(
                self.open(self.session),
                self.out,
                start=self.start,
                duration=self.duration,
                fps=self.fps,
                size=parse_size(self.size),
                camera=self.camera,
                force=self.force,
                progress=partial(progress, "rendered"),
            )
        took = time.monotonic() - started
        text = (
            f"{video.path}: {counted(video.frames, 'frame')} from {video.start:.2f} s, "
            f"{video.shown}, {'meshes' if video.meshes else 'primitive shapes'}, in {took:.1f} s"
        )
        about = asdict(video) | {"path": str(video.path)}
        print_result(about, text, as_json=self.json)
        return EXIT_OK


def parse_size(text: str) -> tuple[int, int]:
    """Width and height of a size such as `1280x720`."""
    width, _, height = text.partition("x")
    if not (width.isascii() and width.isdigit() and height.isascii() and height.isdigit()):
        raise ConfigError(f"{text} is not a size.", "Give width and height such as 1280x720.")
    return int(width), int(height)
