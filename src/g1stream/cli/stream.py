"""`g1stream stream`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

import tyro

from g1stream.cli.common import (
    Flag,
    WireCommand,
    announce_wire,
    on_signals,
    print_warning,
    value,
)
from g1stream.cli.progress import watching
from g1stream.cli.summary import exit_code, print_summary
from g1stream.cli.values import flag_name
from g1stream.errors import ConfigError

if TYPE_CHECKING:
    from g1stream.config import Config
    from g1stream.control.loop import StreamLoop
    from g1stream.session.summary import Summary

__all__ = ["PlayCommand", "Stream"]

#: Flags that say how to record.
_OF_RECORDING = ("force", "auto_name", "split_size", "split_duration")


@dataclass(frozen=True, kw_only=True)
class PlayCommand(WireCommand):
    """Flags of the subcommands that play something on a robot."""

    settings: ClassVar[dict[str, str]] = {
        **WireCommand.settings,
        "rate": "stream.rate",
        "start": "stream.start",
        "duration": "stream.duration",
        "loop": "stream.loop",
        "ramp": "stream.ramp",
        "feedforward": "stream.feedforward",
        "support": "stream.support",
        "allow_second_writer": "safety.allow_second_writer",
        "auto_name": "record.auto_name",
        "split_size": "record.split_size",
        "split_duration": "record.split_duration",
    }

    record: Annotated[Path | None, value("MCAP")] = None
    """Record the session into this file."""
    force: Flag = False
    """Replace a recording that is there already."""
    auto_name: Flag = False
    """Put the time, UTC, into the recording's name."""
    split_size: Annotated[float | None, value("MB", "one file")] = None
    """Split the recording into parts of this size: name/name_0.mcap and so on."""
    split_duration: Annotated[float | None, value("S", "one file")] = None
    """Split the recording into parts of this duration."""
    rate: Annotated[float | None, value("HZ", "500")] = None
    """LowCmd per second."""
    start: Annotated[float | None, value("S", "0")] = None
    """Where in the motion to start."""
    duration: Annotated[float | None, value("S", "to its end")] = None
    """How much of the motion to play."""
    loop: Flag = False
    """Play again and again until stopped."""
    ramp: Annotated[float | None, value("S", "3")] = None
    """Time from the measured pose to the first frame."""
    feedforward: Annotated[
        Literal["none", "velocity", "dynamics"] | None,
        value(
            "{none,velocity,dynamics}",
            "dynamics where a simulator here says how it holds, velocity elsewhere",
        ),
    ] = None
    """What commands carry beside the position: nothing, velocity, or velocity and torque."""
    support: Annotated[
        Literal["bolted", "hanging", "follow", "free"] | None,
        value("{bolted,hanging,follow,free}", "as the simulator says"),
    ] = None
    """How the robot is held, for the torque; a wrong answer follows worse than none."""
    gains: Annotated[Path | None, value("TOML", "those of Unitree's example")] = None
    """File with tables [kp] and [kd]: joint name or pattern = gain. Goes over the config's."""
    allow_second_writer: Flag = False
    """Play although somebody else commands the robot. Dangerous."""
    json: Flag = False
    """Print the summary as JSON on standard output."""

    def resolve(self) -> Config:
        """The config file, if any, with the flags over it.

        Raises:
            ConfigError: the file or a value does not fit, or a flag has no meaning.
        """
        if self.record is None:
            for field in _OF_RECORDING:
                if getattr(self, field) not in (None, False):
                    raise ConfigError(
                        f"The flag {flag_name(field)} says how to record, and nothing is recorded.",
                        "Add --record FILE, or leave it out.",
                    )
        return super().resolve()

    def overrides(self) -> dict[str, Any]:
        """The flags that were given, and the gains file's tables."""
        over = super().overrides()
        if self.gains:
            from g1stream.control.gains import read_gains

            over |= {f"gains.{name}": table for name, table in read_gains(self.gains).items()}
        return over

    def report(self, summary: Summary) -> int:
        """Print how it went, and return the exit code."""
        print_summary(summary, as_json=self.json)
        return exit_code(summary)


@dataclass(frozen=True, kw_only=True)
class Stream(PlayCommand):
    """Play a motion on whatever robot listens: publish it as LowCmd, watch LowState.

    Waits for a LowState, moves to the first frame, plays, holds, damps. Ctrl-C damps and ends.

    Exit code 0: played as asked; 1: something stopped it, or is missing from the recording; 2: bad
    input; 128 + n: signal n ended it, so that it is 130 after Ctrl-C.
    """

    motion: Annotated[str, tyro.conf.Positional, value("MOTION")]
    """Motion file (CSV), session file, or the name of a bundled motion: demo."""
    fps: Annotated[float | None, value("N", "30")] = None
    """Frames per second of the motion file. A session is sampled with its own rate, or with this
    one."""

    def run(self) -> int:
        """Play, and return the exit code."""
        from g1stream.programs.stream import stream
        from g1stream.robot.model import G1
        from g1stream.session.motions import load_motion

        config = self.resolve()
        motion = load_motion(self.motion, G1.load(config.robot), fps=self.fps)
        for warning in motion.warnings:
            print_warning(warning)

        with watching() as watch:

            def prepare(loop: StreamLoop) -> None:
                announce_wire(config)
                on_signals(loop.request_stop)
                watch(loop, motion)

            summary = stream(
                motion,
                config,
                record=self.record,
                force=self.force,
                on_loop=prepare,
            )
        return self.report(summary)
