"""The independent wire of the fault tests against samples of Unitree's SDK."""

import numpy as np
import unitree_hg


def test_a_low_cmd_is_read_as_the_sdk_wrote_it(golden):
    for sample in golden["lowcmd"]:
        data = bytes.fromhex(sample["cdr"])
        struct = unitree_hg.cmd_of(data)
        assert unitree_hg.sample_of_cmd(struct) == data
        command = np.frombuffer(struct, unitree_hg.CMD)[0]
        assert command["crc"] == unitree_hg.crc_of(struct) == sample["crc"]
        assert command["mode_machine"] == sample["mode_machine"]
        assert (
            command["motor"].tolist()
            == np.array(
                [tuple(motor) for motor in sample["motor_cmd"]], command["motor"].dtype
            ).tolist()
        )


def test_a_low_state_is_written_as_the_sdk_writes_it(golden):
    for sample in golden["lowstate"]:
        state = np.zeros((), unitree_hg.STATE)
        for name in ("version", "mode_pr", "mode_machine", "tick", "reserve", "crc"):
            state[name] = sample[name]
        state["remote"] = sample["wireless_remote"]
        state["imu"] = tuple(sample["imu_state"].values())
        for number, motor in enumerate(sample["motor_state"]):
            state["motor"][number] = tuple(motor)
        assert unitree_hg.sample_of_state(state.tobytes()) == bytes.fromhex(sample["cdr"])
        assert unitree_hg.crc_of(state.tobytes()) == sample["crc"]
