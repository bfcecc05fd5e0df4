"""Renders a robot and its ghost with `mujoco.Renderer`, without a display."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from importlib import reload
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from g1stream.errors import ConfigError, RobotError, SimError
from g1stream.extras.meshes.meshes import decimate, find_mesh, has_meshes, read_stl
from g1stream.robot.dynamics import mujoco_spec
from g1stream.robot.joints import JOINT_NAMES
from g1stream.robot.kinematics import pose_blocks
from g1stream.robot.model import G1
from g1stream.robot.shapes import Visual, ghost_size, read_visuals
from g1stream.sim.model import add_floor_and_light
from g1stream.types import Floats

#: Groups of geoms: the robot, and its ghost with smaller shapes.
_ROBOT, _GHOST = 1, 2
_SKY: Final = ([0.95, 0.96, 0.98], [0.75, 0.8, 0.87])
_FIELD_OF_VIEW: Final = 30.0
#: Downward angle of the camera, degrees.
_ELEVATION: Final = -12.0
#: Extent of a robot beyond the origins of its links, and of its head above its pelvis, m.
_BEYOND_LINKS, _HEAD = 0.12, 0.6
#: Height of a foot's link above its sole, m.
_SOLE: Final = 0.03


class PosedRobot(NamedTuple):
    """A robot's pose in each of T frames."""

    q: Floats  # (T, 29) rad, motor order
    pos: Floats  # (T, 3) m, pelvis in the world
    quat_wxyz: Floats  # (T, 4) pelvis to world; zero means upright
    # Red, green, blue and opacity of all shapes, 0 to 1; the robot's own colours if None.
    tint: tuple[float, float, float, float] | None = None
    ghost: bool = False  # smaller, and drawn over another robot


class Scene:
    """Draws several robots at once, with a camera that follows the first one.

    It uses `meshes` if they are found, otherwise primitive shapes. The camera is at `azimuth`
    degrees around the robot: 0 in front of its pose in the first frame, 90 on its left.
    """

    def __init__(
        self, robot: G1, robots: Sequence[PosedRobot], size: tuple[int, int], azimuth: float
    ) -> None:
        with _opengl_errors():
            import mujoco

            # The command line disables it; unlike MuJoCo's default, EGL needs no display.
            if os.environ.get("MUJOCO_GL") in (None, "", "disabled"):
                os.environ["MUJOCO_GL"] = "egl"
            reload(sys.modules[mujoco.Renderer.__module__].gl_context)  # this reads MUJOCO_GL
        self.meshes = has_meshes(robot)
        self._robots = [_with_numbers(posed) for posed in robots]
        self._model = _compile(robot, size)
        self._data = mujoco.MjData(self._model)
        self._present = np.flatnonzero(robot.present)
        joints = [self._model.joint(JOINT_NAMES[i]) for i in self._present]
        self._joints = np.array([joint.qposadr[0] for joint in joints])
        self._options, self._perturb = mujoco.MjvOption(), mujoco.MjvPerturb()
        self._camera = mujoco.MjvCamera()
        self._targets, self._lift = self._follow(robot, size, azimuth)
        with _opengl_errors():
            self._renderer = mujoco.Renderer(self._model, size[1], size[0])

    def close(self) -> None:
        """Free the OpenGL resources."""
        self._renderer.close()

    def draw(self, frame: int) -> NDArray[np.uint8]:
        """Draw the robots in a frame: a picture (height, width, 3), RGB."""
        import mujoco

        self._camera.lookat[:] = self._targets[frame]
        scene, dynamic = self._renderer.scene, mujoco.mjtCatBit.mjCAT_DYNAMIC
        for number, posed in enumerate(self._robots):
            qpos = self._data.qpos
            qpos[:3], qpos[3:7] = posed.pos[frame], posed.quat_wxyz[frame]
            qpos[2] += self._lift
            qpos[self._joints] = posed.q[frame][self._present]
            mujoco.mj_kinematics(self._model, self._data)
            mujoco.mj_camlight(self._model, self._data)
            first = scene.ngeom if number else 0
            self._options.geomgroup[_ROBOT], self._options.geomgroup[_GHOST] = (
                not posed.ghost,
                posed.ghost,
            )
            if number == 0:  # the first scene has the floor and the light
                self._renderer.update_scene(self._data, self._camera, self._options)
            else:
                what = self._model, self._data, self._options, self._perturb
                mujoco.mjv_addGeoms(*what, dynamic, scene)
            for geom in scene.geoms[first : scene.ngeom]:
                if posed.tint and geom.category == dynamic:
                    geom.rgba[:] = posed.tint
                if posed.ghost:
                    geom.category = mujoco.mjtCatBit.mjCAT_DECOR  # it casts no shadow
        picture: NDArray[np.uint8] = self._renderer.render()
        return picture

    def _follow(self, robot: G1, size: tuple[int, int], azimuth: float) -> tuple[Floats, float]:
        """Camera targets of the frames (T, 3), and the height by which everything is raised, m."""
        from scipy.ndimage import gaussian_filter1d

        leader = self._robots[0]
        # Slower than the robot, so that the picture is steady.
        sigma = len(leader.pos) / 40
        targets: Floats = gaussian_filter1d(leader.pos, sigma, axis=0, mode="nearest")
        reach, lowest = _HEAD, np.inf
        for posed in self._robots:
            for part, poses in pose_blocks(robot, posed.q, posed.pos, posed.quat_wxyz):
                away = np.linalg.norm(poses.pos - targets[part, np.newaxis], axis=-1)
                reach = max(reach, float(away.max()) + _BEYOND_LINKS)
                lowest = min(lowest, float(poses.pos[..., 2].min()))
        # The robot's height may be unknown, or it is bolted lower than it would stand.
        lift = max(0.0, _SOLE - lowest)
        half = np.radians(_FIELD_OF_VIEW / 2) * min(1.0, size[0] / size[1])
        w, x, y, z = leader.quat_wxyz[0]
        heading = np.degrees(np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)))
        self._camera.distance = reach / np.sin(half)
        self._camera.azimuth = heading + azimuth + 180.0  # the viewing direction
        self._camera.elevation = _ELEVATION
        targets[:, 2] += lift
        return targets, lift


def _with_numbers(posed: PosedRobot) -> PosedRobot:
    """The pose with 0 for non-finite values, and unit quaternions."""
    q, pos, quat = (np.nan_to_num(one, posinf=0.0, neginf=0.0) for one in posed[:3])
    norm = np.linalg.norm(quat, axis=1, keepdims=True)
    quat = np.where(norm > 0.0, quat / np.where(norm > 0.0, norm, 1.0), [1.0, 0.0, 0.0, 0.0])
    return posed._replace(q=q, pos=pos, quat_wxyz=quat)


@contextmanager
def _opengl_errors() -> Iterator[None]:
    try:
        yield
    except Exception as error:  # PyOpenGL raises various errors for a missing library
        raise SimError(
            f"OpenGL is not available: MUJOCO_GL={os.environ.get('MUJOCO_GL', '')}: "
            f"{' '.join(str(error).split())}.",
            "Unset MUJOCO_GL and install EGL (Debian, Ubuntu: apt-get install libegl1 libopengl0 "
            "libgl1-mesa-dri), or set it to osmesa or glfw, which need other libraries.",
        ) from error


def _compile(robot: G1, size: tuple[int, int]) -> Any:
    """A `mujoco.MjModel` of the robot's shapes and a floor."""
    import mujoco

    try:
        spec = mujoco_spec(robot, floating=True, shapes=False)
        _add_shapes(spec, robot)
        if not spec.geoms:
            raise RobotError(
                f"The robot {robot.source} cannot be drawn: its URDF has no shapes.",
                "Give its links shapes, or the names of a G1's.",
            )
        add_floor_and_light(spec)
        spec.add_texture(
            name="sky",
            type=mujoco.mjtTexture.mjTEXTURE_SKYBOX,
            builtin=mujoco.mjtBuiltin.mjBUILTIN_GRADIENT,
            rgb1=_SKY[0],
            rgb2=_SKY[1],
            width=256,
            height=256,
        )
        visual = spec.visual
        visual.global_.offwidth, visual.global_.offheight = size
        visual.global_.fovy = _FIELD_OF_VIEW
        # Without a GPU, antialiasing would double the time of a frame.
        visual.quality.offsamples, visual.quality.shadowsize = 0, 1024
        return spec.compile()
    except (ValueError, mujoco.FatalError) as error:
        raise RobotError(
            f"MuJoCo does not accept the URDF {robot.source}: {' '.join(str(error).split())}.",
            "Correct the URDF or the mesh.",
        ) from error


def _add_shapes(spec: Any, robot: G1) -> None:
    """Add the shapes of a robot's links, and those of its ghost."""
    import mujoco

    with_meshes = has_meshes(robot)
    for number, visual in enumerate(read_visuals(robot)):
        body, shape = spec.body(visual.link), mujoco.mjtGeom
        pose = {"pos": visual.pos, "quat": visual.quat_wxyz, "rgba": visual.rgba}
        if visual.kind == "mesh":
            if not with_meshes:
                continue
            for group, mesh in _meshes_of(robot, visual).items():
                name = f"mesh_{number}_{group}"
                spec.add_mesh(name=name, **mesh)
                body.add_geom(type=shape.mjGEOM_MESH, meshname=name, group=group, **pose)
            continue
        kind = getattr(shape, f"mjGEOM_{visual.kind.upper()}")
        for group, size in {_ROBOT: visual.size, _GHOST: ghost_size(visual.size)}.items():
            half = [extent / 2 for extent in size]
            half = [half[0], half[2], 0] if visual.kind == "cylinder" else half
            body.add_geom(type=kind, size=half, group=group, **pose)


def _meshes_of(robot: G1, visual: Visual) -> dict[int, dict[str, Any]]:
    """A mesh for MuJoCo, by group; drawing time grows with the number of its triangles."""
    path = find_mesh(robot, visual.mesh)
    if path is None or path.suffix.lower() != ".stl":
        file = {"file": str(path), "scale": visual.size}
        return {_ROBOT: file, _GHOST: file}
    mesh = read_stl(path)
    with suppress(ConfigError):  # without the library, drawing is slower
        mesh = decimate(mesh)
    mesh = mesh.scaled(visual.size)
    return {
        group: {"uservert": np.float64(one.points).ravel(), "userface": one.triangles.ravel()}
        for group, one in ((_ROBOT, mesh), (_GHOST, mesh.of_ghost()))
    }
