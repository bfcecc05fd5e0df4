"""Play a motion on a simulated robot in lockstep, without DDS, another process or a wall clock."""

from __future__ import annotations

import logging
import threading
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Final, get_args

from g1stream._version import __version__
from g1stream.app.session import Session
from g1stream.app.sim import make_world
from g1stream.config import Config, SafetyConfig, load_config
from g1stream.control.loop import make_loop
from g1stream.control.plan import Plan, plan
from g1stream.dds.log_handler import LogHandler
from g1stream.dds.messages import LOG, Batch, LowState, Topic
from g1stream.errors import ConfigError
from g1stream.motion.motion import Motion
from g1stream.motion.readers import default_motion
from g1stream.recorder.recorder import raw_messages
from g1stream.session.records import RecorderSummary
from g1stream.session.source import MemorySource
from g1stream.session.writer import attach_run
from g1stream.sim.lockstep import EPOCH, Lockstep
from g1stream.sim.robot import SimulatedRobot
from g1stream.types import FeedForwardKind, StreamSupport, Support
from g1stream.view.pipeline import MessagePipeline

__all__ = ["LATENCY", "rollout"]

LATENCY: Final = 100_000
"""Log time minus publish time of every message, ns: about the latency of DDS on loopback."""

#: Ticks of the motion that are sampled together.
_BLOCK: Final = 64


def rollout(
    motion: Motion | str | Path | None = None,
    *,
    support: StreamSupport | None = None,
    feedforward: FeedForwardKind | None = None,
    config: Config | None = None,
    seconds: float | None = None,
    joints: str | None = None,
    announced: Support | None = None,
    noise: Callable[[LowState], None] | None = None,
    policy: str | Path | None = None,
    kp: float | Mapping[str, float] | None = None,
    kd: float | Mapping[str, float] | None = None,
) -> Session:
    """Play a motion on a simulated robot, faster than real time, and return the session.

    Loop, safety and feed-forward are those of `stream`; the robot is the bridge's. Both advance in
    lockstep: the robot's ticks are 1 ms after the loop's, at any rate, and take no simulated time.
    The same arguments therefore give the same messages, byte for byte.

    The session is in memory and takes about 4.5 MB per second.

    Each seed gives different sensor noise:

        sessions = [rollout("demo", noise=SensorNoise(seed=seed)) for seed in range(5)]

    Publish times are simulated time since 2000-01-01 00:00 UTC (`g1stream.sim.lockstep.EPOCH`); log
    times are `LATENCY`, 0.1 ms, later.

    Args:
        motion: a motion, a motion file, or the name of a bundled motion; None: the policy's own.
        support: how the pelvis is held; if None free with a policy, otherwise
            `config.sim.support`, by default bolted. With `feet` nothing holds it, and the loop
            balances the robot (extra `feet`).
        feedforward: what commands contain beside positions; if None `config.stream.feedforward`,
            by default dynamics, and velocity for support "free".
        config: all settings; the defaults if None. `dds`, `realtime`, `safety.deadman` and
            `safety.mode_machine` have no effect. With `stream.wait_for` the motion goes on by
            itself after each rest.
        seconds: how much of the motion to play; `config.stream.duration` if None.
        joints: joints that play the motion, such as "arms,waist"; `config.stream.joints` if None.
        announced: support that the simulated robot announces, if it shall differ from the real one.
        noise: called with each `LowState` before it is published, and may change it in place;
            `config.sim.noise` and `config.sim.seed` if None.
        policy: learned policy that plays the motion on free feet (extra `policy`): an ONNX file, or
            the name of a published one; `config.stream.policy` if None.
        kp: servo gain, N·m/rad: for all joints, or by joint, limb or pattern, such as
            {"arms": 60.0, "*_knee_joint": 150.0}; overrides `config.gains`.
        kd: likewise, N·m·s/rad.

    Returns:
        The session in memory, with all channels of a recorded one; `save` writes it to a file.

    Raises:
        G1StreamError: a file or a setting is not valid, or the robot cannot be simulated.
    """
    config = config or Config()
    if policy is not None:
        config = config.changed(stream={"policy": str(policy)})
    if config.stream.policy:
        support = support or "free"
        feedforward = feedforward or config.stream.feedforward or "dynamics"
    config = _resolve(config, support, feedforward, seconds, joints, {"kp": kp, "kd": kd})
    planned = plan(default_motion(config) if motion is None else motion, config, simulated=True)
    planned = replace(planned, rests=())  # nobody can tell it to go on
    robot = planned.robot
    pipeline = MessagePipeline(robot, config.record, planned.source.traits.about)
    simulated = SimulatedRobot(
        make_world(robot, config.sim),
        config.sim,
        mode_machine=robot.joint_set.mode_machine,
        noise=noise,
    )
    batches: dict[str, Batch] = defaultdict(Batch)

    def on_sample(topic: Topic, data: bytes, stamp: int) -> None:
        batch = batches[topic.name]
        batch.data.append(data)
        batch.publish_times.append(stamp)
        batch.log_times.append(stamp + LATENCY)

    link = Lockstep(simulated, announced or config.sim.held_by, on_sample=on_sample)
    loop = make_loop(planned, link, link, settle=0, block=_BLOCK)
    with _log_to(lambda data, _: on_sample(LOG, data, link.stamp())):
        planned.log_events()
        loop.run()
    source = MemorySource(f"rollout of {planned.motion.name}")
    _write_header(source, planned)
    header, shown = pipeline.file_header(EPOCH), pipeline.encode(batches)
    for messages in (*header, *raw_messages(batches), *shown):
        source.write_batch(*messages)
    stream = loop.report.summary(**planned.summary())
    recorder = RecorderSummary(
        first_ns=EPOCH,
        last_ns=link.stamp() + LATENCY,
        counts=source.topics,
        measured_tf=pipeline.base.summary() if pipeline.base else None,
    ).model_dump(mode="json")
    source.add_metadata(
        {
            "stream": stream.model_dump(mode="json"),
            "recorder": recorder,
            "measured_tf": recorder["measured_tf"],
        }
    )
    return Session(source)


def _resolve(
    config: Config,
    support: StreamSupport | None,
    feedforward: FeedForwardKind | None,
    seconds: float | None,
    joints: str | None,
    gains: Mapping[str, float | Mapping[str, float] | None],
) -> Config:
    """The config, overridden by the arguments of a rollout."""
    if support not in (None, *get_args(StreamSupport)):
        raise ConfigError(
            f"There is no support {support!r}.", f"Use {', '.join(get_args(StreamSupport))}."
        )
    if support == "feet" or (
        support is None and "feet" in (config.stream.support, config.sim.support)
    ):
        config = config.changed(stream={"support": "feet"})
        support, feedforward = "free", feedforward or "dynamics"
    support = support or config.sim.held_by
    # The simulated robot has no remote, and the mode_machine of its kind.
    robots = SafetyConfig().mode_machine
    config = config.changed(safety={"deadman": None, "mode_machine": robots})
    default: FeedForwardKind = "velocity" if support == "free" else "dynamics"
    config = load_config(
        over=config.model_dump()
        | {
            "sim.support": support,
            "stream.feedforward": feedforward or config.stream.feedforward or default,
            "stream.duration": None if seconds is None else float(seconds),
            "stream.joints": joints,
        }
        | {
            f"gains.{name}": dict(given) if isinstance(given, Mapping) else {"*": given}
            for name, given in gains.items()
            if given is not None
        }
    )
    if config.stream.via != "lowcmd":
        raise ConfigError(
            f"A rollout has no onboard controller, which stream.via = {config.stream.via} needs.",
            "Remove that setting, or play on `g1stream sim --onboard ai`.",
        )
    if config.stream.loop and config.stream.duration is None:
        raise ConfigError(
            "A rollout of a looping motion would not end: stream.loop is true.",
            "Give `seconds`, or stream.duration.",
        )
    return config


@contextmanager
def _log_to(publish: Callable[[bytes, int], object]) -> Iterator[None]:
    """Publish what this thread logs, as the stream and the bridge publish their events."""
    thread, logger = threading.get_ident(), logging.getLogger("g1stream")

    def is_of(program: str, record: logging.LogRecord) -> bool:
        of_sim = record.name.startswith("g1stream.sim")
        return record.thread == thread and of_sim == (program == "sim")

    with ExitStack() as stack:
        for program in ("stream", "sim"):
            handler = LogHandler(program, publish)
            handler.addFilter(partial(is_of, program))
            logger.addHandler(handler)
            stack.callback(logger.removeHandler, handler)
        yield


def _write_header(source: MemorySource, planned: Plan) -> None:
    packages, info = ("mujoco", "numpy"), planned.session_info()
    source.add_metadata(
        {
            "g1stream": __version__,
            "versions": {name: version(name) for name in packages},
            "started_ns": EPOCH,
            "log_clock": f"simulated; log times are publish times + {LATENCY} ns",
            **info.model_dump(mode="json", exclude_unset=True),
        }
    )
    attach_run(source, planned.robot, planned.config, info, EPOCH)
