"""The guard of a stream: real processes on real DDS, and a reader that hears every LowCmd."""

from __future__ import annotations

import json
import os
import resource
import signal
import subprocess
import sys
import threading
import time
from contextlib import contextmanager, suppress
from pathlib import Path

import pytest
from cyclonedds.core import DDSException

from g1stream.app.session import open_session
from g1stream.app.stream import stream
from g1stream.child_process import ChildError, process_state
from g1stream.config import Config, SimConfig
from g1stream.control.guard import Guard, Heartbeat, Takeover, _damp, _settings
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


@pytest.fixture
def streaming(domain_id, until, running, tap):
    """A stream that plays on our bridge; yields its process and the tap's commands."""

    @contextmanager
    def started(*more):
        play = ["stream", "demo", "--config", PATIENT, "--ramp", 0.5, "--json"]
        with (
            tap(domain_id) as commands,
            running("sim", "--domain", domain_id),
            running(*play, "--domain", domain_id, *more) as stream,
        ):
            until(lambda: len(commands) > 400, "commands")
            yield stream, commands

    return started


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


def debug(pid):
    return subprocess.Popen([sys.executable, "-c", DEBUGGER, str(pid)], stdin=subprocess.PIPE)


@pytest.mark.parametrize(
    "fault", [lambda pid: os.kill(pid, signal.SIGKILL), debug], ids=["SIGKILL", "debugger"]
)
def test_a_stream_that_can_no_longer_damp_is_replaced(
    streaming, tmp_path, until, fault, record_property
):
    path = tmp_path / "s.mcap"
    with streaming("--record", path) as (stream, commands):
        guard = child(stream.pid, "guard")
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGUSR1):
            os.kill(guard, number)  # what is sent to all processes of a session
        debugger = fault(stream.pid)
        until(lambda: is_limp(commands[-1]), "damping")
        until(lambda: process_state(guard) in ("", "Z"), "the guard to end")
        stream.kill()
        if debugger:  # it would keep the stream from being waited for
            debugger.communicate()
        stream.communicate()
    stiff = [one for one in commands if one.command.kp.any()]
    damping = [one for one in commands if one.stamp > stiff[-1].stamp]
    silence = (damping[0].stamp - stiff[-1].stamp) / 1e9
    record_property("silence_ms", silence * 1e3)
    assert silence < SimConfig().command_timeout
    (writer,) = {one.writer for one in damping}
    assert writer != stiff[-1].writer
    assert all(map(is_limp, damping))
    assert (damping[-1].stamp - damping[0].stamp) / 1e9 == pytest.approx(DAMP, abs=0.1 * DAMP)
    until(lambda: open_session(path).complete, "the recorder")
    session = open_session(path)
    ended = session.summary().termination
    assert ended.guard == ended.reason
    assert ended.guard is not None
    assert str(stream.pid) in ended.guard
    assert ended.undamped_in is None
    assert session.command.kp[-1].max() == 0


def test_a_stream_that_goes_on_after_a_stop_sends_nothing_but_damping(streaming, until):
    with streaming() as (stream, commands):
        stream.send_signal(signal.SIGSTOP)
        until(lambda: is_limp(commands[-1]), "damping")
        stream.send_signal(signal.SIGCONT)
        said, _ = stream.communicate(timeout=30)
    first = next(i for i, one in enumerate(commands) if is_limp(one))
    assert all(map(is_limp, commands[first:]))
    assert len({one.writer for one in commands[first:]}) == 2
    assert stream.returncode == 1
    assert "was stopped" in json.loads(said)["stream"]["reason"]


@pytest.mark.parametrize(
    ("number", "cause"),
    [(signal.SIGKILL, "guard ended by SIGKILL"), (signal.SIGSTOP, "guard is stopped")],
)
def test_a_stream_damps_where_it_has_lost_its_guard(streaming, number, cause):
    with streaming() as (stream, commands):
        os.kill(child(stream.pid, "guard"), number)
        said, _ = stream.communicate(timeout=30)
    assert stream.returncode == 1
    assert cause in json.loads(said)["stream"]["reason"]
    assert len({one.writer for one in commands}) == 1
    assert is_limp(commands[-1])


def test_a_guard_has_nothing_to_do_where_the_stream_damps(streaming):
    with streaming() as (stream, commands):
        guard = child(stream.pid, "guard")
        stream.send_signal(signal.SIGUSR2)
        stream.communicate(timeout=30)
        assert not process_state(guard)
    assert stream.returncode == 128 + signal.SIGUSR2
    assert len({one.writer for one in commands}) == 1
    assert is_limp(commands[-1])


def test_an_idle_guard_is_no_publisher_and_one_that_publishes_is(streaming, domain_id, until):
    with streaming() as (stream, _), Participant(domain_id, "lo") as observer:
        until(lambda: len(observer.writers(LOWCMD.name)) == 2, "stream and guard")
        (only,) = observer.commanders()
        assert only.pid == str(stream.pid)
        guard = next(one for one in observer.writers(LOWCMD.name) if one != only)
        assert observer.owner(guard).startswith("g1stream guard")
        stream.kill()
        until(lambda: guard.pid in {one.pid for one in observer.commanders()}, "the guard")


@pytest.mark.parametrize("interface", ["eth0", "wlan0"])
def test_the_guard_can_be_left_out_on_loopback_only(interface):
    values = {"safety": {"guard": False}, "dds": {"interface": interface}}
    with pytest.raises(ConfigError, match=r"safety\.guard"):
        Guard(Config.model_validate(values))
    values["dds"] = {"interface": "lo"}
    with Guard(Config.model_validate(values)) as guard:
        assert guard.wait_until_ready() is None


def test_a_guard_that_cannot_join_is_an_error():
    config = Config.model_validate({"dds": {"interface": "nowhere0"}})
    with Guard(config) as guard, pytest.raises(ChildError, match="nowhere0"):
        guard.wait_until_ready()


def test_a_guard_that_dies_before_the_loop_runs_ends_the_stream(domain_id, until):
    def kill_the_guard(_):
        os.kill(child(os.getpid(), "guard"), signal.SIGKILL)
        until(lambda: "guard" not in [one.name for one in threading.enumerate()], "its failure")

    config = Config.model_validate({"dds": {"domain": domain_id}})
    summary = stream("demo", config, on_loop=kill_the_guard)
    assert "guard ended by SIGKILL" in summary.termination.reason
    assert summary.stream.commands == 0


@contextmanager
def no_open_files():
    """No file can be opened, as in a process that has reached its limit."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (0, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))


@contextmanager
def no_interpreter():
    """No process can be started."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "executable", "/nowhere/python")
        yield


@pytest.mark.parametrize(
    ("lack", "expected"), [(no_open_files, SafetyError), (no_interpreter, ChildError)]
)
def test_a_guard_that_cannot_be_started(lack, expected):
    with lack(), pytest.raises(expected) as error:
        Guard(Config())
    assert error.value.remedy


def test_the_guard_goes_on_damping_after_an_error_of_dds(domain_id, until, tap, monkeypatch):
    config = Config.model_validate({"dds": {"domain": domain_id}})
    heartbeat = Heartbeat()
    last = LowCmd()
    last.motor_mode = 1
    heartbeat.begin_write(last.seal(), time.monotonic_ns())
    heartbeat.end_write(time.monotonic_ns())
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
    settings = _settings(config, heartbeat.descriptor)._replace(damp=200_000_000)
    with tap(domain_id) as commands, Participant(domain_id, "lo") as participant:
        writer = RawWriter(participant, LOWCMD)
        until(lambda: writer.matched, "the tap")
        _damp(heartbeat, settings, writer, Takeover.SILENT)
        until(lambda: len(commands) == len(written) // 2, "damping")
    heartbeat.close()
    assert len(commands) > 1
    assert all(map(is_limp, commands))
