import os
import subprocess
import sys

import numpy as np
import pytest

from g1stream.control.guard import Heartbeat, Takeover, Watch, _fence, _here, damping_command
from g1stream.dds.messages import LowCmd

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
    heartbeat.end_write(START)
    assert (other.writing, other.last_write) == (False, START)
    heartbeat.begin_write(command, START + 1)
    heartbeat.end_write(0)
    assert (other.writing, other.last_write) == (False, START)
    assert (heartbeat.takeover, heartbeat.replacement) == (Takeover.NONE, b"")
    damping, other.subscribers = damping_command(command, 3.0), 2
    other.replace(damping, Takeover.STOPPED)
    assert (heartbeat.takeover, heartbeat.subscribers) == (Takeover.STOPPED, 2)
    assert (heartbeat.replacement, heartbeat.command) == (damping, command)
    heartbeat.clear()
    assert other.last_write == 0
    other.close()


_REPLACING = """
import sys
from itertools import cycle
from g1stream.control.guard import Heartbeat, Takeover
from g1stream.dds.messages import LowCmd
heartbeat = Heartbeat(int(sys.argv[1]))
size = len(LowCmd().seal())
for filled in cycle([bytes([n]) * size for n in range(1, 256)]):
    heartbeat.replace(filled, Takeover.STOPPED)
"""


def test_a_command_that_the_guard_replaces_meanwhile_is_read_whole(heartbeat):
    command = [sys.executable, "-c", _REPLACING, str(heartbeat.descriptor)]
    with subprocess.Popen(command, pass_fds=[heartbeat.descriptor]) as guard:
        try:
            while not heartbeat.replacement:
                assert guard.poll() is None
            read = {heartbeat.replacement for _ in range(100_000)}
        finally:
            guard.kill()
    assert len(read) > 10
    assert all(len(set(one)) == 1 for one in read)


def test_the_guard_damps_where_the_last_command_was():
    """The slots of absent motors stay zero."""
    last, damping = LowCmd(), LowCmd()
    last.motor_mode, last.mode_machine[()] = np.arange(29) % 7 > 0, 5
    last.q[:] = np.linspace(-1, 1, 29)
    last.dq[:], last.tau[:], last.kp[:], last.kd[:] = 1.0, 2.0, 100.0, 4.0
    damping.load(damping_command(last.seal(), 3.0))
    assert damping.crc_matches()
    assert np.array_equal(damping.q, last.q)
    assert np.array_equal((damping.kp, damping.dq, damping.tau), np.zeros((3, 29)))
    assert damping.kd.tolist() == [3.0 if i % 7 else 0.0 for i in range(29)]
    assert damping.motor_mode.tolist() == [int(i % 7 > 0) for i in range(29)]
    assert damping.mode_machine == 5


@pytest.mark.parametrize("why", [Takeover.STOPPED, Takeover.SILENT])
def test_a_stream_that_is_killed_in_a_write_is_not_waited_for(heartbeat, why):
    with subprocess.Popen(["true"]) as process:
        process.wait()
    heartbeat.begin_write(LowCmd().seal(), START)
    _fence(heartbeat, process.pid, why)  # returns, so that the guard damps
    assert heartbeat.writing


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
