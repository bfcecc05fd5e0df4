"""/policy/terms: the steps of a policy by the names of its terms and joints, for viewers."""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING, Final

import numpy as np

from g1stream.dds.layout import CDR_HEADER
from g1stream.dds.messages import POLICY, Samples
from g1stream.extras.policy.observation import TERMS
from g1stream.robot.joints import JOINT_NAMES
from g1stream.session.format import MessageBatch
from g1stream.session.streams import delays_of_steps

if TYPE_CHECKING:
    from g1stream.dds.messages import Batch
    from g1stream.session.records import PolicyInfo

__all__ = ["encode", "schema"]

#: What a message begins with; the delay is from the publish time of the observed LowState to that
#: of the command.
_NUMBERS: Final = struct.Struct("<IIddd")
_HEAD: Final = """uint32 step
uint32 repeated
float64 inference_ms
float64 state_age_ms
float64 delay_ms
g1stream/PolicyObservation observation
g1stream/PolicyAction action
"""
#: Fields of the observation. A policy without one of the terms has no values there. All values are
#: in the last field if a term has no field. The type does not change for a new term, which stands
#: after motion_phase.
_OBSERVED: Final = (*list(TERMS)[: list(TERMS).index("motion_phase")], "values")


def schema() -> bytes:
    """The type g1stream/msg/PolicyTerms as ROS 2 message text."""
    parts = {
        "PolicyObservation": [f"float32[] {name}\n" for name in _OBSERVED],
        "PolicyAction": [f"float32 {name}\n" for name in JOINT_NAMES],
    }
    nested = (f"{'=' * 80}\nMSG: g1stream/{name}\n{''.join(of)}" for name, of in parts.items())
    return (_HEAD + "".join(nested)).encode()


def encode(steps: Batch, policy: PolicyInfo | None) -> MessageBatch:
    """Make a message of each step, in plain CDR.

    Args:
        steps: samples of `POLICY`.
        policy: the policy that plays, whose terms are given with the newest step of their
            histories; None if unknown.
    """
    samples = Samples(POLICY, steps.data)
    published, logged = np.array(steps.publish_times), np.array(steps.log_times)
    names = policy.newest if policy else {}
    complete = bool(names) and all(name.partition(".")[0] in _OBSERVED for name in names)
    head = zip(
        *(samples[name].tolist() for name in ("step", "repeated")),
        *(1e3 * samples[name] for name in ("inference_time", "state_age")),
        1e3 * delays_of_steps(published, samples["state_published"]),
        strict=True,
    )
    counts = samples["n_observation"].tolist()
    payloads = []
    for i, (numbers, observed, action) in enumerate(
        zip(head, samples["observation"], samples["action"], strict=True)
    ):
        columns = names if complete else {**names, "values": slice(counts[i])}
        values = [observed[columns.get(name, slice(0))] for name in _OBSERVED]
        sequences = (len(one).to_bytes(4, "little") + one.tobytes() for one in values)
        data = CDR_HEADER + _NUMBERS.pack(*numbers) + b"".join(sequences) + action.tobytes()
        payloads.append(data)
    return MessageBatch("/policy/terms", payloads, logged, published)
