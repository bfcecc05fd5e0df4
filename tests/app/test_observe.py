"""What a program that shows a domain live is given."""

from __future__ import annotations

import threading

import numpy as np
from foxglove_schemas_protobuf.JointStates_pb2 import JointStates

from g1stream.app.live import observe
from g1stream.config import Config
from g1stream.dds.domain import Participant
from g1stream.dds.endpoints import RawWriter
from g1stream.dds.messages import LOWSTATE, LowState

T0 = 1_700_000_000_000_000_000


def test_it_yields_what_viewers_need_once_and_then_what_is_published(domain_id, until):
    config = Config.model_validate({"dds": {"domain": domain_id}, "record": {"channels": "raw"}})
    state = LowState()
    state.q[:] = np.linspace(-1.0, 1.0, len(state.q))
    stop = threading.Event()
    with Participant(domain_id, "lo") as participant:
        writer = RawWriter(participant, LOWSTATE, 4)
        lists = observe(config, stop.is_set)
        once = {messages.topic: messages for messages in next(lists)}
        until(lambda: writer.matched, "the observer")
        writer.write(state.tobytes(), T0)
        made = {}
        for messages in lists:
            made |= {one.topic: one for one in messages}
            if made:
                stop.set()
    assert set(once) == {
        *("/scene", "/measured/scene", "/ghost/scene"),
        "/measured/robot_description",
    }
    assert made["/lowstate"].payloads == [state.tobytes()]
    assert made["/lowstate"].publish_times.tolist() == [T0]
    joints = JointStates.FromString(bytes(made["/measured/joint_states"].payloads[0])).joints
    assert [joint.position for joint in joints] == state.q.tolist()
