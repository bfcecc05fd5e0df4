"""The tables of a library: Parquet files that are readable while they grow.

    library/motions/part-000012.parquet    one row a motion and variant
    library/joints/part-000012.parquet     one row a joint of it

What was computed is written as soon as the last write is done, as a part of each table; the parts
appear complete, that of the joints first. Many small parts become one. A row that was computed
anew, as settings or versions are others, replaces the older one for who reads.
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
"""What became of a motion: computed; no motion can be read from the file; a motion that is not
played so; it took too much memory, or time; its process ended; or we failed."""


FORMAT: Final = 3
"""Of the tables: another number where a column changes, so that rows are computed again."""


def column(description: str, unit: str = "", default: Any = None) -> Any:
    """A column of a table, with its meaning and its unit."""
    return Field(default, description=description, json_schema_extra={"unit": unit})


class MotionRow(Record):
    """What is known of a motion. What was not computed is None."""

    key: str = column("of this row: content, variant, settings and versions", default=...)
    name: str = column("of the file, without its ending", default=...)
    path: str = column("of the file, or its URL", default=...)
    sha256: str = column("of its content", default=...)
    command: Command = column("that computed the row", default=...)
    variant: str = column("support, policy and values of a sweep, or the format", default="")
    support: str | None = column("how the pelvis was held")
    policy: str | None = column("name of the policy that played it")
    policy_sha256: str | None = column("of the policy's files")
    status: Status = column("what became of it", default="ok")
    reason: str | None = column("why it is not ok")
    frames: Int | None = column("of the motion")
    fps: float | None = column("of the motion", "Hz")
    duration: float | None = column("of the motion", "s")

    bolted: Playable | None = column("whether it can be played, the pelvis bolted")
    hanging: Playable | None = column("whether it can be played, hanging")
    follow: Playable | None = column("whether it can be played, the pelvis following the reference")
    free: Playable | None = column("whether it can be played, standing free")
    feet: Playable | None = column("whether it can be played on its own feet, changed to stand")
    causes: str | None = column("what speaks against it, by support")
    within_limits: bool | None = column("whether it keeps the limits of position and speed")
    looks_like: str | None = column("what a limit that is passed looks like")
    max_speed: float | None = column("of a joint", "rad/s")
    max_tilt: float | None = column("of the pelvis", "rad")
    max_collision: float | None = column("depth of two links in each other", "mm")
    max_penetration: float | None = column("depth of a foot below the floor", "mm")
    max_skating: float | None = column("speed of a foot on the floor", "mm/s")
    least_margin: float | None = column(
        "from the centre of pressure to the edge of the support polygon", "mm"
    )
    supported: float | None = column("share of the frames with a foot on the floor")
    torque_bolted: float | None = column("the largest of a joint over its limit, bolted")
    torque_hanging: float | None = column("the largest of a joint over its limit, hanging")
    torque_follow: float | None = column("the largest of a joint over its limit, following")
    torque_free: float | None = column("the largest of a joint over its limit, free")

    completed: bool | None = column("whether it was played to its end")
    ended: str | None = column("why it was not")
    success: bool | None = column("played to its end and followed, as `session.metrics()` has it")
    success_sonic: bool | None = column("the same within SONIC's limits; None where it is held")
    failed_at: float | None = column("when it was beyond those limits for the first time", "s")
    failed_link: str | None = column("the link that was")
    progress: float | None = column("share of the motion that was played")
    survived: float | None = column("how long it was played, to its end or to a fall", "s")
    rmse: float | None = column("of all joints", "rad")
    mae: float | None = column("mean absolute error of all joints", "rad")
    p99: float | None = column("99th percentile of the absolute error", "rad")
    max: float | None = column("the greatest error", "rad")
    bias: float | None = column("root mean square of the joints' mean errors", "rad")
    delay: float | None = column("by which the joints are behind the reference", "s")
    velocity_rmse: float | None = column("of all joints", "rad/s")
    mpjpe: float | None = column("mean distance of the links, in the pelvis's frame", "mm")
    mpjpe_root: float | None = column("distance of the links, with the pelvis's attitude", "mm")
    mpjpe_world: float | None = column("distance of the links, in the world", "mm")
    e_vel: float | None = column("mean error of the links' velocities, in the world", "mm/frame")
    e_acc: float | None = column("of their accelerations", "mm/frame²")
    delay_p99: float | None = column("from a state to the command that is made of it", "s")
    torque_rms: float | None = column("of all joints", "N·m")
    torque_use: float | None = column("99th percentile of a joint over its limit, the highest")
    saturated: float | None = column("share of the states with a joint at its limit")
    power: float | None = column("of all motors", "W")
    worst_joint: str | None = column("the one with the greatest RMSE")

    output: str | None = column("the file that was written, below the library's directory")
    report: str | None = column("the report of the session, below the library's directory")
    seconds: float | None = column("that it took to compute", "s")
    memory: float | None = column("of its process afterwards", "MB")
    limits: str = column("of time and memory for it", default="")
    picture: str | None = column("five poses, as the path of an SVG 100 wide and 30 high")


_PLAYABLE: Final = {"yes": 1.0, "inexact": 0.5, "no": 0.0}
_KINDS: Final[set[Any]] = {bool, float, Int, Playable}
CONDITION_NAMES: Final = (
    "ok",
    *(
        name
        for name, one in MotionRow.model_fields.items()
        if _KINDS.intersection(get_args(one.annotation))
    ),
)
"""What a condition on a row can name: its columns that are numbers or answers, and `ok`."""


def condition_value(row: Mapping[str, Any], name: str) -> float | None:
    """What a condition names, as a number; None for what is not known.

    Args:
        row: of the table of motions, with None or NaN for what was not computed.
        name: of `CONDITION_NAMES`.
    """
    value = row["status"] == "ok" if name == "ok" else row[name]
    unknown = value is None or (isinstance(value, float) and isnan(value))
    return None if unknown else float(_PLAYABLE.get(value, value))


class JointRow(Record):
    """What is known of a joint in a motion."""

    key: str = column("of the motion's row", default=...)
    joint: str = column("its name", default=...)
    lowest: float | None = column("the smallest angle in the motion", "rad")
    highest: float | None = column("the largest angle in the motion", "rad")
    max_speed: float | None = column("as streamed", "rad/s")
    torque_limit: float | None = column("the smaller of the motor's and the URDF's", "N·m")
    torque_bolted: float | None = column("the largest of the motion, with sign, bolted", "N·m")
    torque_hanging: float | None = column("the largest of the motion, with sign, hanging", "N·m")
    torque_follow: float | None = column("the largest of the motion, with sign, following", "N·m")
    torque_free: float | None = column("the largest of the motion, with sign, free", "N·m")
    rmse: float | None = column("of the simulated joint", "rad")
    bias: float | None = column("its mean error", "rad")
    p99: float | None = column("99th percentile of its absolute error", "rad")
    max: float | None = column("its greatest error", "rad")
    delay: float | None = column("by which it is behind the reference", "s")
    torque_p99: float | None = column("99th percentile of its absolute torque", "N·m")
    torque_use: float | None = column("the same over its limit")
    saturated: float | None = column("share of the states at its limit")


class Rows(Record):
    """The rows of one motion, and the values of a sweep that go into columns of their own."""

    motion: MotionRow
    joints: list[JointRow] = Field(default_factory=list)
    sweep: dict[str, float | str] = Field(default_factory=dict)


_EXTRA: Final = "library", "A library's tables need"
_TABLES: Final[dict[str, type[Record]]] = {"joints": JointRow, "motions": MotionRow}
#: So many small parts are made one; a part with more rows than this is not small.
_MOST_PARTS: Final = 64
_SMALL: Final = 5_000


@dataclass(frozen=True)
class Library:
    """What is known of the motions of a library.

    Attributes:
        path: of its directory.
        motions: a row for each motion and variant, with a column `key`.
        joints: a row for each joint of those, with the `key` of its motion.
    """

    path: Path
    motions: pandas.DataFrame
    joints: pandas.DataFrame

    def __repr__(self) -> str:
        return f"<Library {self.path}: {counted(len(self.motions), 'row')}>"


def open_library(path: str | Path) -> Library:
    """Read the tables of a library, also while it is computed.

    Args:
        path: of its directory, the `-o` of `g1stream library`.

    Raises:
        ConfigError: the extra `library` is not installed.
        RecordingError: there is no library, or a part of it is damaged.
    """
    path = Path(path)
    # Joints last: what has a row has its joints.
    motions, joints = _read_tables(path, "motions", "joints")
    motions = _newest(motions)
    frame = joints.to_pandas().drop_duplicates(["key", "joint"], keep="last")
    frame = frame[frame["key"].isin(motions["key"])].reset_index(drop=True)
    return Library(path, motions, frame)


def newest_motions(path: Path) -> pandas.DataFrame:
    """`Library.motions` alone, in a tenth of the memory; errors are those of `open_library`."""
    (motions,) = _read_tables(path, "motions")
    return _newest(motions)


def _read_tables(path: Path, *names: str) -> list[Any]:
    for _ in range(5):
        try:
            tables = [_read(path / name) for name in names]
            break
        except FileNotFoundError:  # a part became one with others meanwhile
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
    # A broken file has no variant, and may have become whole.
    newest &= (motions["status"] != "broken") | ~motions.duplicated(
        ["path", "command"], keep="last"
    )
    return motions[newest].reset_index(drop=True)


def _parts(directory: Path) -> list[Path]:
    return sorted(directory.glob("part-*.parquet"))


def _read(directory: Path) -> Any:
    """The table in a directory, oldest rows first; None where there is none.

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
        # Most parts are small: threads gain nothing.
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
            f"{path} is damaged: {error}.", "Remove it, and compute what it had into a new library."
        ) from error


def _concatenated(arrow: Any, tables: Sequence[Any]) -> Any:
    """Tables below one another; sweeps have columns that others do not have.

    A column with words in one and numbers in another has the numbers as words, too.
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
    """Adds rows to a library. Use `writing`."""

    def __init__(self, directory: Path) -> None:
        self._arrow = import_extra("pyarrow", *_EXTRA)
        self._directories = {name: directory / name for name in _TABLES}
        for table in self._directories.values():
            with output_errors(table):
                table.mkdir(parents=True, exist_ok=True)
            for left in table.glob(".*.part"):  # of a process that was killed
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
        """Whether a row is there that need not be computed.

        Args:
            key: of the row.
            limits: one that failed within other limits than these does.
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
        """Make the small parts of each table one."""
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
    """Write to a library, as the only one that does.

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
                "Wait until it is done, or choose another directory.",
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
    """Rows as a table with the columns of a record, and with `own` ones of a sweep."""
    fields = [
        arrow.field(name, _type(arrow, one.annotation), metadata=_about(one))
        for name, one in kind.model_fields.items()
    ]
    fields += [arrow.field(name, _type(arrow, values)) for name, values in (own or {}).items()]
    return arrow.Table.from_pylist(rows, arrow.schema(fields))


def _type(arrow: Any, annotation: Any) -> Any:
    """The type of a column: of the first of `X | None`, and of what a Literal is of."""
    kinds = {bool: arrow.bool_(), int: arrow.int64(), float: arrow.float64(), str: arrow.string()}
    while annotation not in kinds:
        annotation = get_args(annotation)[0] if get_args(annotation) else type(annotation)
    return kinds[annotation]


def _about(one: Any) -> dict[str, str]:
    return {"description": one.description, "unit": one.json_schema_extra["unit"]}
