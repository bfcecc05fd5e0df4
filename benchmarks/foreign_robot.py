"""A G1 that is not g1stream's simulator: a plain MuJoCo loop with known parameters.

MuJoCo's own loader reads the URDF. The servo torque is explicit, and a command acts at any fraction
of a tick after its publish time. The session has LowCmds and LowStates with their publish times.
Used by fit.py and by the tests of `fit` and `simulate`.

    session = Foreign(delay=5.5e-3, reports="instant").play(exciting_motion(), "bolted", seed=3)
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np

from g1stream.app.session import Session
from g1stream.dds.messages import LOWCMD, LOWSTATE, SPORTMODESTATE, encode_samples
from g1stream.motion.motion import Motion
from g1stream.motion.trajectory import Trajectory
from g1stream.robot.dynamics import BaseMotion, InverseDynamics
from g1stream.robot.joints import (
    ARMATURE,
    DAMPING,
    EXAMPLE_KD,
    EXAMPLE_KP,
    FRICTION,
    JOINT_NAMES,
    N_JOINTS,
    TORQUE_LIMIT,
)
from g1stream.robot.model import DEFAULT_URDF, G1
from g1stream.session.source import MemorySource
from g1stream.types import Floats

PERIOD, EPOCH = 2_000_000, 1_700_000_000_000_000_000  # ns
UPRIGHT = np.array([1.0, 0.0, 0.0, 0.0])
#: Standard deviations of joint positions and speeds, gyroscope, accelerometer and attitude.
NOISE = {"q": 5e-4, "dq": 0.05, "gyroscope": 0.01, "accelerometer": 0.1, "quaternion": 5e-4}


@dataclass(frozen=True, kw_only=True)
class Foreign:
    """The robot.

    Attributes:
        damping, friction, armature, scale: (29,) N·m·s/rad, N·m, kg·m² and ratio of the applied
            torque and that of the servo law, which is also reported.
        mass: kg added at a link's centre of mass.
        delay: time from the publish time of a LowCmd until it acts, s.
        backlash: play between rotor and link, rad. With it the rotor has the armature, the
            friction and the sensors.
        reports: the torque in LowState: of the last physics step, or the mean of the period.
        step: physics step, s.
        noise: factor of the sensor noise.
    """

    damping: Floats = field(default_factory=DAMPING.copy)
    friction: Floats = field(default_factory=FRICTION.copy)
    armature: Floats = field(default_factory=ARMATURE.copy)
    scale: Floats = field(default_factory=lambda: np.ones(N_JOINTS))
    mass: dict[str, float] = field(default_factory=dict)
    delay: float = 0.0
    backlash: float = 0.0
    reports: Literal["instant", "mean"] = "instant"
    step: float = 5e-4
    noise: float = 1.0

    def _model(self, support: str) -> tuple[Any, Any]:
        import mujoco

        spec = mujoco.MjSpec.from_string(DEFAULT_URDF.read_text())
        spec.option.timestep = self.step
        spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
        for geom in spec.geoms:
            geom.contype = geom.conaffinity = 0
        spec.compiler.fusestatic = False
        if support == "hanging":
            spec.worldbody.first_body().add_freejoint()
        for name, kind in (("gyro", "GYRO"), ("acc", "ACCELEROMETER")):
            spec.body("imu_in_pelvis").add_site(name=name)
            sensor, site = getattr(mujoco.mjtSensor, f"mjSENS_{kind}"), mujoco.mjtObj.mjOBJ_SITE
            spec.add_sensor(name=name, type=sensor, objtype=site, objname=name)
        for j, name in enumerate(JOINT_NAMES):
            joint = spec.joint(name)
            joint.actfrclimited = False
            if not self.backlash:
                joint.armature, joint.frictionloss = self.armature[j], self.friction[j]
        for link, mass in self.mass.items():
            spec.body(link).mass += mass
        model = spec.compile()
        if not self.backlash:
            dofs = [model.joint(name).dofadr[0] for name in JOINT_NAMES]
            model.dof_damping[dofs] = self.damping
        return model, mujoco.MjData(model)

    def play(self, motion: Motion, support: str = "bolted", *, seed: int = 0) -> Session:
        """The session of a motion, with the phase of the commands drawn at random."""
        rng = np.random.default_rng(seed)
        model, data = self._model(support)
        grid = round(self.step * 1e9)
        lead = grid * int(rng.integers(0, PERIOD // grid))  # of the first LowState
        times = EPOCH + np.arange(0, round(motion.duration * 1e9), PERIOD)
        commands = self._commands(motion, (times - EPOCH) / 1e9, support)
        acts = times + round(self.delay * 1e9)
        states, tau = self._simulate(model, data, commands, acts, EPOCH + lead, support)
        stamps = EPOCH + lead + PERIOD * np.arange(len(tau))
        for name, sigma in NOISE.items():
            states[name] += self.noise * sigma * rng.standard_normal(states[name].shape)
        n, gains = len(tau), (len(times), 1)
        source = MemorySource(f"foreign-{seed}")
        command = {
            "motor_cmd.mode": np.ones((len(times), N_JOINTS)),
            **{f"motor_cmd.{name}": values for name, values in commands.items()},
            "motor_cmd.kp": np.tile(EXAMPLE_KP, gains),
            "motor_cmd.kd": np.tile(EXAMPLE_KD, gains),
        }
        state = {
            "tick": 2 * np.arange(n),
            "motor_state.q": states["q"],
            "motor_state.dq": states["dq"],
            "motor_state.tau_est": tau,
            "imu_state.quaternion": states["quaternion"],
            "imu_state.gyroscope": states["gyroscope"],
            "imu_state.accelerometer": states["accelerometer"],
        }
        sport = {"position": states["position"], "velocity": states["velocity"]}
        for topic, values, at, channel in (
            (LOWCMD, command, times, "/lowcmd"),
            (LOWSTATE, state, stamps, "/lowstate"),
            (SPORTMODESTATE, sport, stamps, "/sportmodestate"),
        ):
            source.write_batch(channel, encode_samples(topic, values, len(at)), at + 100_000, at)
        return Session(source)

    def _commands(self, motion: Motion, time: Floats, support: str) -> dict[str, Floats]:
        """Targets with the torques of a model that knows none of the parameters."""
        wanted, dynamics = Trajectory(motion).sample_many(time), InverseDynamics(G1.default())
        base = BaseMotion(UPRIGHT, np.zeros(3))
        rows = zip(wanted.joint_pos, wanted.joint_vel, wanted.joint_acc, strict=True)
        tau = np.stack([dynamics.solve(support, *row, base).tau for row in rows])  # type: ignore[arg-type]
        return {"q": wanted.joint_pos, "dq": wanted.joint_vel, "tau": tau}

    def _teeth(self, inverse_inertia: Floats, between: Floats, faster: Floats) -> Floats:
        """The torque of the rotor on the link: in contact a resonance of 1500 rad/s, damped 0.3."""
        reduced: Floats = 1.0 / (inverse_inertia + 1.0 / self.armature)
        pressed = between - np.clip(between, -0.5 * self.backlash, 0.5 * self.backlash)
        damped = 2.0 * 0.3 * 1500.0 * faster * (pressed != 0.0)
        torque: Floats = reduced * (1500.0**2 * pressed + damped)
        return torque

    def _simulate(
        self,
        model: Any,
        data: Any,
        commands: dict[str, Floats],
        acts: Any,
        first: int,
        support: str,
    ) -> tuple[dict[str, Floats], Floats]:
        import mujoco

        q, v = (
            np.array([getattr(model.joint(name), kind)[0] for name in JOINT_NAMES])
            for kind in ("qposadr", "dofadr")
        )
        torso = np.flatnonzero(model.body_weldid == model.body_weldid[model.body("torso_link").id])
        share = (model.body_mass[torso] / model.body_mass[torso].sum())[:, np.newaxis]
        data.qpos[q] = commands["q"][0]
        if support == "hanging":
            data.qpos[2:7] = 3.0 - 9.81 * model.body_mass.sum() / 200.0, *UPRIGHT
        mujoco.mj_forward(model, data)
        # Of the rotor; without backlash those of the link.
        rotor, speed = data.qpos[q].copy(), np.zeros(N_JOINTS)
        acts = acts - first
        every, grid = round(PERIOD / 1e9 / self.step), round(self.step * 1e9)
        n = (acts[-1] - round(self.delay * 1e9)) // PERIOD
        obeyed = np.searchsorted(acts, np.arange(n * every) * grid, side="right") - 1
        applied, total = np.zeros((2, N_JOINTS))
        found: dict[str, list[Any]] = {name: [] for name in (*NOISE, "position", "velocity", "tau")}
        for step, number in enumerate(obeyed.tolist()):
            if not self.backlash:
                rotor, speed = data.qpos[q], data.qvel[v]
            if step % every == 0:
                base = data.qpos[:7] if support == "hanging" else np.array([0, 0, 1.0, *UPRIGHT])
                velocity = data.qvel[:3] if support == "hanging" else np.zeros(3)
                acc = data.sensor("acc").data if support == "hanging" else np.array([0, 0, 9.81])
                gyro = data.sensor("gyro").data if support == "hanging" else np.zeros(3)
                mean = self.reports == "mean"
                values = rotor, speed, gyro, acc, base[3:], base[:3], velocity
                for name, value in zip(found, values, strict=False):
                    found[name].append(np.array(value))
                found["tau"].append(total / every if mean else applied)
                total = np.zeros(N_JOINTS)
            k = max(0, number)
            error, rate = commands["q"][k] - rotor, commands["dq"][k] - speed
            asked = commands["tau"][k] + EXAMPLE_KP * error + EXAMPLE_KD * rate
            applied = np.clip(self.scale * asked, -TORQUE_LIMIT, TORQUE_LIMIT)
            total = total + applied
            passed = applied
            if self.backlash:
                between, faster = rotor - data.qpos[q], speed - data.qvel[v]
                passed = self._teeth(model.dof_invweight0[v], between, faster)
                pull = applied - passed - self.damping * speed
                speed = speed + self.step * pull / self.armature
                # Dry friction can stop the rotor within a step, and cannot turn it back.
                braked = np.maximum(np.abs(speed) - self.step * self.friction / self.armature, 0.0)
                speed = np.copysign(braked, speed)
                rotor = rotor + self.step * speed
            data.qfrc_applied[v] = passed
            if support == "hanging":
                way = np.array([0.0, 0.0, 3.0]) - data.qpos[:3]
                length = np.linalg.norm(way)
                along = data.qvel[:3] @ way / length
                data.xfrc_applied[torso, :3] = share * (200.0 - 100.0 * along / length) * way
            mujoco.mj_step(model, data)
        arrays = {name: np.stack(values) for name, values in found.items()}
        return arrays, arrays.pop("tau")
