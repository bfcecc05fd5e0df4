"""What tests of every room share."""

from __future__ import annotations

import fcntl
import itertools
import json
import os
import re
import runpy
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
from contextlib import ExitStack, contextmanager
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import pytest
from hypothesis import HealthCheck, settings

from g1stream.dds.discovery import OBSERVER
from g1stream.dds.domain import Participant
from g1stream.dds.endpoints import RawReader
from g1stream.dds.layout import members
from g1stream.dds.messages import LOWCMD, LowCmd
from threads import in_thread

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from contextlib import AbstractContextManager

IDL_DIR = Path(__file__).parents[1] / "idl"
CORE_ALONE = Path(__file__).with_name("core_alone")


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--core-alone",
        action="store_true",
        help="hide g1stream.extras from this process and those that it starts",
    )


def pytest_configure(config: pytest.Config) -> None:
    if config.getoption("--core-alone"):
        paths = [str(CORE_ALONE), *filter(None, [os.environ.get("PYTHONPATH")])]
        os.environ["PYTHONPATH"] = os.pathsep.join(paths)
        runpy.run_path(str(CORE_ALONE / "sitecustomize.py"))


# On a busy machine, examples take longer than hypothesis expects; that is no failure.
settings.register_profile("busy", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("busy")

# Above 101 a domain's ports reach the range that Linux hands out to anybody, and 0 and 1 are where
# robots and simulators are.
DOMAINS = range(10, 101)

#: Longer than anything takes on a busy machine, shorter than pytest's own limit, s.
PATIENCE = 30.0


@contextmanager
def _claim(domain_id: int, wait: bool) -> Iterator[None]:
    """Keep a domain to ourselves among all test processes of this user on this machine."""
    path = Path(tempfile.gettempdir(), f"g1stream-test-domain-{domain_id}-{os.getuid()}.lock")
    with path.open("w") as file:
        fcntl.flock(file, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
        yield


def _is_silent(domain_id: int) -> bool:
    """Whether no program of any kind has the ports of a domain (RTPS 2.5, 9.6.2)."""
    multicast = 7400 + 250 * domain_id
    for port in (multicast, multicast + 10):
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            try:
                probe.bind(("", port))
            except OSError:
                return False
    return True


_turns = itertools.count(os.getpid())


def _claim_any(stack: ExitStack) -> int:
    """Claim a domain that nobody on this machine is on, until the stack is closed."""
    for turn in itertools.islice(_turns, len(DOMAINS)):
        candidate = DOMAINS[turn % len(DOMAINS)]
        try:
            stack.enter_context(_claim(candidate, wait=False))
        except BlockingIOError:
            continue
        if _is_silent(candidate):
            return candidate
    pytest.fail("every DDS domain for tests is in use on this machine")


@contextmanager
def _domain() -> Iterator[int]:
    with ExitStack() as stack:
        stack.enter_context(pytest.MonkeyPatch.context()).delenv("CYCLONEDDS_URI", raising=False)
        yield _claim_any(stack)


@pytest.fixture
def domain_id() -> Iterator[int]:
    """A DDS domain for this test alone, on `lo` whatever CYCLONEDDS_URI says."""
    with _domain() as claimed:
        yield claimed


@pytest.fixture
def participant(domain_id: int) -> Iterator[Participant]:
    """A participant in the domain of this test."""
    with Participant(domain_id, "lo") as joined:
        yield joined


@pytest.fixture(scope="module")
def module_domain_id() -> Iterator[int]:
    """Like `domain_id`, for what a module's tests share."""
    with _domain() as claimed:
        yield claimed


@pytest.fixture(scope="module")
def claim_domain() -> Iterator[Callable[[], int]]:
    """Like `module_domain_id`, for a module that needs several."""
    with ExitStack() as stack:
        stack.enter_context(pytest.MonkeyPatch.context()).delenv("CYCLONEDDS_URI", raising=False)
        yield partial(_claim_any, stack)


@pytest.fixture
def domain_zero(monkeypatch: pytest.MonkeyPatch) -> Iterator[int]:
    """Domain 0, the only one that the C++ SDK knows; one test at a time is on it."""
    monkeypatch.delenv("CYCLONEDDS_URI", raising=False)
    with _claim(0, wait=True):
        yield 0


@pytest.fixture
def until() -> Callable[[Callable[[], Any], str], None]:
    """Wait for something that another process or thread brings about."""

    def wait(condition: Callable[[], Any], what: str) -> None:
        deadline = time.monotonic() + PATIENCE
        while not condition():
            assert time.monotonic() < deadline, f"waited in vain for {what}"
            time.sleep(0.005)

    return wait


@contextmanager
def _running(*arguments: object, **options: Any) -> Iterator[subprocess.Popen[str]]:
    command = [sys.executable, "-m", "g1stream", *map(str, arguments)]
    streams = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True, **options}
    process = subprocess.Popen(command, **streams)
    try:
        yield process
    finally:
        if process.poll() is None:
            process.kill()
        process.communicate()


@pytest.fixture(scope="session")
def running() -> Callable[..., AbstractContextManager[subprocess.Popen[str]]]:
    """Run `g1stream` with these arguments as a process of its own, killed in the end.

    Keyword arguments are those of Popen.
    """
    return _running


class Received(NamedTuple):
    """A command: publish time, ns; Cyclone's handle of its writer; what it asks for."""

    stamp: int
    writer: int
    command: LowCmd


@contextmanager
def _tap(domain_id: int) -> Iterator[list[Received]]:
    received: list[Received] = []
    with Participant(domain_id, "lo") as participant:
        reader = RawReader(participant, LOWCMD, depth=5000, user_data=OBSERVER)

        def take(stop: threading.Event) -> None:
            while not stop.wait(0.01):
                for sample in reader.take(5000):
                    command = LowCmd()
                    command.load(sample.data)
                    writer = sample.sample_info.publication_handle
                    received.append(Received(sample.publish_time, writer, command))

        with in_thread(take):
            yield received
    assert all(one.command.crc_matches() for one in received)


@pytest.fixture(scope="session")
def tap() -> Callable[..., AbstractContextManager[list[Received]]]:
    """All commands on rt/lowcmd of a domain, while they arrive."""
    return _tap


@pytest.fixture(scope="session")
def golden() -> dict[str, list[dict[str, Any]]]:
    """Samples of each of Unitree's topics, every field set, and their CDR bytes in hex as `cdr`.

    Made by Unitree's Python SDK on cyclonedds 0.10.2, CRC included where the type has one. Structs
    in arrays, such as motors, are lists in the IDL's field order.
    """
    data = Path(__file__).parent / "data"
    samples: dict[str, list[dict[str, Any]]] = {}
    for name in ("wire.json", "sdk_samples.json"):
        samples |= json.loads((data / name).read_text())
    return samples


def _filled(element: Any, rng: np.random.Generator) -> Any:
    if isinstance(element, str):
        if element.startswith("float"):
            return float(np.float32(rng.normal()))
        limits = np.iinfo("uint8" if element == "byte" else element)
        return int(rng.integers(limits.min, limits.max, endpoint=True, dtype=limits.dtype))
    values = {}
    for name, (inner, length) in members(element).items():
        made = [_filled(inner, rng) for _ in range(length or 1)]
        values[name] = made[0] if length is None else made
    return element(**values)


@pytest.fixture
def make_sample():
    """Makes instances of cyclonedds' classes with every field set to something of its own."""
    rng = np.random.default_rng(11)
    return lambda topic: _filled(topic.message.idl_type, rng)


@pytest.fixture
def on_the_wire():
    """The bytes of an instance of cyclonedds' classes as they are on the wire: padded to words."""

    def encode(sample):
        data = sample.serialize()
        return data + bytes(-len(data) % 4)

    return encode


_DDS_FIXTURES = {"domain_id", "module_domain_id", "claim_domain", "domain_zero"}


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark what goes over DDS `dds`, the tests of whole programs `slow`, and faults `alone`.

    Faults measure what the motors get while something else goes wrong.
    """
    for item in items:
        if _DDS_FIXTURES & set(getattr(item, "fixturenames", ())):
            item.add_marker(pytest.mark.dds)
            if "faults" in item.path.parts:
                item.add_marker(pytest.mark.alone)
        if {"integration", "faults"} & set(item.path.parts):
            item.add_marker(pytest.mark.slow)


@pytest.fixture
def network_namespace() -> Iterator[Callable[..., str]]:
    """Make a network namespace of the test's own with commands of ip(8); gives its name."""
    if os.geteuid() or not shutil.which("ip"):
        pytest.skip("a network of its own needs root and ip")
    names = []

    def make(*commands: str) -> str:
        name = f"g1test{os.getpid()}n{len(names)}"
        subprocess.run(["ip", "netns", "add", name], check=True)
        names.append(name)
        for command in commands:
            subprocess.run(["ip", "-n", name, *command.split()], check=True)
        return name

    yield make
    for name in names:
        subprocess.run(["ip", "netns", "delete", name], check=True)


@pytest.fixture
def stranger() -> Iterator[Callable[..., int]]:
    """Start a program that this process has not started; gives its pid once it says so.

    It runs until the end of the test. `prefix` is what it is started with, such as `unshare`.
    """
    pids = []

    def start(code: str, *prefix: str) -> int:
        ended = "import os, sys, time\nprint(os.getpid(), flush=True)\ntime.sleep(60)"
        command = [*prefix, sys.executable, "-c", f"{code}\n{ended}"]
        # The shell ends at once, so that another process becomes the parent.
        with subprocess.Popen(
            ["sh", "-c", '"$@" &', "sh", *command], stdout=subprocess.PIPE, text=True
        ) as shell:
            pids.append(int(shell.stdout.readline()))
        return pids[-1]

    yield start
    for pid in pids:
        os.kill(pid, signal.SIGKILL)


class Ended(NamedTuple):
    """A command that has ended: its exit code, and what it printed."""

    code: int
    out: str
    err: str


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str]) -> Callable[..., Ended]:
    """Run a command in this process."""
    from g1stream.cli.main import main

    def run_command(*arguments: object) -> Ended:
        capsys.readouterr()
        code = main([*map(str, arguments)])
        return Ended(code, *capsys.readouterr())

    return run_command


@pytest.fixture
def beside() -> Callable[..., AbstractContextManager[Any]]:
    """Run a program of `g1stream.app` meanwhile; gives its event `ready`, and then its `result`."""

    @contextmanager
    def run(program: Callable[..., Any], *arguments: Any, **options: Any) -> Iterator[Any]:
        own = SimpleNamespace(ready=threading.Event(), result=None)

        def work(stop: threading.Event) -> None:
            given = {"should_stop": stop.is_set, "on_ready": own.ready.set}
            own.result = program(*arguments, **options, **given)

        with in_thread(work):
            yield own

    return run


@pytest.fixture
def publishing(beside: Callable[..., Any]) -> Callable[..., Any]:
    """Call a function at 50 Hz meanwhile."""

    def publish(
        act: Callable[[], object], should_stop: Callable[[], bool], on_ready: object
    ) -> None:
        while not should_stop():
            act()
            time.sleep(0.02)

    return lambda act: beside(publish, act)


@pytest.fixture
def bridge(domain_id: int, beside: Callable[..., Any]) -> Callable[..., Any]:
    """Our bridge in a thread, with a mode of the motion service; gives where it is."""
    from g1stream.app.sim import simulate
    from g1stream.config import Config

    @contextmanager
    def run(onboard: str | None = None) -> Iterator[Any]:
        config = Config.model_validate({"dds": {"domain": domain_id}, "sim": {"onboard": onboard}})
        with beside(simulate, config) as started:
            assert started.ready.wait(30)
            yield config.dds

    return run


class Declared(NamedTuple):
    """A struct of an IDL file; a field is name -> (IDL name of the element's type, length)."""

    annotations: list[str]
    fields: dict[str, tuple[str, int | None]]


@pytest.fixture(scope="session")
def declared() -> dict[str, Declared]:
    """Every struct of idl/ by its full name, such as `unitree_hg.msg.dds_.LowCmd_`."""
    found = {}
    for file in IDL_DIR.glob("*/*.idl"):
        text = re.sub(r"//.*", "", file.read_text())
        module = ".".join(re.findall(r"module\s+(\w+)", text))
        for marks, name, body in re.findall(r"((?:@\w+\s+)*)struct\s+(\w+)\s*{([^}]*)}", text):
            fields = re.findall(r"([\w<>][\w <>]*?)\s+(\w+)\s*(?:\[(\d+)\])?\s*;", body)
            assert len(fields) == body.count(";")
            found[f"{module}.{name}"] = Declared(
                marks.split(), {field: (kind, int(n) if n else None) for kind, field, n in fields}
            )
    return found
