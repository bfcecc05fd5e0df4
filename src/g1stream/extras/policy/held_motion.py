"""Reader for the motion that a policy contains."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from g1stream.errors import MotionError
from g1stream.extras.policy.contract import read_contract
from g1stream.extras.policy.first_actions import held_frame
from g1stream.extras.policy.network import Network
from g1stream.extras.policy.observer import pelvis_poses
from g1stream.motion.motion import Motion
from g1stream.motion.readers import Evidence
from g1stream.robot.model import G1

if TYPE_CHECKING:
    from g1stream.motion.readers import MotionFile
    from g1stream.types import Floats

__all__ = ["HeldMotion", "motion_in"]

#: Most frames of a motion in a policy.
_LONGEST: Final = 1 << 20


def motion_in(policy: str) -> str | None:
    """Path of the ONNX file of a policy, given as of `Network`, if it holds its motion."""
    network = Network(policy)
    return str(network.path) if network.holds_motion else None


class HeldMotion:
    """A `MotionReader` of an ONNX file whose outputs by time_step are a motion.

    Raises:
        MotionError: it contains no motion.
        ConfigError: it is no policy.
    """

    def __init__(self, file: MotionFile) -> None:
        self._file, self._network = file, Network(file.path)
        self._robot = G1.default()
        self._contract = read_contract(self._network, self._robot)
        if self._contract.reference != "in the policy":
            raise MotionError(
                f"The policy {file.path.name} contains no motion.",
                "Give the file of the motion from the training.",
            )

    @property
    def evidence(self) -> Evidence:
        origin, rate = self._contract.origin, f"{self._contract.rate:g} fps"
        used, assumed = {"joint order": origin["joint_names"]}, {}
        if self._file.fps is None and "rate" in self._contract.assumed:
            assumed["frame rate"] = rate
        elif self._file.fps is None:
            used["frame rate"] = f"{rate}, from {origin['rate']}"
        return Evidence(used, assumed)

    def motion(self) -> Motion:
        contract, network = self._contract, self._network
        frames = [held_frame(contract, network, step) for step in range(self._length())]
        joint_pos = np.array([frame.joint_pos for frame in frames])
        anchors = [frame.anchor for frame in frames]
        root_pos, root_quat = pelvis_poses(contract, self._robot, joint_pos, anchors)
        return Motion(
            name=self._file.path.stem,
            fps=self._file.fps or contract.rate,
            joint_pos=joint_pos,
            root_pos=root_pos,
            root_quat_wxyz=root_quat,
            source=self._file.path,
            sha256=self._file.sha256,
        )

    def _length(self) -> int:
        """Number of frames. All later frames equal the last one."""
        last, least, most = self._at(_LONGEST), 1, _LONGEST
        while least < most:
            middle = (least + most) // 2
            if np.array_equal(self._at(middle), last):
                most = middle
            else:
                least = middle + 1
        return least + 1

    def _at(self, step: int) -> Floats:
        frame = held_frame(self._contract, self._network, step)
        return np.concatenate([frame.joint_pos, *frame.anchor])
