"""The file of a correction, and the spline through its values."""

from __future__ import annotations

import io

import numpy as np
import pytest

from g1stream.errors import ConfigError, RecordingError
from g1stream.motion.correction import (
    LARGEST_CORRECTION,
    Conditions,
    Correction,
    CorrectionSpline,
    grid,
)
from g1stream.robot.joints import EXAMPLE_KD, EXAMPLE_KP


def make(**changed):
    time = grid(1.0, 5.0)
    values = 0.05 * np.sin(3.0 * time[:, np.newaxis] + np.arange(29))
    frozen = np.zeros(values.shape, dtype=bool)
    frozen[10:20, 3] = True
    conditions = Conditions(
        "walk", "ab" * 32, "g1", 500.0, EXAMPLE_KP, EXAMPLE_KD, "dynamics", "hanging"
    )
    given = {"time": time, "values": values, "frozen": frozen, "history": np.array([0.01, 0.004])}
    return Correction(conditions, **given | changed)


def test_a_file_is_read_back_exactly(tmp_path):
    path = make().save(tmp_path / "better.npz")
    read = Correction.load(path)
    assert not read.conditions.differences(make().conditions)
    assert read.source == path
    assert read.to_bytes() == path.read_bytes()
    with pytest.raises(RecordingError):
        make().save(path)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("correction", None),
        ("correction", np.full((201, 29), np.nan)),
        ("correction", np.full((201, 29), 0.2)),
        ("correction", np.zeros((201, 28))),
        ("correction", np.full((201, 29), "0.1")),
        ("time", np.zeros(201)),
        ("frozen", np.zeros((201, 29))),
        ("joint_names", np.array(["left_knee_joint"] * 29)),
        ("kp", np.ones(3)),
        ("support", np.array("standing")),
        ("rate", np.array("often")),
        ("rmse_history", np.array([{}], dtype=object)),
    ],
)
def test_a_file_with_something_wrong_is_refused(tmp_path, name, value):
    with np.load(io.BytesIO(make().to_bytes())) as archive:
        arrays = dict(archive)
    arrays[name] = value
    path = tmp_path / "bad.npz"
    np.savez(path, **{key: values for key, values in arrays.items() if values is not None})
    with pytest.raises(ConfigError) as refused:
        Correction.load(path)
    assert str(path) in refused.value.cause


@pytest.mark.parametrize("content", [b"", b"PK\x03\x04", b"time,q\n1,2\n", make().to_bytes()[:900]])
def test_another_file_is_refused(tmp_path, content):
    path = tmp_path / "bad.npz"
    path.write_bytes(content)
    with pytest.raises(ConfigError):
        Correction.load(path)
    with pytest.raises(ConfigError):
        Correction.load(tmp_path / "none.npz")


@pytest.mark.slow
def test_the_spline_is_smooth_and_zero_at_both_ends_of_what_is_played():
    correction, dt = make(), 5e-4
    for start, stop in ((1.0, 5.0), (2.01, 4.003), (0.0, 99.0)):
        spline = CorrectionSpline(correction, start, stop)
        times = np.arange(0.9, 5.1, dt)
        c, rate, acceleration = np.moveaxis([spline.at(t) for t in times.tolist()], 1, 0)
        assert np.abs(c).max() <= 1.01 * LARGEST_CORRECTION
        outside = (times < max(start, 1.0) - dt) | (times > min(stop, 5.0) + dt)
        assert np.abs(c[outside]).max(initial=0.0) < 1e-5
        # C2: each derivative is that of the one before.
        assert np.abs(np.diff(c, axis=0) / dt - rate[1:]).max() < 2e-3
        assert np.abs(np.diff(rate, axis=0) / dt - acceleration[1:]).max() < 0.2
        middle = (times > max(start, 1.0) + 0.4) & (times < min(stop, 5.0) - 0.4)
        expected = 0.05 * np.sin(3.0 * times[middle, np.newaxis] + np.arange(29))
        assert c[middle] == pytest.approx(expected, abs=1e-4)
