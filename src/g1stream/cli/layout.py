"""`g1stream layout`: layouts of viewers for session files."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Literal

from g1stream.cli.command import EXIT_OK, Command
from g1stream.cli.flags import argument, flag

#: By viewer: the file's name, and how to load it.
_VIEWERS: Final = {
    "foxglove": ("g1stream-foxglove.json", "Layouts menu > Import from file."),
    "lichtblick": ("g1stream-lichtblick.json", "Layouts menu > Import from file."),
    "plotjuggler": (
        "g1stream-plotjuggler.xml",
        "Load a session converted with `g1stream convert SESSION OUT --ros2`, then File > Load "
        "Layout.",
    ),
}


@dataclass(frozen=True, kw_only=True)
class Layout(Command):
    """Writes a layout file, which shows a session's robot, ghost, worst joints, torques and timing.

    With a session, the six joints with the greatest error in it are plotted, and where a learned
    policy played, its delays and actions. What `g1stream simulate` simulated is plotted, too.

    Examples:
      g1stream layout lichtblick session.mcap
      g1stream layout foxglove --dir layouts

    Exit codes:
      0  written
      2  bad input: not a session file, a file that cannot be written
    """

    viewer: Literal["foxglove", "lichtblick", "plotjuggler"] = argument(
        "The viewer: foxglove, lichtblick or plotjuggler.", "VIEWER"
    )
    session: Path | None = flag(
        None, "A session file, to choose the joints by.", "SESSION", positional=True
    )
    dir: Path = flag(Path(), "Write the layout into this directory.", "DIR", shown="here")
    force: bool = flag(False, "Replace a file that exists already.")

    def run(self) -> int:
        """Write the layout, and return the exit code."""
        from g1stream.analysis.tracking import worst_joints
        from g1stream.files import complete_file, output_errors
        from g1stream.session.recording import open_recording
        from g1stream.view.layouts import DEFAULT_JOINTS, foxglove_layout, plotjuggler_layout

        joints: tuple[str, ...] = DEFAULT_JOINTS
        policy = simulated = False
        robot = None
        if self.session:
            recording = open_recording(self.session)
            robot = recording.robot
            joints = worst_joints(recording, len(joints)) or joints
            policy = bool(recording.topics.get("/policy/terms"))
            simulated = bool(recording.topics.get("/simulated/joint_states"))
        if self.viewer == "plotjuggler":
            content = plotjuggler_layout(joints).encode()
        else:
            layout = foxglove_layout(joints, robot, policy=policy, simulated=simulated)
            content = json.dumps(layout, indent=1).encode() + b"\n"
        name, how = _VIEWERS[self.viewer]
        path = self.dir / name
        with output_errors(self.dir):
            self.dir.mkdir(parents=True, exist_ok=True)
        with complete_file(path, force=self.force) as temporary:
            temporary.write_bytes(content)
        print(f"{path}\n{how}")
        return EXIT_OK
