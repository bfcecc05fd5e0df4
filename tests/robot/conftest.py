import pytest

from g1stream.robot.model import G1
from known_robots import compile_mujoco, random_frames, real_clip, reference_urdf, robot

__all__ = ["compile_mujoco", "random_frames", "real_clip", "reference_urdf", "robot"]


@pytest.fixture
def load(tmp_path):
    """Load a robot from the text of a URDF."""

    def load_text(text, **options):
        path = tmp_path / "some.urdf"
        path.write_text(text, encoding="utf-8")
        return G1.load(path, **options)

    return load_text
