import json
from hashlib import sha256
from pathlib import Path

import pytest

import g1stream
from g1stream.cli.main import main
from g1stream.config import load_config
from g1stream.errors import ConfigError
from g1stream.extras.library.compute import LibraryCase
from known_policies import DANCE, POLICIES, needs_policies

HOLOSOMA = POLICIES / "holosoma_dance1_subject2.onnx"


def case(path, out="out", **over):
    config = load_config(over={"stream.policy": str(path), **over})
    return LibraryCase("simulate", Path(out), config, "free")


@pytest.fixture
def file(tmp_path):
    """Writes a file that is no policy, and returns its path."""

    def write(name, text="no policy"):
        path = tmp_path / name
        path.parent.mkdir(exist_ok=True)
        path.write_text(text)
        return path

    return write


def test_the_name_of_a_policy(file):
    assert case(file("walk.onnx")).policy == "walk"
    assert case(file("dance/policy.onnx")).policy == "dance"
    assert case("/policy.onnx").policy == "policy"
    assert LibraryCase("simulate", Path("out")).policy is None
    assert LibraryCase("simulate", Path("out")).policy_sha256 == ""
    assert LibraryCase("check", Path("out"), case(file("walk.onnx")).config).policy is None


@pytest.mark.parametrize(
    "changed", ["a/policy.onnx", "a/policy.onnx.data", "a/policy.toml", "a/deploy.yaml"]
)
def test_a_policy_is_another_one_when_a_file_of_it_changes(file, changed):
    path = file("a/policy.onnx")
    before = case(path)
    known = before.policy_sha256, before.variant, before.fingerprint
    file("a/other.onnx")
    same = case(path)
    assert (same.policy_sha256, same.variant, same.fingerprint) == known
    file(changed, "changed")
    after = case(path)
    assert after.policy_sha256 != known[0]
    assert after.variant != known[1]
    assert after.fingerprint != known[2]


def test_a_policy_is_the_same_elsewhere(file, tmp_path):
    first, second = case(file("a/walk.onnx")), case(file("b/walk.onnx"))
    assert first.fingerprint == second.fingerprint
    assert first.fingerprint != case(file("a/walk.onnx"), **{"sim.push": 0.5}).fingerprint
    with pytest.raises(ConfigError):
        case(tmp_path / "none.onnx").variant  # noqa: B018


@pytest.mark.parametrize(
    "flags",
    [
        ("simulate", "--policy", "none.onnx"),
        ("simulate", "--policy", "walk.onnx", "--support", "bolted"),
        ("check", "--policy", "walk.onnx"),
        ("simulate", "--sweep", "stream.policy=walk.onnx"),
    ],
)
def test_flags_that_do_not_go_with_a_policy(file, motions, monkeypatch, tmp_path, flags):
    file("walk.onnx")
    monkeypatch.chdir(tmp_path)
    action, *others = flags
    assert main(["library", action, str(motions), "-o", "out", *others]) == 2
    assert not Path("out").exists()


def test_a_policy_may_be_the_name_of_a_published_one(file, motions, monkeypatch, capsys, cluster):
    """The file is in the cache, and is no network."""
    path = file("g1stream/walker.onnx")
    row = {"sha256": sha256(path.read_bytes()).hexdigest()}
    monkeypatch.setattr("g1stream.extras.policy.published.published", lambda: {"walker": row})
    monkeypatch.setenv("XDG_CACHE_HOME", str(path.parents[1]))
    out = path.parents[1] / "out"
    command = ["library", "simulate", str(motions / "first.npz"), "-o", str(out), "--json"]
    assert main([*command, "--cluster", cluster, "--policy", "walker"]) == 0
    (row,) = g1stream.library.open_library(out).motions.to_dict("records")
    assert (row["policy"], row["status"]) == ("walker", "refused")
    assert str(path) in row["reason"]


@pytest.mark.slow
def test_a_policy_that_is_refused_is_a_row_with_its_cause(file, motions, tmp_path, capsys, cluster):
    one, other = file("one.onnx"), file("two.onnx", "neither")
    out = tmp_path / "out"
    command = ["library", "simulate", str(motions / "first.npz"), "-o", str(out), "--json"]
    command += ["--cluster", cluster, "--sweep", "sim.command_delay=0,0.008"]
    assert main([*command, "--policy", str(one), "--policy", str(other)]) == 0
    printed = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert len(printed) == 4
    rows = g1stream.library.open_library(out).motions
    assert set(rows["status"]) == {"refused"}
    assert rows["reason"].str.contains("onnx").all()
    found = rows[["policy", "sim.command_delay"]].to_numpy().tolist()
    assert sorted(found) == [["one", 0.0], ["one", 0.008], ["two", 0.0], ["two", 0.008]]
    assert rows.groupby("policy")["policy_sha256"].nunique().tolist() == [1, 1]
    assert main([*command, "--policy", str(one)]) == 0
    assert capsys.readouterr().out == ""
    file("one.onnx", "another")
    assert main([*command, "--policy", str(one)]) == 0
    assert len(capsys.readouterr().out.splitlines()) == 2


@pytest.mark.slow
@needs_policies
def test_the_row_of_a_policy_is_that_of_its_rollout(tmp_path, cluster):
    path = tmp_path / "dance.npz"
    g1stream.load_motion(DANCE).trim(0.0, 0.5).save(path)
    short = {"stream.ramp": 0.5, "stream.stand": 0.5, "stream.hold": 0.0, "stream.damp": 0.5}
    one = case(HOLOSOMA, tmp_path / "out", **short)
    run = g1stream.library.run_library([str(path)], [one], cluster=cluster)
    assert (run.done, run.failed) == (1, 0)
    (row,) = g1stream.library.open_library(tmp_path / "out").motions.to_dict("records")
    session = g1stream.rollout(path, config=one.config)
    metrics, summary = session.metrics(), session.summary()
    assert (row["policy"], row["support"]) == ("holosoma_dance1_subject2", "free")
    assert row["success_sonic"] is metrics.success.success_sonic is True
    assert row["survived"] == summary.termination.played_s == pytest.approx(3.0, abs=0.05)
    assert row["mae"] == metrics.tracking.all_joints.mae_rad
    assert row["e_vel"] == metrics.body.world.vel_mm_per_frame
    assert row["e_acc"] == metrics.body.world.acc_mm_per_frame2
    assert row["delay_p99"] == pytest.approx(0.003)
