"""Sessions of a robot whose error is known in closed form.

Each joint is asked for a sine; the measurement is the same sine, later and beside it. PLAY lasts a
whole number of periods and the states divide it evenly, so that means over PLAY are exact.
"""

from typing import NamedTuple

import numpy as np
import pytest

from g1stream.dds.messages import LowCmd, LowState
from g1stream.dds.messages import Reference as ReferenceMessage
from g1stream.session.streams import MeasuredStream, ReferenceStream
from g1stream.session.writer import SessionWriter
from g1stream.types import Phase

T0 = 1_700_000_000_000_000_000
LATENCY = 100_000


class Motion(NamedTuple):
    """amplitude (29,) rad and angular frequency (29,) rad/s; amplitude 0 for joints 13 and 27."""

    amplitude: np.ndarray
    omega: np.ndarray

    def at(self, seconds):
        return self.amplitude * np.sin(self.omega * np.asarray(seconds)[:, None] + np.arange(29))


class Played(NamedTuple):
    reference: ReferenceStream
    measured: MeasuredStream


_AMPLITUDE = np.linspace(0.1, 0.6, 29)
_AMPLITUDE[[13, 27]] = 0.0
MOTION = Motion(_AMPLITUDE, 2 * np.pi * 0.25 * (1 + np.arange(29) % 5))


def _stamps(seconds):
    return T0 + np.round(np.asarray(seconds) * 1e9).astype(np.int64)


def _reference(phases):
    lengths = np.array([round(length * 500) for _, length in phases])
    phase = np.repeat(np.array([phase for phase, _ in phases], dtype=np.uint8), lengths)
    before_play = int(lengths[: [p for p, _ in phases].index(Phase.PLAY)].sum())
    seconds = (np.arange(len(phase)) - before_play) / 500.0
    q = MOTION.at(seconds)
    stamps = _stamps(seconds)
    n = len(stamps)
    return ReferenceStream(
        log_time=stamps + LATENCY,
        publish_time=stamps,
        tick=np.arange(n, dtype=np.uint64),
        motion_time=seconds.clip(0.0),
        phase=phase,
        played=np.full(n, 2**29 - 1, np.uint32),
        q=q,
        **{name: np.zeros_like(q) for name in ("dq", "ddq", "tau")},
        root_quat_wxyz=np.tile([1.0, 0, 0, 0], (n, 1)),
        **{name: np.zeros((n, 3)) for name in ("root_pos", "root_lin_vel", "root_ang_vel")},
    )


def _measured(seconds, q):
    stamps, n = _stamps(seconds), len(seconds)
    return MeasuredStream(
        log_time=stamps + LATENCY,
        publish_time=stamps,
        tick=np.zeros(n, dtype=np.uint32),
        mode_pr=np.zeros(n, dtype=np.uint8),
        mode_machine=np.zeros(n, dtype=np.uint8),
        q=q,
        **{name: np.zeros_like(q) for name in ("dq", "ddq", "tau")},
        imu_quat_wxyz=np.tile([1.0, 0, 0, 0], (n, 1)),
        **{name: np.zeros((n, 3)) for name in ("gyroscope", "accelerometer")},
    )


ALL_PHASES = ((Phase.RAMP, 0.5), (Phase.PLAY, 4.0), (Phase.HOLD, 0.3), (Phase.DAMP, 0.2))


@pytest.fixture(scope="session")
def play():
    """Makes the streams of a session: the robot is `delay` s late and `offset` (29,) rad off."""

    def make(delay=0.0, offset=0.0, phases=ALL_PHASES):
        reference = _reference(phases)
        first, last = (reference.publish_time[[0, -1]] - T0) / 1e9
        # 0.7 ms beside the references, from 0.1 s before them until 0.1 s after them.
        seconds = np.arange(round((last - first + 0.2) * 500)) / 500 + first - 0.0993
        return Played(reference, _measured(seconds, MOTION.at(seconds - delay) + offset))

    return make


@pytest.fixture
def change():
    """Makes a stream with other values in some columns."""

    def make(stream, **columns):
        names = ("log_time", "publish_time", *stream.wire_fields())
        return type(stream)(**{name: getattr(stream, name) for name in names} | columns)

    return make


@pytest.fixture
def take():
    """Picks samples of a stream by a mask or by indices, into a stream of its own."""

    def pick(stream, which):
        names = ("log_time", "publish_time", *stream.wire_fields())
        return type(stream)(**{name: getattr(stream, name)[which] for name in names})

    return pick


def write_known(path, reference=None, measured=None, metadata=None, *, derived=(), close=True):
    """Writes a session file of these streams; a command goes with each reference.

    `derived` are messages without a body, by topic, at the times of a stream.
    """
    writer = SessionWriter(path)
    if reference is not None:
        _write(writer, "/reference", reference, _as_reference)
        _write(writer, "/lowcmd", reference, _as_command)
    if measured is not None:
        _write(writer, "/lowstate", measured, _as_state)
    for topic, stream in dict(derived).items():
        _write(writer, topic, stream, lambda stream, i: b"")
    if close:
        writer.add_metadata(metadata or {})
        writer.close()
    else:
        writer.flush_if_due(2 * T0)
    return path


@pytest.fixture
def write_session(tmp_path):
    """Writes with `write_known` into the directory of the test."""
    return lambda *streams, name="session.mcap", **how: write_known(
        tmp_path / name, *streams, **how
    )


def _write(writer, topic, stream, encode):
    payloads = [encode(stream, i) for i in range(len(stream))]
    writer.write_batch(topic, payloads, stream.log_time, stream.publish_time)


_REFERENCE, _COMMAND, _STATE = ReferenceMessage(), LowCmd(), LowState()


def _as_reference(stream, i):
    for name in ("tick", "motion_time", "phase", "q", "root_quat_wxyz"):
        getattr(_REFERENCE, name)[...] = getattr(stream, name)[i]
    return _REFERENCE.tobytes()


def _as_command(stream, i):
    _COMMAND.q[:] = stream.q[i]
    return _COMMAND.seal()


def _as_state(stream, i):
    _STATE.q[:], _STATE.quaternion[:] = stream.q[i], stream.imu_quat_wxyz[i]
    _STATE.mode_pr[()] = stream.mode_pr[i]
    return _STATE.seal()
