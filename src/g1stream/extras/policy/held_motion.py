"""The motion that a policy contains: a reader, and a check of the motion that it shall track."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from g1stream.errors import ConfigError, MotionError
from g1stream.extras.policy.contract import PolicyContract, read_contract
from g1stream.extras.policy.network import Network
from g1stream.extras.policy.observer import pelvis_poses
from g1stream.motion.motion import Motion
from g1stream.motion.readers import Evidence
from g1stream.robot.model import G1
from g1stream.robot.rotations import wxyz_from_xyzw

if TYPE_CHECKING:
    from g1stream.motion.readers import MotionFile
    from g1stream.types import Floats

__all__ = ["HeldFrame", "HeldMotion", "check_motion", "held_frame", "motion_in"]

#: Compared length of a given motion and that in the policy, s; their largest RMS difference, rad.
_COMPARED, _SAME = 5.0, 0.05
#: Most frames of a motion in a policy.
_LONGEST: Final = 1 << 20


class HeldFrame(NamedTuple):
    """Joints (29,), rad and rad/s, and pose of the anchor: pos (3,) m and quat_wxyz (4,)."""

    joint_pos: Floats
    joint_vel: Floats
    pos: Floats
    quat_wxyz: Floats


def motion_in(policy: str) -> str | None:
    """Path of the ONNX file of a policy, given as of `Network`, if it holds its motion."""
    network = Network(policy)
    return str(network.path) if network.holds_motion else None


def held_frame(network: Network, contract: PolicyContract, step: int) -> HeldFrame:
    """The frame of a time step of the motion in a policy.

    Raises:
        ConfigError: the motion has no pose of the anchor.
    """
    out = {
        name: value.astype(np.float64)
        for name, value in network.run(np.zeros(network.width), step).items()
    }
    joint_pos, joint_vel = map(contract.in_motor_order, (out["joint_pos"], out["joint_vel"]))
    if {"ref_pos_xyz", "ref_quat_xyzw"} <= out.keys():  # holosoma
        return HeldFrame(
            joint_pos, joint_vel, out["ref_pos_xyz"], wxyz_from_xyzw(out["ref_quat_xyzw"])
        )
    bodies = network.metadata.get("body_names", "").split(",")
    link = contract.anchor or "pelvis"
    if not {"body_pos_w", "body_quat_w"} <= out.keys() or link not in bodies:
        raise ConfigError(
            f"The motion in {contract.path} has no pose of {link}.",
            "Export the policy again, with body_names in its metadata.",
        )
    at = bodies.index(link)
    return HeldFrame(joint_pos, joint_vel, out["body_pos_w"][at], out["body_quat_w"][at])


def check_motion(contract: PolicyContract, network: Network, motion: Motion) -> None:
    """Refuse a motion that a policy does not track.

    Raises:
        ConfigError: the policy tracks no motion, or contains another motion.
        MotionError: the motion has no sample at the policy's rate.
    """
    if contract.reference == "none":
        raise ConfigError(
            f"The policy {contract.path} tracks no motion: it does not observe one.",
            "Give a policy whose observation has motion_command.",
        )
    if contract.reference != "in the policy":
        return
    most, parts = round(_COMPARED * contract.rate), []
    for numbers, part in motion.samples(contract.rate, 0, motion.n_frames):
        parts.append(part.joint_pos)
        if numbers.stop >= most:
            break
    given = np.concatenate(parts)[:most]
    held = [held_frame(network, contract, step).joint_pos for step in range(len(given))]
    if (difference := float(np.sqrt(np.mean((given - held) ** 2)))) > _SAME:
        raise ConfigError(
            f"The policy {contract.path} contains another motion: its joint positions differ by "
            f"{difference:.2f} rad (RMS) in the first seconds, more than {_SAME:g}.",
            "Give the motion of the training; the policy's file is one, too.",
        )


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
        frames = [held_frame(network, contract, step) for step in range(self._length())]
        joint_pos, _, *anchor = map(np.array, zip(*frames, strict=True))
        root_pos, root_quat = pelvis_poses(contract.anchor, self._robot, joint_pos, *anchor)
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
        joint_pos, _, *anchor = held_frame(self._network, self._contract, step)
        return np.concatenate([joint_pos, *anchor])
