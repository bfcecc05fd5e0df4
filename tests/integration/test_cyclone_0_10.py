"""g1stream on the Cyclone DDS of the SDK, which users of both have in one environment."""

import subprocess
import sys
from pathlib import Path

import pytest

TESTS = Path(__file__).parents[1]


@pytest.mark.timeout(400)  # the environment is made first
def test_our_wire_on_the_sdks_own_cyclone(sdk_python, tmp_path):
    """Run the tests of dds/ and doctor/, and an exchange with the SDK, in its environment."""
    if Path(sys.prefix) == sdk_python.parents[1]:
        pytest.skip("these very tests are running there")
    exchange = f"{TESTS}/integration/test_python_sdk.py::test_sdk_reads_every_field_of_ours"
    command = [
        sdk_python,
        "-m",
        "pytest",
        "-p",
        "no:cacheprovider",
        "--basetemp",
        tmp_path / "inner",
    ]
    done = subprocess.run(
        [*command, TESTS / "dds", TESTS / "doctor", exchange],
        cwd=TESTS.parent,
        capture_output=True,
        text=True,
        check=False,
        timeout=240,
    )
    assert done.returncode == 0, done.stdout
