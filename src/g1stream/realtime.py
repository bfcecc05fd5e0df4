"""Real-time scheduling of a thread: priority, time slice, locked memory, timer slack, CPU affinity.

Everything works without them, with more jitter. Each request is reported as granted, or with the
way to get the permission.
"""

from __future__ import annotations

import ctypes
import gc
import os
import platform
import sys
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

__all__ = [
    "Grant",
    "allow_all_cpus",
    "describe",
    "lower_priority",
    "on_time",
]

_PR_SET_TIMERSLACK, _PR_GET_TIMERSLACK = 29, 30  # <linux/prctl.h>
_MCL_CURRENT, _MCL_ONFAULT = 1, 4  # <sys/mman.h>
#: Numbers of `sched_setattr` and `sched_getattr`, <asm/unistd.h>.
_SYSCALLS = {"x86_64": (314, 315), "aarch64": (274, 275)}
_RESET_ON_FORK = 1  # <linux/sched.h>
#: The shortest time slice that Linux gives, ns. A thread with a short slice soon gets a CPU.
_SLICE = 100_000
_BACKGROUND_NICE = 5
#: Maximum time for which another thread holds the GIL, for example while it writes a file, s.
_SWITCH_INTERVAL = 1e-4


@dataclass(frozen=True)
class Grant:
    """The result of one request to the system."""

    what: str
    granted: bool
    detail: str  # the setting in force, or why the request was not granted
    cost: str = ""  # effect of a request that was not granted
    remedy: str = ""  # how to get the permission, on one line


@contextmanager
def on_time(
    priority: int, cpu: int | None = None, helpers: Sequence[int] = ()
) -> Iterator[list[Grant]]:
    """Context manager that gives the calling thread the lowest latency that the system allows.

    It requests SCHED_FIFO, or a short time slice if that is denied, locked memory, timers without
    slack, and an isolated CPU if there is one. It disables Python's garbage collector and limits
    the wait for the GIL to 0.1 ms. The helpers get the next lower priority, or the same time slice.
    Threads and processes that are started inside do not inherit the priority.

    Args:
        priority: SCHED_FIFO priority, 1 to 99; 0: normal scheduling.
        cpu: the only CPU to run on; None: an isolated CPU, or any if there is none.
        helpers: ids of threads that the calling one depends on, such as `Participant.threads`.

    Yields:
        The result of each request.
    """
    collecting = gc.isenabled()
    gc.collect()
    gc.freeze()
    gc.disable()
    try:
        with _quick_thread_switches(), _linux_thread(priority, cpu, helpers) as grants:
            yield [*grants, Grant("garbage collector", granted=True, detail="frozen")]
    finally:
        if collecting:
            gc.enable()
        gc.unfreeze()


@contextmanager
def _quick_thread_switches() -> Iterator[None]:
    """Context manager that switches threads after 0.1 ms, instead of CPython's 5 ms."""
    before = sys.getswitchinterval()
    sys.setswitchinterval(min(_SWITCH_INTERVAL, before))
    try:
        yield
    finally:
        sys.setswitchinterval(before)


@contextmanager
def _linux_thread(priority: int, cpu: int | None, helpers: Sequence[int]) -> Iterator[list[Grant]]:
    if sys.platform != "linux":
        yield [Grant("SCHED_FIFO", granted=False, detail="only on Linux")]
        return
    affinity, slack = os.sched_getaffinity(0), _timer_slack()
    policy, parameters = os.sched_getscheduler(0), os.sched_getparam(0)
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
        # The flag is harmless, and clearing it needs a permission that the user may not have.
        for thread in (0, *helpers):
            with suppress(ProcessLookupError):  # it has ended meanwhile
                os.sched_setscheduler(thread, policy | os.SCHED_RESET_ON_FORK, parameters)
            _set_slice(thread, 0)
        os.sched_setaffinity(0, affinity)
        _libc().prctl(_PR_SET_TIMERSLACK, ctypes.c_ulong(slack))
        _libc().munlockall()


def lower_priority() -> None:
    """Lower the priority of the calling process, so that it yields to real-time loops."""
    os.nice(_BACKGROUND_NICE)


def allow_all_cpus(thread: int = 0) -> None:
    """Let a thread, by default the calling one, run on all CPUs, independent of its parent."""
    if sys.platform == "linux":
        with suppress(OSError):  # a container may allow none of the others
            os.sched_setaffinity(thread, range(os.cpu_count() or 1))


def describe(grants: list[Grant]) -> str:
    """The results of the requests on one line."""
    return ", ".join(f"{g.what} {g.detail if g.granted else 'not granted'}" for g in grants)


def _ask_for_fifo(priority: int, helpers: Sequence[int]) -> Grant:
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
            f"rtprio {priority + 1}",  # the guard process requests one more than the loop
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


def _ask_for_short_slice(helpers: Sequence[int]) -> Grant:
    """Request a short time slice, which gets a CPU before long ones and needs no permission."""
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
    """Set the time slice of a thread, ns; 0: the system's default. Return whether it is set."""
    set_attributes, get_attributes = _SYSCALLS.get(platform.machine(), (0, 0))
    if not set_attributes:
        return False
    now, size = _Scheduling(), ctypes.sizeof(_Scheduling)
    _libc().syscall(get_attributes, thread, ctypes.byref(now), size, 0)
    now.flags, now.runtime = _RESET_ON_FORK, runtime
    _libc().syscall(set_attributes, thread, ctypes.byref(now), 0)
    _libc().syscall(get_attributes, thread, ctypes.byref(now), size, 0)
    return bool(now.runtime == runtime)


def _ask_for_memory() -> Grant:
    what = "memory"
    # Only current pages, because with a limit on locked memory, MCL_FUTURE would make a later
    # allocation fail.
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
    """CPUs that the kernel isolates from other threads (isolcpus)."""
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
    """The result of a denied request that needs a line in limits.conf(5)."""
    import getpass

    try:
        user = getpass.getuser()
    except (KeyError, OSError):  # a user without a name, as in containers
        user = f":{os.getuid()}"
    line, file = f"'{user} - {limit}'", "/etc/security/limits.d/g1stream.conf"
    remedy = f"Add the line {line} to {file} and log in again."
    return Grant(what, granted=False, detail=detail, cost=cost, remedy=remedy)
