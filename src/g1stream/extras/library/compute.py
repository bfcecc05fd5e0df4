"""Computes the rows of one motion, and its files for `simulate` and `convert`.

`rows_of` runs in every process. Any fault of a motion is stored in its row.
"""

from __future__ import annotations

import json
import re
import resource
import time
from dataclasses import dataclass, field
from functools import cache, cached_property
from glob import escape
from hashlib import sha256
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple

from g1stream._version import __version__
from g1stream.config import Config
from g1stream.errors import ConfigError, G1StreamError, MotionError, RecordingError
from g1stream.extras.formats.table import WRITTEN
from g1stream.extras.formats.write import write_motion
from g1stream.extras.library.files import content_hash, motions_at
from g1stream.extras.library.table import FORMAT, Command, JointRow, MotionRow, Rows, Status
from g1stream.extras.physics.measure import motion_physics
from g1stream.motion.check import check_motion
from g1stream.motion.motion import MOTION_SUFFIXES, Motion
from g1stream.motion.readers import load_motion
from g1stream.motion.trajectory import Trajectory
from g1stream.optional import load_object
from g1stream.robot.joints import JOINT_NAMES
from g1stream.robot.model import G1

if TYPE_CHECKING:
    from g1stream.analysis.metrics import Metrics
    from g1stream.extras.physics.result import MotionPhysics
    from g1stream.types import StreamSupport

__all__ = ["OUTPUTS", "Content", "LibraryCase", "Task", "contents_of", "rows_of"]

OUTPUTS: Final = {"simulate": "sessions", "convert": "converted"}
"""The library's subdirectory for the files that a command writes."""

#: Settings without effect on a simulation: DDS, scheduling and recording. Parameters are identified
#: by their content, not by their path.
_WITHOUT_EFFECT: Final = {"dds", "realtime", "record", "live_port", "params"}
#: Maximum length of a motion's name in the name of a file, which has up to 255 bytes, characters.
_LONGEST_NAME: Final = 50
_HUGE: Final = "It needs more memory than --memory-limit."


@dataclass(frozen=True)
class LibraryCase:
    """A computation for each motion.

    Attributes:
        command: check, simulate or convert.
        config: all settings; `stream.policy` applies to `simulate`.
        support: how the pelvis is held in `simulate`.
        sweep: values of swept settings, by name; `config` already has them.
        format: file format of `convert`: csv, npz, mcap, or that of another program.
        out: the library's directory.
        sessions: `simulate` keeps each session and its report.
    """

    command: Command
    out: Path
    config: Config = field(default_factory=Config)
    support: StreamSupport | None = None
    sweep: dict[str, float | str] = field(default_factory=dict)
    format: str = ""
    sessions: bool = False

    @property
    def variant(self) -> str:
        """A text that distinguishes the rows of one motion and one command."""
        values = [
            f"{name}={value:.12g}" if isinstance(value, float) else f"{name}={value}"
            for name, value in self.sweep.items()
        ]
        policy = self.policy and f"policy={self.policy}:{self.policy_sha256[:8]}"
        return " ".join(filter(None, [self.support, self.format, policy, *values]))

    @property
    def policy(self) -> str | None:
        """Name of the policy: of its file, or of the directory of a policy.onnx."""
        if self.command != "simulate" or not self.config.stream.policy:
            return None
        path = Path(self.config.stream.policy).absolute()
        return (path.stem == "policy" and path.parent.name) or path.stem

    @cached_property
    def policy_sha256(self) -> str:
        """SHA-256, in hex, of the policy's file and its accompanying files; "" without a policy.

        Raises:
            ConfigError: a file cannot be read.
        """
        if not self.policy:
            return ""
        path = Path(self.config.stream.policy or "")
        # External weights, and files about the training.
        beside = (*sorted(path.parent.glob(f"{escape(path.name)}.*")), path.with_suffix(".toml"))
        digest = sha256()
        for file in (path, *beside, path.with_name("deploy.yaml")):
            if file is path or file.is_file():
                digest.update(f"{file.name} {_file_hash(file)} ".encode())
        return digest.hexdigest()

    @cached_property
    def fingerprint(self) -> str:
        """A hash that is equal if command, variant, settings and versions are equal."""
        robot = _robot(self.config)
        about: dict[str, Any] = {
            "command": self.command,
            "variant": self.variant,
            "table": FORMAT,
            "robot": robot.urdf,
            "g1stream": __version__,
        }
        if robot.parameters.sha256 and self.command != "convert":
            about["params"] = robot.parameters.sha256
        if self.command != "convert":
            about["mujoco"] = version("mujoco")
        if self.command == "check":
            safety = self.config.safety
            about["settings"] = (*_limits(self.config), safety.max_tilt, safety.urdf_limits)
        elif self.command == "simulate":
            settings = self.config.model_dump(mode="json", exclude=_WITHOUT_EFFECT)
            settings["stream"]["policy"] = self.policy_sha256  # independent of its path
            about |= {"settings": settings, "sessions": self.sessions}
        return sha256(json.dumps(about, sort_keys=True).encode()).hexdigest()


class Content(NamedTuple):
    """A motion in a file.

    Attributes:
        sha256: hash of the file, in hex; with a member, hash of the file's hash and its name.
        fault: why it cannot be read, or "".
        member: name of the motion in a file of several, or "".
    """

    sha256: str
    fault: str = ""
    member: str = ""


@dataclass(frozen=True)
class Task:
    """A unit of work: one case of one motion."""

    location: str
    content: Content
    case: LibraryCase

    @property
    def key(self) -> str:
        """Key of the row, equal for equal content, variant, settings and versions."""
        return self._key(self.case.fingerprint)

    @property
    def key_if_broken(self) -> str:
        """Key of the row for a file without a motion, the same for all cases of a command."""
        return self._key(self.case.command, FORMAT, __version__)

    def _key(self, *about: object) -> str:
        of = *about, self.content.sha256 or self.location
        return sha256(" ".join(map(str, of)).encode()).hexdigest()[:16]

    def rows(self, status: Status, reason: str | None = None) -> Rows:
        """Rows of a motion with only a status."""
        broken, case = status == "broken", self.case
        row = MotionRow(
            key=self.key_if_broken if broken else self.key,
            name=self.content.member or Path(self.location).stem,
            path=_place(self.location, self.content.member),
            sha256=self.content.sha256,
            command=case.command,
            variant="" if broken else case.variant,
            support=None if broken else case.support,
            policy=None if broken else case.policy,
            policy_sha256=None if broken else case.policy_sha256 or None,
            status=status,
            reason=reason,
        )
        return Rows(motion=row, sweep={} if broken else case.sweep)


def _file_hash(path: Path) -> str:
    try:
        return sha256(path.read_bytes()).hexdigest()
    except OSError as error:
        raise ConfigError(
            f"The policy {path} cannot be read: {error.strerror}.", "Give the path of an ONNX file."
        ) from error


@cache
def _robot_at(path: Path | None, own_limits: bool, params: Path | None) -> G1:
    return G1.load(path, own_limits=own_limits, params=params)


def _robot(config: Config) -> G1:
    return _robot_at(config.robot, config.safety.urdf_limits, config.params)


def _limits(config: Config) -> tuple[float, float]:
    """Rate of targets and margin to position limits for the limit check."""
    return config.stream.rate, config.safety.position_margin


def contents_of(location: str) -> list[tuple[str, Content]]:
    """The motions at a path, with their hashes."""
    try:
        file, members = motions_at(location)
        whole = content_hash(file)
    except MotionError as error:
        return [(location, Content("", error.cause))]
    if not members:
        return [(file, Content(whole))]
    hashes = {one: sha256(f"{whole} {one}".encode()).hexdigest() for one in members}
    return [(file, Content(hashes[one], member=one)) for one in members]


def _place(path: Path | str, member: str) -> str:
    return f"{path}:{member}" if member else str(path)


def rows_of(task: Task) -> Rows:
    """Compute the rows of one motion. Any fault of the motion is stored in them.

    MuJoCo has errors of its own if it gets no memory, and a reader may call a file damaged. So a
    computation that fails so within a memory limit is repeated with twice the memory, and is too
    large if it does not fail then.
    """
    rows, (limit, hard) = _rows(task), resource.getrlimit(resource.RLIMIT_DATA)
    if (failed := rows.motion.status) in ("broken", "error") and limit != hard:
        most = 2 * limit if hard == resource.RLIM_INFINITY else min(2 * limit, hard)
        resource.setrlimit(resource.RLIMIT_DATA, (most, hard))
        try:
            again = _rows(task).motion
        finally:
            resource.setrlimit(resource.RLIMIT_DATA, (limit, hard))
        if again.status != failed:
            for name in filter(None, (again.output, again.report)):
                (task.case.out / name).unlink(missing_ok=True)
            first, rows = rows.motion, task.rows("huge", _HUGE)
            rows.motion.seconds, rows.motion.memory = first.seconds, first.memory
    return rows


def _rows(task: Task) -> Rows:
    begun = time.perf_counter()
    case, rows, path = task.case, task.rows("refused"), Path(task.location)
    row = rows.motion
    try:
        if task.content.fault:
            raise MotionError(task.content.fault, "")
        motion = _load(Path(_place(path, task.content.member)))
        row.frames, row.fps, row.duration = motion.n_frames, motion.fps, motion.duration
        _COMPUTE[case.command](motion, case, rows)
        row.status = "ok"
    except RecordingError as error:  # an output file cannot be written
        row.status, row.reason = "error", error.cause
    except G1StreamError as error:
        if row.frames is None:
            rows = task.rows("broken")
        row = rows.motion
        row.reason = _without_name(error.cause, path)
    except MemoryError:
        row.status, row.reason = "huge", _HUGE
    except Exception as error:  # a bug must not stop the other motions
        row.status, row.reason = "error", f"{type(error).__name__}: {error}"
    row.seconds = time.perf_counter() - begun
    row.memory = _resident() / 1e6
    return rows


def _load(path: Path) -> Motion:
    try:
        return load_motion(path)
    except RecordingError as error:  # a damaged session as input, not an output file
        raise MotionError(error.cause, error.remedy) from error


def _without_name(cause: str, path: Path) -> str:
    """A cause without the path of the file, because the row has the path."""
    shorter = cause.removeprefix(path.name).lstrip(":, ")
    return shorter.replace(f"The file {path}", "The file").replace(str(path), "the file")


def _resident() -> int:
    """Resident memory of this process, bytes."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize()


def _check(motion: Motion, case: LibraryCase, rows: Rows) -> None:
    robot, row = _robot(case.config), rows.motion
    rate, margin = _limits(case.config)
    trajectory = Trajectory(motion)
    report = check_motion(motion, robot, rate=rate, position_margin=margin, trajectory=trajectory)
    row.within_limits = report.within_limits
    row.looks_like = report.suspicion or None
    speeds = {one.joint: one.value for one in report.streamed.speeds}
    row.max_speed = max(speeds.values())
    lowest, highest = motion.joint_pos.min(axis=0), motion.joint_pos.max(axis=0)
    joints = {
        name: JointRow(
            key=row.key,
            joint=name,
            lowest=float(lowest[j]),
            highest=float(highest[j]),
            max_speed=speeds.get(name),
        )
        for j, name in enumerate(JOINT_NAMES)
    }
    rows.joints += joints.values()
    if not report.in_si_units:
        raise MotionError(
            f"It looks as if {report.suspicion}.", "Convert it to radians and metres."
        )
    max_tilt = case.config.safety.max_tilt
    found = motion_physics(motion, robot, max_tilt=max_tilt, trajectory=trajectory)
    _add_physics(found, row, joints)
    if report.dropped and report.dropped.moved:
        row.causes = "; ".join(filter(None, [row.causes, str(report.dropped)]))


def _add_physics(found: MotionPhysics, row: MotionRow, joints: dict[str, JointRow]) -> None:
    causes = []
    for support, verdict in found.verdicts.items():
        setattr(row, support, verdict.playable)
        against = dict.fromkeys(excess.cause for excess in verdict.excesses)
        if why := verdict.refused or ", ".join(against):
            causes.append(f"{support}: {why}")
    row.causes = "; ".join(causes) or None
    row.max_tilt = found.tilt_rad
    row.max_collision = found.collisions[0].depth_mm if found.collisions else 0.0
    row.max_penetration = max(foot.penetration_mm for foot in found.feet)
    row.max_skating = max(foot.skating_max_mm_s or 0.0 for foot in found.feet)
    row.least_margin, row.supported = found.margin_mm, found.supported_share
    for support, peaks in found.torques.items():
        setattr(row, f"torque_{support}", peaks[0].share)
        for peak in peaks:
            joint = joints[peak.joint]
            joint.torque_limit = peak.limit_nm
            setattr(joint, f"torque_{support}", peak.torque_nm)


def _simulate(motion: Motion, case: LibraryCase, rows: Rows) -> None:
    from g1stream.app.rollout import rollout

    row, config = rows.motion, case.config
    if not case.sessions:  # the session is not kept
        config = config.changed(record={"channels": "raw"})
    session = rollout(motion, support=case.support, config=config)
    metrics, summary = session.metrics(), session.summary()
    success, row.ended = metrics.success, summary.termination.reason or None
    row.completed, row.success = success.completed, success.success
    row.success_sonic, row.progress = success.success_sonic, success.progress
    row.survived = summary.termination.played_s
    if metrics.body and (ends := metrics.body.terminations) and ends.sonic:
        row.failed_at, row.failed_link = ends.sonic.at_s, ends.sonic.link
    for name, value in metrics.named().items():
        if name in MotionRow.model_fields:
            setattr(row, name, value)
    if metrics.tracking:
        row.worst_joint = metrics.tracking.all_joints.worst_joint
    rows.joints += _joint_rows(row.key, metrics)
    if case.sessions:
        from g1stream.extras.report.page import report

        path = _output(motion, case, row.key, ".mcap")
        page = path.with_suffix(".html")
        session.save(path, force=True)
        report(path, page, force=True)
        row.output, row.report = (str(one.relative_to(case.out)) for one in (path, page))


def _joint_rows(key: str, metrics: Metrics) -> list[JointRow]:
    if metrics.tracking is None:
        return []
    torques = metrics.torque.joints if metrics.torque else {}
    rows = []
    for name, one in metrics.tracking.joints.items():
        row = JointRow(
            key=key,
            joint=name,
            rmse=one.rmse_rad,
            bias=one.bias_rad,
            p99=one.p99_rad,
            max=one.max_abs_rad,
            delay=one.delay_s,
        )
        if torque := torques.get(name):
            row.torque_limit, row.torque_p99 = torque.limit_nm, torque.p99_nm
            row.torque_use, row.saturated = torque.use, torque.saturated
        rows.append(row)
    return rows


def _convert(motion: Motion, case: LibraryCase, rows: Rows) -> None:
    from g1stream.app.convert import convert

    robot = _robot(case.config)
    written = WRITTEN.get(case.format)
    suffix = load_object(written).suffix if written else f".{case.format}"
    path = _output(motion, case, rows.motion.key, suffix)
    if written:
        write_motion(motion, path, case.format, robot=robot, force=True)
    elif suffix in MOTION_SUFFIXES:
        motion.save(path, force=True)
    else:
        convert(motion, path, force=True, robot=robot)
    rows.motion.output = str(path.relative_to(case.out))


def _output(motion: Motion, case: LibraryCase, key: str, suffix: str) -> Path:
    """Path of a row's file. Motions with the same name have different keys."""
    directory = case.out / OUTPUTS[case.command]
    directory.mkdir(parents=True, exist_ok=True)
    # The name of a motion in a pickle may be any text, such as a path.
    name = re.sub(r"[^\w.+-]", "_", motion.name)[:_LONGEST_NAME]
    return directory / f"{name}-{key[:8]}{suffix}"


_COMPUTE: Final = {"check": _check, "simulate": _simulate, "convert": _convert}
