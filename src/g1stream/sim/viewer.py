"""MuJoCo's viewer for a simulated world."""

from __future__ import annotations

import sys
import warnings
from typing import TYPE_CHECKING, Any

from g1stream.errors import SimError

if TYPE_CHECKING:
    from g1stream.sim.world import World

__all__ = ["open_viewer"]

_REMEDY = "Run it on a desktop, or without the viewer."


def open_viewer(world: World) -> Any:
    """Open a window and return MuJoCo's handle of it, a context manager.

    The window shows the world at the last `sync()`, which copies it and should be called some 50
    times a second, from the thread that steps. `is_running()` is False once the user has closed
    the window; `close()` closes it.

    Raises:
        SimError: there is no display, or no OpenGL on it.
    """
    _check_display()
    from mujoco import viewer

    try:
        return viewer.launch_passive(
            world.model, world.data, show_left_ui=False, show_right_ui=False
        )
    except RuntimeError as error:  # macOS wants the program to be run by mjpython
        raise SimError(f"MuJoCo's viewer cannot be opened: {error}.", _REMEDY) from error


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
