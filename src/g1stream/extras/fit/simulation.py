"""Simulation of a robot under the commands of a session, in windows from the measured state."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Final, cast, get_args

import numpy as np

from g1stream.errors import ConfigError
from g1stream.extras.fit.recorded import Recorded, noise_of
from g1stream.robot.joints import N_JOINTS
from g1stream.robot.model import G1
from g1stream.robot.rotations import quat_conj, quat_from_yaw, quat_mul, yaw_of
from g1stream.sim.world import MotorCommand, Root, World
from g1stream.types import Floats, Ints, StreamSupport, Support

__all__ = ["JITTER", "Simulated", "doubt", "simulate_commands", "world_support"]

JITTER: Final = 4e-4
"""Time, s, from the publish time of a command or LowState within which the other side may take or
have taken a message: that of DDS on one machine, about 0.1 ms, and of a bridge that publishes three
messages before it takes a command."""

_SUPPORTS: Final[tuple[str, ...]] = get_args(StreamSupport)
#: Step of the physics, s, as in the embedded simulator at 500 Hz.
_TIMESTEP: Final = 1e-3
#: A bolted pelvis turns slower than this, and a hanging one faster than the next if its joints move
#: (standard deviation of all velocities), rad/s. A G1 that hangs and plays a motion turns at 0.2 or
#: more.
_TURNS, _RESTS, _MOVES = 0.05, 0.01, 0.2
#: Number of samples on both sides for the cubic that gives the initial state of a window.
_SIDE: Final = 12
#: Below this noise a window begins with the measured state itself, rad and rad/s.
_CLEAN: Final = (2e-6, 2e-4)
#: Least number, and one in how many windows, to simulate again from another state within the noise.
_REPEATED, _ONE_IN = 4, 8


@dataclass(frozen=True, eq=False)
class Simulated:
    """The simulated robot at the times of the LowStates of a `Recorded`.

    Attributes:
        q, dq, tau: (N, 29) rad, rad/s, N·m, motor order; nan outside of simulated windows.
        base: (N, 10) of the IMU in the pelvis: quaternion wxyz, gyroscope, accelerometer.
        windows: the states of each window.
        support: how the base was held.
        spread: (3, 29) RMS uncertainty of position, velocity and torque from the noise of the
            measured state with which a window begins, and from commands that were published close
            to a LowState.
    """

    q: Floats
    dq: Floats
    tau: Floats
    base: Floats
    windows: tuple[slice, ...]
    support: Support
    spread: Floats


def world_support(
    recorded: Recorded, support: str | None = None, usable: Sequence[str] = _SUPPORTS
) -> Support:
    """How the base of the simulated robot is held.

    A bolted robot is bolted. A hanging one hangs from the band of the embedded simulator, which
    pulls at the torso, because a driven base would not let the waist carry what is below. A
    following one is driven along the measured base. Nothing holds a standing one.

    Args:
        recorded: the recording.
        support: support of the robot; as recorded if None.
        usable: supports to name if it is unknown.

    Raises:
        ConfigError: the session does not contain the support, or not the pelvis's place.
    """
    support = support or recorded.support
    if support is None:
        raise ConfigError(
            f"{recorded.name} does not contain how the robot was held.",
            f"Give --support {', '.join(usable[:-1])} or {usable[-1]}.",
        )
    if support not in _SUPPORTS:
        raise ConfigError(f"There is no support {support!r}.", f"Use {', '.join(_SUPPORTS)}.")
    held = cast("Support", "free" if support == "feet" else support)
    if held in ("follow", "free") and recorded.base_pos is None:
        raise ConfigError(
            f"{recorded.name} does not contain the position of the robot's pelvis.",
            "Record rt/sportmodestate, or use a bolted or hanging robot.",
        )
    return held


def doubt(recorded: Recorded, support: Support) -> str:
    """Why the pelvis's gyroscope contradicts how the base is said to be held; empty if not."""
    turning = float(np.sqrt(np.mean(np.square(recorded.smooth_base()[1]).sum(axis=1))))
    what = f"the pelvis turned at {turning:.2g} rad/s RMS"
    if support == "bolted" and turning > _TURNS:
        return f"{what}, so it was not bolted"
    if support == "hanging" and turning < _RESTS and recorded.dq.std() > _MOVES:
        return f"{what} while joints moved, so it did not hang"
    return ""


def simulate_commands(
    recorded: Recorded,
    robot: G1,
    *,
    support: Support,
    window: float = 1.0,
    self_collision: bool = True,
    repeats: bool = True,
    exact: bool = False,
) -> Simulated:
    """Simulate the robot under the recorded commands.

    Each window begins with the measured state. Commands take effect at the robot's ticks at which
    the embedded simulator would use them, see `Recorded.in_force`, or exactly at their publish
    times plus the command delay of the parameters. A command that was published so close to a
    LowState that the embedded simulator may have used it a period earlier or later, see `JITTER`,
    belongs to either: in each window, the simulation nearest to the measurement counts.

    Args:
        recorded: the recording.
        robot: robot with its parameters.
        support: see `world_support`.
        window: length of a window, s.
        self_collision: links collide with each other.
        repeats: simulate windows again, for `Simulated.spread`, and with commands earlier or later.
        exact: see above. `Simulated.dq` is then that of the servo, which is implicit: after one
            more physics step.

    Raises:
        SimError: the state can no longer be integrated.
    """
    world = World(robot, support, self_collision=self_collision, timestep=_TIMESTEP)
    delay = robot.parameters.command_delay
    run = _Run(recorded, world, support, delay if exact else None)
    noise = float(noise_of(recorded.q).max()), float(noise_of(recorded.dq).max())
    values = np.full((len(recorded.time), 3, N_JOINTS), np.nan)
    base = np.full((len(recorded.time), 10), np.nan)
    windows = tuple(recorded.windows(window))
    rng, squares, n = np.random.default_rng(0), np.zeros((3, N_JOINTS)), 0
    arrivals = [
        recorded.in_force(delay, one) for one in ((0.0, JITTER, -JITTER) if repeats else (0.0,))
    ]
    moved, n_moved = np.zeros((3, N_JOINTS)), 0
    every = max(1, min(_ONE_IN, len(windows) // _REPEATED))
    for number, part in enumerate(windows):
        state, deviation = _first_state(recorded, part.start, noise)
        usual, *others = (one[part] for one in arrivals)
        tried = [usual, *(one for one in others if (one != usual).any())]
        runs = [run.window(part, state, one) for one in tried]
        best = int(np.argmin([np.square(one[:, 0] - recorded.q[part]).sum() for one, _ in runs]))
        found, of_base = runs[best]
        kept = 0 if part.start == 0 else 1  # the end of a window counts, not the start of the next
        values[part][kept:], base[part][kept:] = found[kept:], of_base[kept:]
        if repeats:
            # The nearer one of the two is at most half their distance from any mixture of them.
            unlike = np.max([np.square(0.5 * (one - found)) for one, _ in runs], axis=0)
            moved += unlike[1:].sum(axis=0)
            n_moved += len(found) - 1
        if repeats and number % every == 0 and deviation.any():
            state = state + deviation @ rng.standard_normal((2, N_JOINTS))
            other, _ = run.window(part, state, tried[best])
            squares += np.square(other - found)[1:].sum(axis=0)
            n += len(found) - 1
    q, dq, tau = values.transpose(1, 0, 2)
    spread = np.sqrt(squares / max(1, n) + moved / max(1, n_moved))
    return Simulated(q, dq, tau, base, windows, support, spread)


class _Run:
    """A simulated robot, and its input in each step."""

    def __init__(
        self, recorded: Recorded, world: World, support: Support, delay: float | None
    ) -> None:
        self._recorded, self._world, self._delay = recorded, world, delay
        self._roots = _roots(recorded, support, world)
        self._driven = support == "follow"

    def window(self, part: slice, state: Floats, numbers: Ints) -> tuple[Floats, Floats]:
        """Simulate the W states of a window.

        Args:
            part: window of the recording.
            state: (2, 29) initial positions and velocities.
            numbers: (W,) commands in force from each state on.

        Returns:
            (W, 3, 29) positions, velocities and torques; (W, 10) measurements of the pelvis's IMU.
        """
        recorded, world = self._recorded, self._world
        command = off = MotorCommand.off()
        world.set_state(state[0], state[1], self._roots(part.start))
        seconds = recorded.time[part] - recorded.time[part.start]
        steps = np.diff(np.round(seconds / _TIMESTEP).astype(int)).tolist()
        found, base = np.empty((len(seconds), 3, N_JOINTS)), np.empty((len(seconds), 10))
        exact = self._means(recorded.time[part.start], sum(steps))
        for k, n in enumerate([0, *steps], start=part.start):
            if self._delay is not None:
                for i in range(n):
                    world.step(next(exact), 1)
                    if not i:
                        found[k - part.start - 1, 1] = world.state().dq
            elif n > 0:
                world.step(command, n)
            at = world.state()
            found[k - part.start] = at.q, at.dq, at.tau_est
            base[k - part.start] = np.concatenate(at.imu)
            number, command = numbers[k - part.start], off
            if number >= 0:
                command = MotorCommand(recorded.enabled[number], *recorded.commands[number])
            if self._driven:
                world.set_reference(self._roots(k))
        return found, base

    def _means(self, start: float, n: int) -> Iterator[MotorCommand]:
        """The mean commands of n physics steps.

        The integrator's force in a step is that at its first instant, the middle between the two
        velocities (semi-implicit Euler), so the mean is that around this instant.
        """
        if self._delay is None:
            return
        edges = np.array(start + _TIMESTEP * (np.arange(n + 1) - 0.5))
        on, zero = np.ones(N_JOINTS, dtype=bool), np.zeros(N_JOINTS)
        for feed, kp, kd in np.diff(self._recorded.total(self._delay, edges), axis=0) / _TIMESTEP:
            yield MotorCommand(on, zero, zero, feed, kp, kd)


def _roots(recorded: Recorded, support: Support, world: World) -> Callable[[int], Root]:
    """A function from the index of a state to the pose of the base."""
    if support == "bolted":
        # Yaw and place have no effect on a bolted robot.
        quat = recorded.quat_wxyz.mean(axis=0)
        tilt = _without_yaw(quat / np.linalg.norm(quat))
        root = Root(np.zeros(3), tilt, np.zeros(3), np.zeros(3), playing=True)
        return lambda _: root
    quat, ang_vel = recorded.smooth_base()
    pos, vel = recorded.base_pos, recorded.base_lin_vel
    if pos is None or vel is None:
        pos, vel = np.tile(world.state().base_pos, (len(quat), 1)), np.zeros((len(quat), 3))
    return lambda k: Root(pos[k], quat[k], vel[k], ang_vel[k], playing=True)


def _without_yaw(quat: Floats) -> Floats:
    """The attitude (4,) without its yaw."""
    return quat_mul(quat_conj(quat_from_yaw(yaw_of(quat))), quat)


def _first_state(recorded: Recorded, k: int, noise: tuple[float, float]) -> tuple[Floats, Floats]:
    """Joint positions and velocities (29,) at the start of a window.

    For a session with noise they are from a cubic fit to the positions and velocities of the
    samples around it, each weighted by its noise.
    """
    measured = np.stack([recorded.q[k], recorded.dq[k]])
    if noise[0] < _CLEAN[0] and noise[1] < _CLEAN[1]:
        return measured, np.zeros((2, 2))
    near = slice(max(0, k - _SIDE), min(len(recorded.time), k + _SIDE + 1))
    s = recorded.time[near] - recorded.time[k]
    usable = np.abs(s) < 3 * _SIDE * recorded.period
    s = s[usable]
    if len(s) < 4:
        return measured, np.zeros((2, 2))
    scale = float(np.abs(s).max())
    u = s / scale
    powers = np.arange(4)
    place = u[:, np.newaxis] ** powers
    rate = np.zeros_like(place)
    rate[:, 1:] = powers[1:] * u[:, np.newaxis] ** (powers[1:] - 1) / scale
    of_q, of_dq = (max(one, 1e-9) for one in noise)
    system = np.concatenate([place / of_q, rate / of_dq])
    values = np.concatenate([recorded.q[near][usable] / of_q, recorded.dq[near][usable] / of_dq])
    covariance = np.linalg.inv(system.T @ system)
    found = covariance @ (system.T @ values)
    units = np.array([1.0, 1.0 / scale])
    deviation = np.linalg.cholesky(covariance[:2, :2] * np.outer(units, units))
    return found[:2] * units[:, np.newaxis], deviation
