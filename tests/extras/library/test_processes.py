"""Calls that take too long, too much memory, or their process with them."""

from __future__ import annotations

import os
import signal
import threading
import time
from concurrent.futures import CancelledError

import pytest

from g1stream.extras.library.processes import LimitError, Limits, end_processes, limited


@pytest.fixture(autouse=True)
def none_left():
    yield
    end_processes()


@pytest.mark.slow
def test_a_slow_call_ends_with_its_process():
    with pytest.raises(LimitError):
        limited(Limits(seconds=0.5), time.sleep, 60.0)
    assert limited(Limits(), abs, -1) == 1


@pytest.mark.slow
def test_memory_is_limited():
    with pytest.raises(MemoryError):
        limited(Limits(megabytes=300.0), bytes, 400_000_000)
    assert len(limited(Limits(megabytes=300.0), bytes, 100_000_000)) == 100_000_000


@pytest.mark.slow
def test_a_call_that_crashes_is_made_twice(tmp_path):
    with pytest.raises(LimitError) as raised:
        limited(Limits(), os.abort)
    assert raised.value.status == "crashed"


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
