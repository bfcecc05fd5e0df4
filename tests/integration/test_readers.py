"""A converted file in the readers people use: Foxglove's own packages from npm, and Rerun.

The Python packages are in tests/app/test_convert.py. What is decoded here is compared with the
motion and with our kinematics, which have truths of their own.
"""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from g1stream.app.convert import convert
from g1stream.robot.model import G1
from g1stream.robot.shapes import read_visuals

HERE = Path(__file__).parent / "npm_readers"
T0 = 1_772_366_400_123_456_789
FRAMES = (100, 160)


@pytest.fixture(scope="module")
def converted(tmp_path_factory):
    path = tmp_path_factory.mktemp("converted") / "demo.mcap"
    convert("demo", path, frames=FRAMES, base_time_ns=T0)
    return path


@pytest.fixture(scope="module")
def read_with_npm():
    """Runs read.mjs; its packages are installed once beside it, where git ignores them."""
    if not (shutil.which("node") and shutil.which("npm")):
        pytest.skip("needs node and npm")
    installed = HERE / "node_modules" / ".package-lock.json"
    lock = HERE / "package-lock.json"
    if not installed.exists() or installed.stat().st_mtime < lock.stat().st_mtime:
        command = ["npm", "ci", "--ignore-scripts", "--no-audit", "--no-fund"]
        done = subprocess.run(command, cwd=HERE, capture_output=True, text=True, check=False)
        if done.returncode != 0:
            pytest.skip(f"npm could not install the readers: {done.stderr.strip()[-200:]}")

    def read(path):
        command = ["node", str(HERE / "read.mjs"), str(path)]
        done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=60)
        return json.loads(done.stdout)

    return read


def stamp(frame):
    return T0 + (2 * frame * 10**9 + 30) // 60


def test_foxgloves_packages_decode_every_topic(converted, read_with_npm):
    found = read_with_npm(converted)
    assert {topic: told["count"] for topic, told in found["topics"].items()} == {
        "/tf": 60,
        "/reference/joint_states": 60,
        "/scene": 1,
        "/robot_description": 1,
    }
    assert sorted(found["attachments"]) == ["demo.csv", "robot.urdf"]
    for told in found["topics"].values():
        assert told["sameTimes"]
        assert int(told["firstTime"]) == stamp(FRAMES[0])
    assert int(found["topics"]["/tf"]["lastTime"]) == stamp(FRAMES[1] - 1)
    assert found["topics"]["/robot_description"]["first"] == {"data": G1.default().urdf}
    scene = found["topics"]["/scene"]["first"]
    assert {entity["frame_id"] for entity in scene["entities"]} == {
        visual.link for visual in read_visuals(G1.default())
    }


@pytest.fixture(scope="module")
def rerun():
    """Rerun's command."""
    pytest.importorskip("rerun", reason="Rerun needs Python 3.11")

    def run(*arguments):
        command = [sys.executable, "-m", "rerun_cli", *map(str, arguments)]
        done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=60)
        return done.stdout

    return run


def test_rerun_turns_the_file_into_transforms_and_a_robot(converted, rerun, tmp_path):
    rerun("mcap", "check", converted)
    recording = tmp_path / "demo.rrd"
    rerun("mcap", "convert", converted, "-o", recording)
    told = rerun("rrd", "print", recording)
    n_links, n_shapes = len(G1.default().link_names), len(read_visuals(G1.default()))
    # A transform for each link of each message, and for each shape what it is drawn as.
    assert re.search(
        rf"with {60 * n_links} rows .* - /tf - data columns: \[Transform3D:child_frame ", told
    )
    shapes = r"/visual_geometries/\S+ - data columns: \[(?:Boxes3D|Cylinders3D|Ellipsoids3D):"
    drawn = re.findall(shapes, told)
    assert len(drawn) == n_shapes
