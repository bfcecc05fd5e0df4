"""Policies that fail where the robot turns: ONNX files of a few nodes."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from g1 import JOINTS

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from engine import Session

#: What a policy observes, and where the gyroscope's z is in it.
TERMS = {"command": 58, "motion_anchor_ori_b": 6, "base_ang_vel": 3}
TERMS |= {"joint_pos": 29, "joint_vel": 29, "actions": 29}
TURNING = 66
#: The pose in which it stands, rad.
BENT = {"hip_pitch": -0.3, "knee": 0.6, "ankle_pitch": -0.3}


def _nodes(what: str) -> list[Any]:
    """Of `actions` from `turning` (1, 1) and `zeros` (1, 29)."""
    from onnx import TensorProto, helper

    node = helper.make_node
    if what == "stands":
        return [node("Identity", ["zeros"], ["actions"])]
    if what == "nan":  # the square root of 1 - turning, which is 1 at rest
        return [
            node("Sub", ["one", "turning"], ["rest"]),
            node("Sqrt", ["rest"], ["root"]),
            node("Sub", ["root", "one"], ["less"]),
            node("Mul", ["less", "one"], ["wrong"]),
            node("Add", ["zeros", "wrong"], ["actions"]),
        ]
    shape = [1, 29]
    out = helper.make_tensor_value_info("branch", TensorProto.FLOAT, shape)
    slow = helper.make_graph(
        [
            node("Expand", ["turning", "large"], ["square"]),
            node("MatMul", ["square", "square"], ["product"]),
            node("MatMul", ["product", "square"], ["again"]),
            node("ReduceMean", ["again"], ["mean"], keepdims=0),
            node("Mul", ["mean", "zeros"], ["branch"]),
        ],
        "slow",
        [],
        [out],
    )
    quick = helper.make_graph([node("Identity", ["zeros"], ["branch"])], "quick", [], [out])
    return [
        node("Greater", ["turning", "one"], ["turns"]),
        node("Squeeze", ["turns"], ["if"]),
        node("If", ["if"], ["actions"], then_branch=slow, else_branch=quick),
    ]


def plays(what: str, *words: str) -> Callable[[Session], Sequence[str]]:
    """Play by a policy that `stands`, or is `nan` or `slow` while the robot turns at 1 rad/s."""

    def prepare(session: Session) -> Sequence[str]:
        import onnx
        from onnx import TensorProto, helper, numpy_helper

        width = sum(TERMS.values())
        turning = np.zeros((width, 1), np.float32)
        turning[TURNING] = 1.0
        constants: dict[str, Any] = {
            "of_turning": turning,
            "to_zeros": np.zeros((1, 29), np.float32),
            "one": np.ones((1, 1), np.float32),
            "large": np.array([2000, 2000], np.int64),
        }
        tensor = helper.make_tensor_value_info
        graph = helper.make_graph(
            [
                helper.make_node("MatMul", ["obs", "of_turning"], ["turning"]),
                helper.make_node("MatMul", ["turning", "to_zeros"], ["zeros"]),
                *_nodes(what),
            ],
            "policy",
            [tensor("obs", TensorProto.FLOAT, [1, width])],
            [tensor("actions", TensorProto.FLOAT, [1, 29])],
            [numpy_helper.from_array(value, name) for name, value in constants.items()],
        )
        model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
        pose = [next((v for k, v in BENT.items() if k in joint), 0.0) for joint in JOINTS]
        told = {
            "joint_names": ",".join(JOINTS),
            "joint_stiffness": ",".join(["60.0"] * 29),
            "joint_damping": ",".join(["2.0"] * 29),
            "default_joint_pos": ",".join(map(str, pose)),
            "action_scale": "0.5",
            "command_names": "motion",
            "observation_names": ",".join(TERMS),
            "anchor_body_name": "torso_link",
        }
        helper.set_model_props(model, told)
        path = session.folder / "policy.onnx"
        onnx.save(model, path)
        return ["--policy", str(path), "--stand", "0.5", *(words or ("--rehearse", "0"))]

    return prepare
