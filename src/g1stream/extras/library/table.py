"""The tables of a library: Parquet files that are readable while they grow.

library/motions/part-000012.parquet    a row for each motion and variant
library/joints/part-000012.parquet     a row for each of its joints

Results are written as a new part of each table as soon as the previous write has ended. The
parts appear complete, that of the joints first. Many small parts are merged into one. A row
that was recomputed, because settings or versions changed, replaces the older one for readers.
"""

from __future__ import annotations

import fcntl
from contextlib import contextmanager
from dataclasses import dataclass
from math import isnan
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Literal, get_args

from pydantic import Field

from g1stream.errors import RecordingError
from g1stream.extras.library.files import LIBRARY
from g1stream.extras.physics.result import Playable
from g1stream.files import complete_file, output_errors
from g1stream.optional import import_extra
from g1stream.session.records import Int, Record
from g1stream.text import counted

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    import pandas

__all__ = [
    "CONDITION_NAMES",
    "FORMAT",
    "Command",
    "JointRow",
    "Library",
    "MotionRow",
    "Rows",
    "Status",
    "TableWriter",
    "condition_value",
    "newest_motions",
    "open_library",
    "writing",
]

Command = Literal["check", "simulate", "convert"]
Status = Literal["ok", "broken", "refused", "huge", "slow", "crashed", "error"]
"""Status of a row: ok; no readable motion in the file; the motion is refused; too much memory or
time; its process ended; or a bug of g1stream."""


FORMAT: Final = 4
"""Version of the tables. It changes with the columns, so that rows are recomputed."""


def column(description: str, unit: str = "", default: Any = None) -> Any:
    """A column of a table, with its meaning and its unit."""
    return Field(default, description=description, json_schema_extra={"unit": unit})


class MotionRow(Record):
    """Results for a motion. Values that were not computed are None."""

    key: str = column("key of this row: content, variant, settings and versions", default=...)
    name: str = column("name of the file, without its suffix", default=...)
    path: str = column("path of the file", default=...)
    sha256: str = column("hash of the content", default=...)
    command: Command = column("command that computed the row", default=...)
    variant: str = column("support, policy and values of a sweep, or the format", default="")
    support: str | None = column("how the pelvis was held")
    policy: str | None = column("name of the policy that played it")
    policy_sha256: str | None = column("hash of the policy's files")
    status: Status = column("result", default="ok")
    reason: str | None = column("why the status is not ok")
    frames: Int | None = column("number of frames")
    fps: float | None = column("frame rate", "Hz")
    duration: float | None = column("duration", "s")

    bolted: Playable | None = column("whether it can be played with the pelvis bolted")
    hanging: Playable | None = column("whether it can be played hanging")
    follow: Playable | None = column(
        "whether it can be played with the pelvis following the reference"
    )
    free: Playable | None = column("whether it can be played standing free")
    feet: Playable | None = column("whether it can be played on its own feet, changed to stand")
    causes: str | None = column("problems by support, and joints that the robot lacks")
    within_limits: bool | None = column("whether it keeps the position and speed limits")
    looks_like: str | None = column("likely fault if a limit is exceeded")
    max_speed: float | None = column("highest joint speed", "rad/s")
    max_tilt: float | None = column("largest tilt of the pelvis", "rad")
    max_collision: float | None = column("largest penetration depth of two links", "mm")
    max_penetration: float | None = column("largest depth of a foot below the floor", "mm")
    max_skating: float | None = column("highest speed of a foot on the floor", "mm/s")
    least_margin: float | None = column(
        "least distance from the centre of pressure to the edge of the support polygon", "mm"
    )
    supported: float | None = column("fraction of the frames with a foot on the floor")
    torque_bolted: float | None = column("largest joint torque over its limit, bolted")
    torque_hanging: float | None = column("largest joint torque over its limit, hanging")
    torque_follow: float | None = column("largest joint torque over its limit, following")
    torque_free: float | None = column("largest joint torque over its limit, free")

    completed: bool | None = column("whether it was played to its end")
    ended: str | None = column("why it was not played to its end")
    success: bool | None = column("played to its end and followed, as in `session.metrics()`")
    success_sonic: bool | None = column("the same with SONIC's limits; None if the pelvis is held")
    failed_at: float | None = column("first time beyond those limits", "s")
    failed_link: str | None = column("link beyond those limits")
    progress: float | None = column("fraction of the motion that was played")
    survived: float | None = column("time played, to its end or to a fall", "s")
    rmse: float | None = column("RMSE of all joints", "rad")
    mae: float | None = column("mean absolute error of all joints", "rad")
    p99: float | None = column("99th percentile of the absolute error", "rad")
    max: float | None = column("largest error", "rad")
    bias: float | None = column("root mean square of the joints' mean errors", "rad")
    delay: float | None = column("delay of the joints behind the reference", "s")
    velocity_rmse: float | None = column("RMSE of all joint velocities", "rad/s")
    mpjpe: float | None = column("mean distance of the links, in the pelvis's frame", "mm")
    mpjpe_root: float | None = column("distance of the links, with the pelvis's attitude", "mm")
    mpjpe_world: float | None = column("distance of the links, in the world", "mm")
    e_vel: float | None = column("mean error of the links' velocities, in the world", "mm/frame")
    e_acc: float | None = column("mean error of their accelerations", "mm/frame²")
    delay_p99: float | None = column(
        "99th percentile from a state to the command computed from it", "s"
    )
    torque_rms: float | None = column("RMS torque of all joints", "N·m")
    torque_use: float | None = column("highest 99th percentile of a joint's torque over its limit")
    saturated: float | None = column("fraction of the states with a joint at its limit")
    power: float | None = column("power of all motors", "W")
    worst_joint: str | None = column("joint with the largest RMSE")

    output: str | None = column("written file, below the library's directory")
    report: str | None = column("report of the session, below the library's directory")
    seconds: float | None = column("computing time", "s")
    memory: float | None = column("memory of the process afterwards", "MB")
    limits: str = column("limits of time and memory", default="")


_PLAYABLE: Final = {"yes": 1.0, "inexact": 0.5, "no": 0.0}
_KINDS: Final[set[Any]] = {bool, float, Int, Playable}
CONDITION_NAMES: Final = (
    "ok",
    "played",
    *(
        name
        for name, one in MotionRow.model_fields.items()
        if _KINDS.intersection(get_args(one.annotation))
    ),
)
"""The names for conditions on a row: its numeric or yes/no columns, `ok`, and `played`, which is
another name of `progress`, as in comparisons."""


def condition_value(row: Mapping[str, Any], name: str) -> float | None:
    """The value of a condition's name as a number; None if it is unknown.

    Args:
        row: row of the table of motions, with None or NaN for values that were not computed.
        name: one of `CONDITION_NAMES`.
    """
    column = "progress" if name == "played" else name
    value = row["status"] == "ok" if name == "ok" else row[column]
    unknown = value is None or (isinstance(value, float) and isnan(value))
    return None if unknown else float(_PLAYABLE.get(value, value))


class JointRow(Record):
    """Results for a joint in a motion."""

    key: str = column("key of the motion's row", default=...)
    joint: str = column("name of the joint", default=...)
    lowest: float | None = column("smallest angle in the motion", "rad")
    highest: float | None = column("largest angle in the motion", "rad")
    max_speed: float | None = column("highest streamed speed", "rad/s")
    torque_limit: float | None = column("the smaller of the motor's and the URDF's limit", "N·m")
    torque_bolted: float | None = column("largest torque of the motion, with sign, bolted", "N·m")
    torque_hanging: float | None = column("largest torque of the motion, with sign, hanging", "N·m")
    torque_follow: float | None = column(
        "largest torque of the motion, with sign, following", "N·m"
    )
    torque_free: float | None = column("largest torque of the motion, with sign, free", "N·m")
    rmse: float | None = column("RMSE of the simulated joint", "rad")
    bias: float | None = column("mean error", "rad")
    p99: float | None = column("99th percentile of the absolute error", "rad")
    max: float | None = column("largest error", "rad")
    delay: float | None = column("delay behind the reference", "s")
    torque_p99: float | None = column("99th percentile of the absolute torque", "N·m")
    torque_use: float | None = column("the same over its limit")
    saturated: float | None = column("fraction of the states at its limit")


class Rows(Record):
    """The rows of one motion, and the values of a sweep, which have their own columns."""

    motion: MotionRow
    joints: list[JointRow] = Field(default_factory=list)
    sweep: dict[str, float | str] = Field(default_factory=dict)


_EXTRA: Final = "library", "A library's tables need"
_TABLES: Final[dict[str, type[Record]]] = {"joints": JointRow, "motions": MotionRow}
#: Number of small parts that are merged into one, and the most rows of a small part.
_MOST_PARTS: Final = 64
_SMALL: Final = 5_000


@dataclass(frozen=True)
class Library:
    """The tables of a library.

    Attributes:
        path: path of its directory.
        motions: a row for each motion and variant, with a column `key`.
        joints: a row for each of their joints, with the `key` of its motion.
    """

    path: Path
    motions: pandas.DataFrame
    joints: pandas.DataFrame

    def __repr__(self) -> str:
        return f"<Library {self.path}: {counted(len(self.motions), 'row')}>"


def open_library(path: str | Path) -> Library:
    """Read the tables of a library, also while it is being computed.

    Args:
        path: path of its directory, the `-o` of `g1stream library`.

    Raises:
        ConfigError: the extra `library` is not installed.
        RecordingError: there is no library, or a part of it is damaged.
    """
    path = Path(path)
    # Joints are read last, so that every motion has its joints.
    motions, joints = _read_tables(path, "motions", "joints")
    motions = _newest(motions)
    frame = joints.to_pandas().drop_duplicates(["key", "joint"], keep="last")
    frame = frame[frame["key"].isin(motions["key"])].reset_index(drop=True)
    return Library(path, motions, frame)


def newest_motions(path: Path) -> pandas.DataFrame:
    """Only `Library.motions`, in a tenth of the memory; errors are those of `open_library`."""
    (motions,) = _read_tables(path, "motions")
    return _newest(motions)


def _read_tables(path: Path, *names: str) -> list[Any]:
    for _ in range(5):
        try:
            tables = [_read(path / name) for name in names]
            break
        except FileNotFoundError:  # a part was merged meanwhile
            continue
    else:
        raise RecordingError(f"{path} changes too fast to be read.", "Try again.")
    if any(one is None for one in tables):
        raise RecordingError(
            f"There is no library at {path}.", "Make one: g1stream library check PATH... -o DIR."
        )
    return tables


def _newest(table: Any) -> pandas.DataFrame:
    motions: pandas.DataFrame = table.to_pandas()
    same = motions["path"].where(motions["sha256"] == "", motions["sha256"])
    newest = ~motions.assign(sha256=same).duplicated(["sha256", "command", "variant"], keep="last")
    # A broken file has no variant, and may have been replaced by a valid one.
    newest &= (motions["status"] != "broken") | ~motions.duplicated(
        ["path", "command"], keep="last"
    )
    return motions[newest].reset_index(drop=True)


def _parts(directory: Path) -> list[Path]:
    return sorted(directory.glob("part-*.parquet"))


def _read(directory: Path) -> Any:
    """The table in a directory, oldest rows first; None if there is none.

    Raises:
        FileNotFoundError: a part was removed meanwhile.
        RecordingError: a part is damaged.
    """
    arrow = import_extra("pyarrow", *_EXTRA)
    import_extra("pandas", *_EXTRA)
    parts = _parts(directory)
    return _concatenated(arrow, [_read_part(part) for part in parts]) if parts else None


def _read_part(path: Path) -> Any:
    from pyarrow import parquet

    with _damage_named(path):
        # Most parts are small, so threads bring no gain.
        return parquet.read_table(path, partitioning=None, use_threads=False)


def _small_parts(directory: Path) -> list[Path]:
    return [part for part in _parts(directory) if _rows_in(part) < _SMALL]


def _rows_in(path: Path) -> int:
    from pyarrow import parquet

    with _damage_named(path):
        return int(parquet.read_metadata(path).num_rows)


@contextmanager
def _damage_named(path: Path) -> Iterator[None]:
    import pyarrow

    try:
        yield
    except FileNotFoundError:
        raise
    except (pyarrow.ArrowException, OSError) as error:
        raise RecordingError(
            f"{path} is damaged: {error}.", "Remove it, and compute its motions into a new library."
        ) from error


def _concatenated(arrow: Any, tables: Sequence[Any]) -> Any:
    """Concatenate tables, which may have different columns of sweeps.

    A column with text in one table and numbers in another becomes text.
    """
    kinds: dict[str, set[Any]] = {}
    for field in (field for table in tables for field in table.schema):
        kinds.setdefault(field.name, set()).add(field.type)
    for name in [name for name, several in kinds.items() if len(several) > 1]:
        tables = [_as_words(arrow, table, name) for table in tables]
    return arrow.concat_tables(tables, promote_options="default")


def _as_words(arrow: Any, table: Any, name: str) -> Any:
    place = table.schema.get_field_index(name)
    if place < 0:
        return table
    return table.set_column(place, name, table.column(place).cast(arrow.string()))


class TableWriter:
    """Adds rows to a library. Create it with `writing`."""

    def __init__(self, directory: Path) -> None:
        self._arrow = import_extra("pyarrow", *_EXTRA)
        self._directories = {name: directory / name for name in _TABLES}
        for table in self._directories.values():
            with output_errors(table):
                table.mkdir(parents=True, exist_ok=True)
            for left in table.glob(".*.part"):  # from a killed process
                left.unlink()
        known = _read(self._directories["motions"])
        columns = ["sha256", "path", "command", "variant", "key", "status", "limits"]
        rows = _newest(known.select(columns)).to_dict("records") if known else []
        self._known = {row["key"]: row for row in rows}
        names = [part.stem for part in _parts(self._directories["motions"])]
        names += [part.stem for part in _parts(self._directories["joints"])]
        self._number = max((int(name.partition("-")[2]) for name in names), default=0)
        self._n_small = len(_small_parts(self._directories["motions"]))

    def has(self, key: str, limits: str) -> bool:
        """Whether a row exists and need not be computed.

        Args:
            key: key of the row.
            limits: a row that failed within other limits is computed again.
        """
        row = self._known.get(key)
        if row is None or row["status"] == "error":
            return False
        return row["status"] not in ("huge", "slow", "crashed") or row["limits"] == limits

    def add(self, several: Sequence[Rows]) -> None:
        """Write rows as a new part of each table."""
        self._number += 1
        joints = [joint.model_dump() for rows in several for joint in rows.joints]
        motions = [{**rows.motion.model_dump(), **rows.sweep} for rows in several]
        own = {name: type(value) for rows in several for name, value in rows.sweep.items()}
        self._write("joints", _table(self._arrow, JointRow, joints))
        self._write("motions", _table(self._arrow, MotionRow, motions, own))
        self._n_small += len(several) < _SMALL
        if self._n_small >= _MOST_PARTS:
            self.merge()

    def merge(self) -> None:
        """Merge the small parts of each table."""
        self._number += 1
        for name, directory in self._directories.items():
            small = _small_parts(directory)
            if len(small) > 1:
                self._write(name, _concatenated(self._arrow, [_read_part(part) for part in small]))
                for part in small:
                    part.unlink()
        self._n_small = len(_small_parts(self._directories["motions"]))

    def _write(self, name: str, table: Any) -> None:
        from pyarrow import parquet

        path = self._directories[name] / f"part-{self._number:06d}.parquet"
        with complete_file(path, force=False) as temporary:
            parquet.write_table(table, temporary, compression="zstd")


@contextmanager
def writing(directory: Path) -> Iterator[TableWriter]:
    """Write to a library, with exclusive access.

    Raises:
        ConfigError: the extra `library` is not installed.
        RecordingError: another process writes to it, or it cannot be written.
    """
    with output_errors(directory):
        directory.mkdir(parents=True, exist_ok=True)
        lock = (directory / LIBRARY).open("w")
    with lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise RecordingError(
                f"Another process is writing to {directory}.",
                "Wait until it ends, or choose another directory.",
            ) from None
        writer = TableWriter(directory)
        try:
            yield writer
        finally:
            writer.merge()


def _table(
    arrow: Any,
    kind: type[Record],
    rows: list[dict[str, Any]],
    own: Mapping[str, type] | None = None,
) -> Any:
    """Rows as a table with the columns of a record, and its `own` columns of a sweep."""
    fields = [
        arrow.field(name, _type(arrow, one.annotation), metadata=_about(one))
        for name, one in kind.model_fields.items()
    ]
    fields += [arrow.field(name, _type(arrow, values)) for name, values in (own or {}).items()]
    return arrow.Table.from_pylist(rows, arrow.schema(fields))


def _type(arrow: Any, annotation: Any) -> Any:
    """The Arrow type of a column: the first type of `X | None`, and the value type of a Literal."""
    kinds = {bool: arrow.bool_(), int: arrow.int64(), float: arrow.float64(), str: arrow.string()}
    while annotation not in kinds:
        annotation = get_args(annotation)[0] if get_args(annotation) else type(annotation)
    return kinds[annotation]


def _about(one: Any) -> dict[str, str]:
    return {"description": one.description, "unit": one.json_schema_extra["unit"]}
