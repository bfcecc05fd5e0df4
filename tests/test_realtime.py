import _thread
import ctypes
import gc
import os
import re
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from g1stream import realtime
from g1stream.dds.domain import Participant
from g1stream.realtime import describe, on_time

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="asks for Linux's own")

PRIORITY = 50
POLICY = ~os.SCHED_RESET_ON_FORK if sys.platform == "linux" else 0


def state():
    return (
        os.sched_getscheduler(0) & POLICY,
        os.sched_getaffinity(0),
        gc.isenabled(),
    )


def by_name(grants):
    return {grant.what: grant for grant in grants}


def test_everything_is_restored_after_an_error():
    before = state()

    def fail():
        with on_time(PRIORITY):
            assert not gc.isenabled()
            assert gc.get_freeze_count() > 0
            raise KeyError

    with pytest.raises(KeyError):
        fail()
    assert state() == before
    assert gc.get_freeze_count() == 0  # Python 3.12 itself begins with some


def test_a_reported_priority_is_in_force():
    with on_time(priority=7) as grants:
        is_fifo = os.sched_getscheduler(0) & POLICY == os.SCHED_FIFO
        assert by_name(grants)["SCHED_FIFO"].granted == is_fifo
        assert ("SCHED_FIFO priority 7" in describe(grants)) == is_fifo
        if is_fifo:
            assert os.sched_getparam(0).sched_priority == 7


def test_threads_of_dds_get_the_next_lower_priority(domain_id):
    with Participant(domain_id, "lo") as participant:
        threads = participant.threads
        with on_time(priority=7, helpers=threads) as grants:
            inside = {os.sched_getparam(thread).sched_priority for thread in threads}
        after = {os.sched_getscheduler(thread) & POLICY for thread in threads}
    assert inside == ({6} if by_name(grants)["SCHED_FIFO"].granted else {0})
    assert after == {os.SCHED_OTHER}


@pytest.mark.parametrize("name", [b"torch-worker", b"gc", b"recv"])
def test_threads_of_others_keep_theirs(domain_id, name):
    """One that a library has started, perhaps with the name of one of Cyclone's."""
    named, done, threads = threading.Event(), threading.Event(), []

    def work():
        threads.append(threading.get_native_id())
        ctypes.CDLL(None).prctl(15, name)  # PR_SET_NAME
        named.set()
        done.wait()

    _thread.start_new_thread(work, ())
    named.wait()
    with Participant(domain_id, "lo") as own, on_time(PRIORITY, helpers=own.threads):
        inside = os.sched_getscheduler(threads[0]) & POLICY
    done.set()
    assert inside == os.SCHED_OTHER


def test_without_the_priority_the_time_slice_is_short():
    """Beside threads that compute, a thread with a long one waits for milliseconds."""
    own = _slice()
    with on_time(priority=0) as grants:
        assert os.sched_getscheduler(0) & POLICY == os.SCHED_OTHER
        assert not by_name(grants)["SCHED_FIFO"].granted
        if not by_name(grants)["time slice"].granted:
            pytest.skip("Linux before 6.12")
        inside, of_new = _slice(), []
        thread = threading.Thread(target=lambda: of_new.append(_slice()))
        thread.start()
        thread.join()
    assert inside == 100_000 < own
    assert of_new == [own]
    assert _slice() == own


def _slice():
    """Of the calling thread, ns, as the kernel tells it."""
    text = Path(f"/proc/self/task/{threading.get_native_id()}/sched").read_text()
    return int(re.search(r"se.slice\s*:\s*(\d+)", text)[1])


def test_threads_do_not_inherit_the_priority():
    seen = []
    with on_time(PRIORITY):
        thread = threading.Thread(target=lambda: seen.append(os.sched_getscheduler(0) & POLICY))
        thread.start()
        thread.join()
    assert seen == [os.SCHED_OTHER]


def test_a_missing_permission_has_a_remedy(monkeypatch):
    def refuse(*_):
        raise PermissionError

    monkeypatch.setattr(os, "sched_setscheduler", refuse)
    for name in ("LOGNAME", "USER", "LNAME", "USERNAME"):  # a user without a name
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(os, "getuid", lambda: 1_234_567)
    grant = realtime._ask_for_fifo(50, [])
    assert not grant.granted
    assert ":1234567 - rtprio 51" in grant.remedy
    assert grant.cost


def test_one_cpu_is_chosen():
    cpu = min(os.sched_getaffinity(0))
    with on_time(PRIORITY, cpu=cpu) as grants:
        assert os.sched_getaffinity(0) == {cpu}
        assert by_name(grants)["affinity"].granted
    with on_time(PRIORITY, cpu=100_000) as grants:
        assert not by_name(grants)["affinity"].granted


def test_lower_priority_applies_to_the_whole_process():
    """In a process of its own, because it cannot be undone."""
    script = "import os, g1stream.realtime as r; r.lower_priority(); print(os.nice(0))"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, check=True)
    assert int(done.stdout) == min(19, os.nice(0) + 5)
