import os
from pathlib import Path

from g1stream.analysis.body import Excess, TerminationMetrics
from g1stream.analysis.summary import MessageStats, SuccessMetrics, Summary, Termination, outcome
from g1stream.analysis.tracking import ErrorStats, TrackingSummary
from g1stream.realtime import Grant
from g1stream.robot.joints import JOINT_GROUPS, JOINT_NAMES
from g1stream.session.records import (
    BalanceSummary,
    FeedForwardChange,
    MotionInfo,
    Percentiles,
    PhaseInterval,
    RecorderSummary,
    StreamSummary,
    TopicDelay,
)
from g1stream.text import WIDTH
from g1stream.types import Phase

#: Lines of a small terminal.
SCREEN = 24
SNAPSHOT = Path(__file__).with_name("summary.txt")

STREAM = StreamSummary(
    reason="",
    commands=9500,
    rate_hz=496.784,
    nominal_rate_hz=500.0,
    lateness_us=Percentiles(p50=60.0, p99=117.0, p99_9=180.0, max=1734.4),
    skipped_ticks=1,
    feedforward="dynamics",
    support="hanging",
    states_received=9600,
    states_lost=None,
    realtime=[
        Grant("SCHED_FIFO", granted=False, detail="not permitted"),
        Grant("locked memory", granted=True, detail="locked"),
    ],
)
JOINTS = {
    name: ErrorStats(
        rmse_rad=0.001 * (1 + i % 7), bias_rad=0.0, max_abs_rad=0.004 * (1 + i % 7), max_abs_at_s=i
    )
    for i, name in enumerate(JOINT_NAMES)
}


def together(rmse, joints, **more):
    """The errors of several joints: the greatest is that of the worst of them."""
    worst = max((JOINT_NAMES[i] for i in joints), key=lambda name: JOINTS[name].rmse_rad)
    return JOINTS[worst].model_copy(update={"rmse_rad": rmse, "worst_joint": worst, **more})


TRACKING = TrackingSummary(
    compared_states=7000,
    excluded_states=151,
    compared_s=14.0,
    rmse_without_delay_rad=0.0031,
    rmse_without_delay_and_mean_rad=0.0024,
    all_joints=together(0.004, range(len(JOINT_NAMES)), delay_s=0.0021, delay_ci95_s=0.0003),
    limbs={
        limb: together(0.001 * (i + 2), joints)
        for i, (limb, joints) in enumerate(JOINT_GROUPS.items())
    },
    joints=JOINTS,
)


def with_delay(delay, ci95=0.0003, **more):
    errors = TRACKING.all_joints.model_copy(update={"delay_s": delay, "delay_ci95_s": ci95})
    return TRACKING.model_copy(update={"all_joints": errors, **more})


def test_a_delay_with_a_wide_interval_is_unknown():
    def told(ci95):
        text = str(
            Summary(tracking=with_delay(0.0618, ci95), topics={"/scene": MessageStats(count=1)})
        )
        (line,) = (one for one in text.splitlines() if one.startswith("delay"))
        return line

    assert "unknown" in told(0.074)
    assert "unknown" not in told(0.0003)


LATENCY = Percentiles(p50=151.2, p99=340.0, p99_9=512.0, max=12_345.6)
RECORDED = Summary(
    files_bytes={"demo-out/session_0.mcap": 8_000_000, "demo-out/session_1.mcap": 4_345_678},
    complete=True,
    first_ns=1_700_000_000_000_000_000,
    last_ns=1_700_000_019_250_000_000,
    host="bench",
    domain=1,
    interface="lo",
    versions={"g1stream": "0.1.0"},
    motion=MotionInfo(name="demo", fps=30.0, frames=421, sha256="ab" * 32),
    settings={"stream.rate": 250.0, "stream.support": "hanging"},
    gains={"kp": (40.0, 100.0), "kd": (1.0, 2.0)},
    phases=[
        PhaseInterval(phase=Phase.RAMP, start_s=-3.0, end_s=0.0),
        PhaseInterval(phase=Phase.PLAY, start_s=0.0, end_s=14.0),
    ],
    termination=Termination(reason="", played_s=14.0, motion_s=14.0),
    stream=STREAM,
    recorder=RecorderSummary(
        absent=["/secondary_imu"],
        delays={
            "/lowstate": TopicDelay(hosts=["robot"], median_ns=5, clock_offset_estimate_ns=312_345)
        },
    ),
    tracking=TRACKING,
    topics={
        "/log": MessageStats(count=12),
        "/lowcmd": MessageStats(
            count=9500,
            lost=0,
            rate_hz=496.78,
            gaps=0,
            longest_interval_s=0.0041,
            latency_us=LATENCY,
            clock_offset_s=0.0,
        ),
        "/sportmodestate": MessageStats(
            count=1, lost=3, gaps=0, latency_us=LATENCY, clock_offset_s=0.0
        ),
        "/tf": MessageStats(count=1902),
        "/tracking_error/joint_states": MessageStats(count=7151),
    },
    attachments_bytes={"robot.urdf": 41_000, "demo.csv": 412_000},
    problems=["1 tick skipped by the stream."],
)
CHANGES = [
    FeedForwardChange(motion_time_s=2.13, kind="velocity", reason="LowState is older than 0.02 s"),
    FeedForwardChange(motion_time_s=3.0, kind="dynamics"),
]
MOTION = MotionInfo(name="walk")
BALANCE = BalanceSummary(
    capture_margin_m=0.0234,
    tilt_rad=0.0184,
    height_error_m=0.0045,
    feet_error_m=0.0083,
    carried=0.836,
    lifts=4,
    unsolved_ticks=0,
)

CASES = {
    "a recorded session": RECORDED,
    "a stream without a recording": Summary(
        motion=MOTION,
        termination=Termination(reason="SIGINT", motion_s=131.5),
        stream=STREAM.model_copy(
            update={"rate_hz": None, "feedforward_changes": CHANGES, "states_lost": 2}
        ),
        problems=["The stream ended early: SIGINT."],
    ),
    "a recording only": Summary(
        termination=Termination(played_s=30.0, motion_s=14.0),
        files_bytes={"dance.mcap": 90_000},
        first_ns=0,
        last_ns=2_500_000_000,
        recorder=RecorderSummary(lost={"/lowstate": 3}),
        topics={"/lowstate": MessageStats(count=1250, lost=3), "/tf": MessageStats(count=250)},
        problems=["3 samples lost on /lowstate."],
    ),
    "nothing sent": Summary(
        termination=Termination(reason="no LowState came", played_s=0.0, motion_s=14.0),
        settings={"stream.duration": 3.0},
        stream=StreamSummary(commands=0, nominal_rate_hz=500.0, states_received=0, states_lost=0),
    ),
    "nothing received": Summary(recorder=RecorderSummary(path="a.mcap", removed=True)),
    "a killed stream, a robot without delay": Summary(
        termination=Termination(
            reason="the stream process ended without DAMP",
            undamped_in=Phase.PLAY,
            played_s=2.0,
            motion_s=14.0,
        ),
        tracking=with_delay(None, excluded_states=0),
        topics={"/scene": MessageStats(count=1)},
        problems=[f"problem {i}" for i in range(14)],
    ),
    "a policy that failed, behind its commands": Summary(
        tracking=with_delay(-0.0002),
        stream=StreamSummary(preview_s=0.002),
        success=SuccessMetrics(
            completed=True,
            links="world",
            max_link_error_mm=480.4,
            success=True,
            success_strict=False,
            success_sonic=False,
        ),
        terminations=TerminationMetrics(
            max_anchor_height_mm=80.0,
            max_gravity_difference=0.1,
            max_end_effector_height_mm=355.0,
            sonic=Excess(at_s=38.401, link="left_ankle_roll_link", height_mm=261.2),
        ),
    ),
    "a run of a few seconds that was spoilt": Summary(
        tracking=with_delay(0.0021, ci95=None, compared_s=3.0),
        success=SuccessMetrics(success=True, spoilt_by_ms=94.0),
        terminations=TerminationMetrics(
            max_anchor_height_mm=80.0,
            max_gravity_difference=1.1,
            max_end_effector_height_mm=200.0,
            sonic=Excess(at_s=3.0, link="pelvis", rotation_rad=1.0049),
        ),
    ),
    "on its feet, looped": Summary(
        termination=Termination(reason="", played_s=30.0, motion_s=14.0),
        joints=list(JOINT_NAMES[12:]),
        settings={"stream.support": "feet", "stream.joints": "arms,waist"},
        phases=[
            PhaseInterval(phase=phase, start_s=start, end_s=end)
            for phase, start, end in ((Phase.RAMP, -3.0, 0.0), (Phase.HOLD, 2.0, 5.0))
        ],
        stream=StreamSummary(
            support="feet",
            balance=BALANCE,
        ),
    ),
    "one that fell in a part of a part": Summary(
        termination=Termination(reason="SIGINT", played_s=2.0, motion_s=14.0, start_s=2.0),
        settings={"stream.duration": 6.0},
        stream=StreamSummary(
            balance=BALANCE.model_copy(
                update={"capture_margin_m": -0.012, "lifts": 1, "unsolved_ticks": 25}
            ),
        ),
    ),
    "from 2 s to the end, not recorded": Summary(
        termination=Termination(reason="", played_s=12.0, motion_s=14.0, start_s=2.0),
        tracking=with_delay(None),
        stream=STREAM,
    ),
    "a selection of a part": Summary(
        selected=True,
        termination=Termination(reason="", played_s=6.0, motion_s=14.0, start_s=2.0),
        stream=STREAM,
    ),
}


def test_the_text_is_the_snapshots_and_fits_a_terminal():
    """UPDATE_SNAPSHOTS=1 writes it anew."""
    text = "".join(
        f"=== {name}\n{case}\n--- details\n{case.details}\n" for name, case in CASES.items()
    )
    if os.environ.get("UPDATE_SNAPSHOTS"):
        SNAPSHOT.write_text(text)
    assert text == SNAPSHOT.read_text()
    lines = text.splitlines()
    assert max(map(len, lines)) <= WIDTH
    assert not any(line != line.rstrip() for line in lines)
    assert len(str(CASES["a recorded session"]).splitlines()) <= SCREEN


def test_a_motion_that_was_not_played_has_no_tracking_error_to_miss():
    assert "not played" in outcome(Summary(motion=MOTION))
    recorded = Summary(recorder=RecorderSummary(), topics={"/scene": MessageStats(count=4)})
    assert "not recorded" in outcome(recorded)
    assert "other topics" not in str(recorded)
