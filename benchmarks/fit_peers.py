"""What `fit` finds in unitree_mujoco's C++ simulator, and how much closer `--params` follows there.

    python benchmarks/fit_peers.py [--runs 10] [--as-shipped] [--keep DIR]

The simulator gets a copy of its model of the G1 with other friction and armature, by class of
joint, and 0.3 kg more in the left forearm; with --as-shipped its own. The hanging robot plays the
motion of `fit --motion-out`, `fit` fits the session, and what it finds is compared with the XML.
Then the demo is streamed with and without `--params` in turn, each with a simulator of its own. The
RMSE of a run depends on how long the simulator stalled; the median over time of the RMS over all
joints does not.
tracking_peers.py says what has to be set up.
"""

from __future__ import annotations

import argparse
import re
import shutil
import sys
import tempfile
from pathlib import Path
from statistics import median
from typing import Any, Final

import numpy as np

from g1stream.analysis.tracking import rms
from g1stream.app.session import open_session
from g1stream.errors import G1StreamError
from g1stream.extras.fit.excite import exciting_motion
from g1stream.extras.fit.identify import Fit, FittedValue, fit_parameters
from g1stream.robot.joints import JOINT_NAMES
from g1stream.robot.model import G1
from tracking_peers import PEERS, missing, running, stream_on_peer

ROBOT: Final = "g1_29dof"
#: Damping, armature and dry friction of the classes of joints.
OTHERS: Final = {
    "torso_motor": (0.10, 0.015, 0.40),
    "leg_motor": (0.12, 0.020, 0.50),
    "ankle_motor": (0.03, 0.007, 0.40),
    "arm_motor": (0.10, 0.015, 0.10),
    "wrist_motor": (0.07, 0.005, 0.25),
}
HEAVIER: Final = ("left_elbow_link", 0.3)
FLAGS: Final = ["--robot", ROBOT, "--support", "hanging", "--feedforward", "dynamics"]


def other_model(directory: Path) -> Path:
    """A copy of the simulator's model with other parameters; returns its scene."""
    shutil.copytree(PEERS / "unitree_mujoco/unitree_robots/g1", directory, dirs_exist_ok=True)
    path = directory / "g1_29dof.xml"
    text = path.read_text()
    for name, (damping, armature, friction) in OTHERS.items():
        joint = f'<joint damping="{damping}" armature="{armature}" frictionloss="{friction}"/>'
        text = re.sub(rf'(<default class="{name}">\s*)<joint [^>]*/>', rf"\1{joint}", text)
    link, mass = HEAVIER
    at = text.index(f'<body name="{link}"')
    found = re.compile(r'mass="([0-9.]+)"').search(text, at)
    if found is None:
        raise ValueError(f"{link} has no mass")
    text = f"{text[: found.start(1)]}{float(found[1]) + mass:g}{text[found.end(1) :]}"
    path.write_text(text)
    return directory / "scene_29dof.xml"


def inside_of(one: FittedValue, true: float) -> bool:
    """Whether the 95 % interval has the true value."""
    return one.low is not None and one.high is not None and one.low <= true <= one.high


def compare(fit: Fit, scene: Path, added: dict[str, float]) -> None:
    """Print what was found beside the model."""
    import mujoco

    model: Any = mujoco.MjModel.from_xml_path(str(scene))
    dofs = [model.joint(name).dofadr[0] for name in JOINT_NAMES]
    truth = {
        "damping": dict(zip(JOINT_NAMES, model.dof_damping[dofs], strict=True)),
        "friction": dict(zip(JOINT_NAMES, model.dof_frictionloss[dofs], strict=True)),
        "armature": dict(zip(JOINT_NAMES, model.dof_armature[dofs], strict=True)),
        "mass": {one.name: added.get(one.name, 0.0) for one in fit.values if one.kind == "mass"},
    }
    print(f"{'':<10}{'told':>8}{'inside':>8}{'median error':>14}{'median value':>14}")
    for kind, values in truth.items():
        told = [one for one in fit.values if one.kind == kind and one.told]
        inside = np.mean([inside_of(one, values[one.name]) for one in told])
        error = median(abs(one.value - values[one.name]) for one in told)
        size = median(abs(value) for value in values.values())
        print(f"{kind:<10}{len(told):>5}/{len(values):<2}{inside:>8.2f}{error:>14.4f}{size:>14.4f}")
    for name, mass in added.items():
        one = fit.find("mass", name)
        print(f"{name}: {mass:g} kg added, {one.value:.3f} +- {one.half} found")


def errors(path: Path) -> tuple[float, float]:
    """RMSE of all joints, and the median over time of their RMS, rad; NaN for a failed run."""
    try:
        tracking = open_session(path).tracking()
    except G1StreamError:
        return np.nan, np.nan
    return tracking.overall, float(np.median(rms(tracking.error.T)))


def main() -> None:
    """Parse, measure, print."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--runs", type=int, default=10, help="with and without, each")
    parser.add_argument("--seconds", type=float, default=40.0, help="of the exciting motion")
    parser.add_argument("--as-shipped", action="store_true")
    parser.add_argument("--keep", type=Path, help="folder for the sessions")
    flags = parser.parse_args()
    if why := missing("unitree_mujoco"):
        sys.exit(why)
    with tempfile.TemporaryDirectory() as temporary:
        directory = flags.keep or Path(temporary)
        scene = PEERS / "unitree_mujoco/unitree_robots/g1/scene_29dof.xml"
        added: dict[str, float] = {}
        if not flags.as_shipped:
            scene, added = other_model(Path(temporary, "g1")), dict([HEAVIER])
        motion = exciting_motion(G1.load(ROBOT), seconds=flags.seconds)
        excite = motion.save(directory / "excite.npz", force=True)
        session = directory / "excite.mcap"
        with running("cppsim", "-s", str(scene)):
            run = stream_on_peer(excite, flags.seconds, [*FLAGS, "--force"], session)
        if run.failure:
            sys.exit(run.failure)
        fit = fit_parameters([session], robot=G1.load(ROBOT))
        params = fit.save(directory / "g1.toml", force=True)
        print(f"{fit}\n", flush=True)
        compare(fit, scene, added)
        found: dict[str, list[tuple[float, float]]] = {"without": [], "with": []}
        for number in range(flags.runs):
            for name, more in (("without", []), ("with", ["--params", str(params)])):
                path = directory / f"{name}-{number}.mcap"
                with running("cppsim", "-s", str(scene)):
                    run = stream_on_peer(Path("demo"), 14.0, [*FLAGS, *more, "--force"], path)
                found[name].append(errors(path))
                rmse, usual = found[name][-1]
                print(
                    f"{name} --params: RMSE {rmse:.4f} rad, median {usual:.4f} rad {run.failure}",
                    flush=True,
                )
        for i, what in enumerate(("RMSE", "median over time")):
            without, known = (np.array(found[name])[:, i] for name in ("without", "with"))
            print(
                f"{what}: {np.nanmedian(without):.4f} rad without, {np.nanmedian(known):.4f} with "
                f"--params, which is better in {(known < without).sum()} of {len(known)} pairs"
            )


if __name__ == "__main__":
    main()
