"""What a frame of a video costs, and which part of the picture costs what.

    python benchmarks/render.py session.mcap [--size 1280x720]

CPU time a frame, ms: the least of three rounds of ten frames. The parts are left out one after the
other, so that the difference of two rows is the part that the lower one lacks. The last rows are
the text in the picture, and the encoding of one into H.264.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from fractions import Fraction
from io import BytesIO
from unittest.mock import patch

import av
import mujoco
import numpy as np

import g1stream
from g1stream.extras.meshes.meshes import with_shapes
from g1stream.extras.video import render, scene
from g1stream.extras.video.render_cli import parse_size

FRAMES = 10


def cost(draw: Callable[[int], object]) -> float:
    """CPU time of a frame, ms."""
    draw(0)
    rounds = []
    for _ in range(3):
        begun = time.process_time()
        for frame in range(FRAMES):
            draw(frame)
        rounds.append((time.process_time() - begun) / FRAMES)
    return 1e3 * min(rounds)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("session")
    parser.add_argument("--size", default="1280x720")
    args = parser.parse_args()
    session, size = g1stream.open_session(args.session), parse_size(args.size)
    times = np.arange(FRAMES) / 25.0
    poses = render.Poses(session, times)
    robot = with_shapes(session.robot)
    rows: dict[str, float] = {}

    with patch("g1stream.extras.video.scene.decimate", lambda mesh: mesh):
        drawn = scene.Scene(robot, poses.robots, size, 35.0)
    rows["meshes as they are in their files"] = cost(drawn.draw)
    drawn.close()
    drawn = scene.Scene(robot, poses.robots, size, 35.0)
    rows["a frame of g1stream render"] = cost(drawn.draw)
    alone = scene.Scene(robot, poses.robots[:1], size, 35.0)
    rows["without the ghost"] = cost(alone.draw)
    flags = alone._renderer.scene.flags
    flags[mujoco.mjtRndFlag.mjRND_SHADOW] = 0
    rows["and without shadows"] = cost(alone.draw)
    alone._renderer.scene.ngeom = 1
    rows["the floor alone"] = cost(lambda frame: alone._renderer.render())
    alone._renderer.scene.ngeom = 0
    rows["nothing"] = cost(lambda frame: alone._renderer.render())
    alone.close()
    pixels = drawn.draw(0)
    drawn.close()
    rows["text"] = cost(lambda frame: render._labelled(pixels, poses.text(frame)))
    with av.open(BytesIO(), "w", format="mp4") as container:
        stream = container.add_stream("libx264", rate=Fraction(25), options={"crf": "20"})
        stream.width, stream.height = size
        stream.pix_fmt = "yuv420p"

        def encode(frame: int) -> None:
            shifted = np.ascontiguousarray(np.roll(pixels, 3 * frame, axis=1))
            container.mux(stream.encode(av.VideoFrame.from_ndarray(shifted, format="rgb24")))

        rows["encoding"] = cost(encode)
    for name, value in rows.items():
        print(f"{name:<36} {value:7.1f}")


if __name__ == "__main__":
    main()
