import ctypes
import os
import random
import signal
import threading
import time

import psutil
import pytest

import g1stream
from g1stream.extras.library.workers import (
    CrashedError,
    Limits,
    TooSlowError,
    completed,
    open_workers,
)

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def client():
    with open_workers(2) as client:
        yield client


def answers(client, function, items, limits=None):
    calls = (pair for pairs in completed(client, function, items, limits) for pair in pairs)
    return {item: future.exception() or future.result() for item, future in calls}


def call(what):
    if what == "endless":  # in C, with the lock of the interpreter
        ctypes.PyDLL(None).pause()
    elif what == "abort":
        os.abort()
    elif what == "huge":
        return len(bytes(500_000_000))
    elif what == "raise":
        raise ZeroDivisionError
    elif what == "lock":  # cannot be pickled
        return threading.Lock()
    return os.getpid()


def test_each_call_has_its_own_fate(client):
    found = answers(
        client,
        call,
        ["a", "endless", "abort", "b", "huge", "raise", "lock", "c"],
        Limits(4.0, megabytes=200.0),
    )
    kinds = {what: type(one) for what, one in found.items()}
    assert kinds == {
        **dict.fromkeys("abc", int),
        "endless": TooSlowError,
        "abort": CrashedError,
        "huge": MemoryError,
        "raise": ZeroDivisionError,
        "lock": TypeError,
    }
    assert os.getpid() not in found.values()


def test_the_limits_are_those_of_a_call_alone(client):
    assert answers(client, abs, [-1], Limits(float("inf"), 20.0)) == {-1: 1}
    assert answers(client, time.sleep, [1.5, 1.6], Limits(2.0)) == {1.5: None, 1.6: None}
    assert answers(client, call, ["huge"]) == {"huge": 500_000_000}


@pytest.fixture
def sent(client, monkeypatch):
    """Numbers of calls that were sent together."""
    sizes, submit = [], client.submit

    def counted(function, *args, **kwargs):
        sizes.extend(len(items) for items in args)
        return submit(function, *args, **kwargs)

    monkeypatch.setattr(client, "submit", counted)
    return sizes


def test_calls_take_a_quarter_of_a_second_together_also_if_this_process_is_slow(client, sent):
    delays = [0.005 + 1e-9 * i for i in range(800)]
    slow = lambda: time.sleep(0.5) is not None  # noqa: E731  several answers come meanwhile
    assert sum(len(pairs) for pairs in completed(client, time.sleep, delays, stop=slow)) == 800
    assert 8 < max(sent) <= 50


def test_calls_after_quick_ones_are_not_sent_by_the_hundred(client, sent):
    delays = [1e-9 * i for i in range(100)] + [0.005 + 1e-9 * i for i in range(2000)]
    assert len(answers(client, time.sleep, delays)) == 2100
    assert all(n <= 2 * max(sent[:i], default=1) for i, n in enumerate(sent))


def test_workers_take_messages_only_from_who_has_their_key(client):
    address = client.scheduler.address
    assert address.startswith("tls://127.0.0.1:")
    workers = client.scheduler_info()["workers"]
    assert all(one.startswith("tls://127.0.0.1:") for one in workers)
    # Other sockets of this process and other children, and theirs, are those of other tests.
    info = client.scheduler_info()
    ours = {int(address.rpartition(":")[2]), *info["services"].values()}
    of_dask = [
        one for one in psutil.Process().children() if "spawn_main" in " ".join(one.cmdline())
    ]
    sockets = [one for process in of_dask for one in process.net_connections("tcp")]
    sockets += [one for one in psutil.Process().net_connections("tcp") if one.laddr.port in ours]
    listening = {one.laddr.ip for one in sockets if one.status == psutil.CONN_LISTEN}
    assert len(of_dask) >= len(workers)
    assert listening == {"127.0.0.1"}


def test_workers_that_are_killed_at_random_lose_nothing(many, tmp_path):
    over = threading.Event()

    def kill():
        chance = random.Random(0)
        while not over.wait(chance.uniform(0.3, 1.2)):
            children = psutil.Process().children()
            workers = [one for one in children if "spawn_main" in " ".join(one.cmdline())]
            if workers:
                chance.choice(workers).send_signal(signal.SIGKILL)

    killer = threading.Thread(target=kill)
    timer = threading.Timer(8.0, over.set)

    def on_row(_):
        if not killer.is_alive() and not over.is_set():
            killer.start()
            timer.start()

    case = g1stream.library.LibraryCase("check", tmp_path)
    try:
        run = g1stream.library.run_library([str(many)], [case], workers=2, on_row=on_row)
    finally:
        over.set()
        timer.cancel()
    killer.join()
    assert (run.complete, run.lost) == (True, {})
    statuses = g1stream.library.open_library(tmp_path).motions["status"]
    assert len(statuses) == 120
    assert set(statuses) <= {"ok", "crashed"}  # killed twice
    assert (statuses == "ok").sum() > 30
