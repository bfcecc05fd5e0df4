"""Motions from wherever there are some."""

from __future__ import annotations

import os

import pytest

from g1stream.errors import MotionError
from g1stream.session.motions import load_motion


def test_a_pipe_is_refused_with_what_to_do(tmp_path):
    # It would give its content once, and to the first who looks.
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(MotionError, match=r"pipe is not a file\. Save what it gives to a file"):
        load_motion(tmp_path / "pipe")
