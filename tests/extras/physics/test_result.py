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

AT = {"frame": 61, "time_s": 61 / 30}
TORQUE = {"cause": "torque", "where": "left_knee_joint", "unit": "N·m", "worst": 152.4}
BRIEF = Excess(**TORQUE, **AT, limit=139.0, spans=((60, 62),), longest_s=0.1, forbids=False)
FRICTION = {"cause": "friction", "where": "", "unit": "", "worst": 1234.5, "limit": 0.6}
SPANS = tuple((10 * i, 10 * i + (i != 2)) for i in range(6))
LASTING = BRIEF.model_copy(update=FRICTION | {"spans": SPANS, "forbids": True})
PEAKS = tuple(
    TorquePeak(joint=joint, torque_nm=tau, limit_nm=139, frames=frames, **AT)
    for joint, tau, frames in (("left_knee_joint", -152.4, 3), ("right_knee_joint", 90.0, 0))
)
LINKS = {"link": "torso_link", "other": "left_rubber_hand"}
DEEP = Collision(**LINKS, depth_mm=12.34, **AT, spans=((60, 62), (70, 70)), simulated=False)
SKATING = {"skating_mm_s": 33.3, "skating_max_mm_s": 444.4, "skating_max_frame": 8}
CONTACT = {"contact_share": 0.5, "height_mm": 4.2}
FOOT = Foot(
    link="left_ankle_roll_link", penetration_mm=12.0, penetration_frame=7, **CONTACT, **SKATING
)
AIRBORNE = FOOT.model_copy(
    update={"contact_share": 0.0, "height_mm": None, **dict.fromkeys(SKATING)}
)
EXCESSES = {"hanging": (BRIEF,), "follow": (BRIEF,), "free": (LASTING, BRIEF)}
VERDICTS = {
    support: Verdict(support=support, excesses=EXCESSES.get(support, ()))
    for support in ("bolted", "hanging", "follow", "free")
}
PHYSICS = MotionPhysics(
    motion="hop",
    frames=100,
    fps=30.0,
    robot="g1_29dof",
    mass_kg=33.34,
    verdicts={
        **VERDICTS,
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
GOOD = {support: Verdict(support=support) for support in get_args(Support)}
GOOD["feet"] = Verdict(support="feet", changed="as it is")
NOTHING = dict.fromkeys(("inside_share", "margin_mm", "margin_frame"))
YES = PHYSICS.model_copy(update={"verdicts": GOOD, "collisions": (), **NOTHING})


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
