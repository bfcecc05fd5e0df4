"""Programs run as children: they speak, they fail with a reason, and none outlives its parent."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import textwrap
import threading
from pathlib import Path

import pytest

from g1stream.cli.main import main
from g1stream.programs.child_process import Child, ChildError


def sim(domain_id: int) -> Child:
    return Child(["sim"], {"config": {"dds": {"domain": domain_id}}})


def test_a_child_says_when_it_is_ready_and_what_it_did(domain_id):
    child = sim(domain_id)
    child.wait_for("ready", timeout=20)
    done = child.finish()
    assert done["states"] >= 0
    assert not child.alive


def test_a_child_that_cannot_start_says_why(tmp_path):
    path = tmp_path / "there.mcap"
    path.write_bytes(b"precious")
    child = Child(["record", str(path)], {"config": {}})
    with pytest.raises(ChildError, match="exists already"):
        child.wait_for("ready", timeout=20)
    child.kill()


def test_a_child_that_ends_early_is_noticed(capfd):
    child = Child(["sim", "--nonsense"], {"config": {}})
    with pytest.raises(ChildError, match="exit code 2"):
        child.wait_for("ready", timeout=20)
    assert "--nonsense" in capfd.readouterr().err


def test_an_attached_program_without_a_parent_says_so():
    done = subprocess.run(
        [sys.executable, "-m", "g1stream", "sim", "--attached"],
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert done.returncode == 2
    assert "Leave out --attached" in done.stdout


@pytest.mark.parametrize("command", [["sim"], ["record", "out.mcap"]])
@pytest.mark.parametrize(
    ("greeting", "told"),
    [
        (b"not JSON", "is not a JSON object"),
        (b"\xff\xfe\xfd", "is not a JSON object"),
        (b"[" * 100_000, "is not a JSON object"),
        (b"5", "is not a JSON object"),
        (b"{}", "has no object 'config'"),
        (b'{"config": [1]}', "has no object 'config'"),
        (b'{"config": {"dds": 5}}', "dds = 5 is not a table"),
        (b'{"config": {"dds": {"domain": "x"}}}', "dds.domain = 'x' does not fit"),
        (b'{"config": {"nonsense": 1}}', "There is no setting nonsense"),
    ],
)
def test_a_greeting_that_describes_nothing_is_explained(
    command, greeting, told, tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    written = tmp_path / "greeting"
    written.write_bytes(greeting + b"\n")
    stdin = written.open()
    written.unlink()
    monkeypatch.setattr(sys, "stdin", stdin)
    monkeypatch.setattr("g1stream.cli.record.stand_back", lambda: None)
    for module in ("record", "sim"):
        monkeypatch.setattr(f"g1stream.cli.{module}.on_signals", lambda stop: None)
    assert main([*command, "--attached"]) == 2
    for thread in threading.enumerate():
        if thread.name == "parent":
            thread.join()
    stdin.close()
    (line,) = capsys.readouterr().out.splitlines()
    message = json.loads(line)
    assert message["event"] == "error"
    assert told in message["cause"]
    assert message["remedy"]
    assert not list(tmp_path.iterdir())


def test_what_a_library_prints_is_no_message(monkeypatch):
    """Whether it happens to be JSON or not even text."""
    code = r"import os, sys; os.write(1, b'5\n\xff\n{\"event\": \"ready\"}\n')"
    start = subprocess.Popen
    monkeypatch.setattr(
        subprocess, "Popen", lambda _, **how: start([sys.executable, "-c", code], **how)
    )
    child = Child(["sim"], {"config": {}})
    assert child.wait_for("ready", timeout=20) == {"event": "ready"}
    child.kill()


def test_a_child_that_ends_before_its_parent_does_not_stumble(tmp_path, capfd):
    """Though it still waits for its parent's next word."""
    path = tmp_path / "there.mcap"
    path.write_bytes(b"precious")
    child = Child(["record", str(path)], {"config": {}})
    with pytest.raises(ChildError):
        child.wait_for("ready", timeout=20)
    assert child._process.wait(20) == 2
    assert not capfd.readouterr().err


def test_a_child_that_is_silent_is_not_waited_for_for_ever(domain_id):
    child = sim(domain_id)
    child.wait_for("ready", timeout=20)
    with pytest.raises(ChildError, match="did not come to 'lunch'"):
        child.wait_for("lunch", timeout=0.2)
    child.kill()
    assert not child.alive


def test_speaking_to_a_child_that_is_gone_does_no_harm(domain_id):
    child = sim(domain_id)
    child.kill()
    child.send({"anybody": "there"})


def test_a_child_ends_when_its_parent_is_killed(domain_id):
    code = f"""
        import time
        from g1stream.programs.child_process import Child
        child = Child(["sim"], {{"config": {{"dds": {{"domain": {domain_id}}}}}}})
        child.wait_for("ready", timeout=20)
        print(child._process.pid, flush=True)
        time.sleep(60)
    """
    parent = subprocess.Popen(
        [sys.executable, "-c", textwrap.dedent(code)], stdout=subprocess.PIPE, text=True
    )
    assert parent.stdout is not None
    pid = int(parent.stdout.readline())
    parent.send_signal(signal.SIGKILL)
    parent.communicate()
    assert_ends(pid)


def test_a_child_ends_though_its_parent_died_in_mid_line(domain_id):
    child = subprocess.Popen(
        [sys.executable, "-m", "g1stream", "sim", "--attached"],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    greeting = json.dumps({"config": {"dds": {"domain": domain_id}}})
    child.communicate(greeting + '\n{"half a', timeout=20)
    assert child.returncode == 0


def assert_ends(pid: int, seconds: float = 15.0) -> None:
    """The process of another parent ends; a zombie has ended."""
    import time

    end = time.monotonic() + seconds
    while time.monotonic() < end:
        try:
            os.kill(pid, 0)
            if Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] == "Z":
                return
        except (ProcessLookupError, FileNotFoundError):
            return
        time.sleep(0.05)
    pytest.fail(f"process {pid} still runs")
