"""A process of Unitree's C++ SDK (far-unitree-sdk, Cyclone DDS 0.10.2 inside), run in .sdk-venv.

    cpp_peer.py controller    writes LowCmd and reads LowState, as a program that drives a robot
    cpp_peer.py robot         writes LowState and reads LowCmd, as a simulator does

It is always on domain 0, here on `lo` alone. It fills in the checksum of what it writes, and does
not take over what comes with a wrong one but complains. It writes what it was last told, reports
what it reads whenever that has changed, and names fields in its own way.
"""

import argparse

from lines import hold, instructions, open_reports
from unitree_interface import LowState, MotorCommand, UnitreeInterface

N_MOTORS = 29
COMMAND = ("q_target", "dq_target", "kp", "kd", "tau_ff")
MOTOR = ("q", "dq", "tau_est", "temperature", "voltage")
IMU = ("quat", "omega", "accel", "rpy")


def shown(part, names):
    return {name: list(getattr(part, name)) for name in names}


def fill(part, values):
    for name, value in values.items():
        setattr(part, name, value)


def controller(sdk, report):
    """Return what a controller does every few milliseconds."""
    told = last = None

    def act(instruction):
        nonlocal told, last
        if instruction != told:
            told = instruction
            command = MotorCommand(N_MOTORS)
            fill(command, instruction)
            # From here on a thread of the SDK's repeats it at 500 Hz.
            sdk.write_low_command(command)
        state = sdk.read_low_state()
        seen = {
            "motor": shown(state.motor, MOTOR),
            "imu": shown(state.imu, IMU),
            "mode_machine": state.mode_machine,
        }
        if last is not None and seen != last:
            report("lowstate", fields=seen)
        last = seen

    return act


def robot(sdk, report):
    """Return what a robot does every few milliseconds."""
    last = None

    def act(instruction):
        nonlocal last
        if instruction is not None:
            state = LowState(N_MOTORS)
            fill(state.motor, instruction["motor"])
            fill(state.imu, instruction["imu"])
            state.tick, state.mode_machine = instruction["tick"], instruction["mode_machine"]
            sdk.publish_low_state(state)
        seen = shown(sdk.read_incoming_command(), COMMAND)
        if last is not None and seen != last:
            report("lowcmd", fields=seen)
        last = seen

    return act


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("role", choices=["controller", "robot"])
    role = {"controller": controller, "robot": robot}[parser.parse_args().role]
    report = open_reports()
    act = role(UnitreeInterface.create_g1("lo"), report)
    act(None)
    report("ready")
    hold(instructions(), 0.005, act)


if __name__ == "__main__":
    main()
