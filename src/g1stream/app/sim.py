"""Run the MuJoCo bridge: a simulated G1 on DDS."""

from __future__ import annotations

import logging
import math
import os
import sys
import time
import warnings
from collections.abc import Callable
from contextlib import ExitStack
from typing import Any

from g1stream.child_process import Parent, publishing_for_ros2, run_child
from g1stream.clock import SystemClock
from g1stream.config import Config, SimConfig
from g1stream.dds.domain import Participant
from g1stream.dds.log_handler import dds_log_handler
from g1stream.errors import SimError
from g1stream.events import ConsoleHandler, handled_by
from g1stream.optional import extension
from g1stream.realtime import describe, on_time
from g1stream.robot.model import G1
from g1stream.sim.bridge import Bridge
from g1stream.sim.model import BASE_BODY
from g1stream.sim.robot import SimReport, SimulatedRobot
from g1stream.sim.world import World

__all__ = ["follow", "make_world", "open_viewer", "simulate"]

_LOGGER = logging.getLogger(__name__)

#: How far its priority is below that of the loop, which must not wait for the bridge.
_BELOW_LOOP = 10


def simulate(
    config: Config | None = None,
    *,
    should_stop: Callable[[], bool] = lambda: False,
    on_ready: Callable[[], None] = lambda: None,
    on_report: Callable[[SimReport], None] = lambda _: None,
) -> SimReport:
    """Run a simulated G1 on DDS until stopped or for `config.sim.duration`.

    Args:
        config: all settings; the defaults if omitted.
        should_stop: called at every LowState; True ends the simulation.
        on_ready: called when the robot is about to appear on DDS.
        on_report: called at the same time with the running report, to display it.

    Raises:
        G1StreamError: a setting or the wire is not valid.
    """
    config = config or Config()
    settings = config.sim
    model = G1.of_config(config)
    world = make_world(model, settings)
    with ExitStack() as stack:
        participant = stack.enter_context(Participant(config.dds.domain, config.dds.interface))
        stack.enter_context(handled_by(dds_log_handler(participant, "sim")))
        stack.enter_context(publishing_for_ros2(config, should_stop))
        window: Any = stack.enter_context(open_viewer(world)) if settings.viewer else None

        def view() -> bool:
            window.sync()
            return bool(window.is_running())

        robot = SimulatedRobot(world, settings, mode_machine=model.joint_set.mode_machine)
        bridge = Bridge(
            participant,
            robot,
            settings.held_by,
            SystemClock(),
            onboard=extension("simulated_service")(participant, settings.onboard),
            view=view if window else None,
        )
        granted = stack.enter_context(on_time(_priority(config), helpers=participant.threads))
        on_ready()
        on_report(robot.report)
        _LOGGER.info(describe(granted))
        end = None if settings.duration is None else time.monotonic() + settings.duration
        return bridge.run(lambda: should_stop() or (end is not None and time.monotonic() >= end))


def _run_child(parent: Parent) -> SimReport:
    """Simulate for a parent process. The startup message is the config."""
    with handled_by(ConsoleHandler(program="sim")):
        return simulate(
            parent.startup_message, should_stop=parent.done.is_set, on_ready=parent.ready
        )


def _priority(config: Config) -> int:
    """Priority for SCHED_FIFO, below the loop's; 0 if the bridge could block everything else.

    With one CPU, a simulation that is too slow would block it. With a viewer, it would wait for the
    drawing thread.
    """
    cpus = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    if config.sim.viewer or cpus < 2:
        return 0
    return max(0, config.realtime.priority - _BELOW_LOOP)


def make_world(robot: G1, settings: SimConfig) -> World:
    """The simulated robot with these settings."""
    # The largest step up to a millisecond that divides the period of LowState.
    timestep = 1.0 / (settings.rate * math.ceil(1000.0 / settings.rate))
    return World(
        robot,
        settings.held_by,
        self_collision=settings.self_collision,
        timestep=timestep,
        push=settings.push,
        seed=settings.seed,
        visual=settings.viewer,
    )


_REMEDY = "Run it on a desktop, or without the viewer."


def open_viewer(world: World) -> Any:
    """Open a window that follows the robot and return MuJoCo's handle, a context manager.

    The window shows the world at the last `sync()`, which copies it. Call `sync()` about 50 times a
    second, from the thread that steps. `is_running()` is False once the user has closed the window;
    `close()` closes it.
    """
    _check_display()
    from mujoco import viewer

    try:
        window = viewer.launch_passive(
            world.model, world.data, show_left_ui=False, show_right_ui=False
        )
    except RuntimeError as error:  # macOS requires mjpython
        raise SimError(f"MuJoCo's viewer cannot be opened: {error}.", _REMEDY) from error
    with window.lock():
        follow(world, window.cam)
    return window


def follow(world: World, camera: Any) -> None:
    """Let a `mujoco.MjvCamera` follow the robot from the front, with the whole robot in view."""
    import mujoco

    camera.type = mujoco.mjtCamera.mjCAMERA_TRACKING
    camera.trackbodyid = BASE_BODY
    camera.lookat[:] = world.data.subtree_com[BASE_BODY]
    camera.distance, camera.azimuth, camera.elevation = 3.0, 145.0, -10.0


def _check_display() -> None:
    """Try a hidden window first, because MuJoCo's viewer waits for ever without a display."""
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


if __name__ == "__main__":
    run_child(_run_child)
