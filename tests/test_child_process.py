import os
import signal
import subprocess
import sys
import textwrap
import time
from pathlib import Path

import pytest
from mcap.reader import make_reader

from g1stream.child_process import Child, ChildError
from g1stream.config import Config
from g1stream.dds.domain import Participant
from g1stream.dds.endpoints import RawWriter
from g1stream.dds.messages import LOWSTATE, LowState


@pytest.fixture
def sim(domain_id):
    child = Child("sim", Config.model_validate({"dds": {"domain": domain_id}}))
    child.wait_until_ready()
    yield child
    child.kill()


def record(path: Path) -> Child:
    return Child("record", {"path": path})


def test_a_child_says_when_it_is_ready_and_returns_its_result(sim):
    # Ctrl-C in the terminal does not reach it.
    assert os.getsid(sim._process.pid) != os.getsid(0)
    assert os.getpgid(sim._process.pid) != os.getpgid(0)
    assert sim.finish().states >= 0
    assert not sim.alive


def test_a_child_that_fails_says_why(tmp_path, capfd):
    path = tmp_path / "there.mcap"
    path.write_bytes(b"precious")
    child = record(path)
    with pytest.raises(ChildError) as error:
        child.wait_until_ready()
    assert str(path) in error.value.cause
    assert error.value.remedy
    assert child._process.wait(20) == 2
    assert not capfd.readouterr().err
    child.kill()


def test_a_child_that_crashes_is_noticed_at_once(capfd):
    child = Child("nonsense", None)
    with pytest.raises(ChildError, match="exit code 1"):
        child.wait_until_ready(timeout=60)
    assert "nonsense" in capfd.readouterr().err
    child.kill()


def test_a_child_that_is_killed_is_noticed_at_once(sim):
    sim._process.kill()
    with pytest.raises(ChildError, match="SIGKILL"):
        sim.finish(timeout=60)


def test_a_child_that_hangs_is_killed(sim):
    os.kill(sim._process.pid, signal.SIGSTOP)
    with pytest.raises(ChildError, match="within"):
        sim.finish(timeout=0.2)
    assert not sim.alive
    assert sim._process.returncode == -signal.SIGKILL
    sim.kill()  # again


def test_a_recorder_whose_parent_is_killed_closes_its_file(domain_id, tmp_path, until):
    path = tmp_path / "s.mcap"
    code = f"""
        import time
        from g1stream.config import Config
        from g1stream.child_process import Child
        config = Config.model_validate({{"dds": {{"domain": {domain_id}}}}})
        child = Child("record", {{"path": {str(path)!r}, "config": config}})
        child.wait_until_ready()
        print(child._process.pid, flush=True)
        time.sleep(60)
    """
    parent = subprocess.Popen(
        [sys.executable, "-c", textwrap.dedent(code)], stdout=subprocess.PIPE, text=True
    )
    assert parent.stdout is not None
    pid = int(parent.stdout.readline())
    with Participant(domain_id, "lo") as participant:
        states = RawWriter(participant, LOWSTATE)
        empty = path.stat().st_size
        while path.stat().st_size < empty + 10_000:  # some LowStates are in it
            states.write(LowState().tobytes())
            time.sleep(0.002)
        parent.kill()
        parent.communicate()
        until(lambda: has_ended(pid), "the recorder to end")
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    assert summary.statistics.message_count > 10


def has_ended(pid: int) -> bool:
    """Whether a process of another parent has ended, maybe as a zombie."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] == "Z"
    except OSError:
        return True
