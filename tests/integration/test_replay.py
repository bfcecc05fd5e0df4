"""A session played again: real processes, real DDS on loopback, real MuJoCo."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from g1stream.app.session import open_session
from g1stream.types import Phase

if TYPE_CHECKING:
    from collections.abc import Callable

    from g1stream.app.session import Session

PATIENT = Path(__file__).parents[1] / "data" / "patient.toml"
PLAY = 1.0


def run(*arguments: object) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "g1stream", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=90, check=False)


@pytest.fixture(scope="module")
def sessions(
    module_domain_id: int, running: Callable[..., Any], tmp_path_factory: pytest.TempPathFactory
) -> dict[str, tuple[Session, dict[str, Any]]]:
    """A motion as it was streamed, streamed again from its session, and at half speed."""
    directory = tmp_path_factory.mktemp("replay")
    first = directory / "first.mcap"
    runs = {
        "first": ["stream", "demo", "--start", 2.0, "--duration", PLAY],
        "again": ["stream", first],
        "slow": ["stream", first, "--speed", 0.5],
    }
    found = {}
    with running("sim", "--domain", module_domain_id):
        for name, arguments in runs.items():
            path = directory / f"{name}.mcap"
            shared = ["--domain", module_domain_id, "--config", PATIENT, "--ramp", 0.5, "--json"]
            done = run(*arguments, *shared, "--record", path)
            # A recorder that a busy machine keeps from its samples says so with exit code 1.
            assert done.returncode in {0, 1}, done.stderr
            found[name] = open_session(path), json.loads(done.stdout)
    return found


def played(session: Session) -> tuple[np.ndarray, np.ndarray]:
    """Motion times (N,) and q (N, 29) while the motion played, as far as they were recorded."""
    playing = session.reference.phase == Phase.PLAY
    return session.reference.motion_time[playing], session.reference.q[playing]


def rmse(
    times: np.ndarray, values: np.ndarray, others_times: np.ndarray, others: np.ndarray
) -> float:
    """Of two (N, 29) and (M, 29) at instants where both are known, no hole of either near."""
    other = np.column_stack([np.interp(times, others_times, column) for column in others.T])
    after = np.searchsorted(others_times, times).clip(1, len(others_times) - 1)
    known = others_times[after] - others_times[after - 1] < 0.02
    assert known.mean() > 0.5
    return float(np.sqrt(np.mean((other - values)[known] ** 2)))


@pytest.mark.parametrize(("name", "slower"), [("again", 1.0), ("slow", 2.0)])
def test_the_reference_is_played_again(sessions, name, slower):
    times, q = played(sessions["first"][0])
    session, summary = sessions[name]
    assert rmse(slower * (times - times[0]), q, *played(session)) < 1e-3
    assert summary["stream"]["reason"] == ""
    assert session.complete
    told = [event.text for event in session.log if event.name == "stream"]
    assert {"RAMP -> PLAY", "PLAY -> HOLD", "HOLD -> DAMP", "DAMP -> DONE"} <= {*told}
