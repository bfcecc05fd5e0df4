import numpy as np

from g1stream.control.receiver import Receiver
from g1stream.dds.messages import LowCmd


def test_the_guard_damps_the_motors_where_the_last_command_was():
    """For 0.5 s; the slots of absent motors stay zero."""
    last, damping = LowCmd(), LowCmd()
    last.motor_mode, last.mode_machine[()] = np.arange(29) % 7 > 0, 5
    last.q[:] = q = np.linspace(-1, 1, 29)
    last.dq[:], last.tau[:], last.kp[:], last.kd[:] = 1.0, 2.0, 100.0, 4.0
    commands = list(Receiver(2_000_000, 0.5).end(last))
    assert len(commands) == 251
    assert len({*commands}) == 1
    damping.load(commands[0])
    assert damping.crc_matches()
    assert damping.q.tolist() == q.astype(np.float32).tolist()
    assert np.array_equal((damping.kp, damping.dq, damping.tau), np.zeros((3, 29)))
    assert damping.kd.tolist() == [3.0 if i % 7 else 0.0 for i in range(29)]
    assert damping.motor_mode.tolist() == [int(i % 7 > 0) for i in range(29)]
    assert damping.mode_machine == 5
