"""Settings of all programs: their declarations, and reading them from TOML files and flags.

A TOML file has one table for each class below. Settings that it leaves out keep their defaults, and
a flag on the command line overrides both. To add a setting and its flag, add a field with
`setting`; then `make docs` writes it into configs/sim.toml.
"""

from __future__ import annotations

import sys
from math import inf
from pathlib import Path
from typing import (
    TYPE_CHECKING,
    Annotated,
    Any,
    Final,
    Literal,
    NamedTuple,
    TypeVar,
    get_args,
    get_origin,
)

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from g1stream.errors import ConfigError
from g1stream.files import read_file
from g1stream.input_limits import SETTINGS_DOTS, SETTINGS_FILE, check_integers
from g1stream.network import is_loopback
from g1stream.profiles import PROFILES, ProfileConstants
from g1stream.types import (
    STREAM_RATE,
    BeyondLimits,
    ChannelSet,
    FeedForwardKind,
    OnboardMode,
    OtherJoints,
    Profile,
    StreamSupport,
    Support,
    Via,
)

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

if TYPE_CHECKING:
    from collections.abc import Mapping

    from pydantic.fields import FieldInfo
    from pydantic_core import ErrorDetails

__all__ = [
    "LIVE_FLAG",
    "PLAY_FLAG",
    "ROBOT_FLAG",
    "SHIPPED",
    "Config",
    "DdsConfig",
    "GainsConfig",
    "RealtimeConfig",
    "RecordConfig",
    "SafetyConfig",
    "SimConfig",
    "StreamConfig",
    "Table",
    "WiderValue",
    "accepted",
    "load_config",
    "read_table",
    "read_toml",
    "setting",
    "settings",
]

#: The highest gains that can be configured, N·m/rad and N·m·s/rad. No G1 is run with higher ones.
_MAX_KP, _MAX_KD = 500.0, 50.0

#: Pelvis tilt that ends a session where nothing holds the robot, rad: Unitree's own threshold.
_FALLEN: Final = 1.0
#: Groups of commands that share flags: they use DDS, play a motion or write a session file.
_ON_ROBOT = ("demo", "stream", "sim", "record", "doctor")
_DDS = (*_ON_ROBOT, "robot")
_RECORD = ("stream", "record")
_ROS = ("demo", "stream", "sim", "record")
#: The command that plays on a robot.
PLAY_FLAG: Final = ("stream",)
#: The commands that take `--robot`.
ROBOT_FLAG: Final = (*_ON_ROBOT, "motion", "physics", "library", "simulate", "fit")
#: The commands that take `--params`.
_PARAMS: Final = ("demo", "stream", "sim", "physics", "library", "simulate")
#: The commands that take `--live`.
LIVE_FLAG: Final = ("demo", "stream", "record", "sim")


def setting(
    default: Any,
    description: str,
    unit: str = "",
    *,
    flag: tuple[str, ...] = (),
    advanced: bool = False,
    metavar: str = "",
    example: Any = None,
    robot: Any = None,
    dangerous: bool = False,
    needs: tuple[str, ...] = (),
    **limits: Any,
) -> Any:
    """Declare a setting as a field of a table.

    The validation, the flag, the help and the lines in configs/*.toml are derived from it.

    Args:
        default: value without a config file and a flag; None for a setting that is unset.
        description: meaning of the setting, without its unit.
        unit: SI symbol; empty if the setting has no unit.
        flag: subcommands on which `--name` overrides the config file.
        advanced: show the flag only in --help-all.
        metavar: placeholder for the flag's value, if neither unit nor type describes it.
        example: a value to show if there is no default.
        robot: value with the profile `robot`, if it is not the default; docs/safety.md has a
            table of these.
        dangerous: any other value than the default is less careful.
        needs: what the flag needs, as in `flag` of cli/flags.py.
        limits: `ge`, `gt`, `le`, `lt` and the other constraints of pydantic.
    """
    about: Any = {"unit": unit, "flag": flag, "advanced": advanced, "metavar": metavar}
    about |= {"needs": needs, "dangerous": dangerous, "robot": default if robot is None else robot}
    examples = None if example is None else [example]
    return Field(
        default, description=description, examples=examples, json_schema_extra=about, **limits
    )


class Table(BaseModel):
    """Settings that are declared with `setting`."""

    # Strict, because TOML values have types: "yes" is not a bool and true is not a number.
    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)


class DdsConfig(Table):
    """DDS domain and network interface."""

    domain: int = setting(
        1, "DDS domain; simulators use 1, the robot uses 0", flag=_DDS, ge=0, le=232
    )
    interface: str = setting(
        "lo",
        "network interface; on lo, messages stay on this machine",
        flag=_DDS,
        metavar="INTERFACE",
        min_length=1,
    )
    ros_tf: bool = setting(
        False,
        "publish /tf, /joint_states and /robot_description of the measured robot and of the "
        "reference (ghost) for ROS 2, record.tf_rate times a second",
        flag=_ROS,
        advanced=True,
    )


class StreamConfig(Table):
    """How a motion is played."""

    rate: float = setting(
        STREAM_RATE,
        "LowCmd per second",
        "Hz",
        flag=(*PLAY_FLAG, "demo"),
        advanced=True,
        ge=50.0,
        le=2000.0,
    )
    wait: float = setting(
        10.0,
        "maximum wait for the first LowState and for a subscriber of LowCmd; discovery alone may "
        "take 2 s",
        "s",
        ge=1.0,
        le=86_400.0,
    )
    ramp: float = setting(
        3.0,
        "minimum time from the measured pose to the first frame",
        "s",
        flag=PLAY_FLAG,
        advanced=True,
        ge=0.2,
        le=60.0,
        robot=6.0,
    )
    hold: float = setting(
        1.0,
        "time at the last frame",
        "s",
        ge=0.0,
        le=86_400.0,
        robot=2.0,
    )
    damp: float = setting(
        1.0,
        "duration of damping at the end",
        "s",
        ge=0.5,
        le=10.0,
        robot=3.0,
    )
    start: float = setting(
        0.0, "start time in the motion", "s", flag=(*PLAY_FLAG, "demo", "physics"), ge=0.0
    )
    duration: float | None = setting(
        None,
        "how much of the motion to play; if unset, play to its end",
        "s",
        flag=(*PLAY_FLAG, "demo", "physics"),
        example=10.0,
        gt=0.0,
        le=86_400.0,
    )
    loop: bool = setting(False, "play again and again until stopped", flag=PLAY_FLAG)
    wait_for: str | None = setting(
        None,
        "what the next of several motions waits for, while the robot rests, and with a policy "
        "stands: enter (the key), or a button of the remote, such as A or R2+A",
        flag=PLAY_FLAG,
        metavar="EVENT",
        example="enter",
    )
    via: Via = setting(
        "lowcmd",
        "receiver of the commands; lowcmd: the motors; arm_sdk: the robot's own controller, which "
        "accepts targets for arms and waist while it stands and balances",
        flag=PLAY_FLAG,
        advanced=True,
    )
    joints: str | None = setting(
        None,
        "the joints that play the motion: limbs (arms, legs, left_arm, waist ...), names or "
        "patterns, separated by commas; all if unset",
        flag=(*PLAY_FLAG, "demo", "physics"),
        metavar="JOINTS",
        example="arms,waist",
    )
    others: OtherJoints = setting(
        "hold",
        "behaviour of the other joints; hold: keep the pose measured when the ramp begins; free: "
        "only damp, with their kd",
        flag=(*PLAY_FLAG, "demo"),
        advanced=True,
    )
    beyond_limits: BeyondLimits = setting(
        "refuse",
        "handling of a motion beyond the joint limits; refuse: do not play it; scale-time: slow it "
        "down until its speeds fit; clamp: hold its targets at the limits; anyway: play it at its "
        "own speeds, on the loopback interface only",
    )
    feedforward: FeedForwardKind | None = setting(
        None,
        "feed-forward beside the position: nothing, velocity, or velocity and torque (dynamics); "
        "if unset, dynamics for a simulator on this machine that announces its support, and "
        "velocity otherwise",
        flag=(*PLAY_FLAG, "demo"),
        advanced=True,
        example="velocity",
        robot="velocity",
    )
    support: StreamSupport | None = setting(
        None,
        "how the robot is held, which the feed-forward torque depends on (a wrong value tracks "
        "worse than no torque); feet: nothing holds it, and the stream balances it (extra `feet`); "
        "if unset, as the simulator announces",
        flag=PLAY_FLAG,
        example="bolted",
    )
    policy: str | None = setting(
        None,
        "learned policy that plays the motion on the robot's own feet: an ONNX file, or the name "
        "of a published one (extra `policy`, see `g1stream policy`)",
        flag=(*PLAY_FLAG, "demo"),
        metavar="POLICY",
        example="policy.onnx",
    )
    stand: float = setting(
        3.0,
        "with a policy, time for which the robot stands before and after the motion",
        "s",
        flag=(*PLAY_FLAG, "demo"),
        advanced=True,
        needs=("stream.policy",),
        ge=0.5,
        le=3600.0,
    )
    rehearse: float = setting(
        5.0,
        "with a policy, length of the motion's beginning that is tested in the simulator, without "
        "DDS, before the stream begins; the stream is refused if the robot falls; 0: no test",
        "s",
        flag=PLAY_FLAG,
        advanced=True,
        needs=("stream.policy",),
        ge=0.0,
        le=60.0,
    )
    preview: float | None = setting(
        None,
        "time by which commands are ahead of the motion, to compensate for their delay; if unset, "
        "one command period for g1stream's own simulator and 0 otherwise, plus the command delay "
        "of params",
        "s",
        example=0.002,
        ge=0.0,
        le=0.1,
    )

    @property
    def period(self) -> int:
        """Time between commands, ns; an integer, because deadlines are integers."""
        return round(1e9 / self.rate)

    @property
    def played_joints(self) -> str | None:
        """The joints that play the motion, as `joints` names them; None: all."""
        if self.joints is None and self.via == "arm_sdk":
            return "arms,waist"
        return self.joints


class RealtimeConfig(Table):
    """Real-time scheduling of the loop; it also runs if the system denies some of these."""

    # The guard process needs a priority one above the loop's, and 99 is the highest.
    priority: int = setting(50, "SCHED_FIFO priority; 0: normal scheduling", ge=0, le=98)
    cpu: int | None = setting(
        None,
        "the only CPU that the loop runs on; if unset, an isolated CPU, or any if there is none",
        example=3,
        ge=0,
        le=8191,
    )


class GainsConfig(Table):
    """Servo gains by joint, which override those of Unitree's example.

    Each table maps a joint name, or a pattern such as "*_knee_joint", to a gain. Later entries
    override earlier ones. Joints that match no entry keep the example's gain.
    """

    kp: dict[str, Annotated[float, Field(ge=0.0, le=_MAX_KP)]] = Field(default_factory=dict)
    kd: dict[str, Annotated[float, Field(ge=0.0, le=_MAX_KD)]] = Field(default_factory=dict)


class RecordConfig(Table):
    """How a session file is written."""

    channels: ChannelSet = setting(
        "standard",
        "channels that are recorded beside samples and log; raw: none; standard: for viewers, "
        "at record.tf_rate; full: also joint states and their errors at every sample",
        flag=(*_RECORD, "demo"),
        advanced=True,
        needs=("record",),
    )
    meshes: bool = setting(
        False,
        "show simplified meshes of the URDF, or of the real G1 if the URDF has none, instead of "
        "primitive shapes (extra `meshes`)",
        flag=(*_RECORD, "demo"),
        advanced=True,
        needs=("record",),
    )
    tf_rate: float = setting(
        100.0,
        "link poses (/tf) per second, and joint states unless channels is full",
        "Hz",
        gt=0.0,
        le=2000.0,
    )


class SimConfig(Table):
    """The MuJoCo bridge: support of the robot, rates, delay, noise and pushes."""

    support: StreamSupport = setting(
        "bolted",
        "support of the pelvis; bolted: fixed to the world; hanging: an elastic band at the torso; "
        "follow: moved along the streamed reference; free: nothing holds it once the motion "
        "begins; feet: as free, but `demo` and `rollout` balance it (extra `feet`)",
        flag=("sim", "demo"),
    )
    self_collision: bool = setting(
        True,
        "links of the robot collide with each other, as convex hulls of their meshes",
        flag=("sim", "demo"),
        advanced=True,
    )
    rate: float = setting(
        500.0, "LowState per second", "Hz", flag=("sim",), advanced=True, ge=50.0, le=1000.0
    )
    command_delay: float = setting(
        0.0,
        "time from receiving a LowCmd until the motors apply it, in whole periods of LowState",
        "s",
        flag=("sim", "demo"),
        advanced=True,
        ge=0.0,
        le=1.0,
    )
    noise: float = setting(
        0.0,
        "sensor noise of LowState; at 1 its standard deviations are 0.5 mrad and 0.05 rad/s for "
        "the joints, 0.01 rad/s, 0.1 m/s² and 1 mrad of attitude for the IMU; the same in every "
        "rollout with the same sim.seed",
        flag=("sim", "demo"),
        advanced=True,
        ge=0.0,
        le=100.0,
    )
    push: float = setting(
        0.0,
        "maximum speed that is added to the pelvis along x and along y every 5 s while nothing "
        "holds it, as in the training of policies; 0: no pushes",
        "m/s",
        flag=("sim", "demo"),
        advanced=True,
        ge=0.0,
        le=5.0,
    )
    seed: int = setting(
        0,
        "seed of the random numbers for sensor noise and pushes",
        flag=("sim", "demo"),
        advanced=True,
        ge=0,
        le=999_999,
    )
    duration: float | None = setting(
        None,
        "time after which the simulator stops; if unset, it runs until interrupted",
        "s",
        flag=("sim",),
        example=60.0,
        gt=0.0,
    )
    onboard: OnboardMode | None = setting(
        None,
        "mode of the motion service that is active at the start: one of the robot's own "
        "controllers, which holds the pose until it is released; if unset, none",
        flag=("sim",),
        advanced=True,
        example="ai",
    )
    viewer: bool = setting(False, "open MuJoCo's viewer", flag=("sim", "demo"))

    @property
    def held_by(self) -> Support:
        """The support of the pelvis in the simulator."""
        return "free" if self.support == "feet" else self.support


class SafetyConfig(Table):
    """Thresholds at which a stream stops; docs/safety.md explains each of them."""

    position_margin: float = setting(
        0.0,
        "distance that targets keep from the joint limits",
        "rad",
        ge=0.0,
        le=0.5,
        robot=0.05,
    )
    # Two programs and the physics share one machine in simulation, and silences above a robot's
    # 0.1 s are common on two CPUs. They are harmless there, because the feed-forward torque fades
    # out after 20 ms and the position servo holds. Unitree's own programs stop after 1 s.
    state_timeout: float = setting(
        0.5,
        "maximum age of the last LowState and maximum stall of the loop",
        "s",
        gt=0.0,
        le=1.0,
        robot=0.1,
    )
    max_tilt: float | None = setting(
        None,
        f"maximum pelvis tilt; if unset, {_FALLEN:g} rad where nothing holds the robot (support "
        "free or feet) and none otherwise, because a robot that hangs swings",
        "rad",
        example=1.0,
        gt=0.0,
        le=3.2,
        robot=0.5,
    )
    max_joint_speed: float = setting(
        60.0,
        "maximum measured joint speed",
        "rad/s",
        gt=0.0,
        le=1000.0,
        robot=10.0,
    )
    mode_machine: tuple[int, ...] = setting(
        (0, 5),
        "values of mode_machine of robots that may be commanded; 5: the 29-joint G1, replaced by "
        "the value of `robot` if that is another kind (4 with 23 joints); 0: a simulator that does "
        "not set it",
        min_length=1,
        strict=False,  # TOML and JSON know lists only,
        robot=(5,),
    )
    max_tracking_error: float = setting(
        1.0,
        "maximum distance of a joint from its target, averaged over a time that the profile fixes",
        "rad",
        gt=0.0,
        le=6.3,
        robot=0.3,
    )
    max_torque: float = setting(
        1.5,
        "maximum measured torque, as a multiple of the joint's torque limit",
        gt=0.0,
        le=10.0,
        robot=1.1,
    )
    motor_fault_mask: int = setting(
        0xFFFFFFFF,
        "bits of a motor's motorstate that count as faults",
        ge=0,
        le=0xFFFFFFFF,
        dangerous=True,
    )
    stop_buttons: tuple[str, ...] = setting(
        ("L2+B", "select"),
        "buttons, or combinations of buttons, of the robot's remote that damp and end the stream",
        strict=False,
        dangerous=True,
    )
    deadman: str | None = setting(
        None,
        "button of the robot's remote that must be held for the robot to move; releasing it damps",
        flag=PLAY_FLAG,
        advanced=True,
        metavar="BUTTON",
        example="R1",
    )
    guard: bool = setting(
        True,
        "start a guard process, which damps if the stream is killed, stopped or hangs; false is "
        "accepted on the loopback interface only",
        dangerous=True,
    )
    require_record: bool = setting(
        False,
        "damp and end when the recording fails",
        flag=PLAY_FLAG,
        advanced=True,
        needs=("record",),
    )
    urdf_limits: bool = setting(
        False,
        "use a URDF's joint limits even where they are wider than those of the robots in this "
        "package",
        flag=(*PLAY_FLAG, "motion", "physics"),
        advanced=True,
        dangerous=True,
    )
    allow_second_writer: bool = setting(
        False,
        "play even if there is another publisher on rt/lowcmd, or on rt/arm_sdk with stream.via = "
        "arm_sdk",
        flag=PLAY_FLAG,
        advanced=True,
        dangerous=True,
    )

    def tilt_limit(self, support: str | None) -> float:
        """The pelvis tilt that ends a session, rad; infinity if none does.

        Args:
            support: how the robot is held, as `stream.support` names it; None: not known.
        """
        if self.max_tilt is not None:
            return self.max_tilt
        return _FALLEN if support in ("free", "feet") else inf


#: The tables with values that depend on the profile.
_PROFILED: Final[tuple[tuple[str, type[Table]], ...]] = (
    ("stream", StreamConfig),
    ("safety", SafetyConfig),
)

#: Config files that come with the package, found by name: `--config robot`.
SHIPPED: Final = Path(__file__).with_name("configs")


class Config(Table):
    """All settings of a session.

    Settings of `stream` and `safety` that are not given get the values of the profile when a Config
    is made, and are part of it from then on.
    """

    profile: Profile = setting(
        "simulator",
        "whom settings that are not given are for; network-simulator: as simulator, on a network "
        "that no robot can be reached on; if unset, simulator on the loopback interface and robot "
        "on others, where simulator is refused",
        flag=PLAY_FLAG,
        advanced=True,
        robot="robot",
    )
    robot: Path | None = setting(
        None,
        "the robot: g1_29dof_rev_1_0, g1_29dof (which unitree_mujoco simulates), g1_23dof, "
        "g1_29dof_lock_waist, g1_dual_arm, or a URDF file; if unset, g1_29dof_rev_1_0, and the "
        "torque is for what the simulator announces, or for g1_29dof on loopback if it does not",
        flag=ROBOT_FLAG,
        metavar="NAME_OR_URDF",
        example="g1_29dof",
        strict=False,
    )
    params: Path | None = setting(
        None,
        "parameters file of the robot, as written by `g1stream fit`: friction, armature, delay, "
        "torque scale and masses, for the simulator and the feed-forward torque",
        flag=_PARAMS,
        example="g1.toml",
        strict=False,
    )
    live_port: int = setting(
        8765,
        "port of the WebSocket server of --live",
        flag=LIVE_FLAG,
        advanced=True,
        needs=("live",),
        ge=1,
        le=65535,
    )
    dds: DdsConfig = DdsConfig()
    stream: StreamConfig = StreamConfig()
    realtime: RealtimeConfig = RealtimeConfig()
    safety: SafetyConfig = SafetyConfig()
    gains: GainsConfig = GainsConfig()
    record: RecordConfig = RecordConfig()
    sim: SimConfig = SimConfig()

    @model_validator(mode="before")
    @classmethod
    def _fill(cls, values: Any) -> Any:
        """Choose the profile by the interface unless it is named, and fill in its values."""
        if not isinstance(values, dict):
            return values
        filled = dict(values)
        if filled.get("profile") is None:
            interface = _given(filled.get("dds")).get("interface") or DdsConfig().interface
            on_loopback = not isinstance(interface, str) or is_loopback(interface)
            filled["profile"] = "simulator" if on_loopback else "robot"
        if filled["profile"] == "robot":
            for name, table in _PROFILED:
                given = filled.get(name, {})
                if isinstance(given, dict | table):
                    filled[name] = _robot_values(table) | _given(given)
        return filled

    @property
    def constants(self) -> ProfileConstants:
        """What the profile fixes beside the settings."""
        return PROFILES[self.profile]

    def filled(self) -> Config:
        """These settings with the values of the profile, also after `model_copy`."""
        return Config.model_validate(
            {name: getattr(self, name) for name in type(self).model_fields}
        )

    def changed(self, **tables: Mapping[str, Any]) -> Config:
        """Other values in some tables, not checked, such as `changed(sim={"support": "free"})`."""
        new = {name: getattr(self, name).model_copy(update=one) for name, one in tables.items()}
        return self.model_copy(update=new)

    def wider_than_robot(self) -> list[WiderValue]:
        """The values that are less careful than those of the profile `robot`."""
        values = self.model_dump()
        found = []
        for key, field in settings().items():
            table, _, name = key.rpartition(".")
            value = (values[table] if table else values)[name]
            about: Any = field.json_schema_extra
            if about and _is_wider(value, field.default, about["robot"], about["dangerous"]):
                found.append(WiderValue(key, value, about["robot"], about["unit"]))
        return found


class WiderValue(NamedTuple):
    """A setting that is less careful than with the profile `robot`."""

    key: str  # as in a TOML file, such as `safety.max_tilt`
    value: Any
    robot: Any  # the value of the profile `robot`
    unit: str  # of both; empty without one

    def __str__(self) -> str:
        """The setting in words."""
        value = "unset" if self.value is None else self.value
        return f"{self.key} = {value}, robot: {self.robot} {self.unit}".rstrip()


def _given(table: Any) -> dict[str, Any]:
    """The settings of a table that are given; of a `Table` those that its maker named."""
    if isinstance(table, Table):
        table = {name: getattr(table, name) for name in table.model_fields_set}
    if not isinstance(table, dict):
        return {}
    return {name: value for name, value in table.items() if value is not None}


def _robot_values(table: type[Table]) -> dict[str, Any]:
    """The values of the profile `robot` that are not defaults."""
    found = {}
    for name, field in table.model_fields.items():
        about: Any = field.json_schema_extra
        if about["robot"] != field.default:
            found[name] = about["robot"]
    return found


def _is_wider(value: Any, simulator: Any, robot: Any, dangerous: bool) -> bool:
    """Whether a value is less careful than the robot's; the simulator's tells the direction."""
    if value == robot or (simulator == robot and not dangerous):
        return False
    if isinstance(robot, float | int) and not dangerous and value is not None:
        return bool((value > robot) == (simulator is None or simulator > robot))
    return dangerous or not isinstance(robot, tuple) or not set(value) <= set(robot)


def settings() -> dict[str, FieldInfo]:
    """All settings by their names in a TOML file, such as `stream.rate` or `gains.kp`."""
    found: dict[str, FieldInfo] = {}
    for name, field in Config.model_fields.items():
        table = field.annotation
        if isinstance(table, type) and issubclass(table, Table):
            found |= {f"{name}.{key}": inner for key, inner in table.model_fields.items()}
        else:
            found[name] = field
    return found


def load_config(path: Path | str | None = None, over: Mapping[str, Any] | None = None) -> Config:
    """Read the settings from a TOML file, with other values overriding it.

    Args:
        path: the TOML file, or the name of one in the package: robot, sim; None: only defaults.
        over: values that override the file's, keyed like `stream.rate`. None values are ignored.
            Tables, such as `gains.kp`, override the file's entry by entry.

    Raises:
        ConfigError: the file cannot be read or is not TOML, or a value is invalid; the error names
            it.
    """
    values = read_toml(_found(path)) if path else {}
    given = {key: value for key, value in (over or {}).items() if value is not None}
    for key, value in given.items():
        table, _, name = key.rpartition(".")
        below = values.setdefault(table, {}) if table else values
        if isinstance(below, dict):  # otherwise the file is invalid, which is reported below
            entries = below.get(name)
            if isinstance(value, dict) and isinstance(entries, dict):
                # Later entries override earlier ones.
                kept = {k: v for k, v in entries.items() if k not in value}
                below[name] = kept | value
            else:
                below[name] = value
    try:
        return Config.model_validate(values)
    except ValidationError as error:
        first = error.errors()[0]
        key = ".".join(str(part) for part in first["loc"])
        in_file = path and not any(f"{key}.".startswith(f"{flag}.") for flag in given)
        raise _explained(first, key, f" in {path}" if in_file else "") from error


def _found(path: Path | str) -> Path:
    """The path itself, or the shipped file of that name if the path is not a file."""
    shipped = SHIPPED / f"{path}.toml"
    return shipped if shipped.is_file() and not Path(path).is_file() else Path(path)


def read_toml(path: Path, what: str = "config") -> dict[str, Any]:
    """Read the tables of a TOML file.

    Raises:
        ConfigError: it cannot be read or is not TOML; the error calls the file `what`.
    """
    try:
        text = read_file(path, SETTINGS_FILE).decode("utf-8")
        if max(line.count(".") for line in text.split("\n")) > SETTINGS_DOTS:
            raise ValueError(f"a line has more than {SETTINGS_DOTS} dots")
        values: dict[str, Any] = tomllib.loads(text)
        check_integers(values)
    except OSError as error:
        names = ", ".join(sorted(file.stem for file in SHIPPED.glob("*.toml")))
        raise ConfigError(
            f"The {what} {path} cannot be read: {error.strerror}.",
            f"Check the path; configs that come with g1stream are {names}.",
        ) from error
    except (ValueError, RecursionError) as error:  # not UTF-8, not TOML, or nested too deeply
        raise ConfigError(
            f"The {what} {path} is not valid TOML: {error}.",
            "Fix the syntax on that line; configs/sim.toml is an example.",
        ) from error
    return values


TableT = TypeVar("TableT", bound=Table)


def read_table(
    kind: type[TableT], path: Path, what: str, remedy: str
) -> tuple[TableT, dict[str, Any]]:
    """Read a TOML file with the settings of one table.

    Args:
        kind: the table.
        path: path of the file.
        what: what errors call the file.
        remedy: remedy in the error for an invalid value.

    Returns:
        The settings, and the tables as they are in the file.

    Raises:
        ConfigError: the file cannot be read, or a value is invalid.
    """
    tables = read_toml(path, what)
    try:
        return kind.model_validate(tables), tables
    except ValidationError as error:
        first = error.errors()[0]
        key = ".".join(map(str, first["loc"]))
        raise ConfigError(
            f"In the {what} {path}: {key} = {first['input']!r:.80}: {first['msg']}.", remedy
        ) from error


def _explained(error: ErrorDetails, key: str, where: str) -> ConfigError:
    value = error["input"]
    if error["type"] == "extra_forbidden":
        parent = Config.model_fields.get(key.split(".", maxsplit=1)[0])
        table = parent.annotation if parent and "." in key else Config
        table_name, _, name = key.rpartition(".")
        if table_name in ("safety", "stream") and name in ProfileConstants._fields:
            fixed = ", ".join(f"{getattr(one, name)} ({p})" for p, one in PROFILES.items())
            return ConfigError(
                f"{key}{where} is no setting: the profile fixes it.", f"Remove it; it is {fixed}."
            )
        known = ", ".join(getattr(table, "model_fields", {}))
        return ConfigError(f"There is no setting {key}{where}.", f"Choose from {known}.")
    if error["type"] in ("model_type", "dict_type"):
        return ConfigError(
            f"The setting {key} = {value!r:.80}{where} is not a table.",
            f"Write [{key}] and its settings below it, as in configs/sim.toml.",
        )
    message = error["msg"]
    return ConfigError(
        f"The setting {key} = {value!r:.80}{where} is invalid: {message[0].lower()}{message[1:]}.",
        "Correct the value; configs/sim.toml lists every setting with its meaning.",
    )


def accepted(field: FieldInfo) -> str:
    """The values that a setting accepts, such as `10 to 2000`; empty for any value of its type."""
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
