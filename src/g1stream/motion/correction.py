"""A correction of a motion's joint targets, learned from sessions in which it was played.

`g1stream learn` makes it (analysis/learning.py), and `stream.correction` applies it: q + c(t),
dq + c'(t), ddq + c''(t) of a cubic spline (C2) through its values, before every safety limit. It
holds for the conditions that it was learned under, and is refused under others.

The file is a NumPy archive (npz) without pickled objects.
"""

from __future__ import annotations

import io
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, get_args

import numpy as np

from g1stream.errors import ConfigError
from g1stream.files import check_suffix, complete_file, read_file
from g1stream.motion.arrays import read_npz
from g1stream.motion.blend import minimum_jerk
from g1stream.robot.joints import JOINT_NAMES, N_JOINTS, by_joint
from g1stream.types import FeedForwardKind, StreamSupport

if TYPE_CHECKING:
    import os

    from numpy.typing import NDArray

    from g1stream.types import Floats

__all__ = [
    "ATTACHMENT_NAME",
    "GRID_STEP",
    "LARGEST_CORRECTION",
    "Conditions",
    "Correction",
    "CorrectionSpline",
]

ATTACHMENT_NAME: Final = "correction.npz"
"""Under this name a session has the correction that it was played with."""

LARGEST_CORRECTION: Final = 0.15
"""No correction is larger, either way, rad."""

GRID_STEP: Final = 0.02
"""Two times of the grid of a correction are at most this far apart, s."""

#: The correction fades in and out in this time at both ends of what is played, s.
_FADE: Final = 0.3
#: Times that are added at both ends, with no correction.
_PADDING: Final = 4
#: Largest relative difference of gains and rates that count as equal.
_EQUAL: Final = 1e-9


@dataclass(frozen=True, eq=False)
class Conditions:
    """What a correction depends on.

    Attributes:
        motion: name of the motion; not compared.
        motion_sha256: `Motion.content_sha256`.
        robot: the URDF's robot name.
        rate: commands per second, Hz.
        kp, kd: (29,) gains, N·m/rad and N·m·s/rad, motor order.
        feedforward: what commands carry beside the position; None: not decided yet.
        support: how the robot is held; None: not known.
    """

    motion: str
    motion_sha256: str
    robot: str
    rate: float
    kp: Floats
    kd: Floats
    feedforward: FeedForwardKind | None
    support: StreamSupport | None

    def differences(self, other: Conditions) -> list[str]:
        """What differs, such as "rate 500 Hz and 250 Hz", in the order self and other."""
        found = []
        if self.motion_sha256 != other.motion_sha256:
            found.append(f"the motions {self.motion} and {other.motion} (by their content)")
        if self.robot != other.robot:
            found.append(f"robot {self.robot} and {other.robot}")
        if not np.isclose(self.rate, other.rate, rtol=_EQUAL):
            found.append(f"rate {self.rate:g} and {other.rate:g} Hz")
        for name, own, others in (("kp", self.kp, other.kp), ("kd", self.kd, other.kd)):
            unequal = np.flatnonzero(~np.isclose(own, others, rtol=_EQUAL))
            found += [f"{name} {own[j]:g} and {others[j]:g} of {JOINT_NAMES[j]}" for j in unequal]
        if self.feedforward != other.feedforward:
            found.append(f"feed-forward {self.feedforward} and {other.feedforward}")
        if self.support != other.support:
            found.append(f"support {self.support} and {other.support}")
        return found


@dataclass(frozen=True, eq=False)
class Correction:
    """What is added to the joint targets of a motion, by motion time.

    Attributes:
        conditions: under which it was learned, and may be used.
        time: (T,) s since the motion's first frame, evenly spaced.
        values: (T, 29) rad, motor order.
        frozen: (T, 29) bool, where the error did not respond to a change: it stays as it is.
        history: (K,) rad, RMSE over all joints of each repetition that it was learned from.
        source: the file it came from, if any.

    Raises:
        ConfigError: the shapes do not fit together, or a value is not finite or too large.
    """

    conditions: Conditions
    time: Floats
    values: Floats
    frozen: NDArray[np.bool_]
    history: Floats
    source: Path | None = None

    def __post_init__(self) -> None:
        n_times, shape = len(self.time), (len(self.time), N_JOINTS)
        if n_times < 4 or self.values.shape != shape or self.frozen.shape != shape:
            raise self._invalid(
                f"it has {n_times} times, but values of shape {self.values.shape} and frozen of "
                f"shape {self.frozen.shape}"
            )
        steps = np.diff(self.time)
        if not (np.isfinite(self.time).all() and steps.min() > 0 and np.ptp(steps) < 1e-6):
            raise self._invalid("its times are not evenly spaced")
        if not np.isfinite(self.values).all():
            raise self._invalid("it has a value that is not finite")
        largest = float(np.abs(self.values).max())
        if largest > LARGEST_CORRECTION + _EQUAL:
            raise self._invalid(f"it has {largest:g} rad, above {LARGEST_CORRECTION:g}")

    def __repr__(self) -> str:
        return (
            f"Correction(motion={self.conditions.motion!r}, repetitions={len(self.history)}, "
            f"largest={self.largest:.4f} rad)"
        )

    @property
    def largest(self) -> float:
        """The largest correction, either way, rad."""
        return float(np.abs(self.values).max())

    @property
    def frozen_seconds(self) -> dict[str, float]:
        """Joint -> for how long its correction is frozen, s; without joints that are not."""
        seconds = self.frozen.sum(axis=0) * (self.time[1] - self.time[0])
        return by_joint(seconds.tolist())

    def require(self, conditions: Conditions) -> None:
        """Refuse conditions other than those that it was learned under.

        Raises:
            ConfigError: names what differs.
        """
        if different := self.conditions.differences(conditions):
            raise ConfigError(
                f"The correction {self.source or 'given'} does not fit. It was learned for, and "
                f"would be used for: {'; '.join(different)}.",
                "Play the motion as it was learned, or learn from sessions like this one.",
            )

    def require_feedforward(self, kind: FeedForwardKind, support: StreamSupport | None) -> None:
        """The same for feed-forward and support, once they have been decided."""
        self.require(replace(self.conditions, feedforward=kind, support=support))

    def to_bytes(self) -> bytes:
        """The content of its file."""
        conditions = self.conditions
        buffer = io.BytesIO()
        np.savez_compressed(
            buffer,
            motion=conditions.motion,
            motion_sha256=conditions.motion_sha256,
            robot=conditions.robot,
            joint_names=np.array(JOINT_NAMES),
            rate=conditions.rate,
            kp=conditions.kp,
            kd=conditions.kd,
            feedforward=conditions.feedforward or "",
            support=conditions.support or "",
            time=self.time,
            correction=self.values,
            frozen=self.frozen,
            rmse_history=self.history,
        )
        return buffer.getvalue()

    def save(self, path: str | os.PathLike[str], *, force: bool = False) -> Path:
        """Write it into a file.

        Args:
            path: of the file, .npz; its directory must exist.
            force: replace a file that exists.

        Raises:
            ConfigError: the path does not end in .npz.
            RecordingError: the file exists, or cannot be written.
        """
        path = Path(path)
        check_suffix(path, "a correction", ".npz")
        with complete_file(path, force=force) as temporary:
            temporary.write_bytes(self.to_bytes())
        return path

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Correction:
        """Read a file that `save` wrote.

        Raises:
            ConfigError: it cannot be read, or its content is not a correction.
        """
        path = Path(path)
        try:
            data = read_file(path)
        except OSError as error:
            raise ConfigError(
                f"The correction {path} cannot be read: {error.strerror}.",
                "Give a file that `g1stream learn` made.",
            ) from error
        return cls.from_bytes(data, path)

    @classmethod
    def from_bytes(cls, data: bytes, source: Path) -> Correction:
        """A correction from the content of its file.

        Args:
            data: what `to_bytes` returned.
            source: the file it came from.

        Raises:
            ConfigError: the content is not a correction.
        """
        try:
            return cls._of_arrays(read_npz(data), source)
        except ConfigError:
            raise
        except Exception as error:  # each compression has errors of its own
            reason = f"it has no {error.args[0]}" if isinstance(error, KeyError) else str(error)
            raise _invalid(source, reason) from error

    @classmethod
    def _of_arrays(cls, arrays: dict[str, NDArray[Any]], source: Path) -> Correction:
        if arrays["joint_names"].tolist() != list(JOINT_NAMES):
            raise ValueError("its joints are not the 29 of a G1 in motor order")
        conditions = Conditions(
            motion=str(arrays["motion"]),
            motion_sha256=str(arrays["motion_sha256"]),
            robot=str(arrays["robot"]),
            rate=float(arrays["rate"]),
            kp=_numbers(arrays, "kp", (N_JOINTS,)),
            kd=_numbers(arrays, "kd", (N_JOINTS,)),
            feedforward=_choice(arrays, "feedforward", FeedForwardKind),
            support=_choice(arrays, "support", StreamSupport),
        )
        if arrays["frozen"].dtype != np.bool_:
            raise ValueError(f"frozen is of type {arrays['frozen'].dtype}")
        return cls(
            conditions,
            time=_numbers(arrays, "time"),
            values=_numbers(arrays, "correction"),
            frozen=arrays["frozen"],
            history=_numbers(arrays, "rmse_history"),
            source=source,
        )

    def _invalid(self, reason: str) -> ConfigError:
        return _invalid(self.source, reason)


class CorrectionSpline:
    """A correction as a function of motion time, for the part of a motion that is played.

    Args:
        correction: its values.
        start, stop: the part that is played, motion time in s; where it cuts into the correction,
            that fades in and out there as well.
    """

    def __init__(self, correction: Correction, start: float, stop: float) -> None:
        from scipy.interpolate import CubicSpline

        self.correction = correction
        time, values = correction.time, correction.values
        values = values * fade(time, max(start, time[0]), min(stop, time[-1]))[:, np.newaxis]
        # Zeros on both sides, where what a natural end of a spline leaves of its slope dies away.
        step = (time[-1] - time[0]) / (len(time) - 1)
        time = time[0] + step * np.arange(-_PADDING, len(time) + _PADDING)
        values = np.pad(values, ((_PADDING, _PADDING), (0, 0)))
        spline = CubicSpline(time, values, bc_type="natural")
        self._coefficients = np.ascontiguousarray(np.moveaxis(spline.c, 0, 1))
        self._first, self._last = float(time[0]), float(time[-1])
        self._per_second = (len(time) - 1) / (self._last - self._first)

    def at(self, time: float) -> Floats:
        """(3, 29) correction, rad, and its first two time derivatives; takes some 5 us.

        Args:
            time: motion time, s; outside the correction, all is 0.
        """
        if not self._first <= time < self._last:
            return np.zeros((3, N_JOINTS))
        k = int((time - self._first) * self._per_second)
        k = min(k, len(self._coefficients) - 1)
        s = time - self._first - k / self._per_second
        basis = np.array(
            ((s * s * s, s * s, s, 1.0), (3.0 * s * s, 2.0 * s, 1.0, 0.0), (6.0 * s, 2.0, 0.0, 0.0))
        )
        value: Floats = basis @ self._coefficients[k]
        return value

    def at_many(self, times: Floats) -> Floats:
        """(N, 29) the correction at times (N,), rad."""
        return np.array([self.at(time)[0] for time in times.tolist()])


def grid(start: float, stop: float) -> Floats:
    """The times of a correction from `start` to `stop`, s."""
    return np.linspace(start, stop, max(4, int(np.ceil((stop - start) / GRID_STEP))) + 1)


def fade(time: Floats, start: float, stop: float) -> Floats:
    """(T,) weights: 0 up to `start`, 1 from shortly after it, 0 again from `stop`; smooth."""
    inside: Floats = (
        minimum_jerk((time - start) / _FADE)[0] * minimum_jerk((stop - time) / _FADE)[0]
    )
    return inside


def _numbers(arrays: dict[str, NDArray[Any]], name: str, shape: tuple[int, ...] = ()) -> Floats:
    if arrays[name].dtype.kind not in "fiu":
        raise ValueError(f"{name} is of type {arrays[name].dtype}")
    values = arrays[name].astype(np.float64)
    if shape and values.shape != shape:
        raise ValueError(f"{name} has the shape {values.shape}, not {shape}")
    if not np.isfinite(values).all():
        raise ValueError(f"{name} has a value that is not finite")
    return values


def _choice(arrays: dict[str, NDArray[Any]], name: str, choices: Any) -> Any:
    value = str(arrays[name])
    if value and value not in get_args(choices):
        raise ValueError(f"{name} is {value!r}, not one of {', '.join(get_args(choices))}")
    return value or None


def _invalid(source: Path | None, reason: str) -> ConfigError:
    return ConfigError(
        f"{source or 'The correction'} is not a valid correction: {reason}.",
        "Make it with `g1stream learn SESSION... -o better.npz`.",
    )
