"""Formats of motion files, written and read back: what is lost, how long it takes, who agrees.

    python benchmarks/formats.py [--motion CSV] [--hour] [--json]
        [--model XML]... [--mjlab PYTHON] [--holosoma NPZ]

- Round trip: each format is written and read again, at its frame rate, and compared with the spline
  at that rate: the largest difference of an angle, of a link's place, of the pelvis's height.
- Velocities: derivatives of the spline beside `--velocities finite`, differences of the frames.
- --hour: CPU time and memory of an hour at 30 fps (the motion again and again), each format in a
  process of its own, without reading the motion.
- --model: how far our links are from those of the same name in a URDF or MJCF of others, at 200
  random poses.
- --mjlab: the Python of an environment with mjlab. Its own csv_to_npz converts ten seconds of the
  motion. Compared are ours of its frames at 50 fps with finite velocities, and ours of the motion.
- --holosoma: a file that holosoma's converter made, such as sub3_largebox_003_mj.npz of its
  repository. It is read, written in that format for each of our robots, and compared.
"""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any, Final
from xml.etree import ElementTree as ET

import numpy as np

import g1stream
from g1stream.extras.formats.table import WRITTEN
from g1stream.optional import load_object
from g1stream.robot.kinematics import forward_kinematics
from g1stream.robot.model import REVISIONS

CLIP: Final = Path(__file__).parents[2] / "shared" / "lafan1" / "joints_labeled.csv"
#: Suffix and frame rate of each format.
FORMATS: Final = {"csv": (".csv", None), "npz": (".npz", None)} | {
    name: (form.suffix, form.fps)
    for name, form in ((name, load_object(where)) for name, where in WRITTEN.items())
}
HOUR: Final = 3600 * 30
ARRAYS: Final = ("body_pos_w", "joint_vel", "body_lin_vel_w", "body_ang_vel_w")

#: csv_to_npz uploads what it wrote to /tmp/motion.npz; here it does not.
MJLAB: Final = """
import sys, types
run = types.SimpleNamespace(log_artifact=lambda **_: None, link_artifact=lambda **_: None)
nothing = lambda *_, **__: None
wandb = types.ModuleType("wandb")
wandb.init, wandb.finish, wandb.log = (lambda **_: run), nothing, nothing
sys.modules["wandb"] = wandb
from mjlab.scripts import csv_to_npz
csv_to_npz.main(sys.argv[1], "motion", input_fps=float(sys.argv[2]), device="cpu")
"""


def places(motion: g1stream.Motion) -> np.ndarray[Any, Any]:
    pose = motion.joint_pos, motion.root_pos, motion.root_quat_wxyz
    return forward_kinematics(g1stream.G1.default(), *pose).pos


def round_trip(motion: g1stream.Motion, directory: Path) -> dict[str, Any]:
    """Of each format: largest differences, and its size."""
    found = {}
    for name, (suffix, fps) in FORMATS.items():
        path = motion.save(directory / f"out{suffix}", format=name, force=True)
        expected = motion.resample(fps) if fps else motion
        read = g1stream.load_motion(path, fps=expected.fps if name == "csv" else None)
        files = [path] if path.is_file() else list(path.iterdir())
        found[name] = {
            "fps": read.fps,
            "frames": read.n_frames,
            "angle_rad": float(np.abs(read.joint_pos - expected.joint_pos).max()),
            "body_mm": float(np.linalg.norm(places(read) - places(expected), axis=-1).max() * 1e3),
            "height_mm": float(np.abs(read.root_pos - expected.root_pos)[:, 2].max() * 1e3),
            "mb": sum(file.stat().st_size for file in files) / 1e6,
        }
    return found


def velocities(motion: g1stream.Motion, directory: Path) -> dict[str, Any]:
    """Differences of the frames less derivatives of the spline, of joints and bodies."""
    files = []
    for kind in ("spline", "finite"):
        motion.save(directory / f"{kind}.npz", format="mjlab", velocities=kind, force=True)
        with np.load(directory / f"{kind}.npz") as file:
            files.append({name: file[name] for name in ARRAYS[1:]})
    return {name: difference(*(one[name] for one in files)) for name in ARRAYS[1:]}


def difference(ours: np.ndarray[Any, Any], theirs: np.ndarray[Any, Any]) -> dict[str, float]:
    error = np.abs(ours.astype(float) - theirs)
    return {"max": float(error.max()), "rms": float(np.sqrt((error**2).mean()))}


def hour(path: Path, name: str) -> dict[str, float]:
    """CPU seconds and the process's MB, of writing an hour."""
    motion = g1stream.load_motion(path)
    motion = motion.at_frames(np.arange(HOUR) % motion.n_frames)
    with tempfile.TemporaryDirectory() as directory:
        start = time.process_time()
        motion.save(Path(directory, f"out{FORMATS[name][0]}"), format=name)  # type: ignore[arg-type]
        cpu_s = time.process_time() - start
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3
    return {"cpu_s": cpu_s, "mb": memory}


def model_difference(path: Path) -> dict[str, float | str]:
    """The largest distance between links of one name, mm, and which; with the pelvis at 0."""
    import mujoco

    root = ET.parse(path).getroot()
    unused = {"geom", "site", "light", "camera", "visual", "collision", "asset", "actuator"}
    unused |= {"sensor", "contact", "keyframe", "include", "statistic", "equality", "tendon"}
    for parent in list(root.iter()):
        for element in [one for one in parent if one.tag in unused]:
            parent.remove(element)
    model = mujoco.MjModel.from_xml_string(ET.tostring(root, encoding="unicode"))
    data, robot = mujoco.MjData(model), g1stream.G1.default()
    joints = np.random.default_rng(0).uniform(robot.lower, robot.upper, (200, 29))
    poses = forward_kinematics(robot, joints, np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]))
    where = [model.joint(name).qposadr[0] for name in robot.joint_names]
    worst: dict[str, float] = {}
    for pose, angles in enumerate(joints):
        data.qpos[where] = angles
        if model.nq > len(where):
            data.qpos[:7] = [0, 0, 0, 1, 0, 0, 0]
        mujoco.mj_kinematics(model, data)
        for body in range(1, model.nbody):
            if (name := model.body(body).name) in robot.link_names:
                at = poses.pos[pose, robot.link_index(name)]
                away = float(np.linalg.norm(data.xpos[body] - at)) * 1e3
                worst[name] = max(worst.get(name, 0.0), away)
    link = max(worst, key=lambda name: worst[name])
    return {"links": len(worst), "mm": worst[link], "link": link}


def beside_mjlab(motion: g1stream.Motion, python: str, directory: Path) -> dict[str, Any]:
    """Our arrays less those of mjlab's csv_to_npz, and the seconds that both take."""
    root = motion.root_pos, motion.root_quat_wxyz[:, [1, 2, 3, 0]], motion.joint_pos
    np.savetxt(directory / "in.csv", np.concatenate(root, axis=1), delimiter=",", fmt="%.9f")
    start = time.perf_counter()
    command = [python, "-c", MJLAB, str(directory / "in.csv"), str(motion.fps)]
    subprocess.run(command, check=True, capture_output=True)
    its_s = time.perf_counter() - start
    with np.load("/tmp/motion.npz") as file:
        theirs = {name: file[name] for name in file}
    pelvis = theirs["body_pos_w"][:, 0], theirs["body_quat_w"][:, 0]
    same = g1stream.Motion.from_arrays(theirs["joint_pos"], *pelvis, fps=50)
    found: dict[str, Any] = {}
    for title, one, kind in (
        ("of its frames", same, "finite"),
        ("of the motion", motion, "spline"),
    ):
        start = time.perf_counter()
        one.save(directory / "ours.npz", format="mjlab", velocities=kind, force=True)  # type: ignore[arg-type]
        seconds = {"its s": its_s, "our s": time.perf_counter() - start}
        with np.load(directory / "ours.npz") as ours:
            worst = {
                f"{name} {how}": value
                for name in ("joint_pos", *ARRAYS)
                for how, value in difference(ours[name][: len(theirs[name])], theirs[name]).items()
            }
        found[title] = {"frames": len(theirs["joint_pos"]), **seconds, **worst}
    return found


def beside_holosoma(path: Path, directory: Path) -> dict[str, Any]:
    """Our bodies, joints and velocities less those in a file, bodies by name."""
    motion, found = g1stream.load_motion(path), {}
    with np.load(path) as file:
        theirs = {name: file[name] for name in file}
    names = theirs["body_names"].tolist()
    for robot in REVISIONS:
        ours_at = directory / "holosoma.npz"
        motion.save(
            ours_at,
            format="holosoma",
            robot=g1stream.G1.load(robot),
            velocities="finite",
            force=True,
        )
        with np.load(ours_at) as ours:
            columns = [names.index(name) for name in ours["body_names"].tolist()]
            away = ours["body_pos_w"] - theirs["body_pos_w"][:, columns]
            found[robot] = {
                "bodies": len(columns),
                "mm max": float(np.linalg.norm(away, axis=-1).max()) * 1e3,
                "joint_pos max": difference(ours["joint_pos"], theirs["joint_pos"])["max"],
                "joint_vel max": difference(ours["joint_vel"][:, 6:], theirs["joint_vel"][:, 6:])[
                    "max"
                ],
            }
    return found


def table(rows: dict[str, dict[str, Any]], title: str) -> str:
    heads = list(next(iter(rows.values())))
    lines = [[title, *heads]]
    for name, row in rows.items():
        cells = (
            f"{row[head]:.3g}" if isinstance(row[head], float) else row[head] for head in heads
        )
        lines.append([name, *map(str, cells)])
    lines.insert(1, ["---"] * (len(heads) + 1))
    return "\n".join(f"| {' | '.join(line)} |" for line in lines) + "\n"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("--motion", default=str(CLIP) if CLIP.exists() else "demo")
    parser.add_argument("--hour", action="store_true")
    parser.add_argument("--one-hour-of", help=argparse.SUPPRESS)
    parser.add_argument("--model", type=Path, action="append", default=[])
    parser.add_argument("--mjlab")
    parser.add_argument("--holosoma", type=Path)
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()
    if args.one_hour_of:
        print(json.dumps(hour(args.motion, args.one_hour_of)))
        return
    motion = g1stream.load_motion(args.motion)
    found: dict[str, dict[str, Any]] = {}
    with tempfile.TemporaryDirectory() as directory:
        found["round trip"] = round_trip(motion, Path(directory))
        found["finite less spline"] = velocities(motion, Path(directory))
        if args.mjlab:
            part = motion.frames(0, min(motion.n_frames, 300))
            beside = beside_mjlab(part, args.mjlab, Path(directory))
            heads = list(next(iter(beside.values())))
            found["ours less csv_to_npz of mjlab"] = {
                head: {title: row[head] for title, row in beside.items()} for head in heads
            }
        if args.holosoma:
            found["ours less holosoma's"] = beside_holosoma(args.holosoma, Path(directory))
    if args.model:
        found["links of others"] = {str(path): model_difference(path) for path in args.model}
    if args.hour:
        command = [sys.executable, __file__, "--motion", args.motion, "--one-hour-of"]
        found["an hour"] = {
            name: json.loads(
                subprocess.run([*command, name], check=True, capture_output=True).stdout
            )
            for name in FORMATS
        }
    if args.json:
        print(json.dumps(found, indent=2))
    else:
        print("\n".join(table(rows, title) for title, rows in found.items()))


if __name__ == "__main__":
    main()
