from __future__ import annotations

import sysconfig
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple
from xml.etree import ElementTree as ET

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from g1stream.config import SafetyConfig
from g1stream.profiles import PROFILES
from g1stream.robot.model import G1

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]

REFERENCE_DIR = Path(
    sysconfig.get_path("purelib"), "cmeel.prefix/share/example-robot-data/robots/g1_description"
)


CLIP = Path(__file__).parents[2] / "shared" / "lafan1" / "joints_labeled.csv"


class Frames(NamedTuple):
    joint_pos: Array
    root_pos: Array
    root_quat_wxyz: Array


def thresholds(**changed):
    """The settings of [safety] and the constants of the profile `simulator`, with changes."""
    constants = PROFILES["simulator"]
    ours = {name: changed.pop(name) for name in changed.keys() & set(constants._fields)}
    return SafetyConfig(**changed), constants._replace(**ours)


@pytest.fixture(scope="session")
def robot():
    return G1.default()


@pytest.fixture(scope="session")
def reference_urdf():
    """Path of a URDF of the PyPI package example-robot-data."""

    def find(name):
        path = REFERENCE_DIR / "urdf" / name
        if not path.exists():
            pytest.skip(f"needs {name} of the package example-robot-data (extra `meshes`)")
        return path

    return find


@pytest.fixture(scope="session")
def real_clip():
    """3,945 frames of a dance at 30 fps, retargeted to the G1; too big a file of others to ship."""
    if not CLIP.exists():
        pytest.skip(f"the LAFAN1 clip is not at {CLIP}")
    return CLIP


@pytest.fixture
def random_frames(robot):
    """Twelve frames anywhere within the joint limits, the root anywhere and turned any way."""
    rng = np.random.default_rng(29)
    quat_xyzw = Rotation.random(12, rng=rng).as_quat()
    return Frames(
        joint_pos=rng.uniform(robot.lower, robot.upper, (12, 29)),
        root_pos=rng.uniform(-3, 3, (12, 3)),
        root_quat_wxyz=quat_xyzw[:, [3, 0, 1, 2]],
    )


@pytest.fixture(scope="session")
def compile_mujoco():
    """Compiles a URDF text to a MuJoCo model with a free root and all links, but no meshes."""
    import mujoco

    def compile_urdf(urdf, *, ground=False):
        root = ET.fromstring(urdf)
        for link in root.iter("link"):
            link[:] = [part for part in link if part.find("geometry/mesh") is None]
        spec = mujoco.MjSpec.from_string(ET.tostring(root, encoding="unicode"))
        spec.compiler.fusestatic = False
        spec.worldbody.first_body().add_freejoint()
        if ground:
            spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0, 0, 1])
        return spec.compile()

    return compile_urdf
