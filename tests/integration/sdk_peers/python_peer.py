"""A process of Unitree's Python SDK (unitree-sdk2 on cyclonedds 0.10.2), run in .sdk-venv.

    python_peer.py types            how the SDK announces its types
    python_peer.py samples          a few samples with every field set, and their bytes
    python_peer.py TOPIC-reader --domain N
    python_peer.py TOPIC-writer --domain N
    python_peer.py motion-switcher --domain N

A reader reports every sample that differs from the one before, with all of its fields. A writer
writes the sample it was last told, all fields but the checksum, which is the SDK's own. Samples are
objects with the field names of the IDL; structs in arrays, such as motors, are lists in its order.
A motion-switcher calls the service as it is told, [api id, parameter], and reports code and data.
"""

import argparse
import dataclasses
import importlib.util
import platform
import random
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
    unitree_go_msg_dds__SportModeState_,
    unitree_hg_msg_dds__IMUState_,
    unitree_hg_msg_dds__LowCmd_,
    unitree_hg_msg_dds__LowState_,
)
from unitree_sdk2py.idl.unitree_api.msg.dds_ import (  # noqa: E402
    Request_,
    RequestHeader_,
    RequestIdentity_,
    RequestLease_,
    RequestPolicy_,
    Response_,
    ResponseHeader_,
    ResponseStatus_,
)
from unitree_sdk2py.idl.unitree_go.msg.dds_ import SportModeState_  # noqa: E402
from unitree_sdk2py.idl.unitree_hg.msg.dds_ import IMUState_, LowCmd_, LowState_  # noqa: E402
from unitree_sdk2py.rpc.client import Client  # noqa: E402
from unitree_sdk2py.utils.crc import CRC  # noqa: E402

# The type on each topic, and what makes the SDK's empty sample of it.
TOPICS = {
    "lowcmd": (LowCmd_, unitree_hg_msg_dds__LowCmd_),
    "arm_sdk": (LowCmd_, unitree_hg_msg_dds__LowCmd_),
    "lowstate": (LowState_, unitree_hg_msg_dds__LowState_),
    "secondary_imu": (IMUState_, unitree_hg_msg_dds__IMUState_),
    "sportmodestate": (SportModeState_, unitree_go_msg_dds__SportModeState_),
}


def sdk_crc():
    """The SDK's checksum in its own pure Python.

    On Linux it wants a library that its wheel lacks; everywhere else it computes in Python.
    """
    with mock.patch.object(platform, "system", return_value="elsewhere"):
        return CRC()


def announced_types():
    """XTypes' TypeInformation and TypeMapping of each type, as they travel in discovery, in hex."""
    found = {}
    for sdk_type in (*(one for one, _ in TOPICS.values()), Request_, Response_):
        idl = sdk_type.__idl__
        idl.populate()
        idl.fill_type_data()
        found[sdk_type.__idl_typename__] = [
            part.serialize(endianness=Endianness.Little, use_version_2=True)[4:].hex()
            for part in (idl.get_type_info(), idl.get_type_mapping())
        ]
    return found


def invent(sample, rng):
    """Set every field at random: integers to fit an octet, floats that float32 holds exactly."""
    for field in dataclasses.fields(sample):
        current = getattr(sample, field.name)
        is_list, is_real = isinstance(current, list), "float" in str(field.type)
        if dataclasses.is_dataclass(current):
            invent(current, rng)
        elif is_list and dataclasses.is_dataclass(current[0]):
            for element in current:
                invent(element, rng)
        else:
            drawn = [
                rng.randrange(-2000, 2000) / 64 if is_real else rng.randrange(1, 256)
                for _ in (current if is_list else [current])
            ]
            setattr(sample, field.name, drawn if is_list else drawn[0])


def invented_samples():
    """Two samples of each topic without a checksum: their fields, and their bytes in hex.

    Those are the bytes on the wire: Cyclone DDS fills the last word of what the SDK serialises.
    """
    rng = random.Random(29)
    samples = {}
    for topic in ("secondary_imu", "sportmodestate"):
        samples[topic] = []
        for _ in range(2):
            sample = TOPICS[topic][1]()
            invent(sample, rng)
            data = sample.serialize()
            data += bytes(-len(data) % 4)
            samples[topic].append({**shown(sample), "cdr": data.hex()})
    identity = RequestIdentity_(2**40 + 3, 1002)
    request = RequestHeader_(identity, RequestLease_(-5), RequestPolicy_(7, True))
    response = ResponseHeader_(identity, ResponseStatus_(-3203))
    for name, sample in {
        "api_request": Request_(request, '{"name": "ai"}', [1, 2, 255]),
        "api_response": Response_(response, '{"form": "0", "name": ""}', [9]),
    }.items():
        samples[name] = [{**shown(sample), "cdr": sample.serialize().hex()}]
    return samples


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
    crc = sdk_crc()
    last = None

    def handle(sample):
        nonlocal last
        if sample == last:
            return
        last = sample
        checked = {"crc_ok": crc.Crc(sample) == sample.crc} if hasattr(sample, "crc") else {}
        report("sample", fields=shown(sample), **checked)

    subscriber = ChannelSubscriber(f"rt/{topic}", TOPICS[topic][0])
    subscriber.Init(handle, 10)
    report("ready")
    hold(instructions(), 0.1, lambda _: None)
    subscriber.Close()


def write(report, topic):
    """Write the sample last told, again and again, until the test is done."""
    sdk_type, empty = TOPICS[topic]
    crc = sdk_crc()
    publisher = ChannelPublisher(f"rt/{topic}", sdk_type)
    publisher.Init()

    def publish(values):
        if values is None:
            return
        sample = empty()
        fill(sample, values)
        if hasattr(sample, "crc"):
            sample.crc = crc.Crc(sample)
        publisher.Write(sample)

    report("ready")
    hold(instructions(), 0.01, publish)
    publisher.Close()


def call(report):
    """Call the motion service as told: the wheel has the SDK's calls, but not MotionSwitcher's."""
    client = Client("motion_switcher")
    client.SetTimeout(5.0)
    for api in (1001, 1002, 1003, 1004):
        client._RegistApi(api, 0)
    report("ready")
    for api, parameter in iter(instructions().get, None):
        code, data = client._Call(api, parameter)
        report("answer", code=code, data=data)


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    roles = [f"{topic}-{role}" for topic in TOPICS for role in ("reader", "writer")]
    parser.add_argument("mode", choices=["types", "samples", "motion-switcher", *roles])
    parser.add_argument("--domain", type=int)
    args = parser.parse_args()
    report = open_reports()
    if args.mode in ("types", "samples"):
        report(args.mode, data=announced_types() if args.mode == "types" else invented_samples())
        hold(instructions(), 0.1, lambda _: None)
        return
    ChannelFactoryInitialize(args.domain, "lo")
    if args.mode == "motion-switcher":
        call(report)
        return
    topic, role = args.mode.split("-")
    (read if role == "reader" else write)(report, topic)


if __name__ == "__main__":
    main()
