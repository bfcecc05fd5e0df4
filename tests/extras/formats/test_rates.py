"""The frame rate by times, by speeds, and by what is beside a file."""

import json
import pickle

import numpy as np
import pytest

import g1stream
from known_arrays import opened


@pytest.mark.parametrize(
    ("fps", "unit", "decimals"),
    [(50, 1, 6), (30, 1, 2), (120, 1e3, 3), (500, 1e9, 0), (29.97, 1, 9)],
)
def test_times_of_frames_tell_the_rate(tmp_path, motion, fps, unit, decimals):
    times = np.round(1000.0 * unit + unit * np.arange(motion.n_frames) / fps, decimals)
    names = motion.joint_names
    path = tmp_path / "motion.npz"
    np.savez(path, joint_pos=motion.joint_pos, joint_names=names, time=times)
    assert g1stream.load_motion(path).fps == pytest.approx(fps, rel=1e-4)
    assert "frame rate" not in opened(path).evidence.assumed
    assert g1stream.load_motion(path, fps=25).fps == 25.0
    times -= times[0]  # a table has no number beyond 1e9
    head = ",".join(["time", "X", "Y", "Z", "QX", "QY", "QZ", "QW", *names])
    pose = motion.root_pos, motion.root_quat_wxyz[:, [1, 2, 3, 0]]
    table = np.column_stack([times, *pose, motion.joint_pos])
    np.savetxt(tmp_path / "motion.csv", table, "%.9f", ",", header=head, comments="")
    assert g1stream.load_motion(tmp_path / "motion.csv").fps == pytest.approx(fps, rel=1e-4)


def test_times_that_do_not_rise_evenly_tell_nothing(tmp_path, motion):
    path = tmp_path / "motion.npz"
    times = np.arange(motion.n_frames) / 50
    times[100:] += 1.0
    broken = [np.where(times > 2.0, bad, times) for bad in (np.nan, np.inf, 1e308)]
    for one in (times, times[::-1], np.arange(motion.n_frames), 0 * times, *broken):
        np.savez(path, joint_pos=motion.joint_pos, joint_names=motion.joint_names, time=one)
        found = g1stream.load_motion(path)
        assert found.fps == 30.0
        assert opened(path).evidence.assumed["frame rate"]
        assert any("time" in text for text in found.warnings)


@pytest.mark.parametrize("fps", [24.0, 50.0, 120.0, 43.0])
@pytest.mark.parametrize("kind", ["central", "backward", "spline", "qvel"])
def test_speeds_of_the_joints_tell_the_rate(tmp_path, motion, fps, kind):
    q = motion.joint_pos
    if kind == "backward":
        speeds = np.diff(q, axis=0, prepend=q[:1]) * fps
    elif kind == "spline":
        from scipy.interpolate import CubicSpline

        speeds = CubicSpline(np.arange(len(q)) / fps, q)(np.arange(len(q)) / fps, 1)
    else:
        speeds = np.gradient(q, 1 / fps, axis=0)
    if kind == "qvel":  # MuJoCo's, with the pelvis before the joints
        speeds = np.hstack([np.ones((len(q), 6)), speeds])
    path = tmp_path / "motion.npz"
    arrays = {"joint_pos": q, "joint_names": motion.joint_names, "joint_vel": speeds}
    np.savez(path, **arrays)
    assert g1stream.load_motion(path).fps == fps
    assert "frame rate" not in opened(path).evidence.assumed
    np.savez(path, **arrays, fps=fps)
    assert "joint_vel" in opened(path).evidence.not_used
    assert not any("fps" in text for text in g1stream.load_motion(path).warnings)
    np.savez(path, **arrays, fps=2 * fps)
    found = g1stream.load_motion(path)
    assert found.fps == 2 * fps
    assert f"--fps {fps:g} " in found.warnings[0]


def test_speeds_of_another_motion_tell_nothing(tmp_path, motion):
    path = tmp_path / "motion.npz"
    other = np.gradient(motion.joint_pos[:, ::-1], 0.02, axis=0)
    bad = [np.where(other > 0.5, one, other) for one in (np.nan, np.inf, 1e308)]
    for speeds in (other, 0 * other, other[:, :5], other[1:], *bad):
        np.savez(path, joint_pos=motion.joint_pos, joint_names=motion.joint_names, joint_vel=speeds)
        assert g1stream.load_motion(path).fps == 30.0
        assert "frame rate" in opened(path).evidence.assumed


def test_what_meta_json_beside_an_npz_says(tmp_path, motion):
    """As in the directories of HDMI: rate, joints and bodies; the file itself comes first."""
    order = np.random.default_rng(0).permutation(29)
    names = [motion.joint_names[i] for i in order]
    pose = np.tile([0.0, 0.0, 0.79], (motion.n_frames, 2, 1))
    pose[:, 0] = 9.0
    path, meta = tmp_path / "motion.npz", tmp_path / "meta.json"
    arrays = {"joint_pos": motion.joint_pos[:, order], "body_pos_w": pose}
    arrays["body_quat_w"] = np.tile([1.0, 0.0, 0.0, 0.0], (motion.n_frames, 2, 1))
    np.savez(path, **arrays)
    meta.write_text(
        json.dumps({"fps": 50.0, "joint_names": names, "body_names": ["box", "pelvis"]})
    )
    found = g1stream.load_motion(path)
    assert found.fps == 50.0
    np.testing.assert_array_equal(found.joint_pos, motion.joint_pos)
    assert (found.root_pos[:, 2] == 0.79).all()
    assert "meta.json" in opened(path).evidence.used["frame rate"]
    assert found.warnings == ()
    np.savez(path, **arrays, fps=25, joint_names=motion.joint_names)
    found = g1stream.load_motion(path)
    assert found.fps == 25.0
    np.testing.assert_array_equal(found.joint_pos, arrays["joint_pos"])
    for text in ("", "[1]", '{"fps": "fast"', "[" * 100_000, "\xff"):
        meta.write_text(text, encoding="latin-1")
        assert g1stream.load_motion(path).fps == 25.0


def test_meta_json_beside_another_kind_of_file_says_nothing(tmp_path, motion):
    (tmp_path / "meta.json").write_text(json.dumps({"fps": 50.0}))
    path = tmp_path / "motion.pkl"
    path.write_bytes(pickle.dumps({"joint_pos": motion.joint_pos}))
    assert g1stream.load_motion(path).fps == 30.0
    assert "frame rate" in opened(path).evidence.assumed
