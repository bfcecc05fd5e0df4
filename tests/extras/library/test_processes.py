"""Calls that take too long, too much memory, or their process with them."""

from __future__ import annotations

import os
import signal
import threading
import time
from concurrent.futures import CancelledError

import pytest

from g1stream.extras.library import processes
from g1stream.extras.library.processes import (
    CrashedError,
    Limits,
    TooSlowError,
    end_processes,
    limited,
)


@pytest.fixture(autouse=True)
def none_left():
    yield
    end_processes()


@pytest.mark.slow
def test_the_process_is_kept():
    assert limited(Limits(), os.getpid) == limited(Limits(), os.getpid) != os.getpid()


@pytest.mark.slow
def test_a_slow_call_ends_with_its_process():
    with pytest.raises(TooSlowError):
        limited(Limits(seconds=0.5), time.sleep, 60.0)
    assert limited(Limits(), abs, -1) == 1


@pytest.mark.slow
def test_memory_is_limited():
    with pytest.raises(MemoryError):
        limited(Limits(megabytes=300.0), bytes, 400_000_000)
    assert len(limited(Limits(megabytes=300.0), bytes, 100_000_000)) == 100_000_000


@pytest.mark.slow
def test_a_call_that_crashes_is_made_twice(tmp_path):
    with pytest.raises(CrashedError):
        limited(Limits(), os.abort)


@pytest.mark.slow
def test_a_killed_process_is_replaced():
    pid = limited(Limits(), os.getpid)
    killer = threading.Timer(0.5, os.kill, (pid, signal.SIGKILL))
    killer.start()
    begun = time.monotonic()
    limited(Limits(), time.sleep, 1.0)
    assert time.monotonic() - begun > 1.4  # it slept anew
    assert limited(Limits(), os.getpid) != pid


@pytest.mark.slow
def test_processes_can_be_ended():
    limited(Limits(), abs, -1)
    threading.Timer(0.3, end_processes).start()
    with pytest.raises(CancelledError):
        limited(Limits(), time.sleep, 60.0)


@pytest.mark.slow
def test_what_it_raises_is_raised():
    with pytest.raises(ZeroDivisionError):
        limited(Limits(), divmod, 1, 0)


def test_a_broken_pool_is_replaced():
    """pebble gives a pool up where its process is killed at a bad moment."""
    from pebble.pool.base_pool import PoolStatus

    pid = limited(Limits(), os.getpid)
    processes._THREAD.pool[0]._context.status = PoolStatus.ERROR
    assert limited(Limits(), os.getpid) not in (pid, os.getpid())
