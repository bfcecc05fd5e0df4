import shutil
import subprocess

import pytest

from g1stream.config import load_config
from g1stream.extras.physics.stance import stand
from g1stream.motion.readers import load_motion
from g1stream.robot.model import G1
from known_robots import reference_urdf, robot
from known_sessions import change, play, take, write_session

__all__ = [
    "change",
    "play",
    "reference_urdf",
    "robot",
    "take",
    "write_session",
]


@pytest.fixture(scope="session")
def standing_demo():
    """The right foot stands at 7.5 s, is lifted at 8.6 s for 0.4 s, and is up by 9 cm at 8.67 s."""
    return stand(load_motion("demo"), G1.default())


@pytest.fixture(scope="session")
def short():
    """Settings of a rollout with little but PLAY."""
    return load_config(over={"stream.ramp": 0.5, "stream.hold": 0.1, "stream.damp": 0.5})


@pytest.fixture
def chromium(tmp_path):
    """Run a browser without a screen."""
    browser = shutil.which("chromium") or shutil.which("chromium-browser")
    if not browser:
        pytest.skip("chromium is not installed")

    def run(*arguments):
        profile = f"--user-data-dir={tmp_path / 'profile'}"
        quiet = "--headless", "--no-sandbox", "--disable-gpu", "--enable-logging=stderr", profile
        command = [browser, *quiet, "--virtual-time-budget=20000", *map(str, arguments)]
        done = subprocess.run(command, capture_output=True, text=True, timeout=170, check=True)
        assert "CONSOLE" not in done.stderr
        return done.stdout

    return run
