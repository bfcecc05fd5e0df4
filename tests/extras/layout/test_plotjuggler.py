from xml.etree import ElementTree

import pytest
from foxglove_schemas_protobuf.JointStates_pb2 import JointStates

import g1stream
from g1stream.config import Config
from g1stream.errors import ConfigError
from g1stream.extras.layout.foxglove import DEFAULT_JOINTS
from g1stream.extras.layout.plotjuggler import plotjuggler_layout
from g1stream.session.writer import SessionWriter
from known_policies import METADATA, network_of
from written_sessions import decoded


@pytest.fixture(scope="module")
def session():
    config = Config.model_validate({"stream": {"ramp": 0.5, "hold": 0.1, "damp": 0.5}})
    return g1stream.rollout("demo", support="hanging", seconds=0.5, config=config)


def selected(root):
    (parameters,) = root.findall("./previouslyLoaded_Datafiles/fileInfo/plugin/parameters")
    return parameters.get("selected_topics").split(";")


def plotted(root):
    return {curve.get("name") for curve in root.iter("curve")}


def test_every_curve_is_that_of_its_joint_in_the_messages(session):
    """A curve that a session lacks would be a dialog."""
    root = ElementTree.fromstring(plotjuggler_layout(session, "s.mcap", DEFAULT_JOINTS))
    found = {}
    for snippet in root.iter("snippet"):
        assert snippet.get("language") == "lua"
        assert snippet.findtext("function") == "return value"
        topic, _, element = snippet.findtext("linked_source").rpartition("/joints[")
        index, _, field = element.partition("]/")
        joint = JointStates.FromString(next(session.messages(topic)).data).joints[int(index)]
        assert joint.HasField(field)
        assert snippet.get("name").startswith(f"{joint.name}/{field}/")
        assert topic in selected(root)
        found[snippet.get("name")] = topic
    assert {topic for name, topic in found.items() if "left_knee_joint/position" in name} == {
        f"/{which}/joint_states" for which in ("reference", "measured", "tracking_error")
    }
    assert not [name for name in found if name.endswith("effort/error")]
    raw = {"/reference/phase"} | {
        f"/timing/{one}/{field}_ms"
        for one in ("commands", "states")
        for field in ("interval", "latency")
    }
    assert plotted(root) - found.keys() == raw
    assert {f"{joint}/effort/measured" for joint in DEFAULT_JOINTS} <= plotted(root)
    first = next(session.messages("/timing/states"))
    assert decoded("/timing/states", first.data).latency_ms > 0.0
    assert [tab.get("tab_name") for tab in root.iter("Tab")] == [
        *("Positions", "Torques", "Error", "Phase")
    ]


def test_the_selected_topics_have_numbers_to_plot(session):
    root = ElementTree.fromstring(plotjuggler_layout(session, "s.mcap", DEFAULT_JOINTS))
    left = session.topics.keys() - set(selected(root))
    assert set(selected(root)) <= session.topics.keys()
    assert left == {
        *("/scene", "/ghost/scene", "/measured/scene", "/measured/path"),
        *("/tf", "/ghost/tf", "/measured/tf", "/measured/robot_description"),
    }


def test_every_splitter_has_as_many_sizes_as_parts(session):
    root = ElementTree.fromstring(plotjuggler_layout(session, "s.mcap", DEFAULT_JOINTS))
    grid = root.find(".//Tab[@tab_name='Positions']/Container/DockSplitter")
    assert [len(row) for row in grid] == [3, 3]
    for splitter in root.iter("DockSplitter"):
        sizes = list(map(float, splitter.get("sizes").split(";")))
        assert len(sizes) == len(splitter) == int(splitter.get("count"))
        assert sum(sizes) == pytest.approx(1.0, abs=1e-5)


def test_a_session_of_a_policy_has_a_tab_for_it(tmp_path):
    onnx = pytest.importorskip("onnx")
    model = network_of()
    helper = pytest.importorskip("onnx.helper")
    helper.set_model_props(model, METADATA)
    policy = tmp_path / "policy.onnx"
    onnx.save(model, policy)
    config = Config.model_validate({"stream": {"beyond_limits": "anyway"}})
    session = g1stream.rollout("demo", policy=policy, seconds=0.5, config=config)
    root = ElementTree.fromstring(plotjuggler_layout(session, "s.mcap", DEFAULT_JOINTS))
    assert "/policy/terms" in selected(root)
    assert "/policy" not in selected(root)
    row = decoded("/policy/terms", next(session.messages("/policy/terms")).data)
    curves = {one for one in plotted(root) if one.startswith("/policy/terms/")}
    for name in curves:
        *path, field = name.removeprefix("/policy/terms/").split("/")
        assert hasattr(row.action if path else row, field)
    assert len(curves) == 3 + len(DEFAULT_JOINTS)


def test_the_command_writes_how_to_open_the_session(session, tmp_path, run):
    (tmp_path / "in").mkdir()
    path = session.save(tmp_path / "in" / "session.mcap")
    told = run("layout", "plotjuggler", path, "-o", tmp_path / "out")
    made = tmp_path / "out" / "g1stream-plotjuggler.xml"
    assert f"plotjuggler -l {made}" in told.out
    (info,) = ElementTree.parse(made).getroot().iter("fileInfo")
    assert (made.parent / info.get("filename")).samefile(path)
    assert run("layout", "plotjuggler", "-o", tmp_path).code == 2


def test_a_damaged_message_is_refused(session, tmp_path, run):
    path = tmp_path / "damaged.mcap"
    with SessionWriter(path) as writer:
        for topic in ("/lowstate", "/reference"):
            message = next(session.messages(topic))
            writer.write(topic, message.data, message.log_time, message.publish_time)
        writer.write("/measured/joint_states", b"\xff", message.log_time, message.publish_time)
    assert run("layout", "plotjuggler", path, "-o", tmp_path).code == 2


def test_a_session_without_joint_states_is_refused(tmp_path):
    config = Config.model_validate({"record": {"channels": "raw"}})
    raw = g1stream.rollout("demo", seconds=0.2, config=config)
    with pytest.raises(ConfigError):
        plotjuggler_layout(raw, "s.mcap", DEFAULT_JOINTS)
