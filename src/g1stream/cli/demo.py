"""`g1stream demo`: simulates a G1, plays a motion, records and compares it on this machine."""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

from g1stream.cli.command import (
    LiveCommand,
    announce_wire,
    exit_code,
    print_note,
    print_summary,
    print_warning,
)
from g1stream.cli.flags import flag
from g1stream.cli.motion_flags import MOTION, MotionFlags
from g1stream.cli.progress import showing_progress
from g1stream.cli.stream import playing
from g1stream.errors import ConfigError
from g1stream.optional import extension

if TYPE_CHECKING:
    from g1stream.config import Config
    from g1stream.control.loop import StreamLoop


@dataclass(frozen=True, kw_only=True)
class Demo(LiveCommand, MotionFlags):
    """Needs no robot and no other program. It writes session.mcap and tracking.png.

    With the extra `report` it also writes report.html.

    A DDS domain is free if it has no publisher of LowState or LowCmd.

    Examples:
      g1stream demo
      g1stream demo --motion dance.csv --support hanging -o dance-demo
      g1stream demo --support feet
      g1stream demo --policy holosoma
      g1stream demo --duration 5 --viewer
      g1stream demo --live

    Exit codes:
      0        played as asked
      1        something stopped it, or the recording is incomplete
      2        bad input
      128 + n  ended by signal n: 130 after Ctrl-C
    """

    defaults: ClassVar = {"dds.domain": "the first free one of 1 to 8"}

    motion: str | None = flag(None, MOTION, "MOTION", shown="that in the ONNX file, or demo")
    out: Path = flag(
        Path("demo-out"), "Directory for session.mcap, tracking.png, report.html.", "DIR"
    )
    force: bool = flag(False, "Replace existing files.")
    json: bool = flag(False, "Print the summary as JSON on standard output.")

    def run(self) -> int:
        """Run it, and return the exit code."""
        from g1stream.app.demo import FIGURE, check_absent, demo
        from g1stream.motion.readers import default_motion
        from g1stream.robot.model import G1

        config = self.resolve()
        page = self.out / "report.html"
        if not self.force:
            check_absent(page)
        motion = self.load([self.motion or default_motion(config, "demo")], G1.of_config(config))
        print_warning(*motion.warnings)
        with playing() as prepare, ExitStack() as stack:

            def on_loop(loop: StreamLoop, config: Config) -> None:
                stack.enter_context(self.serving(config))  # in the domain that the demo chose
                announce_wire(config)
                prepare(loop, motion)

            summary = demo(motion, self.out, config, force=self.force, on_loop=on_loop)
        print_summary(summary, as_json=self.json)
        if summary.tracking:
            print_note(
                f"Figure: {self.out / FIGURE}. "
                "The session opens in Foxglove, PlotJuggler and Rerun."
            )
            if summary.recorder and summary.recorder.path:
                _write_page(Path(summary.recorder.path), page)
        return exit_code(summary)


def _write_page(session: Path, page: Path) -> None:
    """Write the page of `g1stream report`, or print how to install it."""
    try:
        with showing_progress() as progress:
            extension("report")(session, page, force=True, progress=progress)
    except ConfigError as error:
        print_warning(f"no {page.name}: {error.cause} {error.remedy}")
    else:
        print_note(str(page))
