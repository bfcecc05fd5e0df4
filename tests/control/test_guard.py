import os
import socket
import subprocess
import time
from types import SimpleNamespace

import pytest

from g1stream.config import Config
from g1stream.control.guard import Heartbeat, Takeover, Watch, _fence, _here, _settings, _watch
from g1stream.dds.messages import LowCmd
from threads import in_thread

MS = 1_000_000
LIMIT = 40 * MS
START = 1_000 * MS


def running():
    return Takeover.NONE


def stopped():
    return Takeover.STOPPED


@pytest.fixture
def watch():
    return Watch(LIMIT)


@pytest.fixture
def heartbeat():
    own = Heartbeat()
    yield own
    own.close()


def test_nothing_is_taken_over_before_the_first_command(watch):
    assert watch.judge(START, START, 0, stopped) is Takeover.NONE


@pytest.mark.parametrize(
    ("silence", "state", "expected"),
    [
        (19, stopped, Takeover.NONE),
        (20, stopped, Takeover.STOPPED),
        (39, running, Takeover.NONE),
        (40, running, Takeover.SILENT),
        (40, stopped, Takeover.STOPPED),
    ],
)
def test_silence_and_state_decide(watch, silence, state, expected):
    now = START + silence * MS
    assert watch.judge(now, now, START, state) is expected


def test_a_takeover_is_rehearsed_once_shortly_before_the_limit(heartbeat, monkeypatch):
    """In time for the takeover to be quick, and never while the stream is in time."""
    now, ages = START, []
    monkeypatch.setattr("g1stream.control.guard.time.monotonic_ns", lambda: now)

    def wait(seconds):
        nonlocal now
        now += round(1e9 * seconds)
        if now < START + 400 * MS:  # it writes every 20 ms, then no more
            heartbeat.begin_write(bytes(LowCmd().tobytes()), now - now % (20 * MS))
            heartbeat.end_write(sent=True)
        return now > START + 1_000 * MS

    parent = SimpleNamespace(done=SimpleNamespace(wait=wait), beat=lambda: None)
    settings = _settings(Config(), 0, ())._replace(limit=LIMIT)
    heartbeat.begin_write(bytes(LowCmd().tobytes()), START)
    heartbeat.end_write(sent=True)
    why = _watch(parent, heartbeat, settings, list, lambda: ages.append(now - heartbeat.last_write))
    assert why is Takeover.SILENT
    assert now - heartbeat.last_write == LIMIT
    assert ages == [LIMIT - 10 * MS]


def test_the_guards_own_lateness_is_no_silence(watch):
    now = START + 100 * MS
    assert watch.judge(now, START + 20 * MS, START, running) is Takeover.NONE
    due = watch.next_look(now)
    assert watch.judge(due, due, START, running) is Takeover.NONE
    due = START + 120 * MS
    assert watch.judge(due, due, START, running) is Takeover.SILENT
    again = due + MS  # a command, whose silence that lateness does not excuse
    now = again + LIMIT
    assert watch.judge(now, now, again, running) is Takeover.SILENT


def test_a_stream_that_writes_is_looked_at_every_20_ms_and_a_silent_one_at_the_limit(watch):
    watch.judge(START, START, START, running)
    assert watch.next_look(START + MS) == START + 20 * MS
    assert watch.next_look(START + 20 * MS) == START + 30 * MS
    assert watch.next_look(START + 35 * MS) == START + LIMIT
    assert watch.next_look(START + LIMIT) > START + LIMIT


def test_both_processes_see_the_same_heartbeat(heartbeat):
    other = Heartbeat(os.dup(heartbeat.descriptor))
    command = LowCmd().seal()
    heartbeat.begin_write(command, START - 1)
    assert (other.writing, other.last_write, other.command) == (True, START - 1, command)
    heartbeat.end_write(sent=True)
    assert (other.writing, other.last_write) == (False, START - 1)
    heartbeat.begin_write(command, START)
    heartbeat.end_write(sent=False)
    assert (other.writing, other.last_write) == (False, START - 1)
    assert (heartbeat.takeover, heartbeat.subscribers) == (Takeover.NONE, 0)
    other.takeover, other.subscribers = Takeover.STOPPED, 2
    assert (heartbeat.takeover, heartbeat.subscribers) == (Takeover.STOPPED, 2)
    assert heartbeat.command == command
    heartbeat.clear()
    assert other.last_write == 0
    other.close()


@pytest.mark.parametrize("priority", [0, 50])
def test_the_guard_asks_for_a_priority_above_the_loops(heartbeat, priority):
    config = Config.model_validate({"realtime": {"priority": priority}})
    assert _settings(config, heartbeat.descriptor, ()).priority == priority + 1


@pytest.fixture
def fence(heartbeat):
    """Fences a stream off, by its process id and its sockets."""

    def fence(why, pid, *sockets):
        settings = _settings(Config(), heartbeat.descriptor, [os.dup(s.fileno()) for s in sockets])
        _fence(heartbeat, settings._replace(stream=pid), why)

    return fence


@pytest.mark.parametrize("why", [Takeover.STOPPED, Takeover.SILENT])
def test_a_stream_that_is_killed_in_a_write_is_not_waited_for(heartbeat, fence, why):
    with subprocess.Popen(["true"]) as process:
        process.wait()
    heartbeat.begin_write(LowCmd().seal(), START)
    fence(why, process.pid)  # returns, so that the guard damps
    assert heartbeat.writing


def test_a_write_that_blocks_is_waited_for_less_than_what_a_robot_allows(heartbeat, fence):
    """With the silence before, the first damping command is in time: a bound of safety."""
    heartbeat.begin_write(LowCmd().seal(), START)
    with subprocess.Popen(["sleep", "60"]) as stream:
        begun = time.monotonic()
        fence(Takeover.SILENT, stream.pid)
        waited = time.monotonic() - begun
        stream.kill()
    assert heartbeat.writing
    assert waited < 0.05 - 0.04


def test_a_stream_that_is_fenced_off_sends_nothing_more_and_still_receives(fence):
    with (
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stream,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as robot,
    ):
        for one in (stream, robot):
            one.bind(("127.0.0.1", 0))
            one.settimeout(5.0)
        stream.sendto(b"stiff", robot.getsockname())
        assert robot.recv(10) == b"stiff"
        fence(Takeover.STOPPED, os.getpid(), stream)
        with pytest.raises(BrokenPipeError):
            stream.sendto(b"stale", robot.getsockname())
        robot.sendto(b"state", stream.getsockname())
        assert stream.recv(10) == b"state"


def test_a_send_that_waits_for_the_kernel_never_comes_out(fence, until):
    """A pair of Unix sockets stands in for UDP, where a full buffer does not block the sender."""
    robot, stream = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
    sent, failed = [], []

    def send(_):
        try:
            while True:
                sent.append(stream.send(b"stiff"))
        except BrokenPipeError:
            failed.append(True)

    def waiting():
        before = len(sent)
        time.sleep(0.05)
        return 0 < before == len(sent)

    with robot, stream, in_thread(send):
        until(waiting, "a send that waits")
        fence(Takeover.STOPPED, os.getpid(), stream)
        until(lambda: failed, "its failure")
        robot.setblocking(False)
        for _ in sent:
            assert robot.recv(10) == b"stiff"
        with pytest.raises(BlockingIOError):
            robot.recv(10)


def test_a_stream_ends_its_write_on_the_guards_cpu_and_goes_back():
    with subprocess.Popen(["sleep", "60"]) as stream:
        before, own = os.sched_getaffinity(stream.pid), os.sched_getaffinity(0)
        cpu = max(own)
        try:
            os.sched_setaffinity(0, {cpu})
            with _here(stream.pid):
                assert os.sched_getaffinity(stream.pid) == {cpu}
            assert os.sched_getaffinity(stream.pid) == before
        finally:
            os.sched_setaffinity(0, own)
            stream.kill()
