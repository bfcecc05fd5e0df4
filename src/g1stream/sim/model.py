"""The MuJoCo model of a G1 above a floor, made from its URDF."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import numpy as np

from g1stream.errors import SimError
from g1stream.robot.dynamics import mujoco_spec
from g1stream.robot.hulls import add_hulls, never_collide, read_hulls
from g1stream.robot.joints import JOINT_NAMES, TORQUE_LIMIT

if TYPE_CHECKING:
    from g1stream.robot.model import G1

__all__ = ["BASE_BODY", "BASE_TARGET", "add_floor_and_light", "build_model", "torso_link"]

BASE_BODY: Final = 1
"""Body of the URDF's root link; the world is body 0."""

BASE_TARGET: Final = "base_target"
"""Name of the mocap body that a base is welded to, and of the weld."""

_FLOOR: Final = 1  # contact bit of the floor and of shapes that collide with it
_LINKS: Final = 2  # contact bit of the hulls, which collide with each other
_HIDDEN: Final = 3  # the first group of shapes that MuJoCo's viewer hides by default


def torso_link(robot: G1) -> str:
    """Name of the link above the waist; torso_link if the waist has no pitch joint."""
    moved = robot.joint_of_link == JOINT_NAMES.index("waist_pitch_joint")
    return robot.link_names[int(moved.argmax())] if moved.any() else "torso_link"


def build_model(
    robot: G1,
    *,
    floating: bool,
    driven: bool,
    timestep: float,
    self_collision: bool,
    visual: bool,
) -> Any:
    """Compile a `mujoco.MjModel` of the robot above a floor at height 0.

    Motors are servos in motor order, for the joints that the robot has. With control c and
    `actuator_biasprm` (0, -kp, -kd), the torque of a motor is c - kp q - kd dq, clipped at
    `g1stream.robot.joints.TORQUE_LIMIT`. Sensors have unitree_mujoco's names: `imu_quat`,
    `imu_gyro` and `imu_acc` at the URDF's `imu_in_pelvis`, the same with the prefix `secondary_` at
    its `imu_in_torso` (at the base and the torso without these frames), and `frame_pos` and
    `frame_vel` of the base.

    Meshes and finger joints are left out; fingers stay at zero. The robot's primitive shapes
    collide with the floor. Links collide with each other as in unitree_mujoco, as the convex hulls
    of their meshes with MuJoCo's default contact parameters. Feet collide with their soles only,
    and hands do not collide.

    Args:
        robot: the robot with URDF and parameters.
        floating: give the base a free joint; otherwise it is fixed to the world.
        driven: weld the base to a mocap body `base_target`, by an equality of that name.
        timestep: simulation timestep, s.
        self_collision: let links collide with each other.
        visual: keep the shapes that only a viewer needs; the physics is faster without them.

    Raises:
        SimError: MuJoCo does not accept the URDF.
    """
    import mujoco

    try:
        spec = mujoco_spec(robot, floating=floating, shapes=True)
        spec.option.timestep = timestep
        spec.compiler.discardvisual = not visual
        # Damping is integrated implicitly, including that of the servos, so any kd is stable.
        spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
        _set_contacts(spec)
        if self_collision:
            solid = [hull for hull in read_hulls(robot) if hull.solid]
            add_hulls(spec, solid, never_collide(robot), contact_bit=_LINKS)
        add_floor_and_light(spec)
        _add_motors(spec, robot)
        _add_sensors(spec, robot)
        if driven:
            _add_base_target(spec, timestep)
        model = spec.compile()
    except (ValueError, mujoco.FatalError) as error:
        raise SimError(
            f"MuJoCo does not accept the URDF {robot.source}: {' '.join(str(error).split())}.",
            "Correct the URDF; every moving link needs a mass and an inertia.",
        ) from error
    for motor in np.flatnonzero(robot.present):
        dof = model.joint(JOINT_NAMES[motor]).dofadr[0]
        model.dof_damping[dof] = robot.parameters.damping[motor]
    return model


def _set_contacts(spec: Any) -> None:
    """Let solid shapes collide with the floor only, and hide them if there are visual shapes."""
    solid = [geom for geom in spec.geoms if geom.contype]
    for geom in solid:
        geom.contype, geom.conaffinity = 0, _FLOOR
        if len(solid) < len(spec.geoms):
            geom.group = _HIDDEN


def add_floor_and_light(spec: Any) -> None:
    """Add a floor and a light."""
    import mujoco

    spec.add_texture(
        name="floor",
        type=mujoco.mjtTexture.mjTEXTURE_2D,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_CHECKER,
        rgb1=[0.25, 0.3, 0.35],
        rgb2=[0.3, 0.35, 0.4],
        width=256,
        height=256,
    )
    material = spec.add_material(name="floor", texrepeat=[1, 1], texuniform=True)
    material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = "floor"
    spec.worldbody.add_geom(
        name="floor",
        type=mujoco.mjtGeom.mjGEOM_PLANE,
        size=[0, 0, 1],
        contype=_FLOOR,
        conaffinity=0,
        material="floor",
    )
    spec.worldbody.add_light(pos=[1, 1, 4], dir=[-0.2, -0.2, -1])
    spec.visual.headlight.ambient = [0.4, 0.4, 0.4]


def _add_base_target(spec: Any, timestep: float) -> None:
    """Add a body at the target pose of the base, and a weld as stiff as the timestep allows."""
    import mujoco

    spec.worldbody.add_body(name=BASE_TARGET, mocap=True)
    spec.add_equality(
        name=BASE_TARGET,
        type=mujoco.mjtEq.mjEQ_WELD,
        objtype=mujoco.mjtObj.mjOBJ_BODY,
        name1=BASE_TARGET,
        name2=spec.worldbody.first_body().name,
        solref=[2 * timestep, 1],
        solimp=[0.9999, 0.9999, 0.001, 0.5, 2],
    )


def _add_motors(spec: Any, robot: G1) -> None:
    import mujoco

    for motor in np.flatnonzero(robot.present):
        name, limit = JOINT_NAMES[motor], TORQUE_LIMIT[motor]
        spec.add_actuator(
            name=name.removesuffix("_joint"),
            target=name,
            trntype=mujoco.mjtTrn.mjTRN_JOINT,
            biastype=mujoco.mjtBias.mjBIAS_AFFINE,
            forcelimited=True,
            forcerange=[-limit, limit],
        )


def _add_sensors(spec: Any, robot: G1) -> None:
    import mujoco

    base, torso = spec.worldbody.first_body(), spec.body(torso_link(robot))
    sensor, obj = mujoco.mjtSensor, mujoco.mjtObj
    for name, kind in (
        ("frame_pos", sensor.mjSENS_FRAMEPOS),
        ("frame_vel", sensor.mjSENS_FRAMELINVEL),
    ):
        spec.add_sensor(name=name, type=kind, objtype=obj.mjOBJ_XBODY, objname=base.name)
    for imu, body in (
        ("imu", spec.body("imu_in_pelvis") or base),
        ("secondary_imu", spec.body("imu_in_torso") or torso),
    ):
        body.add_site(name=imu)
        for part, kind in (
            ("quat", sensor.mjSENS_FRAMEQUAT),
            ("gyro", sensor.mjSENS_GYRO),
            ("acc", sensor.mjSENS_ACCELEROMETER),
        ):
            spec.add_sensor(name=f"{imu}_{part}", type=kind, objtype=obj.mjOBJ_SITE, objname=imu)
