import json
import re

import numpy as np
import pytest

import g1stream
from g1stream.app.session import Session
from g1stream.cli.main import main
from g1stream.errors import RecordingError
from g1stream.extras.report.comparison import differences, ranked, verdict
from g1stream.session.source import MemorySource
from g1stream.session.writer import SessionWriter
from g1stream.testing import SyntheticSession


def session(**wrong):
    source = MemorySource()
    SyntheticSession(**{"seconds": 1.0} | wrong).write(source)
    return Session(source)


def runs(levels):
    """Sessions whose error varies by some 3 % from run to run."""
    rng = np.random.default_rng(5)
    return [
        [session(bias=level * (1 + 0.03 * x), noise=1e-4) for x in rng.standard_normal(4)]
        for level in levels
    ]


def test_several_sessions_show_their_spread():
    found = g1stream.report.compare(*runs((0.010, 0.013)))
    rmse = found.metrics["rmse"]
    assert rmse.change == pytest.approx(0.3, abs=0.05)
    spreads = [max(values) - min(values) for values in (rmse.base_values, rmse.other_values)]
    assert rmse.spread == max(spreads)
    assert 0.0 < rmse.spread < rmse.difference
    assert f"{rmse.spread:.2g} rad" in verdict(found)
    (line,) = (one for one in str(found).splitlines() if one.startswith("rmse "))
    assert line.split()[-1] == f"{rmse.spread:.2g}"
    assert max(map(len, str(found).splitlines())) <= 80


def test_one_session_a_side_has_none():
    found = g1stream.report.compare(session(bias=0.01), session(bias=0.02))
    assert found.metrics["rmse"].other == pytest.approx(2 * found.metrics["rmse"].base, rel=1e-3)
    assert found.metrics["rmse"].spread is None
    assert max(map(len, str(found).splitlines())) <= 80


def test_joints_are_ranked_by_the_difference_and_not_by_its_share():
    base = {"waist_yaw_joint": 1e-9, "left_knee_joint": 0.02, "right_knee_joint": 0.03}
    other = {"waist_yaw_joint": 1e-7, "left_knee_joint": 0.025, "right_knee_joint": 0.031}
    found = differences([[base], [other]], {})
    assert list(ranked(found)) == ["left_knee_joint", "right_knee_joint", "waist_yaw_joint"]


def test_the_verdict_has_the_digits_that_a_difference_needs():
    found = g1stream.report.compare(session(bias=0.01), session(bias=0.02))
    for base, other, figures in ((0.05523, 0.05501, 2), (1.20001, 1.20002, 2), (0.5, 0.5, 1)):
        found.metrics = differences([[{"rmse": one}] for one in (base, other)], {})
        shown = {float(one) for one in re.findall(r"\d\.\d+(?= rad| \()", verdict(found))}
        assert len(shown) == figures


def test_a_share_of_what_has_a_sign_or_is_zero_says_nothing():
    found = g1stream.report.compare(session(delay=0.001), session(delay=0.004)).metrics["delay"]
    assert found.change is None
    assert found.difference == pytest.approx(0.003, abs=2e-4)
    assert differences([[{"x": 0.0}], [{"x": 2.0}]], {})["x"].change is None
    assert differences([[{"x": 4.0}], [{"x": 2.0}]], {})["x"].change == -0.5


def test_a_run_counts_once(tmp_path):
    """A rollout made twice has the same measurements, whatever else is in its file."""
    once, again, other = session(), session(metadata={"host": "another"}), session(bias=0.02)
    for sides in (([once, again], [other]), ([other], [once, other, again])):
        with pytest.raises(RecordingError, match="the same run"):
            g1stream.report.compare(*sides)
    assert (
        g1stream.report.compare([once, other], [again, session(bias=0.03)]).metrics["rmse"].spread
        > 0.0
    )


def test_only_the_common_part_is_compared():
    found = g1stream.report.compare(
        session(seconds=2.0, bias=0.01), session(seconds=4.0, bias=0.01)
    )
    assert (found.start_s, found.stop_s) == pytest.approx((0.0, 2.0), abs=0.01)
    assert found.metrics["rmse"].change == pytest.approx(0.0, abs=1e-3)


def test_another_motion_is_refused(monkeypatch):
    first = session()
    monkeypatch.setattr(
        SyntheticSession, "joints", lambda self, time, late=0.0: np.zeros((3, len(time), 29))
    )
    with pytest.raises(RecordingError):
        g1stream.report.compare(first, session())


@pytest.mark.slow
def test_only_joints_that_play_in_all_sessions_count(short):
    left, arms, right = (
        g1stream.rollout("demo", joints=joints, seconds=0.3, config=short)
        for joints in ("left_arm", "arms", "right_arm")
    )
    found, alone = g1stream.report.compare(left, arms), arms.tracking().rmse[15:22]
    assert list(found.limbs) == ["left_arm"]
    assert len(found.joints) == 7
    assert found.metrics["rmse"].base == left.tracking().overall
    assert found.metrics["rmse"].other == pytest.approx(np.sqrt(np.mean(alone**2)))
    with pytest.raises(RecordingError, match="No joint"):
        g1stream.report.compare([left, arms], right)


def test_what_differs_is_said():
    gains = {"kp": [60.0] * 29, "kd": [1.0] * 29}
    soft = {"kp": [40.0] * 29, "kd": [1.0] * 29}
    soft["kp"][:12] = [50.0] * 12
    soft["kp"][12] = soft["kp"][25] = 60.0
    stream = {"feedforward": "dynamics", "support": "bolted", "nominal_rate_hz": 500.0}
    first = session(metadata={"gains": gains, "stream": stream})
    other = session(metadata={"gains": soft, "stream": stream | {"feedforward": "velocity"}})
    assert g1stream.report.compare(first, other).differs == {
        "feed-forward": ("dynamics", "velocity"),
        **dict.fromkeys(("gains.kp of left_leg", "gains.kp of right_leg"), ("60", "50")),
        "gains.kp of waist": ("60", "60, 40"),
        "gains.kp of left_arm": ("60", "40"),
        "gains.kp of right_arm": ("60", "40, 60"),
    }


def test_the_command(tmp_path, capsys):
    paths = []
    for name, bias in (("a", 0.01), ("b", 0.02)):
        paths.append(str(tmp_path / f"{name}.mcap"))
        with SessionWriter(paths[-1]) as writer:
            SyntheticSession(1.0, bias=bias).write(writer)
    given = ["compare", paths[0], "--with", paths[1]]
    assert main(given) == 0
    assert main([*given, "--fail-if", "rmse > 1.1 * base"]) == 1
    assert "FAILED: rmse > 1.1 * base holds" in capsys.readouterr().out
    assert main([*given, "-q", "--fail-if", "rmse > 1.1 * base"]) == 1
    quiet = capsys.readouterr()
    assert (quiet.out, quiet.err.count("FAILED: rmse > 1.1 * base holds")) == ("", 1)
    assert main([*given, "--fail-if", "rmse < 1 * base"]) == 0
    assert "passed: rmse < 1 * base does not hold" in capsys.readouterr().out
    assert main([*given, "--fail-if", "rmse < 1 * base", "--fail-if", "rmse > 0.015"]) == 1
    assert main([*given, "--fail-if", "torque_use > 1e9"]) == 1  # the sessions have no such metric
    assert "is unknown, because not all sessions have torque_use" in capsys.readouterr().out
    assert main([*given, "--fail-if", "p.rmse < 0.05"]) == 2
    assert main(["compare", paths[0]]) == 2
    assert main([*given, "--fail-if", "rmse"]) == 2
    capsys.readouterr()
    assert main([*given, "--json", "--fail-if", "rmse > 1 * base"]) == 1
    assert '"failed": true' in capsys.readouterr().out


def test_sessions_without_a_common_part_are_refused():
    whole = session(seconds=4.0, bias=0.01)
    early, late = whole.sel(time=slice(0.0, 1.0)), whole.sel(time=slice(3.0, None))
    with pytest.raises(RecordingError):
        g1stream.report.compare(whole, [early, late])
    with pytest.raises(RecordingError):  # they only touch
        g1stream.report.compare(early, whole.sel(time=slice(0.95, None)))
    found = g1stream.report.compare(early, whole.sel(time=slice(0.85, None)))
    assert found.stop_s - found.start_s == pytest.approx(0.15, abs=0.01)
    assert found.metrics["rmse"].base == pytest.approx(0.01, rel=0.1)


def ended(played, reason="", *, support="bolted", **wrong):
    """A session of a motion of 2 s of which `played` s were played, and why it ended."""
    stream = {"reason": reason, "support": support, "commands": 1000}
    metadata = {"stream": stream, "motion": {"name": "dance", "fps": 30.0, "frames": 61}}
    return session(seconds=played, metadata=metadata, **wrong)


WHOLE = {"completed": 1.0, "played": 1.0, "success": 1.0}


@pytest.mark.parametrize(
    ("run", "as_asked"),
    [
        (ended(2.0, bias=0.02), WHOLE),
        (ended(1.2, "SIGINT"), {"completed": 0.0, "played": 0.6, "success": 0.0}),
        (ended(2.0, "SIGTERM"), WHOLE | {"completed": 0.0, "success": 0.0}),  # in HOLD
        (ended(1.2, None), {"completed": None, "played": 0.6}),  # its recorder was killed
        (ended(2.0, support="free", gaps=((1.0, 0.06),)), WHOLE | {"completed": 0.0}),  # void
    ],
)
@pytest.mark.parametrize("side", [0, 1])
def test_a_run_that_was_not_played_as_asked_is_in_the_verdict(run, as_asked, side):
    sides = [ended(2.0, bias=0.01), run]
    found = g1stream.report.compare(*(sides if side else reversed(sides)))
    expected = {name: value for name, value in as_asked.items() if value is not None}
    assert found.as_asked == pytest.approx(expected, abs=0.01)
    short = min(expected.values()) < 1.0
    assert list(found.incomplete) == [str(run.path)] * short
    assert all(reason in verdict(found) for reason in found.incomplete.values())


def test_what_is_not_known_of_a_log_does_not_count_against_it():
    found = g1stream.report.compare(session(bias=0.01), session(bias=0.02))
    assert (found.as_asked, found.incomplete) == ({}, {})
    part = ended(2.0, bias=0.01).sel(time=slice(0.0, 1.5))
    found = g1stream.report.compare(ended(2.0, bias=0.03), part)
    assert (found.as_asked, found.incomplete) == ({"completed": 1.0, "success": 1.0}, {})


def test_a_run_that_was_stopped_fails_whatever_its_error_is(tmp_path, capsys):
    for name, played, reason in (("whole", 2.0, ""), ("stopped", 1.2, "SIGINT")):
        run = ended(played, reason, bias=0.02 if name == "whole" else 0.01)
        run.save(tmp_path / f"{name}.mcap")
    whole, stopped = (str(tmp_path / f"{name}.mcap") for name in ("whole", "stopped"))
    smaller = ["--fail-if", "rmse > 1.1 * base"]
    assert main(["compare", whole, "--with", stopped]) == 0  # nothing was tested
    for sides in ((whole, stopped), (stopped, whole)):
        assert main(["compare", sides[0], "--with", sides[1], "--fail-if", "rmse > 1"]) == 1
    assert main(["compare", whole, "--with", stopped, *smaller]) == 1
    assert main(["compare", whole, "--with", stopped, *smaller, "--fail-if", "played < 0.5"]) == 0
    for condition in ("played < 0.7", "completed < 1", "success < 1"):
        assert main(["compare", whole, "--with", stopped, "--fail-if", condition]) == 1
    assert main(["compare", whole, "--with", stopped, "--fail-if", "played < 1 * base"]) == 2
    capsys.readouterr()
    assert main(["compare", whole, "--with", stopped, "--json", *smaller]) == 1
    document = json.loads(capsys.readouterr().out)
    assert document["failed"] is True
    assert list(document["incomplete"]) == [stopped]
