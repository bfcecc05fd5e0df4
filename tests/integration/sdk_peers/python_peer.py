"""A process of Unitree's Python SDK (unitree-sdk2 on cyclonedds 0.10.2), run in .sdk-venv.

    python_peer.py type-information
    python_peer.py lowcmd-reader|lowstate-reader --domain N
    python_peer.py lowcmd-writer|lowstate-writer --domain N

A reader reports every sample that differs from the one before, with all of its fields. A writer
writes the sample it was last told, all fields but the checksum, which is the SDK's own. Samples are
objects with the field names of the IDL; motors are lists in its field order.
"""

import argparse
import dataclasses
import importlib.util
import platform
import sys
import types
from unittest import mock

from lines import hold, instructions, open_reports


def find_sdk():
    """Make the SDK importable.

    Its wheel lacks the subpackage `b2`, which its own `__init__` imports. A module that only knows
    the directory stands in for that `__init__`; everything below it is the SDK's.
    """
    package = types.ModuleType("unitree_sdk2py")
    spec = importlib.util.find_spec("unitree_sdk2py")
    package.__path__ = list(spec.submodule_search_locations)
    sys.modules["unitree_sdk2py"] = package


find_sdk()

from cyclonedds.idl._support import Endianness  # noqa: E402
from unitree_sdk2py.core.channel import (  # noqa: E402
    ChannelFactoryInitialize,
    ChannelPublisher,
    ChannelSubscriber,
)
from unitree_sdk2py.idl.default import (  # noqa: E402
    unitree_hg_msg_dds__LowCmd_,
    unitree_hg_msg_dds__LowState_,
)
from unitree_sdk2py.idl.unitree_go.msg.dds_ import SportModeState_  # noqa: E402
from unitree_sdk2py.idl.unitree_hg.msg.dds_ import IMUState_, LowCmd_, LowState_  # noqa: E402
from unitree_sdk2py.utils.crc import CRC  # noqa: E402

TOPICS = {
    "lowcmd": ("rt/lowcmd", LowCmd_, unitree_hg_msg_dds__LowCmd_),
    "lowstate": ("rt/lowstate", LowState_, unitree_hg_msg_dds__LowState_),
}


def sdk_crc():
    """The SDK's checksum in its own pure Python.

    On Linux it wants a library that its wheel lacks; everywhere else it computes in Python.
    """
    with mock.patch.object(platform, "system", return_value="elsewhere"):
        return CRC()


def type_information():
    """XTypes' TypeInformation and TypeMapping of each type, as announced in discovery, in hex."""
    found = {}
    for sdk_type in (LowCmd_, LowState_, IMUState_, SportModeState_):
        idl = sdk_type.__idl__
        idl.populate()
        idl.fill_type_data()
        found[sdk_type.__idl_typename__] = [
            part.serialize(endianness=Endianness.Little, use_version_2=True)[4:].hex()
            for part in (idl.get_type_info(), idl.get_type_mapping())
        ]
    return found


def fill(target, values):
    """Set the fields of one of the SDK's samples, by name or in order."""
    if not isinstance(values, dict):
        names = [field.name for field in dataclasses.fields(target)]
        values = dict(zip(names, values, strict=True))
    for name, value in values.items():
        current = getattr(target, name)
        if dataclasses.is_dataclass(current):
            fill(current, value)
        elif isinstance(current, list) and dataclasses.is_dataclass(current[0]):
            for element, element_values in zip(current, value, strict=True):
                fill(element, element_values)
        else:
            setattr(target, name, value)


def shown(sample):
    """The fields of one of the SDK's samples, as `fill` takes them."""
    values = dataclasses.asdict(sample)
    for name, value in values.items():
        if isinstance(value, bytes):
            values[name] = list(value)
        elif isinstance(value, list) and isinstance(value[0], dict):
            values[name] = [list(element.values()) for element in value]
    return values


def read(report, topic):
    """Report each new sample until the test is done."""
    name, sdk_type, _ = TOPICS[topic]
    crc = sdk_crc()
    last = None

    def handle(sample):
        nonlocal last
        if sample != last:
            last = sample
            report("sample", fields=shown(sample), crc_ok=crc.Crc(sample) == sample.crc)

    subscriber = ChannelSubscriber(name, sdk_type)
    subscriber.Init(handle, 10)
    report("ready")
    hold(instructions(), 0.1, lambda _: None)


def write(report, topic):
    """Write the sample last told, again and again, until the test is done."""
    name, sdk_type, default = TOPICS[topic]
    crc = sdk_crc()
    publisher = ChannelPublisher(name, sdk_type)
    publisher.Init()

    def publish(values):
        if values is None:
            return
        sample = default()
        fill(sample, values)
        sample.crc = crc.Crc(sample)
        publisher.Write(sample)

    report("ready")
    hold(instructions(), 0.01, publish)


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "mode",
        choices=["type-information"] + [f"{t}-{r}" for t in TOPICS for r in ("reader", "writer")],
    )
    parser.add_argument("--domain", type=int)
    args = parser.parse_args()
    report = open_reports()
    if args.mode == "type-information":
        report("type-information", types=type_information())
        hold(instructions(), 0.1, lambda _: None)
        return
    ChannelFactoryInitialize(args.domain, "lo")
    topic, role = args.mode.split("-")
    (read if role == "reader" else write)(report, topic)


if __name__ == "__main__":
    main()
