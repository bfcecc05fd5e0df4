"""`--support feet` and `--policy` over DDS: how long the robot stands there, and how closely.

    python benchmarks/feet_peers.py [--motion demo] [--seconds 14] [--runs 3] [--simulator Python]
    python benchmarks/feet_peers.py --policy policy.onnx --motion dance.csv --seconds 132

Every run has a simulator of its own: Unitree's two, and `g1stream sim --support free`. In Unitree's
the robot hangs from the elastic band. Once RAMP waits, key 8 lengthens the band until PLAY begins,
and key 9 lets go a second later; with a policy, which stands for 15 s first, after ten more presses
of key 8. A run has stood for as long as PLAY went on and the pelvis was above 0.3 m. RMSE is over
all joints and PLAY.

tracking_peers.py says how the simulators are found. `--motion squat`, `shift`, `steps` and `turns`
are the squats, weight shifts, steps forward and back, and turns of feet.py; for the upper body
alone add `-- --joints arms,waist`.
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np

from feet import FALLEN, striding, swaying
from g1stream.app.session import Session, open_session
from g1stream.extras.physics.example_motions import squatting
from g1stream.types import Phase
from tracking_peers import PEERS, SIMULATORS, missing, running

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from g1stream.motion.motion import Motion

BRIDGE: Final = "g1stream"
#: The Python simulator takes each command in Python, and queues those for which it has no time.
FLAGS: Final = {"C++": [], "Python": ["--rate", "200"], BRIDGE: []}
#: Motions that are made, by name.
MADE: Final[dict[str, Callable[[float], Motion]]] = {
    "squat": squatting,
    "shift": swaying,
    "steps": lambda seconds: striding(seconds, (0.12, 0.0, 0.0)),
    "turns": lambda seconds: striding(seconds, (0.0, 0.0, 0.4)),
}
#: Presses of key 8, s apart, and the most of them.
_PRESS: Final = 0.5
_PRESSES: Final = 60
_LET_GO: Final = 1.0  # s after PLAY began
#: With a policy: presses of key 8 in PLAY, and flags that let it stand until the band has let go.
_POLICY_PRESSES: Final = 10
_STANDING: Final = ("--stand", "15")
#: What a run takes beside the motion at most, s.
_MARGIN: Final = 180.0


@contextmanager
def simulating(name: str, lowered: int, flags: list[str]) -> Iterator[None]:
    """A simulator while it runs; the band of Unitree's is lowered, ours has more flags."""
    if name != BRIDGE:
        with running(SIMULATORS[name]):
            for _ in range(lowered):
                press(name, 8)
            yield
        return
    command = [sys.executable, "-m", "g1stream", "sim", "--support", "free", *flags]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as bridge:
        try:
            yield
            if bridge.poll() is not None:
                raise RuntimeError("g1stream sim ended by itself")
        finally:
            bridge.terminate()


def press(name: str, key: int) -> None:
    """Press a key in the window of a simulator."""
    subprocess.run([PEERS / "keys", SIMULATORS[name].removesuffix("sim"), str(key)], check=True)


def play(
    name: str, motion: str, seconds: float, policy: str | None, flags: list[str], path: Path
) -> str:
    """Play a motion in a running simulator into a session file; why the run ended, if early."""
    last = ""

    def follow() -> None:
        nonlocal last
        for line in stream.stderr or ():
            last = line.strip() or last
            for event, words in ((waits, "RAMP waits"), (plays, "RAMP -> PLAY")):
                if words in line:
                    event.set()

    waits, plays = threading.Event(), threading.Event()
    how = ["--policy", policy, *_STANDING] if policy else ["--support", "feet"]
    command = [sys.executable, "-m", "g1stream", "stream", motion, *how, "--json"]
    command += ["--duration", str(seconds), "--record", str(path), *FLAGS[name], *flags]
    stop = time.monotonic() + seconds + _MARGIN
    with (
        tempfile.TemporaryFile("w+") as printed,
        subprocess.Popen(
            command if name == BRIDGE else [PEERS / "ns", *command],
            stdout=printed,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
        ) as stream,
    ):
        reader = threading.Thread(target=follow)
        reader.start()
        try:
            if name != BRIDGE:
                waits.wait(_MARGIN)
                for _ in range(_PRESSES):
                    if plays.wait(_PRESS) or stream.poll() is not None:
                        break
                    press(name, 8)
                if plays.is_set():
                    for _ in range(_POLICY_PRESSES if policy else 0):
                        press(name, 8)
                    time.sleep(_LET_GO)
                    press(name, 9)
            stream.wait(max(0.0, stop - time.monotonic()))
        except subprocess.TimeoutExpired:
            return "did not end"
        finally:
            if stream.poll() is None:
                os.killpg(stream.pid, signal.SIGKILL)  # with what it started
            reader.join()
        printed.seek(0)
        text = printed.read()
    reason: str = json.loads(text)["termination"]["reason"] if text else last
    return reason


def stood(session: Session) -> float:
    """For how long the robot stood in PLAY, s."""
    playing = next((phase for phase in session.phases if phase.phase is Phase.PLAY), None)
    base = session.base
    if playing is None or base is None:
        return 0.0
    times = base.time
    fell = np.flatnonzero((base.position[:, 2] < FALLEN) & (times > playing.start_s))
    end = min(playing.end_s, float(times[fell[0]])) if len(fell) else playing.end_s
    return end - playing.start_s


def of_policy(session: Session) -> str:
    """Success by SONIC's criterion, MPJPE, delay, inference and pace."""
    found, stream = session.metrics(), session.summary().stream
    success, body, timing = found.success, found.body, found.timing
    told = [f"SONIC {success.success_sonic if success else None}"]
    if body and body.root_relative:
        told.append(f"MPJPE {body.root_relative.mpjpe_mm:.1f} mm from the root")
    if timing and timing.state_to_command_p99_s:
        told.append(f"delay p99 {1e3 * timing.state_to_command_p99_s:.1f} ms")
    if session.policy:
        inference = 1e6 * np.percentile(session.policy.inference_time, 99)
        told.append(f"inference p99 {inference:.0f} us")
    if stream and stream.lateness_us:
        told.append(f"lateness p99 {stream.lateness_us.p99:.0f} us")
    if stream and stream.time_scale and stream.waited_s is not None:
        told.append(f"at {stream.time_scale:.2f} of real time, waited {stream.waited_s:.2f} s")
    if success and success.spoilt_by_ms:
        told.append(f"void: spoilt by {success.spoilt_by_ms:.0f} ms")
    return ", ".join(told)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--motion", default="demo", help="file, demo, squat, shift, steps or turns")
    parser.add_argument("--policy", help="file of a learned policy")
    parser.add_argument("--seconds", type=float, default=14.0)
    parser.add_argument("--runs", type=int, default=3)
    parser.add_argument("--simulator", choices=FLAGS, help="only this one")
    parser.add_argument("--lowered", type=int, default=0, help="presses of 8 before the stream")
    parser.add_argument("--sim", default="", help="more flags of g1stream sim, in one word")
    parser.add_argument("--keep", type=Path, help="a folder for the sessions")
    parser.add_argument("flags", nargs="*", help="more flags of g1stream stream, after --")
    args = parser.parse_args()
    if args.simulator != BRIDGE and (absent := missing("keys")):
        parser.error(absent)
    if args.keep:
        args.keep.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as directory:
        folder, motion = args.keep or Path(directory), args.motion
        if make := MADE.get(motion):
            motion = str(Path(directory, f"{motion}.npz"))
            make(args.seconds).save(motion)
        for name in [args.simulator] if args.simulator else FLAGS:
            for number in range(args.runs):
                path = folder / f"feet-{name}-{Path(args.motion).stem}-{number}.mcap"
                if path.exists():
                    parser.error(f"{path} exists already; keep the sessions in another folder")
                with simulating(name, args.lowered, args.sim.split()):
                    reason = play(name, motion, args.seconds, args.policy, args.flags, path)
                session = open_session(path) if path.exists() else None
                time_stood = stood(session) if session else 0.0
                rmse = session.tracking().overall if session and time_stood else np.nan
                line = f"{name:8s} {args.motion}: stood {time_stood:5.1f} s, RMSE {rmse:.4f} rad"
                if session and time_stood and args.policy:
                    line += f", {of_policy(session)}"
                print(line, reason, flush=True)


if __name__ == "__main__":
    main()
