"""The load of the recorder's benchmark: a robot and a streamer that do nothing but publish.

Publishes LowCmd, LowState and Reference at the same rate and prints, as one JSON line, how many of
each and the digest of all their bytes in order. A recording is exact when its own agree.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import signal
import time
from contextlib import ExitStack

import numpy as np

from g1stream.clock import SystemClock
from g1stream.config import RealtimeConfig
from g1stream.dds.domain import Participant
from g1stream.dds.endpoints import RawWriter
from g1stream.dds.messages import LOWCMD, LOWSTATE, REFERENCE, LowCmd, LowState, Reference
from g1stream.realtime import on_time

TABLE = 4096
PERCENTILES = (50, 99, 99.9)
MATCH_WITHIN = 15_000_000_000


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--domain", type=int, required=True)
    parser.add_argument("--rate", type=float, default=1000.0)
    parser.add_argument("--seconds", type=float, default=10.0)
    arguments = parser.parse_args()
    stopped: list[int] = []
    signal.signal(signal.SIGTERM, lambda number, _: stopped.append(number))
    command, state, reference = LowCmd(), LowState(), Reference()
    command.motor_mode, state.motor_mode = 1, 1
    command.kp[:], command.kd[:] = 60.0, 1.0
    reference.root_quat_wxyz[0] = state.quaternion[0] = 1.0
    clock, period = SystemClock(), round(1e9 / arguments.rate)
    # Noise in the low digits, as encoders have it: constants would compress to nothing.
    noise = np.random.default_rng(5).normal(0.0, 1e-4, (TABLE, 29))
    with Participant(arguments.domain, "lo") as participant, ExitStack() as stack:
        writers = [RawWriter(participant, topic, 64) for topic in (LOWCMD, LOWSTATE, REFERENCE)]
        digests = [hashlib.sha256() for _ in writers]
        patience = clock.now() + MATCH_WITHIN
        while not all(writer.matched for writer in writers):
            if clock.now() > patience:
                raise SystemExit("nobody records")
            time.sleep(0.01)
        time.sleep(0.5)
        # As a loop on a robot: else the delays are those of this process.
        stack.enter_context(on_time(RealtimeConfig().priority))
        start, tick, behind = clock.now(), 0, 0
        written = []  # from the stamp until the last sample was written, ns
        while tick * period < arguments.seconds * 1e9 and not stopped:
            clock.sleep_until(start + tick * period)
            behind = max(behind, clock.now() - start - tick * period)
            wave = np.sin(0.003 * tick + np.arange(29)) * 0.5
            row = noise[tick % TABLE]
            reference.tick[()] = state.tick[()] = tick
            reference.q[:] = command.q[:] = wave
            reference.dq[:] = command.dq[:] = 3.0 * wave
            state.q[:], state.dq[:], state.tau_est[:] = wave + row, 3.0 * wave + row, 1e3 * row
            stamp = clock.stamp()
            samples = (command.seal(), state.seal(), reference.tobytes())
            for writer, data in zip(writers, samples, strict=True):
                writer.write(data, stamp)
            written.append(clock.stamp() - stamp)
            for digest, data in zip(digests, samples, strict=True):
                digest.update(data)
            tick += 1
        time.sleep(0.5)
    elapsed = (clock.now() - start) / 1e9 - 0.5
    print(
        json.dumps(
            {
                "sent": tick,
                "rate_hz": tick / elapsed,
                "worst_lateness_s": behind / 1e9,
                "written_us": [float(p) / 1e3 for p in np.percentile(written, PERCENTILES)],
                "dropped": sum(writer.dropped for writer in writers),
                "sha256": {
                    topic: digest.hexdigest()
                    for topic, digest in zip(
                        ("/lowcmd", "/lowstate", "/reference"), digests, strict=True
                    )
                },
            }
        )
    )


if __name__ == "__main__":
    main()
