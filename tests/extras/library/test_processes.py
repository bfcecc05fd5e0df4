import os
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
def test_a_process_is_kept_until_a_call_is_too_slow():
    pid = limited(Limits(), os.getpid)
    assert limited(Limits(), os.getpid) == pid != os.getpid()
    with pytest.raises(TooSlowError):
        limited(Limits(seconds=0.5), time.sleep, 60.0)
    assert limited(Limits(), os.getpid) != pid


@pytest.mark.slow
def test_a_call_that_raises_or_crashes():
    with pytest.raises(ZeroDivisionError):
        limited(Limits(), divmod, 1, 0)
    with pytest.raises(CrashedError):
        limited(Limits(), os.abort)


@pytest.mark.slow
def test_processes_can_be_ended():
    limited(Limits(), abs, -1)
    threading.Timer(0.3, end_processes).start()
    with pytest.raises(CancelledError):
        limited(Limits(), time.sleep, 60.0)


def test_a_broken_pool_is_replaced():
    """pebble gives a pool up where its process is killed at a bad moment."""
    from pebble.pool.base_pool import PoolStatus

    pid = limited(Limits(), os.getpid)
    processes._THREAD.pool[0]._context.status = PoolStatus.ERROR
    assert limited(Limits(), os.getpid) not in (pid, os.getpid())
