"""The tables of settings: each setting is declared once, here or in safety_settings.py.

To add a setting, and its flag, add a field with `setting`; then `make docs` writes it into
configs/sim.toml.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final, Literal, get_args, get_origin

from pydantic import BaseModel, ConfigDict, Field

from g1stream.types import (
    STREAM_RATE,
    BeyondLimits,
    ChannelSet,
    FeedForwardKind,
    OnboardMode,
    OtherJoints,
    StreamSupport,
    Support,
    Via,
)

if TYPE_CHECKING:
    from pydantic.fields import FieldInfo

__all__ = [
    "LIVE_FLAG",
    "MAX_KD",
    "MAX_KP",
    "PLAY_FLAG",
    "ROBOT_FLAG",
    "DdsConfig",
    "GainsConfig",
    "RealtimeConfig",
    "RecordConfig",
    "SimConfig",
    "StreamConfig",
    "Table",
    "accepted",
    "setting",
]

#: The greatest gains that are ever sent, N·m/rad and N·m·s/rad: beyond any that a G1 is run with.
MAX_KP, MAX_KD = 500.0, 50.0

#: Commands with the same flags: those that go on DDS, play a motion, write a session file.
_ON_ROBOT = ("demo", "stream", "sim", "record", "replay", "doctor")
_DDS = (*_ON_ROBOT, "robot")
_RECORD = ("stream", "replay", "record")
_ROS = ("demo", "stream", "replay", "sim", "record")
#: The commands that play on a robot.
PLAY_FLAG: Final = ("stream", "replay")
#: The commands that take `--robot`.
ROBOT_FLAG: Final = (*_ON_ROBOT, "motion", "library")
#: The commands that take `--live`.
LIVE_FLAG: Final = ("demo", "stream", "replay", "record", "sim")


def setting(
    default: Any,
    description: str,
    unit: str = "",
    *,
    flag: tuple[str, ...] = (),
    example: Any = None,
    **limits: Any,
) -> Any:
    """A field of a table: the one place where a setting is declared.

    Its check, its flag and that flag's help, and its lines in configs/sim.toml all come from here.

    Args:
        default: without a config file and a flag; None for a setting that is unset.
        description: what it means, without its unit.
        unit: SI symbol, empty where it has none.
        flag: subcommands on which `--name` goes over the config file.
        example: a value to show where there is no default.
        limits: `ge`, `gt`, `le`, `lt` and the other limits that pydantic knows.
    """
    about: Any = {"unit": unit, "flag": flag}
    examples = None if example is None else [example]
    return Field(
        default, description=description, examples=examples, json_schema_extra=about, **limits
    )


class Table(BaseModel):
    """Settings that are declared with `setting`."""

    # Strict: TOML has a type for everything, so that "yes" is no bool and true is no number.
    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)


class DdsConfig(Table):
    """Where on DDS."""

    domain: int = setting(
        1, "DDS domain; simulators use 1, the robot uses 0", flag=_DDS, ge=0, le=232
    )
    interface: str = setting(
        "lo", "network interface; lo stays on this machine", flag=_DDS, min_length=1
    )
    ros_tf: bool = setting(
        False,
        "publish the measured robot and its ghost for ROS 2, record.tf_rate times a second: /tf, "
        "/joint_states and /robot_description",
        flag=_ROS,
    )


class StreamConfig(Table):
    """How a motion is played."""

    rate: float = setting(
        STREAM_RATE, "LowCmd per second", "Hz", flag=PLAY_FLAG, ge=50.0, le=2000.0
    )
    wait: float = setting(
        10.0,
        "longest wait for a first LowState and for a subscriber of LowCmd; discovery alone may "
        "take 2 s",
        "s",
        ge=1.0,
    )
    ramp: float = setting(
        3.0,
        "least time from the measured pose to the first frame",
        "s",
        flag=PLAY_FLAG,
        ge=0.2,
        le=60.0,
    )
    soft_start: float = setting(
        0.0, "time of damping, without position control, before the ramp", "s", ge=0.0, le=10.0
    )
    ramp_speed: float = setting(
        1.5,
        "highest speed of a joint on the way to the first frame, which takes longer for it",
        "rad/s",
        gt=0.0,
        le=10.0,
    )
    hold: float = setting(1.0, "time at the last frame", "s", ge=0.0)
    damp: float = setting(1.0, "time of damping at the end", "s", ge=0.5, le=10.0)
    start: float = setting(
        0.0, "where in the motion to start", "s", flag=(*PLAY_FLAG, "motion"), ge=0.0
    )
    duration: float | None = setting(
        None,
        "how much of the motion to play; to its end if unset",
        "s",
        flag=(*PLAY_FLAG, "demo", "motion"),
        example=10.0,
        gt=0.0,
    )
    loop: bool = setting(False, "play again and again until stopped", flag=PLAY_FLAG)
    via: Via = setting(
        "lowcmd",
        "what is commanded; lowcmd: the motors; arm_sdk: the robot's own controller, which takes "
        "targets for arms and waist while it stands and balances",
        flag=PLAY_FLAG,
    )
    joints: str | None = setting(
        None,
        "the joints that play the motion: limbs (arms, legs, left_arm, waist ...), names or "
        "patterns, separated by commas; all if unset",
        flag=(*PLAY_FLAG, "demo", "motion"),
        example="arms,waist",
    )
    others: OtherJoints = setting(
        "hold",
        "what the other joints do; hold: keep the pose measured when the ramp begins; free: only "
        "damp, with their kd",
        flag=(*PLAY_FLAG, "demo"),
    )
    beyond_limits: BeyondLimits = setting(
        "refuse",
        "a motion beyond the joint limits: refuse it; scale-time: slow it down until its speeds "
        "fit; clamp: hold its targets at the limits; anyway: play it at its speeds, on the "
        "loopback interface only",
    )
    damp_kd: float = setting(3.0, "gain of every joint while damping", "N·m·s/rad", ge=0.5, le=10.0)
    feedforward: FeedForwardKind | None = setting(
        None,
        "what commands carry beside the position: nothing, velocity, or velocity and torque; if "
        "unset, dynamics for a simulator on this machine that says how it holds the robot, and "
        "velocity otherwise",
        flag=(*PLAY_FLAG, "demo"),
        example="velocity",
    )
    support: StreamSupport | None = setting(
        None,
        "how the robot is held, which the torque depends on (a wrong value tracks worse than no "
        "torque); feet: nothing holds it, and it is kept on its feet (extra `feet`); as the "
        "simulator says if unset",
        flag=PLAY_FLAG,
        example="bolted",
    )
    experimental_feet: bool = setting(
        False,
        "allow --support feet on other interfaces than loopback, where there may be a robot; it "
        "has been tried in simulators only",
        flag=("stream",),
    )
    preview: float | None = setting(
        None,
        "commands are ahead of the motion by this, as they act a little later; if unset, one "
        "period of them for g1stream's own simulator, and 0 otherwise",
        "s",
        example=0.002,
        ge=0.0,
        le=0.1,
    )
    correction: Path | None = setting(
        None,
        "correction of the joint targets that `g1stream learn` made; refused for another motion, "
        "rate, gains, support or feed-forward",
        flag=("stream",),
        example="better.npz",
        strict=False,
    )
    time_scale: float | None = setting(
        None,
        "simulated over real time, which velocities are corrected by; measured from the joints if "
        "unset; 1 on a robot",
        example=1.0,
        ge=0.5,
        le=1.05,
    )

    @property
    def played_joints(self) -> str | None:
        """The joints that play the motion, as `joints` names them; None: all."""
        if self.joints is None and self.via == "arm_sdk":
            return "arms,waist"
        return self.joints


class RealtimeConfig(Table):
    """How punctual the loop asks to be; it runs without what the system does not grant."""

    # The guard process needs one above the loop's, and 99 is the highest.
    priority: int = setting(50, "SCHED_FIFO priority; 0: an ordinary process", ge=0, le=98)
    cpu: int | None = setting(
        None, "the only CPU of the loop; an isolated one, or any, if unset", example=3, ge=0
    )


class GainsConfig(Table):
    """Servo gains over those of Unitree's example, by joint.

    Each table maps a joint name, or a pattern such as "*_knee_joint", to a gain; later entries go
    over earlier ones, and joints that nothing names keep the example's gain.
    """

    kp: dict[str, Annotated[float, Field(ge=0.0, le=MAX_KP)]] = Field(default_factory=dict)
    kd: dict[str, Annotated[float, Field(ge=0.0, le=MAX_KD)]] = Field(default_factory=dict)


class RecordConfig(Table):
    """How a session file is written."""

    channels: ChannelSet = setting(
        "standard",
        "what is recorded beside samples and log; raw: nothing; standard: what viewers show, at "
        "record.tf_rate; full: joint states and their errors at every sample",
        flag=(*_RECORD, "demo"),
    )
    meshes: bool = setting(
        False,
        "scenes have the meshes of the URDF or, if it has none, of the real G1, with fewer "
        "triangles, instead of primitive shapes (extra `meshes`)",
        flag=(*_RECORD, "demo"),
    )
    tf_rate: float = setting(
        100.0,
        "link poses (/tf) per second, and joint states unless channels is full",
        "Hz",
        gt=0.0,
        le=2000.0,
    )
    batch: float = setting(0.05, "received samples are handled this often", "s", gt=0.0, le=0.5)
    split_size: float | None = setting(
        None,
        "split the recording into parts of this size (NAME/NAME_0.mcap ...); one file if unset",
        "MB",
        flag=_RECORD,
        example=1000.0,
        gt=0.0,
    )
    split_duration: float | None = setting(
        None,
        "split the recording into parts of this duration; one file if unset",
        "s",
        flag=_RECORD,
        example=600.0,
        gt=0.0,
    )
    auto_name: bool = setting(False, "put the time, UTC, into the file's name", flag=_RECORD)


class SimConfig(Table):
    """How the MuJoCo bridge holds the robot and answers."""

    support: Support = setting(
        "bolted",
        "what holds the pelvis; bolted: the world; hanging: an elastic band at the torso; "
        "follow: the reference that is streamed; free: nothing, once the motion begins",
        flag=("sim", "demo"),
    )
    self_collision: bool = setting(
        True,
        "links of the robot collide with each other, as convex hulls of their meshes",
        flag=("sim", "demo"),
    )
    rate: float = setting(500.0, "LowState per second", "Hz", flag=("sim",), ge=50.0, le=1000.0)
    command_timeout: float = setting(
        0.5, "time without a LowCmd after which the motors only damp; 0: never", "s", ge=0.0
    )
    command_delay: float = setting(
        0.0,
        "time from when a LowCmd is received to when the motors obey it; above 0.1 s, a stream "
        "takes it for a queue",
        "s",
        flag=("sim", "demo"),
        ge=0.0,
        le=1.0,
    )
    noise: float = setting(
        0.0,
        "sensor noise of LowState; at 1 its standard deviations are 0.5 mrad and 0.05 rad/s for "
        "the joints, 0.01 rad/s, 0.1 m/s² and 1 mrad of attitude for the IMU; the same in every "
        "rollout",
        flag=("sim", "demo"),
        ge=0.0,
        le=100.0,
    )
    duration: float | None = setting(
        None,
        "stop after this; when interrupted if unset",
        "s",
        flag=("sim",),
        example=60.0,
        gt=0.0,
    )
    onboard: OnboardMode | None = setting(
        None,
        "mode of the motion service that is active from the start: a controller of the robot's own "
        "that holds the pose, until it is released; none if unset",
        flag=("sim",),
        example="ai",
    )
    viewer: bool = setting(False, "open MuJoCo's viewer", flag=("sim", "demo"))


def accepted(field: FieldInfo) -> str:
    """The values that a setting accepts, such as `10 to 2000`; empty where any of its type."""
    for kind in (field.annotation, *get_args(field.annotation)):
        if get_origin(kind) is Literal:
            *others, last = get_args(kind)
            return f"{', '.join(others)} or {last}"
    limits = {
        name: getattr(limit, name)
        for limit in field.metadata
        for name in ("ge", "gt", "le")
        if hasattr(limit, name)
    }
    if "gt" in limits:
        return f"above {limits['gt']:g}" + (f", at most {limits['le']:g}" if "le" in limits else "")
    if "le" in limits:
        return f"{limits['ge']:g} to {limits['le']:g}"
    return f"{limits['ge']:g} or more" if "ge" in limits else ""
