"""The workers of Dask that compute a library: those of this machine, or of a scheduler.

Each worker is a process that makes one call at a time, within limits of time and memory. A call
that does not return, not even to Python, is ended with its process by the timer of the system. Its
nanny starts another worker.
"""

from __future__ import annotations

import asyncio
import logging
import math
import resource
import signal
import time
from collections import deque
from concurrent.futures import Future, wait
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from functools import partial
from importlib import import_module
from ipaddress import ip_address
from pathlib import Path
from queue import Empty, SimpleQueue
from threading import Thread
from typing import TYPE_CHECKING, Any, Final, Generic, TypeVar

from g1stream._version import __version__
from g1stream.errors import ConfigError, G1StreamError
from g1stream.optional import import_extra

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable, Iterator, Sequence

__all__ = ["CrashedError", "Limits", "TooSlowError", "completed", "open_workers"]

T = TypeVar("T")
R = TypeVar("R")

#: Results within this time are returned together, s, because writing a row alone takes 10 ms.
_TOGETHER: Final = 0.25
#: Timeout for an answer of the scheduler, and for workers to import g1stream, s.
_TIMEOUT: Final = 10.0
_START: Final = 60.0
#: Time between checks whether to stop, and for workers that came or went, s.
_POLL: Final = 0.2
#: Longest time of a timer, s.
_LONGEST: Final = 1e8


class TooSlowError(G1StreamError):
    """A call took longer than its limit."""


class CrashedError(G1StreamError):
    """The worker of a call ended twice."""


@dataclass(frozen=True)
class Limits:
    """Limits of a call.

    Attributes:
        seconds: time limit.
        megabytes: memory limit, 10^6 bytes, in addition to what the process has before the call.
            Beyond it the call gets a `MemoryError`.
    """

    seconds: float = 600.0
    megabytes: float = 4000.0

    def __str__(self) -> str:
        return f"{self.seconds:g} s, {self.megabytes:g} MB"


def _import() -> None:
    """Import what a call needs, in a new worker: not within the limits of its first call."""
    for module in ("g1stream.extras.library.compute", "mujoco", "scipy.interpolate"):
        import_module(module)


def _within(limits: Limits | None, function: Callable[[T], R], item: T) -> R:
    """Call a function with an item, in a worker that makes no other call meanwhile."""
    if limits is None:
        return function(item)
    # In the unit of RLIMIT_DATA (proc(5), statm): private writable memory.
    own = int(Path("/proc/self/statm").read_text().split()[5]) * resource.getpagesize()
    soft, hard = resource.getrlimit(resource.RLIMIT_DATA)
    most = own + round(limits.megabytes * 1e6)
    if hard != resource.RLIM_INFINITY:
        most = min(most, hard)
    resource.setrlimit(resource.RLIMIT_DATA, (most, hard))
    # SIGALRM, which nothing handles, ends the process whatever it does.
    signal.setitimer(signal.ITIMER_REAL, min(limits.seconds, _LONGEST))
    try:
        return function(item)
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        resource.setrlimit(resource.RLIMIT_DATA, (soft, hard))


@dataclass(eq=False)
class _Call(Generic[T, R]):
    item: T
    crashed: bool = False  # it may be what its worker made when that ended
    begun: float = 0.0  # when its worker could make it, s
    remote: Any = None  # Dask's future
    result: Future[R] = field(default_factory=Future)


def completed(
    client: Any,
    function: Callable[[T], R],
    items: Sequence[T],
    limits: Limits | None = None,
    stop: Callable[[], bool] = lambda: False,
) -> Iterator[list[tuple[T, Future[R]]]]:
    """Call a function with each item; yields completed calls, some together.

    A call whose worker ends is repeated once, and fails with a `CrashedError` if the other one ends
    as well, or with a `TooSlowError` if its time was over. If the scheduler ends, the pending calls
    are cancelled. The scheduler has two calls for each worker at a time.

    Args:
        client: client of Dask. Its workers with one thread are used.
        function: called with an item. It, its result and its exception are pickled.
        items: arguments of the calls.
        limits: limits of each call.
        stop: polled; True ends without waiting for pending calls.
    """
    calls = _Calls(client, partial(_within, limits, function), items, limits)
    try:
        while calls.pending() and not stop():
            if finished := calls.finished():
                yield [(call.item, call.result) for call in finished]
    finally:
        calls.cancel()


class _Calls(Generic[T, R]):
    """Calls, of which each worker has a queue of its own.

    Dask would choose the worker, and not say which of its calls it made when it ended, or how long.
    """

    def __init__(
        self,
        client: Any,
        function: Callable[[T], R],
        items: Sequence[T],
        limits: Limits | None,
    ) -> None:
        self._client, self._function, self._limits = client, function, limits
        self._waiting = deque(_Call[T, R](item) for item in items)
        self._again: deque[_Call[T, R]] = deque()  # once their worker has ended
        self._importing: dict[str, Any] = {}  # by the address of a worker
        self._queues: dict[str, list[_Call[T, R]]] = {}  # by address; the first call is being made
        self._answers: SimpleQueue[tuple[str, _Call[T, R], Any, Future[R]]] = SimpleQueue()
        self._look, self._next_look, self._due = self._ask(client.nthreads), 0.0, 0.0

    def pending(self) -> bool:
        return bool(self._waiting or self._again or any(self._queues.values()))

    def cancel(self) -> list[_Call[T, R]]:
        """Cancel the calls that workers have."""
        calls = [call for queue in self._queues.values() for call in queue]
        for call in calls:
            call.remote.cancel()
            call.result.cancel()
        self._queues.clear()
        return calls

    def finished(self) -> list[_Call[T, R]]:
        """Finished calls, after a short time without any, or a short time after the first."""
        if self._client.status == "closed":  # the scheduler has ended
            self._waiting.clear()
            self._again.clear()
            return self.cancel()
        found = self._look_for_workers()
        self._send()
        with suppress(Empty):
            found += self._take(*self._answers.get(timeout=_POLL))
            while True:
                self._send()
                wait = max(0.0, self._due - time.monotonic())
                found += self._take(*self._answers.get(timeout=wait))
        if found:
            self._due = time.monotonic() + _TOGETHER
        return found

    def _ask(self, question: Callable[[], Awaitable[Any]]) -> Future[Any]:
        """Wait for an answer in Dask's event loop."""

        async def answer() -> Any:
            return await question()

        return asyncio.run_coroutine_threadsafe(answer(), self._client.loop.asyncio_loop)

    def _look_for_workers(self) -> list[_Call[T, R]]:
        """Find workers that came, and those that ended; returns the calls that failed so."""
        if not self._look.done() or time.monotonic() < self._next_look:
            return []
        found: list[_Call[T, R]] = []
        if not (self._look.cancelled() or self._look.exception()):
            alive = {address for address, threads in self._look.result().items() if threads == 1}
            for address in self._queues.keys() - alive:
                found += self._lose(address)
            for address in alive - self._queues.keys() - self._importing.keys():
                self._importing[address] = self._client.submit(
                    _import, workers=[address], pure=False
                )
            for address in self._importing.keys() - alive:
                del self._importing[address]
            for address in [one for one, remote in self._importing.items() if remote.done()]:
                del self._importing[address]
                self._queues[address] = []
        self._look, self._next_look = self._ask(self._client.nthreads), time.monotonic() + _POLL
        return found

    def _send(self) -> None:
        """Send calls to workers: to each one and the next, so that it need not wait.

        The call that a worker made when it ended is not always known, as an answer may be lost with
        it. Then both are repeated, each alone.
        """
        if self._client.status != "running":
            return
        for address, queue in self._queues.items():
            if not queue and self._again:
                self._submit(address, queue, self._again.popleft())
            elif not queue and not self._waiting:  # take the next one of another worker
                for other in self._queues.values():
                    if len(other) > 1:
                        self._waiting.append(other.pop())
                        self._waiting[0].remote.cancel()
                        break
            if not queue and self._waiting:
                self._submit(address, queue, self._waiting.popleft())
        for address, queue in self._queues.items():
            if len(queue) == 1 and not queue[0].crashed and self._waiting:
                self._submit(address, queue, self._waiting.popleft())

    def _submit(self, address: str, queue: list[_Call[T, R]], call: _Call[T, R]) -> None:
        # Without a fifo_timeout the worker makes its calls in this order.
        call.remote = remote = self._client.submit(
            self._function, call.item, workers=[address], pure=False, fifo_timeout=0
        )
        queue.append(call)
        queue[0].begun = queue[0].begun if len(queue) > 1 else time.monotonic()
        answer = self._ask(lambda: remote)
        answer.add_done_callback(lambda _: self._answers.put((address, call, remote, answer)))

    def _take(
        self, address: str, call: _Call[T, R], remote: Any, answer: Future[R]
    ) -> list[_Call[T, R]]:
        """The calls that are finished by an answer."""
        queue = self._queues.get(address, [])
        if call not in queue or call.remote is not remote:  # it was sent to another worker
            return []
        error = None if answer.cancelled() else answer.exception()
        if type(error).__name__ == "KilledWorker":
            self._look = self._ask(self._client.nthreads)  # the answer to come may be outdated
            return self._lose(address)
        queue.remove(call)
        if queue:
            queue[0].begun = time.monotonic()
        if answer.cancelled():
            call.result.cancel()
        elif error:
            call.result.set_exception(error)
        else:
            call.result.set_result(answer.result())
        return [call]

    def _lose(self, address: str) -> list[_Call[T, R]]:
        """Forget a worker that has ended; returns the call that it made if that has failed."""
        queue = self._queues.pop(address)
        for call in queue:
            call.remote.cancel()
        failed, most = queue[:1], self._limits.seconds if self._limits else math.inf
        late = bool(queue) and time.monotonic() - queue[0].begun >= most
        # The end of a worker is noticed a moment later.
        if late and (len(queue) == 1 or most > _TIMEOUT):
            text = f"It took longer than {most:g} s."
            queue[0].result.set_exception(TooSlowError(text, "Raise --time-limit."))
        elif queue and queue[0].crashed:
            remedy = "Read the file with `g1stream motion`, and report the result."
            text = "The process that computed it crashed, twice."
            queue[0].result.set_exception(CrashedError(text, remedy))
        else:
            failed = []
        for call in queue[len(failed) :]:
            call.crashed = not failed
            (self._waiting if failed else self._again).appendleft(call)
        return failed


@contextmanager
def open_workers(
    workers: int,
    cluster: str | None = None,
    *,
    insecure: bool = False,
    warn: Callable[[str], None] = lambda text: None,
    stop: Callable[[], bool] = lambda: False,
) -> Iterator[Any]:
    """Open a client of Dask.

    Args:
        workers: number of workers to start on this machine. They listen on loopback, with TLS and
            keys of their own, because whoever can send them a message runs code in them.
        cluster: address of a Dask scheduler to use instead, such as `tls://host:8786`.
        insecure: as of `run_library`.
        warn: called with the reason for waiting, and a remedy.
        stop: polled; True ends the wait for workers.

    Raises:
        ConfigError: the extra `library` is not installed, the scheduler may not be trusted, there
            is none, or its workers lack g1stream or have another version.
    """
    distributed = import_extra("distributed", "library", "Libraries need")
    if cluster:
        _require_trusted(cluster, insecure=insecure)
        with _client(distributed, cluster, warn, stop) as client:
            yield client
        return
    import_extra("cryptography", "library", "Libraries need")
    # Each process has an HTTP server, which then has no pages.
    no_pages: dict[str, list[str]] = {
        f"distributed.{of}.http.routes": [] for of in ("scheduler", "worker")
    }
    try:
        with import_extra("dask", "library", "Libraries need").config.set(no_pages):
            own = distributed.LocalCluster(
                n_workers=workers,
                threads_per_worker=1,
                memory_limit=0,  # that of each call holds instead
                dashboard_address="127.0.0.1:0",
                silence_logs=logging.CRITICAL,
                security=True,
                # worker_ttl would end a worker in a long call to C.
                scheduler_kwargs={"dashboard": False, "worker_ttl": None},
            )
    except RuntimeError as error:
        raise ConfigError(
            f"The processes for the library cannot be started: {error}",
            "They import the program that starts them: call run_library below "
            '`if __name__ == "__main__":`.',
        ) from error
    with own, distributed.Client(own, set_as_default=False) as client:
        yield client


def _require_trusted(cluster: str, *, insecure: bool) -> None:
    """Refuse a scheduler elsewhere whose messages anybody on the way can replace."""
    scheme, _, rest = cluster.rpartition("://")
    host = rest.rpartition(":")[0].strip("[]") or rest
    with suppress(ValueError):
        insecure |= ip_address(host).is_loopback
    if insecure or host == "localhost" or scheme == "tls":
        return
    raise ConfigError(
        f"The scheduler {cluster} is on another machine, and is asked for without TLS: whoever "
        "can answer in its place runs code here and on the workers.",
        "Give tls://HOST:PORT with certificates (docs/scale.md), or --cluster-insecure in a "
        "network of your own.",
    )


def _in_time(call: Callable[[], T], seconds: float) -> T:
    """Call a function of Dask, whose own timeouts do not cover a peer that never answers.

    It has a thread of its own because this thread may have a notebook's event loop.
    """
    result: Future[T] = Future()

    def run() -> None:
        try:
            result.set_result(call())
        except BaseException as error:
            result.set_exception(error)

    Thread(target=run, name="cluster", daemon=True).start()
    if not wait([result], seconds).done:
        raise OSError(f"no answer within {seconds:g} s")
    return result.result()


@contextmanager
def _client(
    distributed: Any, cluster: str, warn: Callable[[str], None], stop: Callable[[], bool]
) -> Iterator[Any]:
    try:
        _in_time(lambda: asyncio.run(_connected(cluster)), _TIMEOUT)
        make = partial(distributed.Client, cluster, timeout=_TIMEOUT, set_as_default=False)
        client = _in_time(make, 2.0 * _TIMEOUT)
    except Exception as error:  # what is no scheduler may answer anything
        if cluster.startswith("tls://") and isinstance(error, TypeError):
            raise ConfigError(
                f"The Dask scheduler {cluster} needs TLS certificates: {error}.",
                "Set them in Dask's configuration, distributed.comm.tls.",
            ) from error
        raise ConfigError(
            f"There is no Dask scheduler at {cluster}: {error}.",
            "Start one with `dask scheduler`, and give the address that it prints.",
        ) from error
    with client:
        try:
            if not _has_workers(client):
                warn(
                    f"The scheduler {cluster} has no workers with one thread: waiting for them. "
                    f"Start `dask worker {cluster} --nworkers auto --nthreads 1` on each machine."
                )
            while not _has_workers(client) and not stop():
                time.sleep(_POLL)
            versions = set(_in_time(partial(client.run, _version), _START).values()) - {__version__}
        except Exception as error:  # any error of the scheduler or a worker
            raise ConfigError(
                f"The workers of {cluster} cannot run g1stream: {error}.",
                "Install g1stream on each of them.",
            ) from error
        if versions:
            raise ConfigError(
                f"Workers of {cluster} have g1stream {', '.join(sorted(versions))}.",
                f"Install g1stream {__version__} on each of them.",
            )
        yield client


def _has_workers(client: Any) -> bool:
    threads: dict[str, int] = _in_time(client.nthreads, _TIMEOUT)
    return 1 in threads.values()


async def _connected(cluster: str) -> None:
    """Connect once. An unconnected Client waits 20 s when deleted, and prints a traceback."""
    from distributed.comm import connect
    from distributed.security import Security

    security = Security().get_connection_args("client")
    comm = await connect(cluster, timeout=_TIMEOUT, **security)
    await comm.close()


def _version() -> str:
    return __version__
