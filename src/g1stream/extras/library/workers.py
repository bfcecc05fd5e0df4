"""The workers of Dask that compute a library: those of this machine, or of a scheduler.

Each worker is a process that makes one call at a time, within limits of time and memory. A call
that does not return, not even to Python, is ended with its process by the timer of the system. Its
nanny starts another worker.
"""

from __future__ import annotations

import asyncio
import logging
import math
import os
import resource
import signal
import time
from collections import deque
from concurrent.futures import CancelledError, Future, wait
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from ipaddress import ip_address
from multiprocessing import resource_tracker
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

#: Calls that take this time, s, are sent together, and results within it are returned together,
#: because writing a row alone takes 10 ms.
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


def _within(
    limits: Limits | None, function: Callable[[T], R], item: T
) -> tuple[R | None, Exception | None]:
    """Call a function with an item, in a worker that makes no other call meanwhile."""
    limits = limits or Limits(math.inf, math.inf)
    # In the unit of RLIMIT_DATA (proc(5), statm): private writable memory.
    own = int(Path("/proc/self/statm").read_text().split()[5]) * resource.getpagesize()
    soft, hard = resource.getrlimit(resource.RLIMIT_DATA)
    if math.isfinite(limits.megabytes):
        most = own + round(limits.megabytes * 1e6)
        most = most if hard == resource.RLIM_INFINITY else min(most, hard)
        resource.setrlimit(resource.RLIMIT_DATA, (most, hard))
    # SIGALRM, which nothing handles, ends the process whatever it does.
    signal.setitimer(signal.ITIMER_REAL, min(limits.seconds, _LONGEST))
    try:
        return function(item), None
    except Exception as error:
        return None, error.with_traceback(None)
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        resource.setrlimit(resource.RLIMIT_DATA, (soft, hard))


def _each(
    limits: Limits | None, function: Callable[[T], R], items: list[T]
) -> tuple[float, list[tuple[R | None, Exception | None]]]:
    """Call a function with each item; returns the time of all calls, s, and the answers."""
    begun = time.monotonic()
    answers = [_within(limits, function, item) for item in items]
    return time.monotonic() - begun, answers


def completed(
    client: Any,
    function: Callable[[T], R],
    items: Sequence[T],
    limits: Limits | None = None,
    stop: Callable[[], bool] = lambda: False,
) -> Iterator[list[tuple[T, Future[R]]]]:
    """Call a function with each item; yields completed calls, some together.

    A call whose worker ends is repeated once, alone. It fails with a `CrashedError` if that worker
    ends as well, or with a `TooSlowError` if its time was over. If the scheduler ends, the other
    calls are cancelled. It has few at a time, whatever the number of items.

    Args:
        client: client of Dask. Its workers with one thread are used.
        function: called with an item. It, its result and its exception are pickled.
        items: arguments of the calls.
        limits: limits of each call.
        stop: polled; True ends without waiting for pending calls.
    """
    calls = _Calls(client, function, items, limits)
    try:
        while calls.pending() and not stop():
            if pairs := calls.finished():
                yield pairs
    finally:
        calls.cancel()


@dataclass(eq=False)
class _Batch(Generic[T]):
    """Calls that are sent together, because sending one alone takes several ms."""

    items: list[T]
    again: bool  # a call that is repeated
    begun: float = 0.0  # when its worker could make it, s
    remote: Any = None  # Dask's future


class _Calls(Generic[T, R]):
    """Calls, of which each worker has a queue of its own: those that it makes, and the next.

    Dask would choose the worker, and not say what it did when it ended, or how long.
    """

    def __init__(
        self,
        client: Any,
        function: Callable[[T], R],
        items: Sequence[T],
        limits: Limits | None,
    ) -> None:
        self._client, self._limits = client, limits
        self._function = partial(_each, limits, function)
        self._waiting, self._again = deque(items), deque[T]()
        self._importing: dict[str, Any] = {}  # by the address of a worker
        self._queues: dict[str, list[_Batch[T]]] = {}  # by address; it makes the first
        self._answers: SimpleQueue[tuple[str, _Batch[T], Any, Future[Any]]] = SimpleQueue()
        self._look, self._next_look, self._due = self._ask(client.nthreads), 0.0, 0.0
        self._batch_size = 1

    def pending(self) -> bool:
        return bool(self._waiting or self._again or any(self._queues.values()))

    def cancel(self) -> list[tuple[T, Future[R]]]:
        """Cancel all calls."""
        batches = [batch for queue in self._queues.values() for batch in queue]
        for batch in batches:
            batch.remote.cancel()
        sent = [item for batch in batches for item in batch.items]
        items = [*sent, *self._again, *self._waiting]
        self._queues.clear()
        self._again.clear()
        self._waiting.clear()
        pairs = [(item, Future[R]()) for item in items]
        for _, future in pairs:
            future.cancel()
        return pairs

    def finished(self) -> list[tuple[T, Future[R]]]:
        """Finished calls, after a short time without any, or a short time after the first."""
        if self._client.status == "closed":  # the scheduler has ended
            return self.cancel()
        found = self._look_for_workers()
        self._send()
        with suppress(Empty):
            found += self._take(*self._answers.get(timeout=_POLL))
            while True:
                self._send()
                left = max(0.0, self._due - time.monotonic())
                found += self._take(*self._answers.get(timeout=left))
        if found:
            self._due = time.monotonic() + _TOGETHER
        return found

    def _ask(self, question: Callable[[], Awaitable[Any]]) -> Future[Any]:
        """Wait for an answer in Dask's event loop."""

        async def answer() -> Any:
            return await question()

        return asyncio.run_coroutine_threadsafe(answer(), self._client.loop.asyncio_loop)

    def _look_for_workers(self) -> list[tuple[T, Future[R]]]:
        """Find workers that came, and those that ended; returns the calls that failed so."""
        if not self._look.done() or time.monotonic() < self._next_look:
            return []
        found: list[tuple[T, Future[R]]] = []
        if not (self._look.cancelled() or self._look.exception()):
            alive = {address for address, threads in self._look.result().items() if threads == 1}
            for address in self._queues.keys() - alive:
                found += self._lose(address)
            for address in self._importing.keys() - alive:
                del self._importing[address]
            for address in alive - self._queues.keys() - self._importing.keys():
                self._importing[address] = self._client.submit(
                    _import, workers=[address], pure=False
                )
            for address in [one for one, remote in self._importing.items() if remote.done()]:
                del self._importing[address]
                self._queues[address] = []
        self._look, self._next_look = self._ask(self._client.nthreads), time.monotonic() + _POLL
        return found

    def _send(self) -> None:
        """Send calls to workers, also the next, so that they need not wait.

        A worker that ends may take the answers to its last calls with it. So all that it had is
        repeated, each call alone.
        """
        if self._client.status != "running":
            return
        for address, queue in self._queues.items():
            if not queue and self._again:
                self._submit(address, queue, _Batch([self._again.popleft()], again=True))
            elif not queue and not self._waiting:  # take the next ones of another worker
                full = next((other for other in self._queues.values() if len(other) > 1), None)
                if full:
                    batch = full.pop()
                    batch.remote.cancel()
                    self._waiting.extend(batch.items)
            if not queue and self._waiting:
                self._submit(address, queue, self._next_batch())
        for address, queue in self._queues.items():
            if len(queue) == 1 and not queue[0].again and self._waiting:
                self._submit(address, queue, self._next_batch())

    def _next_batch(self) -> _Batch[T]:
        most = len(self._waiting) // (4 * len(self._queues))  # the last ones are for all workers
        n = max(1, min(most, self._batch_size))
        return _Batch([self._waiting.popleft() for _ in range(n)], again=False)

    def _submit(self, address: str, queue: list[_Batch[T]], batch: _Batch[T]) -> None:
        # Without a fifo_timeout the worker makes its calls in this order.
        batch.remote = remote = self._client.submit(
            self._function, batch.items, workers=[address], pure=False, fifo_timeout=0
        )
        queue.append(batch)
        queue[0].begun = queue[0].begun if len(queue) > 1 else time.monotonic()
        answer = self._ask(lambda: remote)
        answer.add_done_callback(lambda done: self._answers.put((address, batch, remote, done)))

    def _take(
        self, address: str, batch: _Batch[T], remote: Any, answer: Future[Any]
    ) -> list[tuple[T, Future[R]]]:
        """The calls that are finished by an answer."""
        queue = self._queues.get(address, [])
        if batch not in queue or batch.remote is not remote:  # its worker has ended
            return []
        error = None if answer.cancelled() else answer.exception()
        lost = answer.cancelled() or isinstance(error, CancelledError)  # with the scheduler
        if type(error).__name__ == "KilledWorker":
            self._look = self._ask(self._client.nthreads)  # the answer to come may be outdated
            return self._lose(address)
        queue.remove(batch)
        if queue:
            queue[0].begun = time.monotonic()
        if error and not lost and len(batch.items) > 1:  # an answer that cannot be pickled
            self._again.extend(batch.items)
            return []
        pairs = [(item, Future[R]()) for item in batch.items]
        if lost:
            for _, future in pairs:
                future.cancel()
            return pairs
        answers: list[tuple[Any, BaseException | None]] = [(None, error)]
        if not error:
            seconds, answers = answer.result()
            if not batch.again:  # only twice as many, because the next calls may take longer
                fit = int(_TOGETHER * len(answers) / max(seconds, 1e-6))
                self._batch_size = min(2 * len(answers), fit)
        for (_, future), (result, raised) in zip(pairs, answers, strict=False):
            if raised:
                future.set_exception(raised)
            else:
                future.set_result(result)
        return pairs

    def _lose(self, address: str) -> list[tuple[T, Future[R]]]:
        """Forget a worker that has ended; returns the call that it made if that has failed."""
        queue = self._queues.pop(address)
        for batch in queue:
            batch.remote.cancel()
        if not queue:
            return []
        made, most = queue[0], self._limits.seconds if self._limits else math.inf
        error: G1StreamError | None = None
        # The end of a worker is noticed a moment later.
        if time.monotonic() - made.begun >= most and (made.again or most > _TIMEOUT):
            error = TooSlowError(f"It took longer than {most:g} s.", "Raise --time-limit.")
        elif made.again:
            error = CrashedError(
                "The process that computed it crashed, twice.",
                "Read the file with `g1stream motion`, and report the result.",
            )
        if error and len(made.items) == 1:
            future = Future[R]()
            future.set_exception(error)
            self._waiting.extendleft(item for batch in queue[1:] for item in batch.items)
            return [(made.items[0], future)]
        self._again.extend(item for batch in queue for item in batch.items)
        return []


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
    # LocalCluster ends its own silence before it stops sending to workers, which are ended here.
    silence = distributed.utils.silence_logging_cmgr(logging.CRITICAL)
    with silence, _own_cluster(distributed, workers) as own:
        try:
            with distributed.Client(own, set_as_default=False) as client:
                yield client
        finally:  # at once, whatever they compute
            for nanny in own.workers.values():
                nanny.auto_restart = False
                if nanny.pid:
                    with suppress(ProcessLookupError):
                        os.kill(nanny.pid, signal.SIGKILL)


def _own_cluster(distributed: Any, workers: int) -> Any:
    """Start workers on this machine; they end with the returned cluster."""
    import_extra("cryptography", "library", "Libraries need")
    dask = import_extra("dask", "library", "Libraries need")
    settings: dict[str, Any] = {
        # Each process has an HTTP server, which then has no pages.
        "distributed.scheduler.http.routes": [],
        "distributed.worker.http.routes": [],
        # Each worker would look at its stack every 10 ms, and keep a profile of each second.
        "distributed.worker.profile.enabled": False,
        # Dask would have memory returned to the system so often that a check takes 1.25 times as
        # long.
        "distributed.nanny.pre-spawn-environ.MALLOC_TRIM_THRESHOLD_": None,
    }
    # Ctrl-C in a terminal goes to all processes; the workers inherit that it is blocked. The start
    # of the tracker would unblock it.
    resource_tracker.ensure_running()
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        with dask.config.set(settings):
            return distributed.LocalCluster(
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
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


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
