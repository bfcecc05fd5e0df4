"""`g1stream convert --ros2` as a user meets it."""

from __future__ import annotations

import json
import subprocess
import sys

import pytest


def run(*arguments: object) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "g1stream", "convert", *map(str, arguments)],
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )


@pytest.mark.slow
def test_a_session_becomes_a_ros2_bag_and_the_flags_of_motions_are_refused(tmp_path):
    out = tmp_path / "out.mcap"
    assert run("demo", out).returncode == 0
    bag = out.with_suffix("")
    refused = run(out, bag, "--ros2", "--frames", "1:2")
    assert refused.returncode == 2
    assert "--frames" in refused.stderr
    no_session = run("demo", bag, "--ros2")
    assert no_session.returncode == 2
    assert "session" in no_session.stderr
    assert not bag.exists()
    done = run(out, bag, "--ros2", "--json")
    assert done.returncode == 0
    report = json.loads(done.stdout)
    assert report["path"] == str(bag)
    assert report["counts"].keys() == {"/tf", "/reference/joint_states", "/robot_description"}
    assert report["left_out"] == {"/scene": 1}
    assert sorted(path.name for path in bag.iterdir()) == ["metadata.yaml", "out_0.mcap"]
