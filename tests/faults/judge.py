"""What the motors received, how the program ended and what its file says: is it as it must be?"""

from __future__ import annotations

from dataclasses import dataclass, field
from math import inf
from typing import TYPE_CHECKING, Any, Final

import numpy as np
import unitree_hg
from g1 import ARMS, EFFORT, LOWER, UPPER, VELOCITY, WEIGHT
from mcap.exceptions import McapError
from mcap.reader import NonSeekingReader, make_reader

if TYPE_CHECKING:
    from pathlib import Path

    from engine import Fault

#: Commands per second, and how long the motion is, s.
RATE: Final = 200
LENGTH: Final = 3.75
#: In the reserved words of the commands of robot.py's own publisher.
ROGUE: Final = 0xBEEF


@dataclass
class Outcome:
    """What became of a fault.

    Attributes:
        code: exit code of the command.
        said: all that the command printed.
        commands: received by the robot, from whatever publisher of g1stream.
        worst_step: between two commands, rad.
        worst_dq: rad/s.
        worst_torque: of kp (q - measured) + kd (dq - measured) + tau, as a share of the effort.
        silence_ms: longest time between two commands, less what the robot's process lost itself.
        handover_ms: from the last command of the first publisher to the first of the next one, less
        what the robot's process lost meanwhile: a machine that stalls delays the guard as well.
        ending: what the last command is: damped, handed back, stiff or none.
        file: complete, cut, unreadable or none.
        wrong: what must not be.
    """

    fault: Fault
    code: int = 0
    said: str = ""
    commands: int = 0
    worst_step: float = 0.0
    worst_dq: float = 0.0
    worst_torque: float = 0.0
    silence_ms: float = 0.0
    handover_ms: float | None = None
    ending: str = "none"
    file: str = "none"
    wrong: list[str] = field(default_factory=list)


def judge(outcome: Outcome, record: dict[str, Any], path: Path) -> None:
    """Fill in what the robot's record and the session file say, and what is wrong with it."""
    received = [one.tobytes() for one in record["command"]]
    ours = _structs(record)["reserve"][:, 0] != ROGUE
    record |= {name: record[name][ours] for name in record if name not in ("pauses", "wall")}
    if ours.any():
        _measure(outcome, record)
    if path.exists():
        _read(outcome, path, {one.tobytes() for one in record["command"]}, set(received))
    _compare(outcome)


def _structs(record: dict[str, Any]) -> Any:
    """The commands as C structs (N,); copied as bytes only, because numpy leaves padding behind."""
    return np.ascontiguousarray(record["command"]).view(unitree_hg.CMD)[:, 0]


def _measure(outcome: Outcome, record: dict[str, Any]) -> None:
    command, received = _structs(record), record["received"]
    arms = outcome.fault.arms
    motor = command["motor"][:, :29]
    kp, kd, q, dq, tau = (motor[name].astype(float) for name in ("kp", "kd", "q", "dq", "tau"))
    stiff = (kp > 0).any(axis=1)
    on = np.zeros(29, bool)
    on[ARMS if arms else slice(None)] = True
    share = command["motor"]["q"][:, WEIGHT, None] if arms else 1.0
    torque = np.full(q.shape, inf)
    for age in range(OLDEST + 1):
        measured = (np.vstack([x[:1]] * age + [x])[: len(x)] for x in (record["q"], record["dq"]))
        position, velocity = measured
        asked = share * np.abs(kp * (q - position) + kd * (dq - velocity) + tau) / EFFORT
        torque = np.minimum(torque, asked)
    torque[_in_a_pause(record)] = 0.0
    step = np.abs(np.diff(q, axis=0))
    outcome.commands = len(command)
    outcome.worst_dq = float(np.abs(dq).max())
    outcome.worst_torque = float(torque[stiff].max(initial=0.0))
    outcome.worst_step = float(step.max(initial=0.0))
    # Two ticks are a period apart, also where one was late; after a stall no target may leap.
    elapsed = np.clip(np.diff(record["published"]) / 1e9, 1.0 / RATE, CATCH_UP)
    possible = 1.01 * VELOCITY * elapsed[:, None] + 1e-3
    beyond = np.maximum(LOWER - q, q - UPPER)[stiff].max(initial=0.0)
    crcs = [unitree_hg.crc_of(one.tobytes()) for one in record["command"]]
    rules = {
        "a command is not finite": not np.isfinite([q, dq, tau, kp, kd]).all(),
        "a command has a wrong CRC": crcs != command["crc"].tolist(),
        "a command has a wrong mode": command["mode_pr"].any() or (motor["mode"] != on).any(),
        "a joint that is not commanded": any(values[:, ~on].any() for values in (kp, kd, tau)),
        f"a step of {outcome.worst_step:.3g} rad": (step > possible)[stiff[1:]].any(),
        f"dq of {outcome.worst_dq:.3g} rad/s": (np.abs(dq) > VELOCITY * 1.005).any(),
        f"{outcome.worst_torque:.2f} of a joint's torque": outcome.worst_torque > TORQUE,
        f"a target {beyond:.2f} rad beyond a joint's limits": beyond > BEYOND,
    }
    outcome.wrong += [what for what, broken in rules.items() if broken]
    _pauses(outcome, record)
    if arms:
        _weigh(outcome, command, record)
        return
    limp = ~stiff & (kd > 0).all(axis=1) & ~tau.any(axis=1) & ~dq.any(axis=1)
    outcome.ending = "damped" if limp[-1] else "stiff"
    if outcome.fault.soft and not limp[0]:
        outcome.wrong.append("the first command is stiff")
    if limp[-1]:
        first = int(np.argmax(stiff))  # it may begin damped; 0 where no command is stiff
        damped = first + int(np.argmax(limp[first:]))
        published = record["published"]
        if stiff[damped:].any():
            outcome.wrong.append("stiff again after damping had begun")
        if not (limp | stiff)[damped:].all():
            outcome.wrong.append("neither stiff nor damping")
        # Received later than published, all at once, where this machine stalled the robot.
        length = max(times[-1] - times[damped] for times in (received, published)) / 1e9
        if length < DAMPED:
            outcome.wrong.append(f"damped for {length:.2f} s only")


def _weigh(outcome: Outcome, command: Any, record: dict[str, Any]) -> None:
    """Whether arms and waist are taken over and handed back slowly, and rest meanwhile."""
    motor, times = command["motor"], record["published"]
    weight, kp = motor["q"][:, WEIGHT], motor["kp"][:, ARMS]
    highest = int(np.flatnonzero(weight == weight.max())[-1])
    falling = motor["q"][highest + 1 :, ARMS]
    outcome.ending = "stiff" if weight[-1] or not (kp > 0.0).all() else "handed back"
    step = np.abs(np.diff(weight, prepend=0.0)).max()
    length = (times[-1] - times[highest]) / 1e9
    rules = {
        f"a step of the weight by {step:.3f}": step > WEIGHT_STEP,
        "the weight rises again": (np.diff(weight[highest:]) > 0.0).any(),
        f"handed back in {length:.2f} s only": length < SHARE * WEIGHT_TIME * weight.max(),
        "arms or waist move while they are handed back": np.ptp(falling, axis=0).any(),
    }
    outcome.wrong += [what for what, broken in rules.items() if broken]


#: The weight goes from 0 to 1 in this time, s; less of it in a step than in 1.01 periods, and
#: in most of the time that it should take, however late commands are.
WEIGHT_TIME: Final = 2.0
WEIGHT_STEP: Final = 1.01 / RATE / WEIGHT_TIME
SHARE: Final = 0.9
#: Share of a joint's effort, with the state that is the mildest of those not older than so many
#: commands: which one was known where the command was made is not known here.
TORQUE: Final = 1.05
OLDEST: Final = 2
#: What of the time between two commands a target may move in, s.
CATCH_UP: Final = 0.02
#: How far a robot may stand outside its limits and be moved inside, rad.
BEYOND: Final = 0.1
#: Silence after which the guard takes over in any case, ms: it may be late itself.
SILENCE: Final = 1500.0
#: Least length of damping, s; `stream.damp` is 0.5.
DAMPED: Final = 0.4


#: A pause of the robot's process after which its state is not that of its commands, and the time
#: until commands are made with a state after it, ns.
_LONG, _SETTLED = 8_000_000, 20_000_000


def _in_a_pause(record: dict[str, Any]) -> Any:
    """(N,) commands that come when the robot's process was not scheduled, perhaps all at once.

    The state that it has then is neither that of the time for which they were made, nor known to
    who made them.
    """
    received, paused = record["received"], np.zeros(len(record["received"]), bool)
    for begin, end in record["pauses"]:
        if end - begin > _LONG:
            paused |= (received >= begin) & (received <= end + _SETTLED)
    return paused


def _gaps(times: Any, pauses: Any) -> Any:
    """(N-1,) ns between times (N,), less the pauses (M, 2) of the robot's process."""
    since, until = times[:-1], times[1:]
    gaps = until - since
    for begin, end in pauses:
        gaps = gaps - np.maximum(0, np.minimum(until, end) - np.maximum(since, begin))
    return gaps


def _pauses(outcome: Outcome, record: dict[str, Any]) -> None:
    """The longest time without a command, and that until another publisher took over."""
    gaps = _gaps(record["received"], record["pauses"])
    outcome.silence_ms = float(gaps.max(initial=0)) / 1e6
    changes = np.flatnonzero(np.diff(record["writer"]))
    if len(changes):
        # The robot may receive late. The stream's stamp is from before its write.
        published = _gaps(record["published"], record["pauses"] + record["wall"])
        outcome.handover_ms = float(min(gaps[changes[0]], published[changes[0]])) / 1e6


def _read(outcome: Outcome, path: Path, sent: set[bytes], received: set[bytes]) -> None:
    """Compare the session file, read with the official reader, with what the robot received.

    Args:
        outcome: gets what is found.
        path: of the file.
        sent: the commands that g1stream sent.
        received: those of other publishers too.
    """
    fault = outcome.fault
    recorded, log = set(), []
    with path.open("rb") as file:
        try:
            summary = make_reader(file).get_summary()
            outcome.file = "complete" if summary and summary.statistics else "cut"
        except (McapError, EOFError):
            outcome.file = "cut"
        file.seek(0)
        try:
            for _, channel, message in NonSeekingReader(file).iter_messages(log_time_order=False):
                if channel.topic == ("/arm_sdk" if fault.arms else "/lowcmd"):
                    recorded.add(unitree_hg.cmd_of(message.data))
                elif channel.topic == "/log":
                    log.append(message.data)
        except (McapError, EOFError) as error:
            if outcome.file == "complete":
                outcome.wrong.append(f"the official reader cannot read the file: {error}")
            elif not recorded:
                outcome.file = "unreadable"
    if recorded - received:
        outcome.wrong.append("the file has commands that were not sent")
    if fault.record == "complete" and fault.sent:
        missing = len(sent - recorded)
        if missing:
            outcome.wrong.append(f"{missing} of {len(sent)} commands are not in the file")
        if fault.ends and fault.reason.encode() not in b"\n".join(log):
            outcome.wrong.append(f"{fault.reason!r} is not in the file")


def _compare(outcome: Outcome) -> None:
    """With what the row of the table asks for."""
    fault, handover = outcome.fault, outcome.handover_ms
    codes = fault.code if isinstance(fault.code, tuple) else (fault.code,)
    played = outcome.commands / RATE
    ending = "handed back" if fault.arms else "damped"
    longest = LENGTH + (2 * WEIGHT_TIME + 0.5 if fault.arms else 1.7)
    allowed = fault.handover_ms
    rules = {
        f"exit code {outcome.code}, not {' or '.join(map(str, codes))}": outcome.code not in codes,
        f"{fault.reason!r} is not told": fault.reason not in outcome.said and not fault.mute,
        "a traceback": "Traceback" in outcome.said,
        f"the last command is {outcome.ending}": fault.sent and outcome.ending != ending,
        f"{outcome.commands} commands were sent": not fault.sent and outcome.commands,
        f"the file is {outcome.file}": fault.sent
        and fault.record in ("complete", "cut")
        and outcome.file != fault.record,
        "the guard took over": allowed is None and handover is not None,
        "nobody took over": allowed is not None
        and handover is None
        and outcome.silence_ms > min(allowed, SILENCE),
        f"{handover} ms until the guard damped": (handover or 0.0) > (allowed or inf),
        f"played for {played:.1f} s only": fault.sent and not fault.ends and played < LENGTH,
        f"played on for {played:.1f} s": fault.sent and fault.ends and played > longest,
    }
    outcome.wrong += [what for what, broken in rules.items() if broken]
