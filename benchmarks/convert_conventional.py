"""The conventional way to convert a motion, as scripts and tutorials have it.

    python convert_conventional.py MOTION.csv ROBOT.urdf OUT.mcap

Row by row: the matrix of each joint is made and multiplied down the tree that yourdfpy has read, a
protobuf object is filled for each link, straight under `world`, and for each joint, and the stock
writer takes the messages. Nothing in it is slow on purpose; asking yourdfpy itself for each pose of
each link, as many scripts do, takes six times as long.
"""

from __future__ import annotations

import csv
import sys
from pathlib import Path

import numpy as np
import yourdfpy
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.JointStates_pb2 import JointStates
from mcap_protobuf.writer import Writer
from scipy.spatial.transform import Rotation

FPS = 30
COLUMNS_BEFORE_JOINTS = 8


def link_poses(
    joints: list[yourdfpy.Joint], root_link: str, root: np.ndarray, angles: dict[str, float]
) -> dict[str, np.ndarray]:
    """The pose (4, 4) of every link in the world; joints come after those above them."""
    poses = {root_link: root}
    for joint in joints:
        pose = poses[joint.parent] if joint.origin is None else poses[joint.parent] @ joint.origin
        if joint.name in angles:
            turn = np.eye(4)
            turn[:3, :3] = Rotation.from_rotvec(angles[joint.name] * joint.axis).as_matrix()
            pose = pose @ turn
        poses[joint.child] = pose
    return poses


def transforms(poses: dict[str, np.ndarray], stamp: int) -> FrameTransforms:
    """The pose of every link under the world."""
    quats = Rotation.from_matrix(np.array([pose[:3, :3] for pose in poses.values()])).as_quat()
    message = FrameTransforms()
    for (link, pose), quat in zip(poses.items(), quats.tolist(), strict=True):
        transform = message.transforms.add(parent_frame_id="world", child_frame_id=link)
        transform.timestamp.FromNanoseconds(stamp)
        position, rotation = transform.translation, transform.rotation
        position.x, position.y, position.z = pose[:3, 3].tolist()
        rotation.x, rotation.y, rotation.z, rotation.w = quat
    return message


def joint_states(angles: dict[str, float], stamp: int) -> JointStates:
    """The angle of every joint."""
    message = JointStates()
    message.timestamp.FromNanoseconds(stamp)
    for name, angle in angles.items():
        message.joints.add(name=name, position=angle)
    return message


def main(motion: str, robot: str, out: str) -> None:
    urdf = yourdfpy.URDF.load(robot, load_meshes=False)
    with Path(motion).open(newline="") as source, Path(out).open("wb") as file:
        rows = csv.reader(source)
        names = next(rows)[COLUMNS_BEFORE_JOINTS:]
        with Writer(file) as writer:
            for row in rows:
                frame, *numbers = map(float, row)
                stamp = round(frame * 1_000_000_000 / FPS)
                root = np.eye(4)
                root[:3, 3] = numbers[:3]
                root[:3, :3] = Rotation.from_quat(numbers[3:7]).as_matrix()
                angles = dict(zip(names, numbers[7:], strict=True))
                poses = link_poses(urdf.robot.joints, urdf.base_link, root, angles)
                for topic, message in (
                    ("/tf", transforms(poses, stamp)),
                    ("/reference/joint_states", joint_states(angles, stamp)),
                ):
                    writer.write_message(topic, message, log_time=stamp, publish_time=stamp)


if __name__ == "__main__":
    main(*sys.argv[1:])
