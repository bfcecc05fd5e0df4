"""MuJoCo's viewer for a simulated world."""

from __future__ import annotations

import sys
import warnings
from typing import TYPE_CHECKING, Any

from g1stream.errors import SimError
from g1stream.sim.model import BASE_BODY

if TYPE_CHECKING:
    from g1stream.sim.world import World

__all__ = ["follow", "open_viewer"]

_REMEDY = "Run it on a desktop, or without the viewer."


def open_viewer(world: World) -> Any:
    """Open a window that follows the robot and return MuJoCo's handle of it, a context manager.

    The window shows the world at the last `sync()`, which copies it and should be called some 50
    times a second, from the thread that steps. `is_running()` is False once the user has closed
    the window; `close()` closes it.

    Raises:
        SimError: there is no display, or no OpenGL on it.
    """
    _check_display()
    from mujoco import viewer

    try:
        window = viewer.launch_passive(
            world.model, world.data, show_left_ui=False, show_right_ui=False
        )
    except RuntimeError as error:  # macOS wants the program to be run by mjpython
        raise SimError(f"MuJoCo's viewer cannot be opened: {error}.", _REMEDY) from error
    with window.lock():
        follow(world, window.cam)
    return window


def follow(world: World, camera: Any) -> None:
    """Let a `mujoco.MjvCamera` follow the robot, from the front, with all of it in view."""
    import mujoco

    camera.type = mujoco.mjtCamera.mjCAMERA_TRACKING
    camera.trackbodyid = BASE_BODY
    camera.lookat[:] = world.data.subtree_com[BASE_BODY]
    camera.distance, camera.azimuth, camera.elevation = 3.0, 145.0, -10.0


def _check_display() -> None:
    """Try a hidden window first: without a display, MuJoCo's viewer would wait for ever."""
    if sys.platform == "darwin":
        return
    import glfw

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", glfw.GLFWError)
        shown = glfw.init()
        if shown:
            glfw.window_hint(glfw.VISIBLE, glfw.FALSE)
            shown = bool(glfw.create_window(64, 64, "", None, None))
        glfw.terminate()
    if not shown:
        raise SimError("MuJoCo's viewer needs a display with OpenGL, and none was found.", _REMEDY)
