"""`g1stream layout`: writes viewer layouts for session files."""

from __future__ import annotations

import json
import os
from dataclasses import dataclass
from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING, Final, Literal

from g1stream.cli.command import EXIT_OK, Command, print_result
from g1stream.cli.flags import argument, flag

if TYPE_CHECKING:
    from g1stream.session.recording import Recording

#: File name of each viewer's layout, and how it is loaded.
_VIEWERS: Final = {
    "foxglove": ("g1stream-foxglove.json", "Layouts menu > Import from file."),
    "lichtblick": ("g1stream-lichtblick.json", "Layouts menu > Import from file."),
    "plotjuggler": ("g1stream-plotjuggler.xml", "plotjuggler -l {path}"),
}


@dataclass(frozen=True, kw_only=True)
class Layout(Command):
    """Writes a layout file that shows a session's robot, ghost, worst joints, torques and timing.

    Given a session, it plots the six joints with the largest tracking error. The layout for
    PlotJuggler needs a session, and opens it.

    Examples:
      g1stream layout lichtblick session.mcap
      g1stream layout foxglove -o layouts
      g1stream layout plotjuggler session.mcap

    Exit codes:
      0  written
      2  bad input: not a session file, a file that cannot be written
    """

    viewer: Literal["foxglove", "lichtblick", "plotjuggler"] = argument(
        "The viewer: foxglove, lichtblick or plotjuggler.", "VIEWER"
    )
    session: Path | None = flag(
        None, "A session file from which the joints are chosen.", "SESSION", positional=True
    )
    out: Path = flag(
        Path(), "The file to write, or its directory.", "OUT", shown="the current directory"
    )
    force: bool = flag(False, "Replace an existing file.")
    json: bool = flag(False, "Print the path and the plotted joints as JSON.")

    def run(self) -> int:
        """Write the layout, and return the exit code."""
        from g1stream.errors import ConfigError
        from g1stream.extras.layout.foxglove import DEFAULT_JOINTS, foxglove_layout
        from g1stream.extras.layout.plotjuggler import plotjuggler_layout
        from g1stream.files import check_suffix, complete_file, output_errors
        from g1stream.session.recording import open_recording

        joints: tuple[str, ...] = DEFAULT_JOINTS
        recording = None
        if self.session:
            recording = open_recording(self.session)
            joints = worst_joints(recording, len(joints)) or joints
        name, how = _VIEWERS[self.viewer]
        path = self.out / name if self.out.is_dir() or not self.out.suffix else self.out
        check_suffix(path, f"a layout for {self.viewer}", Path(name).suffix)
        if self.viewer == "plotjuggler":
            if recording is None:
                raise ConfigError(
                    "The layout for PlotJuggler opens a session and names its curves.",
                    "Give the session: `g1stream layout plotjuggler session.mcap`.",
                )
            place = os.path.relpath(recording.path.resolve(), path.parent.resolve())
            content = plotjuggler_layout(recording, place, joints).encode()
        else:
            layout = foxglove_layout(joints, recording.robot if recording else None)
            content = json.dumps(layout, indent=1).encode() + b"\n"
        with output_errors(path.parent):
            path.parent.mkdir(parents=True, exist_ok=True)
        with complete_file(path, force=self.force) as temporary:
            temporary.write_bytes(content)
        text = f"{path}\n{how.format(path=quote(str(path)))}"
        print_result({"path": str(path), "joints": joints}, text, as_json=self.json)
        return EXIT_OK


def worst_joints(session: Recording, most: int) -> tuple[str, ...]:
    """The played joints with the largest RMSE, largest first; empty if nothing was compared."""
    from g1stream.analysis.tracking import NothingToCompareError, tracking
    from g1stream.robot.joints import JOINT_NAMES

    try:
        found = tracking(session)
    except NothingToCompareError:
        return ()
    worst = sorted(found.joints, key=lambda joint: -found.rmse[joint])
    return tuple(JOINT_NAMES[joint] for joint in worst[:most])
