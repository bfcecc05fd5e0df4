import numpy as np
import pytest

import g1stream
from g1stream.errors import MotionError, RecordingError
from g1stream.robot.joints import JOINT_NAMES
from written_sessions import turned

RATE = 50
TIME = np.arange(200) / RATE
Q = 0.3 * np.sin(TIME[:, np.newaxis] + np.arange(29))
DQ = 0.3 * np.cos(TIME[:, np.newaxis] + np.arange(29))
TARGETS = Q + 0.05
QUAT = np.stack([np.cos(0.1 * TIME), 0 * TIME, 0 * TIME, np.sin(0.1 * TIME)], axis=1)
EPOCH = 1_700_000_000


def write_csv(path, columns, formats="%.12g"):
    table = np.column_stack(list(columns.values()))
    np.savetxt(path, table, formats, delimiter=",", comments="", header=",".join(columns))
    return path


def named(pattern, values):
    return {pattern.format(name): values[:, i] for i, name in enumerate(JOINT_NAMES)}


def has(session, **expected):
    """The measured columns of a session, and the times."""
    times = session.measured.publish_time
    np.testing.assert_allclose((times - times[0]) / 1e9, TIME, atol=2e-6)
    for name, values in expected.items():
        np.testing.assert_allclose(getattr(session.measured, name), values, atol=1e-6)


def test_columns_are_told_by_the_words_in_their_names(tmp_path):
    columns = {
        "time": TIME,
        **named("{}.q", Q),
        **named("{}_vel", DQ),
        **named("tau_est/{}", 2 * Q),
        **named("target_pos[{}]", TARGETS),
        **{f"imu_quat_{axis}": QUAT[:, i] for i, axis in enumerate("wxyz")},
        "voltage": TIME,
    }
    session = g1stream.open_session(write_csv(tmp_path / "log.csv", columns))
    has(session, q=Q, dq=DQ, tau=2 * Q, imu_quat_wxyz=QUAT)
    np.testing.assert_allclose(session.command.q, TARGETS, atol=1e-6)
    assert "unit assumed" in session.metadata["log"]["time"]
    assert session.summary().problems == []


@pytest.mark.parametrize(
    ("measured", "target"),
    [
        ("/joint_states/{joint}/position", "/joint_targets/{joint}/cmd/position"),
        ("/lowstate/motor_state[{number}]/q", "/lowcmd/motor_cmd[{number}]/q"),
        ("joint_pos_{joint}", "target.{joint}"),
    ],
)
def test_names_that_tools_give_to_columns(tmp_path, measured, target):
    columns = {"__time": TIME}
    for pattern, values in ((measured, Q), (target, TARGETS)):
        for number, joint in enumerate(JOINT_NAMES):
            columns[pattern.format(joint=joint, number=number)] = values[:, number]
    session = g1stream.open_session(write_csv(tmp_path / "log.csv", columns))
    has(session, q=Q)
    if "targets" not in target:  # a word that says nothing is not guessed at
        np.testing.assert_allclose(session.command.q, TARGETS, atol=1e-6)


@pytest.mark.parametrize(
    ("name", "factor", "start"),
    [
        ("t", 1e3, 5.0),  # ms, by its size
        ("time_ms", 1e3, 0.0),
        ("timestamp_us", 1e6, 3.0),
        ("stamp_ns", 1e9, 0.0),
        ("timestamp_ns", 1e9, 3 * 3600.0),  # since the machine was started
        ("timestamp", 1, EPOCH),
        ("timestamp", 1e9, EPOCH),
    ],
)
def test_times_are_read_in_their_unit(tmp_path, name, factor, start):
    columns = {name: np.round((start + TIME) * factor, 3), **named("{}", Q)}
    path = write_csv(tmp_path / "log.csv", columns, ["%.3f", *["%.9g"] * 29])
    session = g1stream.open_session(path)
    has(session, q=Q)
    if start == EPOCH:
        assert session.measured.publish_time[0] == EPOCH * 10**9


@pytest.mark.parametrize("column", ["q_{number}", "q{number}", "action.{joint}"])
def test_columns_that_name_no_joint_or_no_target_are_not_guessed_at(tmp_path, column):
    named_so = {
        column.format(number=number, joint=joint): TARGETS[:, number]
        for number, joint in enumerate(JOINT_NAMES)
    }
    columns = {"time": TIME, **named("{}.q", Q), **named_so}
    session = g1stream.open_session(write_csv(tmp_path / "log.csv", columns))
    has(session, q=Q)
    assert "/lowcmd" not in session.topics


@pytest.mark.parametrize(
    "name", ["action_{}", "raw_action/{}", "actions[{}]", "last_action.{}", "cmd_action_{}"]
)
def test_raw_actions_are_no_targets(tmp_path, name):
    """A network's action is (target - default) / scale; the log says which columns are not used."""
    actions = named(name, (TARGETS - 0.3) / 0.35)
    columns = {"time": TIME, **named("q_{}", Q), **actions}
    session = g1stream.open_session(write_csv(tmp_path / "log.csv", columns))
    has(session, q=Q)
    assert "/lowcmd" not in session.topics
    assert session.metadata["log"]["not used"].startswith(", ".join([*actions][:6]))
    with pytest.raises(MotionError) as refused:
        g1stream.load_motion(tmp_path / "log.csv")
    assert "g1stream attach" in refused.value.remedy


def test_joints_that_a_log_lacks_are_absent(tmp_path):
    columns = {"time": TIME} | {n: v for n, v in named("{}", Q).items() if "wrist_yaw" not in n}
    summary = g1stream.open_session(write_csv(tmp_path / "log.csv", columns)).summary()
    assert summary.absent == ["left_wrist_yaw_joint", "right_wrist_yaw_joint"]


@pytest.mark.parametrize(
    ("columns", "told"),
    [
        (named("{}", Q), "no column of increasing times"),
        ({"time": TIME[::-1], **named("{}", Q)}, "no column of increasing times"),
        ({"time": TIME, "voltage": TIME}, "no column with a joint position"),
        ({"time": TIME, "q_0": Q[:, 0], "q_1": Q[:, 1]}, "no column with a joint position"),
    ],
)
def test_what_is_no_log_is_refused(tmp_path, columns, told):
    with pytest.raises(RecordingError, match=told):
        g1stream.open_session(write_csv(tmp_path / "log.csv", columns))


@pytest.mark.parametrize("text", [b"", b"time,q_0\n", b"time,q_0\n0,1\n1,x\n", b"\xff\xfe,\n1,2\n"])
def test_broken_files_are_refused(tmp_path, text):
    (tmp_path / "log.csv").write_bytes(text)
    with pytest.raises(RecordingError):
        g1stream.open_session(tmp_path / "log.csv")


def test_joint_states_and_transforms_of_foxglove(record):
    times = EPOCH * 10**9 + np.round(TIME * 1e9).astype(np.int64)
    session = g1stream.open_session(record(times, angles=lambda i: Q[i], parts=[range(28, -1, -1)]))
    assert session.topics == {"/lowstate": 200, "/sportmodestate": 200}
    has(session, q=Q, imu_quat_wxyz=turned(200))
    np.testing.assert_allclose(session.base.position[:, 2], 0.75 + 0.0005 * np.arange(200))
    assert session.measured.publish_time[0] == EPOCH * 10**9
