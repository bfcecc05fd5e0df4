import os
import signal
import threading
import time
from concurrent.futures import CancelledError

import pytest

from g1stream.errors import MotionError
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


RAISING = "from g1stream.errors import MotionError; raise MotionError('A cause.', 'A remedy.')"


@pytest.mark.slow
def test_a_call_that_raises_or_crashes():
    with pytest.raises(ZeroDivisionError):
        limited(Limits(), divmod, 1, 0)
    with pytest.raises(FileNotFoundError):  # not an end of the process
        limited(Limits(), os.stat, "/none")
    with pytest.raises(MotionError, match=r"A cause\. A remedy\."):
        limited(Limits(), exec, RAISING)
    with pytest.raises(CrashedError):
        limited(Limits(), os.abort)


@pytest.mark.slow
def test_processes_can_be_ended():
    limited(Limits(), abs, -1)
    threading.Timer(0.3, end_processes).start()
    with pytest.raises(CancelledError):
        limited(Limits(), time.sleep, 60.0)


#: A killed process has sent the length of an answer and a part of it.
KILLED_WHILE_SENDING = """
import gc, os, signal
from multiprocessing.connection import Connection
(pipe,) = (one for one in gc.get_objects() if isinstance(one, Connection))
os.write(pipe.fileno(), bytes((0, 0, 1, 0)) + b"part")
os.kill(os.getpid(), signal.SIGKILL)
"""


@pytest.mark.slow
def test_a_process_that_is_killed_is_replaced():
    with pytest.raises(CrashedError):
        limited(Limits(), exec, KILLED_WHILE_SENDING)
    pid = limited(Limits(), os.getpid)
    os.kill(pid, signal.SIGKILL)
    assert limited(Limits(), os.getpid) not in (pid, os.getpid())
