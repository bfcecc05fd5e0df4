import os
import resource
import signal
import subprocess
import sys
import threading
import time
from contextlib import suppress
from pathlib import Path

import pytest
from cyclonedds.core import DDSException

from g1stream.app.session import open_session
from g1stream.app.stream import stream
from g1stream.child_process import ChildError, process_state
from g1stream.config import Config
from g1stream.control.guard import Guard, Heartbeat, Takeover, _end, _settings
from g1stream.control.receiver import Receiver
from g1stream.dds.domain import Participant
from g1stream.dds.endpoints import RawWriter
from g1stream.dds.messages import LOWCMD, LowCmd
from g1stream.errors import ConfigError, SafetyError

PATIENT = Path(__file__).parents[1] / "data" / "patient.toml"
DAMP = 1.0  # stream.damp

pytestmark = [
    pytest.mark.alone,  # a stream that lacks its CPU ends for that reason
    pytest.mark.skipif(sys.platform != "linux", reason="the guard needs Linux"),
]


def is_limp(received):
    """Whether a command asks for no position, and all joints are damped."""
    command = received.command
    return not command.kp.any() and (command.kd > 0.0).all()


def child(pid, program):
    """The pid of a child process, by its module."""
    for task in Path(f"/proc/{pid}/task").glob("*/children"):
        with suppress(OSError):  # a thread or a process that has just ended
            for own in task.read_text().split():
                if f".{program}\0" in Path(f"/proc/{own}/cmdline").read_text():
                    return int(own)
    pytest.fail(f"no process {program}")


#: Stops a process as a debugger does, until its standard input is closed.
DEBUGGER = """
import ctypes, sys
SEIZE, INTERRUPT = 0x4206, 0x4207
pid = int(sys.argv[1])
for request in (SEIZE, INTERRUPT):
    assert ctypes.CDLL(None).ptrace(request, pid, None, None) == 0
sys.stdin.read()
"""


def test_a_stream_that_a_debugger_stops_is_replaced(domain_id, running, tap, tmp_path, until):
    """tests/faults has other ways in which it can no longer damp."""
    path = tmp_path / "s.mcap"
    play = ["stream", "demo", "--config", PATIENT, "--ramp", 0.5, "--record", path]
    with (
        tap(domain_id) as commands,
        Participant(domain_id, "lo") as observer,
        running("sim", "--domain", domain_id),
        running(*play, "--domain", domain_id) as stream,
    ):
        until(lambda: len(commands) > 400, "commands")
        guard = child(stream.pid, "guard")
        (only,) = observer.commanders()
        assert only.pid == str(stream.pid)
        (idle,) = (one for one in observer.writers(LOWCMD.name) if one != only)
        assert idle.pid == str(guard)
        assert observer.owner(idle).startswith("g1stream guard")
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGUSR1):
            os.kill(guard, number)  # what is sent to all processes of a session
        debug = [sys.executable, "-c", DEBUGGER, str(stream.pid)]
        with subprocess.Popen(debug, stdin=subprocess.PIPE) as debugger:
            until(lambda: is_limp(commands[-1]), "damping")
            until(lambda: idle.pid in {one.pid for one in observer.commanders()}, "the guard")
            until(lambda: process_state(guard) in ("", "Z"), "the guard to end")
            stream.kill()
            debugger.communicate()  # it would keep the stream from being waited for
        stream.communicate()
    stiff = [one for one in commands if one.command.kp.any()]
    damping = [one for one in commands if one.stamp > stiff[-1].stamp]
    assert (damping[0].stamp - stiff[-1].stamp) / 1e9 < 0.5  # when the simulator damps by itself
    (writer,) = {one.writer for one in damping}
    assert writer != stiff[-1].writer
    assert all(map(is_limp, damping))
    assert (damping[-1].stamp - damping[0].stamp) / 1e9 == pytest.approx(DAMP, abs=0.1 * DAMP)
    until(lambda: open_session(path).complete, "the recorder")
    session = open_session(path)
    ended = session.summary().termination
    assert ended.guard == ended.reason
    assert str(stream.pid) in ended.guard
    assert ended.undamped_in is None
    assert session.command.kp[-1].max() == 0


def test_the_guard_can_be_left_out_on_loopback_only(participant):
    values = {"safety": {"guard": False}, "dds": {"interface": "eth0"}}
    with pytest.raises(ConfigError, match=r"safety\.guard"):
        Guard(Config.model_validate(values), participant)
    values["dds"] = {"interface": "lo"}
    with Guard(Config.model_validate(values), participant) as guard:
        guard.wait_until_ready()
        assert guard.heartbeat is None


def test_a_guard_that_cannot_join_is_an_error(participant):
    config = Config.model_validate({"dds": {"interface": "nowhere0"}})
    with Guard(config, participant) as guard, pytest.raises(ChildError, match="nowhere0"):
        guard.wait_until_ready()


def test_a_guard_that_dies_before_the_loop_runs_ends_the_stream(domain_id, until):
    def kill_the_guard(_):
        os.kill(child(os.getpid(), "guard"), signal.SIGKILL)
        until(lambda: "guard" not in [one.name for one in threading.enumerate()], "its failure")

    config = Config.model_validate({"dds": {"domain": domain_id}})
    summary = stream("demo", config, on_loop=kill_the_guard)
    assert "guard ended by SIGKILL" in summary.termination.reason
    assert summary.stream.commands == 0


def test_a_guard_without_memory_is_an_error(participant):
    """No file can be opened, as in a process that has reached its limit."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (0, hard))
    try:
        with pytest.raises(SafetyError) as error:
            Guard(Config(), participant)
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))
    assert error.value.remedy


def test_a_guard_that_cannot_be_started_is_an_error(monkeypatch, participant):
    monkeypatch.setattr(sys, "executable", "/nowhere/python")
    with pytest.raises(ChildError) as error:
        Guard(Config(), participant)
    assert error.value.remedy


def test_the_guard_goes_on_damping_after_an_error_of_dds(domain_id, until, tap, monkeypatch):
    config = Config.model_validate({"dds": {"domain": domain_id}})
    heartbeat = Heartbeat()
    last = LowCmd()
    last.motor_mode = 1
    heartbeat.begin_write(last.seal(), time.monotonic_ns())
    heartbeat.end_write(sent=True)
    write, written = RawWriter.write, []

    def every_other(writer, data):
        written.append(data)
        if len(written) % 2:
            raise DDSException(DDSException.DDS_RETCODE_OUT_OF_RESOURCES)
        return write(writer, data)

    def refused(*_):
        raise DDSException(DDSException.DDS_RETCODE_OUT_OF_RESOURCES)

    monkeypatch.setattr(RawWriter, "write", every_other)
    monkeypatch.setattr(RawWriter, "announce", refused)
    settings = _settings(config, heartbeat.descriptor, ())
    receiver = Receiver(settings.period, 0.2)
    with tap(domain_id) as commands, Participant(domain_id, "lo") as participant:
        writer = RawWriter(participant, LOWCMD)
        until(lambda: writer.matched, "the tap")
        _end(heartbeat, settings, receiver, writer, Takeover.SILENT)
        until(lambda: len(commands) == len(written) // 2, "damping")
    heartbeat.close()
    assert len(commands) > 1
    assert all(map(is_limp, commands))
