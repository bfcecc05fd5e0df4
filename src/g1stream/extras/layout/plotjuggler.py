"""The layout for PlotJuggler, which opens one session and names its curves by joint.

PlotJuggler numbers the joints of foxglove.JointStates, and draws a field that no message has as
zeros. So the layout defines a curve for each joint and each field that is there, such as
`left_knee_joint/position/measured`. PlotJuggler 3 shows a dialog for a curve that is missing, and
takes minutes for a scene with meshes. So the layout names only what the session has, and selects
only topics with numbers to plot.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final
from xml.etree.ElementTree import Element, SubElement, indent, tostring

from foxglove_schemas_protobuf.JointStates_pb2 import JointStates
from google.protobuf.message import DecodeError

from g1stream.errors import ConfigError, RecordingError
from g1stream.extras.layout.foxglove import LIMB_COLORS, MEASURED, RED, REFERENCE
from g1stream.robot.joints import JOINT_GROUPS
from g1stream.session.format import CHANNELS
from g1stream.session.mcap_reader import RECOVER
from g1stream.session.streams import PolicyStream
from g1stream.text import printable, short_name
from g1stream.types import Phase

if TYPE_CHECKING:
    from collections.abc import Sequence

    from g1stream.session.recording import Recording

__all__ = ["plotjuggler_layout"]

_LIMBS: Final = "/tracking_error/limbs"
#: Topics of joint states, and what their curves are called and coloured.
_JOINT_STATES: Final = {
    "/reference/joint_states": ("reference", REFERENCE),
    "/measured/joint_states": ("measured", MEASURED),
    "/simulated/joint_states": ("simulated", LIMB_COLORS[3]),
    "/tracking_error/joint_states": ("error", RED),
    _LIMBS: ("error", RED),
}
_FIELDS: Final = ("position", "velocity", "effort")
#: Schemas without numbers to plot, or with thousands of them.
_NOT_PLOTTED: Final = {"foxglove.SceneUpdate", "foxglove.FrameTransforms", "std_msgs/msg/String"}

#: A plot: its title and its curves, each by name and colour.
_Plot = tuple[str, list[tuple[str, str]]]


def plotjuggler_layout(session: Recording, path: str, joints: Sequence[str]) -> str:
    """Make a layout for PlotJuggler 3, as XML, that opens a session.

    Args:
        session: the session.
        path: path of its file, relative to the layout's directory or absolute.
        joints: names of up to six joints to plot.

    Raises:
        ConfigError: the session has no joint states in g1stream's channels.
        RecordingError: the session is damaged.
    """
    own = CHANNELS.keys() & session.topics.keys() - session.source.foreign
    topics = sorted(
        topic
        for topic in own - {PolicyStream.topic}
        if CHANNELS[topic].schema_name not in _NOT_PLOTTED and session.topics[topic]
    )
    named = _named_curves(session, topics)
    if not named:
        raise ConfigError(
            f"{session.path} has no joint states for viewers.",
            "Give a session file with the channels standard or full, as g1stream recorded it.",
        )

    def there(curves: Sequence[tuple[str, str]]) -> list[tuple[str, str]]:
        prefixes = tuple(f"{topic}/" for topic in topics)
        return [one for one in curves if one[0] in named or one[0].startswith(prefixes)]

    root = Element("root")
    files = SubElement(root, "previouslyLoaded_Datafiles")
    file = SubElement(files, "fileInfo", filename=path, prefix="")
    SubElement(
        SubElement(file, "plugin", ID="DataLoad MCAP"),
        "parameters",
        use_timestamp="0",
        use_mcap_log_time="1",
        clamp_large_arrays="0",
        max_array_size="500",
        selected_topics=";".join(topics),
    )
    equations = SubElement(root, "customMathEquations")
    for name, source in named.items():
        snippet = SubElement(equations, "snippet", name=printable(name), language="lua")
        SubElement(snippet, "global")
        SubElement(snippet, "function").text = "return value"
        SubElement(snippet, "linked_source").text = printable(source)
    window = {"name": "Main Window", "parent": "main_window"}
    tabs = SubElement(root, "tabbed_widget", window)
    for title, rows in _tabs(joints).items():
        drawn = [[(name, of) for name, curves in row if (of := there(curves))] for row in rows]
        if any(drawn):
            _add_tab(tabs, title, list(filter(None, drawn)))
    SubElement(tabs, "currentTabIndex", index="0")
    SubElement(root, "use_relative_time_offset", enabled="1")
    indent(root)
    return tostring(root, encoding="unicode", xml_declaration=True) + "\n"


def _named_curves(session: Recording, topics: Sequence[str]) -> dict[str, str]:
    """PlotJuggler's own name of each curve by joint, field and topic; only fields that are set."""
    found = {}
    for topic in _JOINT_STATES.keys() & topics:
        try:
            message = JointStates.FromString(next(session.messages(topic)).data)
        except DecodeError as error:
            raise RecordingError(
                f"The first message of {topic} in {session.path} is damaged.", RECOVER
            ) from error
        for i, joint in enumerate(message.joints):
            for field in filter(joint.HasField, _FIELDS):
                name = f"{joint.name}/{field}/{_JOINT_STATES[topic][0]}"
                found[name] = f"{topic}/joints[{i}]/{field}"
    return dict(sorted(found.items()))


def _tabs(joints: Sequence[str]) -> dict[str, list[list[_Plot]]]:
    """Rows of plots, by the title of their tab."""

    def grid(unit: str, field: str, kinds: Sequence[str]) -> list[list[_Plot]]:
        colors = dict(_JOINT_STATES.values())
        plots = [
            (
                f"{short_name(joint)}, {unit}",
                [(f"{joint}/{field}/{kind}", colors[kind]) for kind in kinds],
            )
            for joint in joints
        ]
        return [plots[:3], plots[3:]]

    def times(title: str, topic: str, fields: Sequence[str]) -> list[_Plot]:
        colors = (REFERENCE, RED, MEASURED)
        curves = [(f"{topic}/{field}_ms", c) for field, c in zip(fields, colors, strict=False)]
        return [(f"{title}, ms", curves)]

    together = ("reference", "measured", "simulated")
    phases = ", ".join(f"{phase.value} {phase.name}" for phase in Phase)
    limbs = [f"{limb}/position/{_JOINT_STATES[_LIMBS][0]}" for limb in JOINT_GROUPS]
    actions = [f"/policy/terms/action/{joint}" for joint in joints]
    return {
        "Positions": grid("rad", "position", together),
        "Torques": grid("N·m", "effort", together),
        "Error": [
            [("error by limb, RMS, rad", list(zip(limbs, LIMB_COLORS, strict=True)))],
            *grid("rad", "position", ("error",)),
        ],
        "Phase": [
            [(f"phase: {phases}", [("/reference/phase", REFERENCE)])],
            times("commands", "/timing/commands", ("interval", "latency")),
            times("states", "/timing/states", ("interval", "latency")),
        ],
        "Policy": [
            times("steps", "/policy/terms", ("delay", "state_age", "inference")),
            [("actions", list(zip(actions, (*LIMB_COLORS, RED), strict=False)))],
        ],
    }


def _add_tab(parent: Element, title: str, rows: Sequence[Sequence[_Plot]]) -> None:
    tab = SubElement(parent, "Tab", tab_name=title, containers="1")
    column = _splitter(SubElement(tab, "Container"), "-", len(rows))
    for row in rows:
        line = _splitter(column, "|", len(row))
        for name, curves in row:
            area = SubElement(line, "DockArea", name=name)
            plot = SubElement(area, "plot", style="Lines", mode="TimeSeries")
            for curve, color in curves:
                SubElement(plot, "curve", name=curve, color=color)


def _splitter(parent: Element, orientation: str, n: int) -> Element:
    """A row (|) or a column (-) of n parts with the same size."""
    sizes = ";".join([f"{1 / n:.6f}"] * n)
    return SubElement(parent, "DockSplitter", orientation=orientation, sizes=sizes, count=str(n))
