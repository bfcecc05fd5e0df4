import os
from pathlib import Path
from typing import get_args

import pytest

from g1stream.extras.physics.result import (
    Collision,
    Excess,
    Foot,
    MotionPhysics,
    TorquePeak,
    Verdict,
)
from g1stream.text import WIDTH
from g1stream.types import Support

SNAPSHOT = Path(__file__).with_name("physics.txt")

BRIEF = Excess(
    cause="torque",
    where="left_knee_joint",
    worst=152.4,
    limit=139.0,
    unit="N·m",
    frame=61,
    time_s=61 / 30,
    spans=((60, 62),),
    longest_s=0.1,
    forbids=False,
)
LASTING = BRIEF.model_copy(
    update={
        "cause": "friction",
        "where": "",
        "unit": "",
        "worst": 1234.5,
        "limit": 0.6,
        "spans": tuple((10 * i, 10 * i + (i != 2)) for i in range(6)),
        "forbids": True,
    }
)
PEAKS = tuple(
    TorquePeak(joint=joint, torque_nm=tau, limit_nm=139, frame=61, time_s=61 / 30, frames=frames)
    for joint, tau, frames in (("left_knee_joint", -152.4, 3), ("right_knee_joint", 90.0, 0))
)
DEEP = Collision(
    link="torso_link",
    other="left_rubber_hand",
    depth_mm=12.34,
    frame=61,
    time_s=61 / 30,
    spans=((60, 62), (70, 70)),
    simulated=False,
)
FOOT = Foot(
    link="left_ankle_roll_link",
    contact_share=0.5,
    height_mm=4.2,
    penetration_mm=12.0,
    penetration_frame=7,
    skating_mm_s=33.3,
    skating_max_mm_s=444.4,
    skating_max_frame=8,
)
AIRBORNE = FOOT.model_copy(
    update={
        "contact_share": 0.0,
        "height_mm": None,
        "skating_mm_s": None,
        "skating_max_mm_s": None,
        "skating_max_frame": None,
    }
)
PHYSICS = MotionPhysics(
    motion="hop",
    frames=100,
    fps=30.0,
    robot="g1_29dof",
    mass_kg=33.34,
    verdicts={
        "bolted": Verdict(support="bolted"),
        "hanging": Verdict(support="hanging", excesses=(BRIEF,)),
        "follow": Verdict(support="follow", excesses=(BRIEF,)),
        "free": Verdict(support="free", excesses=(LASTING, BRIEF)),
        "feet": Verdict(support="feet", refused="the left foot slides in frames 0 to 3."),
    },
    tilt_rad=0.4,
    hanging_tilt_rad=0.2,
    feet=(FOOT, AIRBORNE),
    supported_share=0.5,
    inside_share=0.9,
    margin_mm=-17.0,
    margin_frame=61,
    collisions=(DEEP,) * 12,
    torques={"bolted": PEAKS, "free": PEAKS},
)
YES = PHYSICS.model_copy(
    update={
        "verdicts": {
            **{support: Verdict(support=support) for support in get_args(Support)},
            "feet": Verdict(support="feet", changed="as it is"),
        },
        "collisions": (),
        "inside_share": None,
        "margin_mm": None,
        "margin_frame": None,
    }
)


def test_the_text_is_the_snapshot():
    text = f"{PHYSICS}\n\n\n{YES}\n"
    if os.environ.get("UPDATE_SNAPSHOTS"):
        SNAPSHOT.write_text(text)
    assert text == SNAPSHOT.read_text()
    assert max(map(len, text.splitlines())) <= WIDTH


@pytest.mark.parametrize(
    ("excesses", "answer"),
    [((), "yes"), ((BRIEF,), "inexact"), ((BRIEF, LASTING), "no"), ((LASTING,), "no")],
)
def test_what_forbids_a_motion_decides(excesses, answer):
    assert Verdict(support="free", excesses=excesses).playable == answer
