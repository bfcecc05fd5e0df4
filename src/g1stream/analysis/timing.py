"""How punctual commands, states and the wire were."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from g1stream.analysis.summary import percentiles
from g1stream.session.metrics import TimingMetrics
from g1stream.session.streams import ArmCommand, Command

if TYPE_CHECKING:
    from g1stream.session.session import Session
    from g1stream.session.summary import Summary

__all__ = ["timing_metrics"]


def timing_metrics(session: Session, summary: Summary) -> TimingMetrics:
    """The metrics, from the summary and the publish times of our commands and of states."""
    # With --via arm_sdk, those on /lowcmd are the robot's own controller's.
    ours = ArmCommand if session.topics.get(ArmCommand.topic) else Command
    stream, command = summary.stream, summary.topics.get(ours.topic)
    late = None if summary.simulated else stream  # a simulation waits for the loop
    found = TimingMetrics(
        rate_hz=command and command.rate_hz,
        nominal_rate_hz=stream and stream.nominal_rate_hz,
        lateness_us=late and late.lateness_us,
        lateness_histogram_us=late and late.lateness_histogram_us,
        skipped_ticks=stream and stream.skipped_ticks,
        topics={t: stats for t, stats in summary.topics.items() if stats.gaps is not None},
    )
    if command is None or not command.rate_hz:
        return found
    sent = session.stream(ours)
    commands = np.sort(sent.publish_time) + sent.clock_offset
    found.interval_us = percentiles(np.diff(commands) / 1e3)
    if "/lowstate" in found.topics:
        states = np.sort(session.measured.publish_time) + session.measured.clock_offset
        newest = np.searchsorted(states, commands, side="right") - 1
        # Where the recorder was killed, states may be missing that commands in the file had seen.
        known = (newest >= 0) & (session.complete | (commands <= states[-1]))
        if known.any():
            found.state_age_us = percentiles((commands[known] - states[newest[known]]) / 1e3)
    return found
