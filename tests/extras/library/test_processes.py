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
    with pytest.raises(MemoryError):  # the bytes fit in the memory, but not with a copy of them
        limited(Limits(megabytes=60.0), bytes, 40_000_000)
    with pytest.raises(TypeError):  # an answer that cannot be pickled
        limited(Limits(), threading.Lock)
    assert limited(Limits(seconds=float("inf")), abs, -1) == 1
    with pytest.raises(CrashedError):
        limited(Limits(), os.abort)


@pytest.mark.slow
def test_an_answer_is_that_of_its_own_call():
    def interrupt(number, frame):
        raise ZeroDivisionError

    before = signal.signal(signal.SIGUSR1, interrupt)
    try:
        pid = limited(Limits(), os.getpid)
        threading.Timer(0.2, os.kill, (os.getpid(), signal.SIGUSR1)).start()
        with pytest.raises(ZeroDivisionError):
            limited(Limits(), time.sleep, 1.0)
        assert limited(Limits(), os.getpid) not in (pid, None)
    finally:
        signal.signal(signal.SIGUSR1, before)
    with pytest.raises(AttributeError):  # the arguments cannot be pickled
        limited(Limits(), abs, lambda: None)
    with pytest.raises(TypeError):  # nor can the parent read the answer
        limited(Limits(), eval, "type('Odd', (), {'__reduce__': lambda self: (len, ())})()")
    assert limited(Limits(), abs, -1) == 1


@pytest.mark.slow
def test_a_process_that_cannot_start_is_no_fault_of_the_call(monkeypatch, tmp_path):
    (tmp_path / "mujoco.py").write_text("raise SystemExit(3)")
    with monkeypatch.context() as there:  # what lies in the working directory is not imported
        there.chdir(tmp_path)
        assert limited(Limits(), abs, -1) == 1
    end_processes()
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(OSError, match="started"):
        limited(Limits(), abs, -1)


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
