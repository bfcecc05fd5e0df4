import re
from typing import Any

import pytest
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory as ProtobufDecoderFactory
from mcap_ros2.decoder import DecoderFactory as Ros2DecoderFactory

import g1stream
from g1stream.config import Config
from g1stream.extras.layout.foxglove import DEFAULT_JOINTS, foxglove_layout
from g1stream.extras.layout.layout_cli import worst_joints
from g1stream.robot.joints import JOINT_NAMES, TORQUE_LIMIT
from g1stream.robot.model import G1

PATH = re.compile(r'(/[\w/]+)\.(?:joints\[:\]\{name=="(\w+)"\}\.)?(\w+)')


@pytest.fixture(scope="module")
def session():
    config = Config.model_validate({"stream": {"ramp": 0.5, "hold": 0.1, "damp": 0.5}})
    return g1stream.rollout("demo", support="hanging", seconds=0.5, config=config)


@pytest.fixture(scope="module")
def decoded(session, tmp_path_factory) -> dict[str, list[Any]]:
    """By topic, the first messages of the session, decoded by official packages."""
    path = tmp_path_factory.mktemp("layouts") / "session.mcap"
    session.save(path)
    found: dict[str, list[Any]] = {}
    factories = [ProtobufDecoderFactory(), Ros2DecoderFactory()]
    with path.open("rb") as file:
        reader = make_reader(file, decoder_factories=factories)
        for schema, channel, message in reader.iter_messages():
            messages = found.setdefault(channel.topic, [])
            if len(messages) < 50:
                made = (one.decoder_for(channel.message_encoding, schema) for one in factories)
                messages.append(next(filter(None, made))(message.data))
    return found


def series(layout: dict[str, Any]) -> list[str]:
    return [
        path["value"]
        for name, panel in layout["configById"].items()
        if name.startswith(("Plot", "StateTransitions"))
        for path in panel["paths"]
    ]


def names_in(tree: Any) -> set[str]:
    if isinstance(tree, str):
        return {tree}
    return names_in(tree["first"]) | names_in(tree["second"])


def placed(layout: dict[str, Any]) -> set[str]:
    trees = [layout["layout"]]
    trees += [tab["layout"] for tab in layout["configById"]["Tab!joints"]["tabs"]]
    return set().union(*map(names_in, trees))


def test_every_series_is_in_the_messages(session, decoded):
    layout = foxglove_layout(worst_joints(session, 6))
    limits = []
    for value in series(layout):
        match = PATH.fullmatch(value)
        if match is None:
            limits.append(float(value))
            continue
        topic, name, field = match.groups()
        if name:
            (one,) = (joint for joint in decoded[topic][0].joints if joint.name == name)
            assert one.HasField(field)
        elif field == "phase":
            assert decoded[topic][0].phase == 1  # RAMP
        else:
            assert hasattr(decoded[topic][0], field)
    robot = G1.default()
    expected = {
        sign * robot.torque_limit[JOINT_NAMES.index(joint)]
        for joint in worst_joints(session, 6)
        for sign in (1, -1)
    }
    assert set(limits) == expected
    assert max(expected) <= max(TORQUE_LIMIT)


def test_every_panel_is_placed_and_every_scene_is_a_topic(decoded):
    layout = foxglove_layout(DEFAULT_JOINTS)
    assert placed(layout) == set(layout["configById"])
    robot = layout["configById"]["3D!robot"]
    assert set(robot["topics"]) <= set(decoded)
    frames = {
        transform.child_frame_id
        for topic in ("/tf", "/measured/tf", "/ghost/tf")
        for transform in decoded[topic][0].transforms
    }
    assert {name.removeprefix("frame:") for name in robot["transforms"]} == {*frames, "world"}
    assert robot["followTf"] in frames


def test_the_worst_joints_come_first(session):
    rmse = session.tracking().rmse
    worst = [JOINT_NAMES.index(name) for name in worst_joints(session, 6)]
    assert len(worst) == 6
    assert rmse[worst[0]] == rmse.max()
    assert (rmse >= rmse[worst[-1]]).sum() == 6
    assert worst_joints(session.sel(phase="RAMP"), 6) == ()
