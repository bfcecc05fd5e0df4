"""Scheduling of a thread: priority or time slice, locked memory, timer slack, CPU affinity.

Everything works without them, with more jitter. What needs a permission is requested, and reported
as granted or with the way to get it.
"""

from __future__ import annotations

import ctypes
import gc
import os
import platform
import re
import sys
import threading
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterator

__all__ = [
    "Grant",
    "allow_all_cpus",
    "describe",
    "lower_priority",
    "on_time",
]

_PR_SET_TIMERSLACK, _PR_GET_TIMERSLACK = 29, 30  # <linux/prctl.h>
_MCL_CURRENT, _MCL_ONFAULT = 1, 4  # <sys/mman.h>
#: Of `sched_setattr` and `sched_getattr`, <asm/unistd.h>.
_SYSCALLS = {"x86_64": (314, 315), "aarch64": (274, 275)}
_RESET_ON_FORK = 1  # <linux/sched.h>
#: The shortest time slice that Linux gives, ns. A thread with a short slice soon gets a CPU.
_SLICE = 100_000
_BACKGROUND_NICE = 5
#: Cyclone 0.10 and 11 name their threads so.
_OF_CYCLONE = re.compile(r"recv(UC|MC)?|tev|gc|lease|(dq|tev|xmit)\..*")
#: Other threads hold the GIL, while they draw or write a file, for at most this long, s.
_SWITCH_INTERVAL = 1e-4


@dataclass(frozen=True)
class Grant:
    """The result of one request to the system."""

    what: str
    granted: bool
    detail: str  # the setting now, or why it was not granted
    cost: str = ""  # the effect of not having it
    remedy: str = ""  # how to get it, on one line


@contextmanager
def on_time(priority: int, cpu: int | None = None) -> Iterator[list[Grant]]:
    """Give the calling thread the lowest latency that the system allows, during a `with`.

    Requests SCHED_FIFO, or without it a short time slice, locked memory, timers without slack and
    an isolated CPU if there is one, disables Python's garbage collector, and gets the GIL within
    0.1 ms. Existing threads of DDS get the next lower priority, or the same time slice. Threads and
    processes that are started inside do not inherit the priority.

    Args:
        priority: of SCHED_FIFO, 1 to 99; 0: normal scheduling.
        cpu: the only CPU to run on; by default an isolated one, or any.

    Yields:
        The result of each request.
    """
    collecting = gc.isenabled()
    gc.collect()
    gc.freeze()
    gc.disable()
    try:
        with _quick_thread_switches(), _linux_thread(priority, cpu) as grants:
            yield [*grants, Grant("garbage collector", granted=True, detail="frozen")]
    finally:
        if collecting:
            gc.enable()
        gc.unfreeze()


@contextmanager
def _quick_thread_switches() -> Iterator[None]:
    """Switch threads after 0.1 ms, and not after CPython's 5 ms, during a `with`."""
    before = sys.getswitchinterval()
    sys.setswitchinterval(min(_SWITCH_INTERVAL, before))
    try:
        yield
    finally:
        sys.setswitchinterval(before)


@contextmanager
def _linux_thread(priority: int, cpu: int | None) -> Iterator[list[Grant]]:
    if sys.platform != "linux":
        yield [Grant("SCHED_FIFO", granted=False, detail="only on Linux")]
        return
    affinity, slack = os.sched_getaffinity(0), _timer_slack()
    policy, parameters = os.sched_getscheduler(0), os.sched_getparam(0)
    helpers = _threads_of_dds()
    try:
        fifo = _ask_for_fifo(priority, helpers)
        yield [
            fifo,
            *([] if fifo.granted else [_ask_for_short_slice(helpers)]),
            _ask_for_memory(),
            _ask_for_exact_timers(),
            _ask_for_cpu(cpu),
        ]
    finally:
        # The flag does no harm, and clearing it needs a permission that the user may not have.
        for thread in (0, *helpers):
            with suppress(ProcessLookupError):  # it has ended meanwhile
                os.sched_setscheduler(thread, policy | os.SCHED_RESET_ON_FORK, parameters)
            _set_slice(thread, 0)
        os.sched_setaffinity(0, affinity)
        _libc().prctl(_PR_SET_TIMERSLACK, ctypes.c_ulong(slack))
        _libc().munlockall()


def lower_priority() -> None:
    """Let the calling process yield to real-time loops."""
    os.nice(_BACKGROUND_NICE)


def allow_all_cpus(thread: int = 0) -> None:
    """Let a thread, the calling one by default, run on any CPU, whatever its parent process may."""
    if sys.platform == "linux":
        with suppress(OSError):  # a container may allow none of the others
            os.sched_setaffinity(thread, range(os.cpu_count() or 1))


def describe(grants: list[Grant]) -> str:
    """The results on one line."""
    return ", ".join(f"{g.what} {g.detail if g.granted else 'not granted'}" for g in grants)


def _ask_for_fifo(priority: int, helpers: list[int]) -> Grant:
    what = "SCHED_FIFO"
    if not priority:
        return Grant(what, granted=False, detail="not requested: the priority is 0")
    # Without the flag, threads and processes started from here would inherit the priority.
    policy = os.SCHED_FIFO | os.SCHED_RESET_ON_FORK
    try:
        os.sched_setscheduler(0, policy, os.sched_param(priority))
        for thread in helpers:
            with suppress(ProcessLookupError):
                os.sched_setscheduler(thread, policy, os.sched_param(max(1, priority - 1)))
    except PermissionError:
        return _denied(
            what,
            f"no permission for priority {priority} (RLIMIT_RTPRIO, CAP_SYS_NICE)",
            "other processes can delay a command by milliseconds",
            f"rtprio {priority + 1}",  # the guard process asks for one more than the loop
        )
    return Grant(what, granted=True, detail=f"priority {priority}")


class _Scheduling(ctypes.Structure):
    """`struct sched_attr`, <linux/sched/types.h>."""

    _fields_ = (
        ("size", ctypes.c_uint32),
        ("policy", ctypes.c_uint32),
        ("flags", ctypes.c_uint64),
        ("nice", ctypes.c_int32),
        ("priority", ctypes.c_uint32),
        ("runtime", ctypes.c_uint64),
        ("deadline", ctypes.c_uint64),
        ("period", ctypes.c_uint64),
    )


def _ask_for_short_slice(helpers: list[int]) -> Grant:
    """Ask for what needs no permission and lets a thread get a CPU before those that compute."""
    for thread in helpers:
        _set_slice(thread, _SLICE)
    if not _set_slice(0, _SLICE):
        return Grant(
            "time slice",
            granted=False,
            detail="Linux before 6.12 cannot set it",
            cost="other processes can delay a command by milliseconds",
        )
    return Grant("time slice", granted=True, detail="0.1 ms")


def _set_slice(thread: int, runtime: int) -> bool:
    """Set the time slice of a thread, ns; 0: the system's. Returns whether it is set."""
    set_attributes, get_attributes = _SYSCALLS.get(platform.machine(), (0, 0))
    if not set_attributes:
        return False
    now, size = _Scheduling(), ctypes.sizeof(_Scheduling)
    _libc().syscall(get_attributes, thread, ctypes.byref(now), size, 0)
    now.flags, now.runtime = _RESET_ON_FORK, runtime
    _libc().syscall(set_attributes, thread, ctypes.byref(now), 0)
    _libc().syscall(get_attributes, thread, ctypes.byref(now), size, 0)
    return bool(now.runtime == runtime)


def _threads_of_dds() -> list[int]:
    """Cyclone's threads in this process, by the names that it gives them.

    The loop depends on what they receive, and at times on a lock that one of them holds.
    """
    ours, found = {thread.native_id for thread in threading.enumerate()}, []
    for task in Path("/proc/self/task").iterdir():
        with suppress(OSError):  # it has ended meanwhile
            name = (task / "comm").read_text().strip()
            if int(task.name) not in ours and _OF_CYCLONE.fullmatch(name):
                found.append(int(task.name))
    return found


def _ask_for_memory() -> Grant:
    what = "memory"
    # Only current pages: with a limit on locked memory, MCL_FUTURE would make a later allocation
    # fail.
    if _libc().mlockall(_MCL_CURRENT | _MCL_ONFAULT):
        return _denied(
            what,
            "no permission to lock all of it (RLIMIT_MEMLOCK, CAP_IPC_LOCK)",
            "when memory is short, a command can be delayed by paging",
            "memlock unlimited",
        )
    return Grant(what, granted=True, detail="locked")


def _ask_for_exact_timers() -> Grant:
    _libc().prctl(_PR_SET_TIMERSLACK, ctypes.c_ulong(1))
    slack = _timer_slack()  # 0 for a thread of SCHED_FIFO
    return Grant("timer slack", granted=slack <= 1, detail=f"{slack} ns")


def _ask_for_cpu(cpu: int | None) -> Grant:
    what = "affinity"
    wanted = {cpu} if cpu is not None else _isolated_cpus()
    try:
        if wanted:
            os.sched_setaffinity(0, wanted)
    except OSError:
        return Grant(
            what,
            granted=False,
            detail=f"CPU {_listed(wanted)} cannot be used by this process",
            remedy=f"Choose one of CPUs {_listed(os.sched_getaffinity(0))}.",
        )
    return Grant(what, granted=True, detail=f"CPU {_listed(os.sched_getaffinity(0))}")


def _isolated_cpus() -> set[int]:
    """CPUs that the kernel keeps free of other work (isolcpus)."""
    try:
        listed = Path("/sys/devices/system/cpu/isolated").read_text().strip()
    except OSError:
        return set()
    found: set[int] = set()
    for part in filter(None, listed.split(",")):
        first, _, last = part.partition("-")
        found.update(range(int(first), int(last or first) + 1))
    return found


def _timer_slack() -> int:
    return int(_libc().prctl(_PR_GET_TIMERSLACK))


def _libc() -> ctypes.CDLL:
    return ctypes.CDLL(None, use_errno=True)


def _listed(cpus: set[int]) -> str:
    return ", ".join(map(str, sorted(cpus)))


def _denied(what: str, detail: str, cost: str, limit: str) -> Grant:
    """A request for which the user needs a line in limits.conf(5)."""
    import getpass

    try:
        user = getpass.getuser()
    except (KeyError, OSError):  # one without a name, as in containers
        user = f":{os.getuid()}"
    line, file = f"'{user} - {limit}'", "/etc/security/limits.d/g1stream.conf"
    remedy = f"Put the line {line} into {file} and log in again."
    return Grant(what, granted=False, detail=detail, cost=cost, remedy=remedy)
