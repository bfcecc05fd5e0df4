"""A small policy, a tracker of 154 values whose action is a product with the observation; and the
policies of others, which are not part of the project."""

from pathlib import Path

import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper, numpy_helper

from g1stream.robot.joints import JOINT_NAMES

__all__ = ["DANCE", "METADATA", "POLICIES", "endless", "needs_policies", "network_of", "saved"]

_SHARED = Path(__file__).parents[2] / "shared"
POLICIES = _SHARED / "policies"
#: The motion that two of them track.
DANCE = _SHARED / "lafan1" / "dance1_subject2.csv"
needs_policies = pytest.mark.skipif(
    not (POLICIES.is_dir() and DANCE.exists()),
    reason="the policies of others are not there: ../shared/policies",
)

#: As whole_body_tracking writes it.
METADATA = {
    "joint_names": ",".join(JOINT_NAMES),
    "joint_stiffness": ",".join(["40.0"] * 29),
    "joint_damping": ",".join(["2.0"] * 29),
    "default_joint_pos": ",".join(["0.1"] * 29),
    "action_scale": "0.5",
    "command_names": "motion",
    "observation_names": "command,motion_anchor_ori_b,base_ang_vel,joint_pos,joint_vel,actions",
    "anchor_body_name": "torso_link",
}


def network_of(width=154, n_actions=29, domain="", batch=1, declared=None):
    weights = numpy_helper.from_array(np.full((width, n_actions), 0.01, np.float32), "weights")
    tensor = helper.make_tensor_value_info
    graph = helper.make_graph(
        [helper.make_node("MatMul", ["obs", "weights"], ["actions"], domain=domain)],
        "policy",
        [tensor("obs", TensorProto.FLOAT, [batch, declared or width])],
        [tensor("actions", TensorProto.FLOAT, [batch, n_actions])],
        [weights],
    )
    opsets = [helper.make_opsetid("", 17)] + ([helper.make_opsetid(domain, 1)] if domain else [])
    return helper.make_model(graph, opset_imports=opsets, ir_version=8)


def endless(width=154, n_actions=29):
    """A policy with a loop whose condition always holds."""
    tensor, real = helper.make_tensor_value_info, TensorProto.FLOAT
    body = helper.make_graph(
        [helper.make_node("Identity", [a], [b]) for a, b in (("go", "on"), ("x", "y"))],
        "body",
        [
            tensor("i", TensorProto.INT64, []),
            tensor("go", TensorProto.BOOL, []),
            tensor("x", real, [1, width]),
        ],
        [tensor("on", TensorProto.BOOL, []), tensor("y", real, [1, width])],
    )
    graph = helper.make_graph(
        [
            helper.make_node("Loop", ["", "always", "obs"], ["looped"], body=body),
            helper.make_node("MatMul", ["looped", "weights"], ["actions"]),
        ],
        "policy",
        [tensor("obs", real, [1, width])],
        [tensor("actions", real, [1, n_actions])],
        [
            helper.make_tensor("always", TensorProto.BOOL, [], [True]),
            numpy_helper.from_array(np.zeros((width, n_actions), np.float32), "weights"),
        ],
    )
    return helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)


def saved(path, inputs, outputs):
    """A network of zeros from the first input to the last output."""
    tensor, real = helper.make_tensor_value_info, TensorProto.FLOAT
    shape = inputs[0][1], outputs[-1][1]
    weights = numpy_helper.from_array(np.zeros(shape, np.float32), "weights")
    nodes = [helper.make_node("Identity", [inputs[0][0]], [name]) for name, _ in outputs[:-1]]
    nodes += [helper.make_node("MatMul", [inputs[0][0], "weights"], [outputs[-1][0]])]
    both = ([tensor(name, real, [1, n]) for name, n in some] for some in (inputs, outputs))
    graph = helper.make_graph(nodes, "policy", *both, [weights])
    opsets = [helper.make_opsetid("", 17)]
    onnx.save(helper.make_model(graph, opset_imports=opsets, ir_version=8), path)
    return path
