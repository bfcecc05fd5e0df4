import json
import shutil
import struct

import numpy as np
import onnx
import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from onnx import helper, numpy_helper

import g1stream
from g1stream.cli.main import main
from g1stream.config import Config, SimConfig
from g1stream.control.loop import make_loop
from g1stream.dds.messages import LowCmd, PolicyStep
from g1stream.errors import ConfigError, RecordingError
from g1stream.extras.policy.replay import replay_policy
from g1stream.extras.policy.steps import policy_steps
from g1stream.extras.report.page import numbers
from g1stream.robot.joints import JOINT_NAMES
from g1stream.session.source import MemorySource
from g1stream.sim.robot import SensorNoise
from g1stream.types import Phase
from known_policies import DANCE, METADATA, POLICIES, needs_policies, network_of
from written_sessions import decoded

UNITREE = POLICIES / "unitree_dance1_subject2" / "policy.onnx"
TERMS = {
    "motion_command": 58,
    "motion_anchor_ori_b": 6,
    "base_ang_vel": 3,
    "joint_pos_rel": 29,
    "joint_vel_rel": 29,
    "last_action": 29,
}


def save(path, weights, **told):
    model = network_of(width=len(weights))
    model.graph.initializer[0].CopyFrom(numpy_helper.from_array(weights, "weights"))
    helper.set_model_props(model, METADATA | told)
    onnx.save(model, path)
    return path


def sizes(terms):
    """The number of values of each term that a message of /policy/terms has."""
    names = [name for name in dir(terms.observation) if not name.startswith("_")]
    return {name: n for name in names if (n := len(getattr(terms.observation, name)))}


def weights(scale=0.02, width=154):
    return np.random.default_rng(3).normal(0.0, scale, (width, 29)).astype(np.float32)


SHORT = {"stream": {"ramp": 0.5, "hold": 0.1, "damp": 0.5}}


def config(**values):
    # The actions of these policies mean nothing.
    stream = SHORT["stream"] | {"stand": 0.5, "beyond_limits": "anyway"} | values
    return Config.model_validate({"stream": stream})


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    return tmp_path_factory.mktemp("policy")


@pytest.fixture(scope="module")
def falling(place):
    """A session of a policy of an order of its own that cannot stand."""
    order = ",".join(reversed(JOINT_NAMES))
    path = save(place / "policy.onnx", weights(), joint_names=order)
    session = g1stream.rollout("demo", policy=path, config=config(), seconds=2.0)
    return g1stream.open_session(session.save(place / "falling.mcap"))


def copied(session, metadata, edit=lambda topic, i, message: message.data):
    """A copy with other metadata; `edit` gives a message's data, or None to leave it out."""
    source = MemorySource("copied")
    source.add_metadata(metadata)
    for topic in ("/lowstate", "/reference", "/lowcmd", "/sportmodestate", "/policy"):
        for i, message in enumerate(session.messages(topic)):
            if (data := edit(topic, i, message)) is not None:
                source.write(topic, data, message.log_time, message.publish_time)
    return g1stream.Session(source)


def changed(session, act, topic="/policy", step=None):
    """A copy of a session whose messages on a topic `act` has changed in place, or left out."""
    step = step or PolicyStep()

    def edit(of, i, message):
        if of != topic:
            return message.data
        step.load(message.data)
        return None if act(i, step) is False else step.tobytes()

    return copied(session, session.metadata, edit)


def test_each_step_is_in_the_session(falling):
    steps, contract = falling.policy, falling.policy_info.contract
    assert {name: at.stop - at.start for name, at in steps.terms.items()} == TERMS
    assert (steps.observation.shape, steps.observation.dtype) == ((len(steps), 154), np.float32)
    assert steps.step.tolist() == list(range(len(steps)))
    assert np.unique(np.diff(steps.publish_time)).tolist() == [20_000_000]
    assert steps.action[0] == pytest.approx((steps.observation[0] @ weights())[::-1], abs=1e-4)
    np.testing.assert_array_equal(steps.observation[1:, -29:], steps.action[:-1, ::-1])
    assert contract["joint_names"] == list(JOINT_NAMES[::-1])
    part = steps[steps.step < 5]
    assert (len(part), part.observation.shape, part.terms) == (5, (5, 154), steps.terms)


def test_a_step_has_the_time_of_its_command_and_of_the_state_that_it_observed(falling):
    steps, reference, measured = falling.policy, falling.reference, falling.measured
    beside = np.searchsorted(reference.publish_time, steps.publish_time)
    np.testing.assert_array_equal(reference.publish_time[beside], steps.publish_time)
    np.testing.assert_array_equal(reference.tick[beside], steps.tick)
    # In lockstep a state comes 1 ms before the tick that takes it, for the command of the next one.
    assert np.unique(steps.delay).tolist() == [0.003]
    assert np.isin(steps.state_published.astype(np.int64), measured.publish_time).all()
    assert (steps.inference_time == 0.0).all()
    target = np.array(METADATA["default_joint_pos"].split(","), float) + 0.5 * steps.action
    np.testing.assert_allclose(falling.command.q[beside][0], target[0], atol=1e-5)


def test_a_table_names_terms_and_joints(falling):
    pytest.importorskip("pandas")
    table = falling.to_dataframe("/policy")
    steps = falling.policy
    np.testing.assert_array_equal(table["base_ang_vel.2"], steps.observation[:, 66])
    np.testing.assert_array_equal(table["action.left_knee_joint"], steps.action[:, 3])
    assert len(table.columns) == 2 + 9 + 154 + 29


def test_a_step_recorded_with_room_for_1024_values_is_read(falling, place):
    """Its fields are those of the IDL of that time, one after the other."""
    now, before = struct.Struct("<3Q3d3I2048f29f"), struct.Struct("<3Q3d3I1024f29f")

    def edit(topic, _, message):
        if topic != "/policy":
            return message.data
        values = now.unpack(message.data[4:])
        return message.data[:4] + before.pack(*values[: 9 + 1024], *values[9 + 2048 :])

    written = copied(falling, falling.metadata, edit).save(place / "earlier.mcap")
    earlier = g1stream.open_session(written)
    for name in ("tick", "state_published", "motion_time", "step", "observation", "action"):
        np.testing.assert_array_equal(getattr(earlier.policy, name), getattr(falling.policy, name))
    with earlier.save(place / "again.mcap").open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        steps = [value for *_, value in reader.iter_decoded_messages(["/policy"])]
    np.testing.assert_array_equal(steps[-1].observation[:154], falling.policy.observation[-1])
    np.testing.assert_array_equal(steps[-1].action, falling.policy.action[-1])


def test_a_wide_observation_that_repeats_terms_is_replayed(place):
    model = network_of(width=1432)
    model.graph.initializer[0].CopyFrom(numpy_helper.from_array(weights(2e-3, 1432), "weights"))
    onnx.save(model, path := place / "wide.onnx")
    session = g1stream.rollout("demo", policy=path, config=config(), seconds=1.0)
    assert session.policy.observation.shape[1] == 1432
    found = replay_policy(session)
    assert (found.same, found.differing, found.rebuilt) == (True, 0, len(session.policy))
    wider = changed(session, lambda _, step: step.observation.__setitem__(1000, 3.0))
    named = [name for name, one in replay_policy(wider).terms.items() if one.step is not None]
    assert named == ["repeated.2"]


def test_a_session_without_a_policy_has_none():
    session = g1stream.rollout("demo", config=Config.model_validate(SHORT), seconds=0.2)
    assert session.policy is None
    assert session.policy_info is None
    assert policy_steps(session) is None
    assert not {"/policy", "/policy/terms"} & set(session.topics)
    assert "policy.json" not in session.attachments
    with pytest.raises(RecordingError):
        replay_policy(session)


def test_another_reader_reads_the_channel_and_what_the_policy_is(falling):
    found = {"/policy": [], "/policy/terms": []}
    with falling.path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        for _, channel, message, value in reader.iter_decoded_messages(list(found)):
            found[channel.topic].append((message.publish_time, value))
        (attached,) = (one for one in reader.iter_attachments() if one.name == "policy.json")
    steps = falling.policy
    raw, named = found["/policy"], found["/policy/terms"]
    assert [time for time, _ in raw] == [time for time, _ in named] == steps.publish_time.tolist()
    for i in (0, 1, len(steps) - 1):
        assert raw[i][1].n_observation == 154
        np.testing.assert_array_equal(raw[i][1].observation[:154], steps.observation[i])
        np.testing.assert_array_equal(raw[i][1].action, steps.action[i])
        assert sizes(named[i][1]) == TERMS
        observed = [getattr(named[i][1].observation, name) for name in TERMS]
        np.testing.assert_array_equal(np.concatenate(observed), steps.observation[i])
        action = [getattr(named[i][1].action, name) for name in JOINT_NAMES]
        np.testing.assert_array_equal(action, steps.action[i])
        assert named[i][1].delay_ms == 3.0
    told = json.loads(attached.data)
    assert told["sha256"] == falling.policy_info.sha256
    assert [term["name"] for term in told["contract"]["terms"]] == list(TERMS)


@pytest.mark.parametrize(
    "told",
    [
        {},
        {"policy": {"contract": {"terms": 5}}},
        {"policy": {"contract": {"terms": [{"name": "a"}]}}},
        {"policy": {"contract": {"terms": [{"name": "a", "size": -1}]}}},
    ],
)
def test_a_recorder_may_say_nothing_or_anything_of_the_policy(falling, place, told):
    session = copied(falling, told)
    assert dict(session.policy.terms) == {}
    assert session.policy.observation.shape[1] == 154
    if told:
        assert policy_steps(session).terms == {}
    else:
        assert replay_policy(session, place / "policy.onnx").same
        with pytest.raises(ConfigError):
            replay_policy(session)


def test_the_recorded_observations_give_the_recorded_actions(falling, capsys):
    found = replay_policy(falling)
    assert (found.differing, found.first, found.same, found.same_file) == (0, None, True, True)
    assert found.rebuilt == found.steps == len(falling.policy)
    assert found.left_out == {}
    assert list(found.terms) == list(TERMS)
    assert max(one.max_abs for one in found.terms.values()) < 1e-5
    assert main(["policy", "--replay", str(falling.path), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert (told["same"], told["differing"], told["steps"]) == (True, 0, len(falling.policy))


def sent_otherwise(session, act):
    """A copy of a session whose commands `act` has changed in place."""

    def sealed(_, command):
        act(command)
        command.seal()

    return changed(session, sealed, "/lowcmd", LowCmd())


def test_the_commands_are_those_of_the_policy(falling):
    found = replay_policy(falling)
    assert list(found.sent) == ["q", "dq", "tau", "kp", "kd"]
    assert [one.joint for one in found.sent.values()] == [None] * 5
    assert found.sent["kp"].share == found.sent["kd"].share == found.sent["tau"].share == 1.0


@pytest.mark.parametrize(
    ("wrong", "quantity", "difference"),
    [
        (lambda c: c.q.__iadd__(np.float32(0.2)), "q", 0.2),
        (lambda c: c.q.__setitem__(slice(12), np.roll(c.q[:12], 6)), "q", None),  # legs exchanged
        (lambda c: c.kp.__imul__(np.float32(2.0)), "kp", None),
        (lambda c: c.kd.__imul__(np.float32(0.0)), "kd", None),
        (lambda c: c.tau.__setitem__(3, 20.0), "tau", 20.0),
        (lambda c: c.dq.__setitem__(3, 1.0), "dq", 1.0),
    ],
)
def test_what_was_sent_otherwise_is_named(falling, wrong, quantity, difference):
    found = replay_policy(sent_otherwise(falling, wrong))
    assert not found.differing  # the recorded actions are as they were
    assert [name for name, one in found.sent.items() if one.joint] == [quantity]
    assert not found.same
    if difference is not None:
        assert found.sent[quantity].difference == pytest.approx(difference, abs=1e-3)


def test_the_first_other_action_is_named(falling):
    def act(i, step):
        if i >= 3:
            step.action[7] = np.nextafter(step.action[7], np.float32(np.inf))

    found = replay_policy(changed(falling, act))
    assert found.differing == found.steps - 3
    assert (found.first.step, found.first.joint) == (3, JOINT_NAMES[7])
    assert found.first.recorded == np.nextafter(
        np.float32(found.first.replayed), np.float32(np.inf)
    )
    assert found.first.time_s == pytest.approx(falling.policy.time[3])


def test_a_term_that_was_computed_otherwise_is_named(falling):
    def act(i, step):
        if i >= 4:
            step.observation[64:67] *= 0.25

    found = replay_policy(changed(falling, act))
    beyond = {name: one.step for name, one in found.terms.items() if one.step is not None}
    assert beyond == {"base_ang_vel": 4}
    assert not found.same
    turning = np.abs(falling.policy.observation[4:, 64:67]).max()
    assert found.terms["base_ang_vel"].max_abs == pytest.approx(0.75 * turning, rel=1e-4)


def test_a_lost_step_and_a_state_that_is_not_known_leave_out_what_needs_them(falling):
    def unknown(i, step):
        if i == 5:
            step.state_published[()] = 0

    found = replay_policy(changed(falling, unknown))
    assert (found.rebuilt, sum(found.left_out.values()), found.same) == (found.steps - 1, 1, True)
    found = replay_policy(changed(falling, lambda i, _: i != 5))
    assert (found.rebuilt, found.steps) == (found.steps - 1, len(falling.policy) - 1)
    assert (found.same, found.differing) == (True, 0)
    found = replay_policy(changed(falling, lambda i, _: i > 0))
    assert found.rebuilt == 0  # the alignment of the motion with the robot is unknown


def test_observations_with_a_history_are_recomputed(place):
    told = {"observation_history_lengths": "1,1,1,1,5,1"}
    path = save(place / "history.onnx", weights(width=154 + 4 * 29), **told)
    session = g1stream.rollout("demo", policy=path, config=config(), seconds=1.0)
    steps = session.policy
    assert steps.observation[:, steps.terms["joint_vel_rel"]].shape[1] == 5 * 29
    row = next(iter(session.messages("/policy/terms")))
    assert sizes(decoded("/policy/terms", row.data)) == TERMS
    replayed = replay_policy(session)
    assert (replayed.rebuilt, replayed.same) == (len(steps), True)
    replayed = replay_policy(changed(session, lambda i, _: i != 4))
    assert (replayed.rebuilt, replayed.same) == (replayed.steps - 5, True)
    later = session.sel(time=slice(float(steps.time[10]) - 0.001, None))
    assert replay_policy(later).rebuilt == 0  # what is before the part is unknown
    figures = policy_steps(session).terms["joint_vel_rel"]
    newest = steps.observation[:, steps.terms["joint_vel_rel"]][:, -29:]
    assert figures.std == pytest.approx(float(newest.astype(np.float64).std()))


def test_the_command_refuses_other_policies(falling, place):
    replay = "--replay", str(falling.path)
    other = save(place / "other.onnx", weights() + np.float32(0.01))
    assert main(["policy", str(other), *replay]) == 1
    narrow = place / "narrow.onnx"
    onnx.save(network_of(width=160), narrow)
    for wrong in ((str(narrow), *replay), (), (*replay, "--motion", "demo")):
        assert main(["policy", *wrong]) == 2


def test_a_file_that_has_changed_or_gone_is_no_default(falling, place, tmp_path):
    path = place / "policy.onnx"
    kept = shutil.copy(path, tmp_path / "kept.onnx")
    try:
        save(path, weights(0.03))
        with pytest.raises(ConfigError):
            replay_policy(falling)
        assert replay_policy(falling, path).same_file is False
        path.unlink()
        with pytest.raises(ConfigError):
            replay_policy(falling)
        assert replay_policy(falling, kept).same
    finally:
        shutil.copy(kept, path)


def nan_where_it_turns(path):
    """A policy that holds the default pose, and gives NaN where the pelvis turns by 1 rad/s."""
    model, pick = network_of(), np.zeros((154, 1), np.float32)
    pick[65] = 1.0  # about the lateral axis
    constants = {"pick": pick, "one": np.float32(1.0), "none": np.zeros((1, 29), np.float32)}
    nodes = ["MatMul obs pick turn", "Mul turn turn square", "Sub one square left"]
    nodes += ["Sqrt left root", "MatMul root none actions"]
    del model.graph.initializer[:], model.graph.node[:]
    for name, value in constants.items():
        model.graph.initializer.append(numpy_helper.from_array(np.asarray(value), name))
    for kind, *takes, gives in map(str.split, nodes):
        model.graph.node.append(helper.make_node(kind, takes, [gives]))
    helper.set_model_props(model, METADATA)
    onnx.save(model, path)
    return path


def test_actions_that_are_not_finite_are_told_and_repeated(place):
    path = nan_where_it_turns(place / "nan.onnx")
    session = g1stream.rollout("demo", policy=path, config=config(), seconds=1.0)
    steps = session.policy
    wrong = np.flatnonzero(steps.repeated)
    assert steps.repeated[wrong].tolist() == [1, 2, 3]
    assert np.isnan(steps.action[wrong]).all()
    assert np.isfinite(steps.action[: wrong[0]]).all()
    assert np.isfinite(steps.observation).all()
    found = replay_policy(session)
    assert (found.differing, found.rebuilt, found.same) == (0, len(steps), True)
    assert policy_steps(session).repeated == 3
    rows = [decoded("/policy/terms", message.data) for message in session.messages("/policy/terms")]
    assert all(np.isnan(getattr(rows[wrong[0]].action, name)) for name in JOINT_NAMES)


def test_a_fall_is_found_and_what_came_before_it(falling):
    found = policy_steps(falling)
    fall, steps = found.fall, falling.policy
    assert 0.0 < fall.time_s < float(steps.time[-1]) + 0.1
    window = min(2.0, 0.5 * (fall.time_s - float(steps.time[0])))
    times = [sign.time_s for sign in fall.signs]
    assert times == sorted(times)
    assert all(fall.time_s - window - 0.02 <= time <= fall.time_s for time in times)
    kinds = [sign.kind for sign in fall.signs]
    assert len(set(kinds)) == len(kinds)
    assert {"term", "action"} & set(kinds)
    assert (found.step_s, found.late, found.delay_s.max) == (0.02, 0, 0.003)
    assert set(found.terms) == set(TERMS)
    assert found.terms["joint_vel_rel"].deviation > 2.0
    (told,) = numbers(falling)["sessions"]
    assert told["policy"]["fall"]["time_s"] == fall.time_s


def test_a_gap_of_lowstate_before_the_fall_is_the_first_sign(falling):
    fall = policy_steps(falling).fall
    since = falling.start_ns + round(1e9 * (fall.time_s - 0.15))

    def edit(topic, i, message):
        gap = topic == "/lowstate" and 0 <= message.publish_time - since < 50_000_000
        return None if gap else message.data

    signs = policy_steps(copied(falling, falling.metadata, edit)).fall.signs
    (gap,) = (sign for sign in signs if sign.kind == "time")
    assert gap.time_s == pytest.approx(fall.time_s - 0.1, abs=0.005)


def test_the_page_has_the_policy(falling, tmp_path):
    text = g1stream.report.report(falling, tmp_path / "report.html").read_text()
    fall = policy_steps(falling).fall
    assert f"The robot fell at {fall.time_s:.2f} s" in text
    assert 'data-key="sessions.0.policy.terms.joint_vel_rel.std"' in text
    assert 'data-key="sessions.0.policy.delay_s.max"' in text


def test_terms_of_two_sessions_are_compared(falling, place):
    noise = SensorNoise(seed=2)
    other = g1stream.rollout(
        "demo", policy=place / "policy.onnx", config=config(), seconds=2.0, noise=noise
    )
    found = g1stream.report.compare(falling, other)
    names = [*TERMS, "action"]
    assert set(found.terms) == {f"{what} of {name}" for what in ("mean", "std") for name in names}
    assert found.terms["std of base_ang_vel"].base > 0.0
    assert list(found.terms_apart) == names
    assert found.terms_apart["motion_command"] < 1e-3
    assert found.terms_apart["base_ang_vel"] > 0.005  # white noise of 0.01 rad/s alone
    ours, theirs = falling.policy, other.policy
    n = min(len(ours), len(theirs))
    assert np.abs(ours.time[:n] - theirs.time[:n]).max() < 1e-6
    apart = (ours.action[:n] - theirs.action[:n])[ours.time[:n] >= found.start_s]
    assert found.terms_apart["action"] == pytest.approx(float(np.sqrt((apart**2).mean())), rel=0.1)
    assert f"action {found.terms_apart['action']:.3g}" in " ".join(str(found).split())


def test_a_part_that_begins_after_the_fall(falling, monkeypatch):
    end = float(falling.policy.time[0]) - 0.01
    monkeypatch.setattr("g1stream.extras.policy.steps._fall", lambda _: (end, "the tilt"))
    found = policy_steps(falling)
    assert (found.fall.time_s, found.fall.signs) == (end, None)
    assert "before" in str(found.fall)
    assert all(np.isfinite(one.std) for one in found.terms.values())


@needs_policies
def test_after_an_early_end_the_observations_are_those_of_the_way_down(monkeypatch):
    loops = []

    def kept(*arguments, **others):
        loops.append(make_loop(*arguments, **others))
        return loops[0]

    def stopping(_):
        if loops[0].motion_time > 1.5 and not loops[0].stop_requests:
            loops[0].request_stop("SIGINT")

    monkeypatch.setattr("g1stream.app.rollout.make_loop", kept)
    session = g1stream.rollout(DANCE, policy=UNITREE, config=config(duration=4.0), noise=stopping)
    assert session.summary().termination.reason == "SIGINT"
    # 4 s, and 0.5 s of standing and 1 s of blend at each end. It is ended after 1.5 s of these.
    assert session.metrics().success.progress == pytest.approx(1.5 / 7.0, abs=0.02)
    replayed = replay_policy(session)
    down = next(one.start_s for one in session.phases if one.phase is Phase.HOLD)
    assert (session.policy.time < down).sum() - 5 < replayed.rebuilt < len(session.policy)
    assert replayed.same


@needs_policies
def test_a_policy_that_stands_has_no_fall():
    motion = g1stream.load_motion(DANCE).trim(0.0, 2.0)
    delayed = config().model_copy(update={"sim": SimConfig(command_delay=0.004)})
    dance = g1stream.rollout(motion, policy=UNITREE, config=delayed)
    summary, found = dance.summary(), policy_steps(dance)
    assert summary.termination.reason == ""
    stream = summary.stream
    assert (stream.support, stream.feedforward, stream.preview_s) == ("free", None, None)
    assert dance.tracking().overall < 0.2
    assert dance.base.position[:, 2][dance.base.time < 3.0].min() > 0.6
    assert found.fall is None
    assert found.late == found.repeated == 0
    assert {one.phase for one in dance.phases} >= {Phase.PLAY, Phase.HOLD}
    replayed = replay_policy(dance)
    assert replayed.same
    assert replayed.rebuilt == len(dance.policy)
    assert dance.policy_info.data_sha256
