"""Pictures of a robot and its ghost by MuJoCo, without a display."""

from __future__ import annotations

import os
from importlib import import_module
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np

from g1stream.errors import RobotError, SimError
from g1stream.robot.joints import JOINT_NAMES
from g1stream.robot.meshes import real_g1
from g1stream.robot.model import G1
from g1stream.robot.mujoco_spec import mujoco_spec
from g1stream.robot.visuals import find_mesh, has_meshes, mesh_names, read_visuals
from g1stream.sim.model import add_floor_and_light
from g1stream.types import Floats

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

__all__ = ["Offscreen", "PosedRobot", "with_shapes"]

#: What MuJoCo can draw with, in the order in which they are tried.
_BACKENDS: Final = ("egl", "osmesa", "glfw")
#: How far behind the robot a ghost is drawn, m: surfaces that coincide would flicker.
_BEHIND: Final = 0.004
_SKY: Final = ([0.95, 0.96, 0.98], [0.75, 0.8, 0.87])
_FIELD_OF_VIEW: Final = 30.0
#: How far the camera looks down, degrees, and what it leaves free around the robot.
_ELEVATION: Final = -12.0
_MARGIN: Final = 1.05
_MOST_SHAPES: Final = 2000


def with_shapes(robot: G1) -> G1:
    """The robot whose shapes stand for a robot's: itself where its URDF's meshes are found.

    Else the real G1 with meshes where they are installed, or instead of missing meshes the default
    robot, if it has links of the same names.
    """
    if has_meshes(robot):
        return robot
    others = (real_g1(), G1.default() if mesh_names(robot) else None)
    same = (one for one in others if one and set(one.link_names) == set(robot.link_names))
    return next(same, robot)


class PosedRobot(NamedTuple):
    """A robot's pose in each of T frames.

    Attributes:
        q: (T, 29) rad, motor order.
        pos: (T, 3) m, pelvis in the world.
        quat_wxyz: (T, 4) pelvis to world; zero is taken for upright.
        tint: red, green, blue and opacity of all shapes, 0 to 1; the robot's colours if None.
    """

    q: Floats
    pos: Floats
    quat_wxyz: Floats
    tint: tuple[float, float, float, float] | None = None


class Offscreen:
    """Draws a robot in several poses at once, with a camera that keeps all of them in view.

    Args:
        robot: whose shapes to draw: its meshes where they are found, else its primitive shapes.
        robots: at least one, of T frames each.
        size: width and height of a picture, pixels.
        azimuth: where the camera stands, degrees around the robot: 0 in front of how it stands in
            the first frame, 90 on its left.

    Attributes:
        meshes: it draws meshes, not primitive shapes.

    Raises:
        RobotError: MuJoCo does not accept the URDF or a mesh.
        SimError: there is no OpenGL to draw with.
    """

    def __init__(
        self, robot: G1, robots: Sequence[PosedRobot], size: tuple[int, int], azimuth: float
    ) -> None:
        self._context = _gl_context(*size)  # before MuJoCo is imported, which may fail likewise
        import mujoco

        self._robots = robots
        self.meshes = has_meshes(robot)
        self._model = _compile(robot, size)
        self._data = mujoco.MjData(self._model)
        self._present = np.flatnonzero(robot.present)
        joints = [self._model.joint(JOINT_NAMES[i]) for i in self._present]
        self._joints = np.array([joint.qposadr[0] for joint in joints])
        self._options, self._perturb = mujoco.MjvOption(), mujoco.MjvPerturb()
        self._scene = mujoco.MjvScene(self._model, _MOST_SHAPES)
        self._camera = mujoco.MjvCamera()
        self._viewport = mujoco.MjrRect(0, 0, *size)
        self._drawing = mujoco.MjrContext(
            self._model,
            mujoco.mjtFontScale.mjFONTSCALE_100
            if size[1] < 600
            else mujoco.mjtFontScale.mjFONTSCALE_150,
        )
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, self._drawing)
        self._lift = 0.0
        self._targets = self._follow(size, azimuth)

    def close(self) -> None:
        """Free what OpenGL holds."""
        self._drawing.free()
        self._context.free()

    def draw(self, frame: int, text: tuple[str, str]) -> NDArray[np.uint8]:
        """A picture (height, width, 3), RGB.

        Args:
            frame: of the robots.
            text: two columns of lines for the upper left corner, ASCII.
        """
        import mujoco

        self._camera.lookat[:] = self._targets[frame]
        self._scene.ngeom = 0
        for number, posed in enumerate(self._robots):
            self._pose(posed, frame)
            first = self._scene.ngeom
            if number == 0:  # with the floor and the light
                every = mujoco.mjtCatBit.mjCAT_ALL
                mujoco.mjv_updateScene(
                    *(self._model, self._data, self._options, self._perturb),
                    *(self._camera, every, self._scene),
                )
            else:
                dynamic = mujoco.mjtCatBit.mjCAT_DYNAMIC
                mujoco.mjv_addGeoms(
                    *(self._model, self._data, self._options, self._perturb, dynamic, self._scene)
                )
            if posed.tint:
                forward = np.array(self._scene.camera[0].forward)
                for geom in self._scene.geoms[first : self._scene.ngeom]:
                    if geom.category == mujoco.mjtCatBit.mjCAT_DYNAMIC:
                        geom.rgba[:] = posed.tint
                        geom.pos[:] += _BEHIND * forward
        mujoco.mjr_render(self._viewport, self._scene, self._drawing)
        mujoco.mjr_overlay(
            mujoco.mjtFont.mjFONT_NORMAL,
            mujoco.mjtGridPos.mjGRID_TOPLEFT,
            self._viewport,
            *text,
            self._drawing,
        )
        pixels = np.empty((self._viewport.height, self._viewport.width, 3), dtype=np.uint8)
        mujoco.mjr_readPixels(pixels, None, self._viewport, self._drawing)
        return pixels[::-1]

    def _pose(self, posed: PosedRobot, frame: int) -> None:
        import mujoco

        qpos = self._data.qpos
        qpos[:3], qpos[3:7] = posed.pos[frame], posed.quat_wxyz[frame]
        qpos[2] += self._lift
        qpos[self._joints] = posed.q[frame][self._present]
        np.nan_to_num(qpos, copy=False, posinf=0.0, neginf=0.0)
        mujoco.mj_kinematics(self._model, self._data)
        mujoco.mj_camlight(self._model, self._data)

    def _follow(self, size: tuple[int, int], azimuth: float) -> Floats:
        """Place camera and robot; what the camera looks at in each frame, (T, 3) m."""
        from scipy.ndimage import gaussian_filter1d

        low, high = self._bounds()
        # Slower than the robot, so that the picture does not shake.
        targets: Floats = gaussian_filter1d((low + high) / 2, len(low) / 40, axis=0, mode="nearest")
        farthest = np.maximum(high - targets, targets - low).max(axis=0)
        across = np.hypot(farthest[0], farthest[1])
        half = np.tan(np.radians(_FIELD_OF_VIEW / 2))
        # The nearest part of the robot is nearer than its middle, by up to its reach.
        distance = max(farthest[2], across * size[1] / size[0]) / half + across
        w, x, y, z = self._robots[0].quat_wxyz[0]
        heading = np.degrees(np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)))
        self._camera.distance = _MARGIN * distance
        self._camera.azimuth = heading + azimuth + 180.0  # that in which it looks
        self._camera.elevation = _ELEVATION
        # The height of a robot may not be known, or it is bolted lower than it would stand.
        self._lift = max(0.0, -float(low[:, 2].min()))
        targets[:, 2] += self._lift
        return targets

    def _bounds(self) -> tuple[Floats, Floats]:
        """Corners of a box around all robots, (T, 3) m each, in every frame."""
        body = self._model.geom_bodyid > 0
        reach = np.minimum(self._model.geom_rbound[body], 0.15)[:, np.newaxis]
        low = np.full((len(self._robots[0].q), 3), np.inf)
        high = -low
        for posed in self._robots:
            for frame in range(len(low)):
                self._pose(posed, frame)
                centres = self._data.geom_xpos[body]
                low[frame] = np.minimum(low[frame], (centres - reach).min(axis=0))
                high[frame] = np.maximum(high[frame], (centres + reach).max(axis=0))
        return low, high


def _compile(robot: G1, size: tuple[int, int]) -> Any:
    """A `mujoco.MjModel` of the robot's shapes and a floor."""
    import mujoco

    meshes = has_meshes(robot)
    try:
        spec = mujoco_spec(robot, floating=True, shapes=not meshes)
        if meshes:
            _add_meshes(spec, robot)
        elif any(not geom.contype for geom in spec.geoms):  # shapes to see, besides solid ones
            for geom in [geom for geom in spec.geoms if geom.contype]:
                spec.delete(geom)
        if not spec.geoms:
            raise RobotError(
                f"There is nothing to draw of the robot {robot.source}: its URDF has no shapes.",
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
        # Without a GPU, smoothed edges would double the time that a frame takes.
        visual.quality.offsamples, visual.quality.shadowsize = 0, 1024
        return spec.compile()
    except (ValueError, mujoco.FatalError) as error:
        raise RobotError(
            f"MuJoCo does not accept the URDF {robot.source}: {' '.join(str(error).split())}.",
            "Correct the URDF or the mesh.",
        ) from error


def _add_meshes(spec: Any, robot: G1) -> None:
    import mujoco

    for number, visual in enumerate(read_visuals(robot)):
        body, shape = spec.body(visual.link), mujoco.mjtGeom
        pose = {"pos": visual.pos, "quat": visual.quat_wxyz, "rgba": visual.rgba}
        if visual.kind == "mesh":
            path, name = find_mesh(robot, visual.mesh), f"mesh_{number}"
            spec.add_mesh(name=name, file=str(path), scale=visual.size)
            body.add_geom(type=shape.mjGEOM_MESH, meshname=name, **pose)
        else:
            kind = getattr(shape, f"mjGEOM_{visual.kind.upper()}")
            half = [extent / 2 for extent in visual.size]
            size = [half[0], half[2], 0] if visual.kind == "cylinder" else half
            body.add_geom(type=kind, size=size, **pose)


def _gl_context(width: int, height: int) -> Any:
    """An OpenGL context that is current, of the first backend that works."""
    chosen = os.environ.get("MUJOCO_GL")
    failures = []
    for backend in (chosen,) if chosen in _BACKENDS else _BACKENDS:
        if backend == "glfw" and not chosen and not os.environ.get("DISPLAY"):
            continue
        before = os.environ.get("PYOPENGL_PLATFORM")
        try:
            context = import_module(f"mujoco.{backend}").GLContext(width, height)
            context.make_current()
        except Exception as error:  # a missing library raises whatever PyOpenGL makes of it
            failures.append(f"{backend}: {error}")
            if before is None:  # or the next backend would be refused
                os.environ.pop("PYOPENGL_PLATFORM", None)
        else:
            return context
    raise SimError(
        f"There is no OpenGL to draw with ({'; '.join(failures)}).",
        "Install EGL, on Debian and Ubuntu: apt-get install libegl1 libgl1-mesa-dri.",
    )
