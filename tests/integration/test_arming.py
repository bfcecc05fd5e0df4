"""Arming on an interface that is not the loopback, in a network namespace of its own."""

from __future__ import annotations

import subprocess
import sys

import pytest

from g1stream.app.session import open_session
from g1stream.config import load_config
from g1stream.types import Phase

# Two ends of a cable; without an own /sys the flags of the interfaces outside would be read.
NETWORK = """
set -e
mount -t sysfs sysfs /sys
ip link set lo up
ip link add robot0 type veth peer name robot1
ip addr add 10.77.0.1/24 dev robot0
ip link set robot0 up
ip link set robot1 up
"""

SETTINGS = """
[dds]
domain = 0
interface = "robot0"
[stream]
ramp = 0.5
hold = 0.0
damp = 0.5
duration = 0.5
[safety]  # of a machine that may keep the simulator waiting; the rest is robot.toml's
state_timeout = 1.0
max_tracking_error = 3.0
max_torque = 10.0
"""

#: Run at the start of each process.
PATIENT = """
from g1stream.profiles import PROFILES
PROFILES["robot"] = PROFILES["robot"]._replace(
    frozen_timeout=2.0, frozen_motion=0.5, max_leap=1.0, jam_time=5.0, motor_fault_time=2.0,
    max_missed_ticks=1.0,
)
"""

SESSION = """
set +e
"$PYTHON" -m g1stream sim --config settings.toml --onboard ai 2> sim.txt &
sim=$!
"$PYTHON" -m g1stream robot status --config settings.toml --timeout 20 && echo "status $?"
"$PYTHON" -m g1stream stream demo --config settings.toml; echo "unarmed $?"
"$PYTHON" -m g1stream stream demo --config settings.toml --arm --yes robot0; echo "active $?"
"$PYTHON" -m g1stream robot release --config settings.toml < /dev/null; echo "unconfirmed $?"
"$PYTHON" -m g1stream robot release --config settings.toml --yes robot0; echo "release $?"
"$PYTHON" -m g1stream stream demo --config settings.toml --arm < /dev/null; echo "unasked $?"
"$PYTHON" -m g1stream stream demo --config settings.toml --arm --yes robot0 \
    --record armed.mcap > summary.txt; echo "armed $?"
kill -TERM $sim
wait $sim
"""


@pytest.fixture
def in_namespace(tmp_path):
    """Run a script where `robot0` is a network interface that no other process is on."""
    isolate = ["unshare", "--net", "--mount", "bash", "-c"]
    try:
        made = subprocess.run([*isolate, NETWORK], capture_output=True, text=True, check=False)
    except OSError as error:
        pytest.skip(f"no network namespaces: {error}")
    if made.returncode:
        pytest.skip(f"no rights for a network namespace with a cable: {made.stderr.strip()}")

    def run(script):
        environment = {
            "PATH": "/usr/sbin:/usr/bin:/sbin:/bin",
            "PYTHON": sys.executable,
            "PYTHONPATH": ":".join([str(tmp_path), *sys.path]),
            "HOME": str(tmp_path),
        }
        return subprocess.run(
            [*isolate, NETWORK + script],
            cwd=tmp_path,
            env=environment,
            capture_output=True,
            text=True,
            check=False,
            timeout=120,
        )

    return run


@pytest.mark.dds
@pytest.mark.alone  # the guard damps an armed stream that another test keeps from its CPU
def test_from_an_active_mode_to_an_armed_session(in_namespace, tmp_path):
    (tmp_path / "settings.toml").write_text(SETTINGS)
    (tmp_path / "sitecustomize.py").write_text(PATIENT)
    done = in_namespace(SESSION)
    codes = dict(line.split() for line in done.stdout.splitlines() if line[-1:].isdigit())
    assert codes == {
        "status": "0",
        "unarmed": "2",
        "active": "2",
        "unconfirmed": "2",
        "release": "0",
        "unasked": "2",
        "armed": "0",
    }, done.stderr
    session = open_session(tmp_path / "armed.mcap")
    settings = session.summary().settings
    assert settings["safety.max_tilt"] == load_config("robot").safety.max_tilt  # by itself
    assert settings["safety.state_timeout"] == 1.0
    phases = [one.phase for one in session.phases]
    assert phases == [Phase.DAMP, Phase.RAMP, Phase.PLAY, Phase.DAMP]
    assert not session.command.kp[0].any()
