"""The faults: one row each, with what must be true of it.

A row is a way into damping, or a decision not to. Which fields and limits a check looks at, and
which files are refused, is for the tests of the check and of the file.
"""

from __future__ import annotations

import os
import shutil
import signal
from math import inf
from typing import TYPE_CHECKING, Any, Final

from engine import Fault, Session
from injections import (
    BROKEN,
    ELBOW,
    KNEE,
    WRIST,
    another_stream,
    cell,
    clock,
    close_terminal,
    constants,
    flags,
    hogs,
    network,
    no_guard_from_the_start,
    no_priority,
    on_terminal,
    replace_file,
    send,
    settings,
    small_disk,
    step_clock,
    stop,
    symlink,
    to_guard,
    to_receiver,
    to_recorder,
    twice,
    wide_urdf,
    writer,
)
from policies import plays

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

NAN: Final = float("nan")
AT: Final = 0.8
#: Longest time from a streamer's last command to the guard's first, ms.
HANDOVER: Final = 50.0


# What the robot does. The times are after the first stiff command: PLAY begins at 0.4 s.


def does(what: str, **more: Any) -> list[dict[str, Any]]:
    return [{"at": AT, "do": what, **more}]


def says(path: str, value: Any, **more: Any) -> list[dict[str, Any]]:
    return [{"at": AT, "set": {path: value}, **more}]


def from_start(fault: list[dict[str, Any]]) -> list[dict[str, Any]]:
    return [{**one, "at": -1.0} for one in fault]


def buttons(*bits: int) -> dict[str, Any]:
    """The bytes of `wireless_remote` with the buttons, counted from R1 = 0 to left = 15."""
    word = sum(1 << bit for bit in bits)
    return {"remote.0": 0x55, "remote.1": 0x51, "remote.2": word & 255, "remote.3": word >> 8}


L2, A, B = 5, 8, 9

STATES: Final = [
    Fault(
        "no LowState any more",
        "LowState",
        does("silent"),
        reason="safety.state_timeout",
        record="complete",
    ),
    Fault(
        "no LowState for 0.2 s on loopback",
        "LowState",
        does("silent", until=AT + 0.2),
        code=0,
        ends=False,
        record="complete",
    ),
    Fault("q is NaN in one state of 50", "LowState", says(f"motor.q.{KNEE}", NAN, every=50)),
    Fault("all LowStates are zero", "LowState", [{"do": "zeros"}], sent=False),
    Fault(
        "wrong CRC in every LowState",
        "LowState",
        does("bad_crc"),
        reason="wrong CRC",
        record="complete",
    ),
    Fault(
        "wrong CRC in a few LowStates",
        "LowState",
        does("bad_crc", until=AT + 0.02),
        code=0,
        ends=False,
    ),
    Fault(
        "wrong CRC and a knee of 100 rad from the start",
        "LowState",
        [{"set": {f"motor.q.{KNEE}": 100.0}, "do": "bad_crc", "until": 0.5}],
        code=1,
        sent=False,
    ),
    Fault(
        "knee of 100 rad from the start",
        "LowState",
        from_start(says(f"motor.q.{KNEE}", 100.0)),
        sent=False,
        reason="beyond its limits",
    ),
    Fault(
        "knee of 100 rad in one state of 50",
        "LowState",
        says(f"motor.q.{KNEE}", 100.0, every=50),
        reason="beyond its limits",
    ),
    Fault("no CRC any more", "LowState", does("no_crc"), reason="wrong CRC"),
    Fault(
        "no CRC at all",
        "LowState",
        from_start(does("no_crc")),
        code=0,
        ends=False,
        record="complete",
    ),
    Fault(
        "no LowState for 0.05 s, again and again",
        "LowState",
        [one for k in range(6) for one in does("silent", at=0.5 + k / 2, until=0.55 + k / 2)],
        code=0,
        ends=False,
        record="complete",
    ),
    Fault("content frozen", "LowState", does("frozen_content"), reason="LowState has not changed"),
    Fault(
        "content frozen from the start",
        "LowState",
        from_start(does("frozen_content")),
        reason="LowState has not changed",
        record="complete",
    ),
    Fault(
        "LowState at 5 Hz", "LowState", [{"do": "seldom"}], sent=False, reason="LowState arrives"
    ),
    Fault("simulator starts again", "LowState", does("restart"), reason="publisher"),
    Fault(
        "mode_machine of another robot",
        "LowState",
        from_start(says("mode_machine", 9)),
        reason="mode_machine",
        sent=False,
    ),
    Fault(
        "second publisher of LowState at 2 Hz from the start",
        "LowState",
        from_start(does("twin", every=125)),
        code=2,
        reason="rt/lowstate",
        sent=False,
    ),
    Fault(
        "second publisher of LowState at 2 Hz",
        "LowState",
        does("twin", every=125),
        reason="publisher",
    ),
    Fault("no robot", "LowState", [{"do": "silent"}], sent=False, reason="no LowState"),
    Fault(
        "publisher of LowCmd that poses as a guard from the start",
        "LowState",
        [{"do": "rogue", "announced": "g1stream.idle"}],
        code=2,
        sent=False,
        reason="rt/lowcmd",
    ),
    Fault(
        "publisher of LowCmd that poses as a guard",
        "LowState",
        does("rogue", announced="g1stream.idle"),
        reason="rt/lowcmd",
    ),
    Fault(
        "simulator ends",
        "LowState",
        act=lambda s: s.robot.mute(),
        reason="state_timeout",
        record="complete",
    ),
]

# The thresholds of a robot; on loopback it waits for a simulator that gets no CPU time.
JAM: Final = constants(jam_time=0.5, jam_motion=0.3)
ROBOT: Final = [
    Fault(
        "pelvis tilts in one state of 50",
        "robot",
        says("imu.quaternion", [0.825, 0, 0.565, 0], every=50),
        prepare=settings("[safety]\nmax_tilt = 1.0\n"),
        reason="safety.max_tilt",
    ),
    Fault(
        "pelvis is upside down from the start",
        "robot",
        from_start(says("imu.quaternion", [0, 1, 0, 0])),
        reason="upside down",
        sent=False,
    ),
    Fault(
        "one joint jams",
        "robot",
        does("jam", joint=ELBOW),
        prepare=JAM,
        reason="does not follow",
    ),
    Fault(
        "a wrist says 55 rad/s in one state of 50",
        "robot",
        says(f"motor.dq.{WRIST}", 55.0, every=50),
        reason="55.0 rad/s",
    ),
    Fault(
        "a joint leaps by 1 rad, again and again",
        "robot",
        [one for k in range(4) for one in does("leap", at=0.8 + k / 10, joint=KNEE, by=1.0)],
        reason="jumped by",
    ),
    Fault("one motor off", "robot", says(f"motor.mode.{KNEE}", 0), reason="left_knee_joint"),
    Fault(
        "motorstate bit for 0.02 s",
        "robot",
        says(f"motor.motorstate.{KNEE}", 4, until=AT + 0.02),
        code=0,
        ends=False,
    ),
    Fault(
        "winding at 150 C",
        "robot",
        says(f"motor.temperature.{KNEE}", [40, 150]),
        reason="the winding of",
    ),
    Fault(
        "torque of 300 N·m",
        "robot",
        says(f"motor.tau_est.{KNEE}", 300.0),
        reason="safety.max_torque",
    ),
    Fault(
        "stop button L2+B",
        "robot",
        [{"at": AT, "set": buttons(L2, B)}],
        reason="safety.stop_buttons",
    ),
    Fault(
        "starts 2 rad from the first frame",
        "robot",
        q=[0.0] * 15 + [-2.0] + [0.0] * 13,
        code=0,
        ends=False,
        record="complete",
    ),
]


DEADMAN: Final = [
    Fault(
        "deadman button is released",
        "robot",
        [{"until": AT, "set": buttons(A)}, {"at": AT, "set": buttons()}],
        prepare=flags("--deadman", "A"),
        reason="deadman",
    ),
    Fault(
        "deadman button is never pressed",
        "robot",
        [{"set": buttons()}],
        prepare=flags("--deadman", "A"),
        reason="deadman",
        sent=False,
    ),
]

# Arms and waist, while the robot stands by itself.


def _arms(name: str, robot: list[dict[str, Any]] | None = None, **more: Any) -> Fault:
    return Fault(f"arms: {name}", "arms", robot or (), arms=True, **more)


ARMS: Final = [
    _arms("the motion ends", code=0, ends=False, record="complete"),
    _arms("no LowState any more", [{"at": 2.5, "do": "silent"}], reason="state_timeout"),
    _arms("the elbow jams", does("jam", joint=ELBOW), prepare=JAM, reason="does not follow"),
    _arms("guard is killed", act=to_guard(signal.SIGKILL), reason="guard"),
    _arms(
        "commands can no longer be written",
        prepare=writer(BROKEN),
        reason="did not send a command in time",
        handover_ms=inf,
    ),
    _arms("second publisher of arm_sdk", does("rogue"), reason="rt/arm_sdk"),
    _arms(
        "another publisher of arm_sdk from the start",
        [{"do": "rogue"}],
        code=2,
        sent=False,
        reason="rt/arm_sdk",
    ),
    _arms("SIGINT", act=send(signal.SIGINT), code=130, reason="SIGINT", record="complete"),
    _arms("Ctrl-C twice in PLAY", act=twice, at=2.5, code=130, reason="SIGINT"),
    _arms(
        "SIGSTOP and continued after 1 s",
        act=stop(1.0),
        at=2.5,
        reason="hands arms and waist back: this process was stopped",
        handover_ms=HANDOVER,
        alone=True,
    ),
    *(
        _arms(
            name,
            act=act,
            at=2.5,
            code=-9,
            mute=True,
            handover_ms=HANDOVER,
            alone=True,
            reason="guard",
            record="complete",
        )
        for name, act in (
            ("SIGKILL", send(signal.SIGKILL)),
            ("SIGSTOP and never continued", stop(3.0, then=signal.SIGKILL)),
        )
    ),
]

# Motions and files.


def _refused(name: str, prepare: Callable[[Session], Sequence[str]], **more: Any) -> Fault:
    return Fault(name, "input", prepare=prepare, code=2, sent=False, **more)


INPUTS: Final = [
    _refused("URDF with wider limits", wide_urdf, reason="left_knee_joint"),
    _refused("spike of 2.4 rad", cell("2.4"), reason="left_knee_joint"),
    _refused("state_timeout of an hour", settings("[safety]\nstate_timeout = 3600.0\n")),
    _refused("unknown interface", flags("--interface", "nowhere0"), reason="nowhere0"),
    _refused("file to record is a symbolic link", symlink, record="any"),
    _refused("file to record is in /proc", lambda s: ["--record", "/proc/x.mcap"]),
]

# Played all the same, within the limits.
ANYWAY: Final = [
    Fault(
        "spike of 2.4 rad with --clamp",
        "input",
        prepare=cell("2.4", "--clamp"),
        code=0,
        ends=False,
    )
]

# Signals and the process.


def ends_by(number: signal.Signals) -> Fault:
    name, code = number.name, 128 + number
    return Fault(name, "signals", act=send(number), code=code, reason=name, record="complete")


SIGNALS: Final = [
    # One handler is of all that can be handled: tests/cli/test_command.py has the others.
    *map(ends_by, (signal.SIGINT, signal.SIGTERM, signal.SIGTSTP)),
    Fault("Ctrl-C twice", "signals", act=twice, code=130, record="complete"),
    Fault("Ctrl-C in RAMP", "signals", act=send(signal.SIGINT), at=0.0, code=130, reason="SIGINT"),
    Fault(
        "Ctrl-C before there is a robot",
        "signals",
        [{"do": "silent"}],
        act=send(signal.SIGINT),
        code=130,
        sent=False,
        record="complete",
    ),
    Fault(
        "terminal is closed",
        "signals",
        reason="SIGHUP",
        mute=True,
        prepare=on_terminal,
        act=close_terminal,
        code=129,
        record="complete",
    ),
    *(
        Fault(
            name,
            "process",
            act=act,
            code=code,
            reason="guard",
            mute=True,
            handover_ms=HANDOVER,
            alone=True,
            record="complete",
        )
        for name, act, code in (
            ("SIGKILL", send(signal.SIGKILL), -9),
            ("SIGSTOP and never continued", stop(1.5, then=signal.SIGKILL), -9),
        )
    ),
    Fault(
        "SIGKILL in RAMP",
        "process",
        act=send(signal.SIGKILL),
        at=0.0,
        code=-9,
        mute=True,
        handover_ms=HANDOVER,
        alone=True,
    ),
    Fault(
        "SIGSTOP and continued after 1 s",
        "process",
        act=stop(1.0),
        reason="was stopped",
        handover_ms=HANDOVER,
        alone=True,
        record="complete",
    ),
    Fault(
        "SIGSTOP for 0.3 s without a guard",
        "process",
        prepare=settings("[safety]\nguard = false\n"),
        act=stop(0.3),  # less than a state_timeout of loopback
        code=(0, 1),
        ends=False,
        record="complete",
    ),
    *(
        Fault(
            name,
            "process",
            act=to_guard(number),
            reason="guard",
            record="complete",
        )
        for name, number in (
            ("guard is killed", signal.SIGKILL),
            ("guard is stopped", signal.SIGSTOP),
        )
    ),
    Fault(
        "guard is killed while it starts",
        "process",
        prepare=no_guard_from_the_start,
        code=(1, 2),
        sent=False,
        reason="guard",
    ),
    Fault(
        "commands can no longer be written",
        "process",
        prepare=writer(BROKEN),
        reason="did not send a command in time",
        handover_ms=inf,
        record="complete",
    ),
    Fault(
        "another stream is started",
        "process",
        act=another_stream,
        prepare=flags("--repeat", "3"),  # a second one may take seconds to start
        at=0.0,
        code=0,
        ends=False,
        record="complete",
    ),
]

# The recorder.


def _recorder(name: str, act: Callable[[Session], None], **more: Any) -> Fault:
    return Fault(name, "recorder", act=act, **{"ends": False, "record": "any", **more})


RECORDER: Final = [
    _recorder("SIGTERM to the recorder", to_recorder(signal.SIGTERM), reason="SIGTERM"),
    _recorder("recorder is killed", to_recorder(signal.SIGKILL), reason="SIGKILL"),
    _recorder("recorder is stopped", to_recorder(signal.SIGSTOP), reason="record"),
    _recorder("recorder's receiver is killed", to_receiver(signal.SIGKILL), reason="SIGKILL"),
    _recorder("SIGTERM to the recorder's receiver", to_receiver(signal.SIGTERM), reason="receiver"),
    _recorder("recorder's receiver is stopped", to_receiver(signal.SIGSTOP), reason="is stopped"),
    _recorder("file is deleted", lambda s: s.path.unlink(), reason="session.mcap"),
    _recorder("file is replaced", replace_file, reason="session.mcap"),
    _recorder(
        "disk is full",
        lambda s: None,
        prepare=small_disk,
        reason="space",
        impossible="mounting a small file system needs root" if os.geteuid() else "",
    ),
    _recorder(
        "recorder is killed with --require-record",
        to_recorder(signal.SIGKILL),
        prepare=flags("--require-record"),
        ends=True,
        reason="the recording failed",
    ),
]

# The machine.


NO_GCC: Final = "" if shutil.which("gcc") else "a wall clock that steps needs gcc"
NO_NETWORK: Final = (
    "" if shutil.which("ip") and not os.geteuid() else "a network of its own needs root and ip"
)
ARMED: Final = network("--arm", "--yes", "eth0")
LOAD: Final = [
    Fault(
        "CPU is taken away",
        "machine",
        prepare=no_priority(),
        act=hogs,
        code=(0, 1),
        alone=True,
        handover_ms=inf,
        record="complete",
    ),
    Fault(
        "CPU is taken away on a robot's interface",
        "machine",
        prepare=no_priority(ARMED),
        act=hogs,
        alone=True,
        handover_ms=HANDOVER,
        impossible=NO_NETWORK,
    ),
    Fault(
        "writes block for 0.3 s on a robot's interface",
        "machine",
        prepare=writer("time.sleep(0.3)", ARMED),
        reason="did not send a command in time",
        alone=True,
        handover_ms=HANDOVER,
        record="complete",
        impossible=NO_NETWORK,
    ),
    Fault(
        "writes block for 3 s",
        "machine",
        prepare=writer("time.sleep(3.0)"),
        reason="did not send a command in time",
        handover_ms=inf,
        record="complete",
    ),
    Fault(
        "wall clock steps forward by an hour",
        "machine",
        prepare=clock(3600),
        act=step_clock,
        code=0,
        ends=False,
        record="complete",
        impossible=NO_GCC,
    ),
    Fault(
        "wall clock steps back by an hour",
        "machine",
        prepare=clock(-3600),
        act=step_clock,
        code=0,
        ends=False,
        record="complete",
        impossible=NO_GCC,
    ),
]

ARMING: Final = [
    Fault(name, "arming", prepare=network(*words), impossible=NO_NETWORK, **more)
    for name, words, more in (
        ("not armed", (), {"code": 2, "sent": False, "reason": "--arm"}),
        ("armed, and nobody to confirm", ("--arm",), {"code": 2, "sent": False}),
        (
            "armed",
            ("--arm", "--yes", "eth0"),
            {"code": (0, 1), "soft": True, "record": "complete"},
        ),
        (
            "armed, with --anyway",
            ("--arm", "--yes", "eth0", "--anyway"),
            {"code": 2, "sent": False, "reason": "anyway"},
        ),
        ("armed for another interface", ("--arm", "--yes", "lo"), {"code": 2, "sent": False}),
    )
]

# A learned policy. PLAY begins within 1.5 s, once the robot's torques look as if it stood.

IN_PLAY: Final = 2.0


def turns(until: float = inf) -> list[dict[str, Any]]:
    return [{"at": IN_PLAY, "until": until, "set": {"imu.gyroscope.2": 5.0}}]


POLICY: Final = [
    Fault(
        "a policy that falls in the rehearsal",
        "policy",
        prepare=plays("stands", "--rehearse", "2"),
        code=2,
        sent=False,
        reason="simulator",
    ),
    *(
        Fault(name, "policy", robot, prepare=plays(what), at=IN_PLAY, record="complete", **more)
        for name, what, robot, more in (
            ("actions are NaN", "nan", turns(), {"reason": "not finite"}),
            (
                "an action or two are NaN",
                "nan",
                turns(IN_PLAY + 0.02),  # one step of the policy, two if the robot is late
                {"code": 0, "ends": False},
            ),
            ("actions take too long", "slow", turns(), {"alone": True, "handover_ms": inf}),
            (
                "a policy, and no LowState any more",
                "stands",
                [{"at": IN_PLAY, "do": "silent"}],
                {"reason": "safety.state_timeout"},
            ),
            (
                "Ctrl-C while a policy plays",
                "stands",
                (),
                {"act": send(signal.SIGINT), "code": 130, "reason": "SIGINT"},
            ),
            (
                "SIGSTOP while a policy plays",
                "stands",
                (),
                {
                    "act": stop(1.5, then=signal.SIGKILL),
                    "code": -9,
                    "reason": "guard",
                    "mute": True,
                    "handover_ms": HANDOVER,
                    "alone": True,
                },
            ),
        )
    ),
]
FAULTS: Final = [
    *(*STATES, *ROBOT, *DEADMAN, *ARMS),
    *(*INPUTS, *ANYWAY, *SIGNALS, *RECORDER, *LOAD, *ARMING, *POLICY),
]
