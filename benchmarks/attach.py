"""A motion found in sessions without a reference: how exactly, how surely, how fast.

    python benchmarks/attach.py [MOTION...] [--clips 11] [--seconds 12] [--json]

Clips of the motions (default: demo, whole) are played in the lockstep simulator, and the reference
is removed. `found` has, over all clips, the greatest errors of start and speed where it is found
again: by commands, by measured joints alone, whose start is late by the robot's lag; with 5 ms of
jitter in the clock; with a tenth of the messages missing; played at other speeds; twice in one
file. `held` has the greatest errors of start and delay for clips of `HELD_LENGTHS`, whose targets
a robot holds from 8 ms after it gets them; each target is sent once, or repeated 500 times a
second. `pairs` counts the clips accepted in sessions of another clip. `cost` is the time to find a
motion in ten minutes, in a file on disk, and its ratio to the session's length.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

import g1stream
from g1stream.dds.messages import LOWCMD, LOWSTATE, encode_samples
from g1stream.errors import RecordingError
from g1stream.motion.trajectory import Trajectory
from g1stream.session.source import MemorySource
from g1stream.session.writer import SessionWriter
from g1stream.sim.lockstep import EPOCH

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from g1stream import Motion, Session

COMMANDS, STATES = "/lowcmd", "/lowstate"
SPEEDS = (0.5, 0.9, 1.25)
TEN_MINUTES = 600.0
HELD_RATES = (25, 50, 100)
HELD_LENGTHS = (4.0, 6.0, 8.0, 12.0, 20.0, 30.0)
RESPONSE = 0.008


def clips_of(motions: list[str], n: int, seconds: float) -> list[Motion]:
    """Clips that do not overlap, spread over the motions."""
    found: list[Motion] = []
    whole = [g1stream.load_motion(one) for one in motions]
    for motion in whole:
        each = max(1, min(-(-n // len(whole)), int(motion.duration // seconds)))
        edges = np.linspace(0.0, motion.duration, each + 1)
        found += [motion.trim(a, min(b, a + seconds)) for a, b in pairwise(edges)]
    return found[:n]


def changed(
    session: Session,
    topics: Iterable[str] = (COMMANDS, STATES),
    keep: Callable[[np.ndarray], np.ndarray] = lambda times: np.ones(len(times), bool),
    jitter: float = 0.0,
    times: int = 1,
) -> Session:
    """A session with some topics only, so many times in a row, and what was done to its clock."""
    source, rng = MemorySource("changed"), np.random.default_rng(0)
    for topic in topics:
        messages = list(session.messages(topic))
        stamps = np.array([one.publish_time for one in messages])
        length = int(stamps[-1] - stamps[0]) + 2_000_000_000
        for again in range(times):
            shift = (rng.uniform(-jitter, jitter, len(stamps)) * 1e9).astype(np.int64)
            moved = stamps + again * length + shift
            order = np.argsort(moved, kind="stable")
            kept = order[keep((stamps[order] - stamps[0]) / 1e9)]
            data = [messages[i].data for i in kept]
            source.write_batch(topic, data, moved[kept] + 100_000, moved[kept])
    source.add_metadata({"stream": session.metadata["stream"]})
    return g1stream.Session(source)


def played(motion: Motion) -> Session:
    """A session of a motion in the lockstep simulator."""
    return g1stream.rollout(motion, support="bolted")


def errors(cases: list[tuple[Session, Motion, int, float]]) -> dict[str, Any]:
    """How far start (ms) and speed (%) are off at most; sessions with where they should be."""
    starts, speeds, similar, found = [0.0], [0.0], [1.0], 0
    for session, motion, start_ns, speed in cases:
        try:
            attached = session.attach(motion)
        except RecordingError:
            continue
        info = attached.attached
        assert info
        found += 1
        reference = attached.reference
        first_frame = reference.published[0] - reference.motion_time[0] / info.speed * 1e9
        starts.append(abs(float(first_frame - start_ns)) / 1e6)
        speeds.append(abs(info.speed / speed - 1.0) * 100.0)
        similar.append(info.similarity)
    return {
        "found": f"{found} of {len(cases)}",
        "start_ms": round(max(starts), 3),
        "speed_percent": round(max(speeds), 4),
        "similarity": round(min(similar), 3),
    }


def held(motion: Motion, rate: int, *, repeated: bool) -> tuple[float, float]:
    """Errors of the start and of the delay, ms, with a robot that holds the targets of a motion."""
    trajectory, begins = Trajectory(motion), 3.0
    times = np.arange(0.0, motion.duration + 2.0 * begins, 0.002)

    def last_step(at: np.ndarray) -> np.ndarray:
        return np.asarray(np.floor(at * rate + 1e-6) / rate)

    sent, seen = times if repeated else np.unique(last_step(times)), last_step(times - RESPONSE)
    source = MemorySource("held")
    for topic, at, step in ((LOWCMD, sent, last_step(sent)), (LOWSTATE, times, seen)):
        q = trajectory.sample_joints((step - begins).clip(0.0))[0]
        fields = {"motor_cmd.q": q, "motor_cmd.kp": np.full(q.shape, 50.0)}
        if topic is LOWSTATE:
            fields = {"motor_state.q": q}
        stamps = EPOCH + np.round(at * 1e9).astype(np.int64)
        data = encode_samples(topic, fields, len(q))
        source.write_batch(topic.name.replace("rt", ""), data, stamps + 100_000, stamps)
    session = g1stream.Session(source).attach(motion)
    delay = session.tracking().delay
    assert delay
    start = (session.start_ns - EPOCH) / 1e9 - begins
    return 1e3 * abs(start), 1e3 * abs(delay.seconds - float(np.mean(times - seen)))


def write_long(path: Path, motion: Motion) -> None:
    """Ten minutes of commands and states, 500 a second, with the motion after a minute."""
    trajectory = Trajectory(motion)
    with SessionWriter(path) as writer:
        for start in np.arange(0.0, TEN_MINUTES, 1.0):
            times = start + np.arange(0.0, 1.0, 1.0 / 500.0)
            q = trajectory.sample_joints(times - 60.0)[0]
            stamps = EPOCH + np.round(times * 1e9).astype(np.int64)
            gains = np.full(q.shape, 50.0)
            for topic, fields in (
                (LOWCMD, {"motor_cmd.q": q, "motor_cmd.kp": gains}),
                (LOWSTATE, {"motor_state.q": q}),
            ):
                data = encode_samples(topic, fields, len(q))
                writer.write_batch(topic.name.replace("rt", ""), data, stamps, stamps)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("motions", nargs="*", default=["demo"])
    parser.add_argument("--clips", type=int, default=11)
    parser.add_argument("--seconds", type=float, default=12.0)
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()
    clips = clips_of(args.motions, args.clips, args.seconds)
    runs = [played(clip) for clip in clips]
    starts = [run.start_ns for run in runs]

    def all_of(change: Callable[[Session], Session]) -> dict[str, Any]:
        done = [change(run) for run in runs]
        return errors([(a, b, c, 1.0) for a, b, c in zip(done, clips, starts, strict=True)])

    def tenth(times: np.ndarray) -> np.ndarray:
        return np.asarray((times < 0.5 * times[-1]) | (times > 0.6 * times[-1]))

    found = {
        "by commands": all_of(changed),
        "by measured joints": all_of(lambda run: changed(run, [STATES])),
        "5 ms of jitter": all_of(lambda run: changed(run, jitter=5e-3)),
        "a tenth missing": all_of(lambda run: changed(run, keep=tenth)),
        "twice in a file": all_of(lambda run: changed(run, times=2)),
    }
    for speed in SPEEDS:
        # Slower and faster than the file says, within what the joints can do.
        sessions = [played(clip.at_speed(speed)) for clip in clips[:: max(1, len(clips) // 4)]]
        motions = clips[:: max(1, len(clips) // 4)]
        cases = [(changed(a), b, a.start_ns, speed) for a, b in zip(sessions, motions, strict=True)]
        found[f"at speed {speed:g}"] = errors(cases)
    parts = [g1stream.load_motion(args.motions[0]).trim(0.0, length) for length in HELD_LENGTHS]
    of_held = {
        f"{rate} Hz, {'500 times a second' if again else 'once'}": np.max(
            [held(part, rate, repeated=again) for part in parts], axis=0
        ).tolist()
        for rate in HELD_RATES
        for again in (False, True)
    }
    own, others = 0, 0
    for i, run in enumerate(runs):
        session = changed(run)
        for j, clip in enumerate(clips):
            try:
                session.attach(clip)
            except RecordingError:
                continue
            own, others = own + (i == j), others + (i != j)
    n = len(clips)
    pairs = {"own": f"{own} of {n}", "others": f"{others} of {n * (n - 1)}"}
    with tempfile.TemporaryDirectory() as directory:
        motion = g1stream.load_motion(args.motions[0])
        path = Path(directory, "long.mcap")
        write_long(path, motion)
        begun = time.perf_counter()
        session = g1stream.open_session(path)
        session.attach(motion)
        took = time.perf_counter() - begun
    cost = {"find_s": round(took, 2), "times_real_time": round(TEN_MINUTES / took)}
    if args.json:
        every = {"found": found, "held": of_held, "pairs": pairs, "cost": cost}
        print(json.dumps(every, indent=2))
        return
    print(f"{'':20}{'found':>12}{'start, ms':>12}{'speed, %':>12}{'similarity':>12}")
    for name, row in found.items():
        print(f"{name:20}" + "".join(f"{value:>12}" for value in row.values()))
    print(f"\n{'held targets':28}{'start, ms':>12}{'delay, ms':>12}")
    for name, (start, delay) in of_held.items():
        print(f"{name:28}{start:>12.3f}{delay:>12.3f}")
    print(f"\nsessions of the clip itself: {pairs['own']}; of another clip: {pairs['others']}")
    print(f"ten minutes: {cost['find_s']} s, {cost['times_real_time']} times real time")


if __name__ == "__main__":
    main()
