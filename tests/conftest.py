"""What tests of every room share."""

from __future__ import annotations

import fcntl
import json
import os
import tempfile
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from collections.abc import Iterator

# Above 101 a domain's ports reach the range that Linux hands out to anybody, and 0 and 1 are where
# robots and simulators are.
DOMAINS = range(10, 101)


@contextmanager
def _claim(domain_id: int, wait: bool) -> Iterator[None]:
    """Keep a domain to ourselves among all test processes of this user on this machine."""
    path = Path(tempfile.gettempdir(), f"g1stream-test-domain-{domain_id}-{os.getuid()}.lock")
    with path.open("w") as file:
        fcntl.flock(file, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
        yield


_next_domain = os.getpid()


@pytest.fixture
def domain_id(monkeypatch: pytest.MonkeyPatch) -> Iterator[int]:
    """A DDS domain that no other test is on; on `lo`, whatever CYCLONEDDS_URI says."""
    global _next_domain  # noqa: PLW0603
    monkeypatch.delenv("CYCLONEDDS_URI", raising=False)
    for _ in DOMAINS:
        _next_domain += 1
        candidate = DOMAINS[_next_domain % len(DOMAINS)]
        try:
            with _claim(candidate, wait=False):
                yield candidate
                return
        except BlockingIOError:
            continue
    pytest.fail("every DDS domain for tests is in use on this machine")


@pytest.fixture
def domain_zero(monkeypatch: pytest.MonkeyPatch) -> Iterator[int]:
    """Domain 0, the only one that the C++ SDK knows; one test at a time is on it."""
    monkeypatch.delenv("CYCLONEDDS_URI", raising=False)
    with _claim(0, wait=True):
        yield 0


@pytest.fixture(scope="session")
def golden() -> dict[str, list[dict[str, Any]]]:
    """Samples of `lowcmd` and `lowstate` with every field, their CRC and their CDR bytes in hex.

    Made by Unitree's Python SDK on cyclonedds 0.10.2. Motors are lists in the IDL's field order.
    """
    path = Path(__file__).parent / "data" / "wire.json"
    samples: dict[str, list[dict[str, Any]]] = json.loads(path.read_text())
    return samples
