"""Motions in Parquet: the columns of the Foxglove CSV, with the frame rate in the file's metadata.

Needs pyarrow, the extra `export`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import numpy as np

from g1stream.motion.csv import ROOT_COLUMNS, canonical_column
from g1stream.optional import import_extra
from g1stream.robot.joints import JOINT_NAMES
from g1stream.robot.rotations import xyzw_from_wxyz

if TYPE_CHECKING:
    from pathlib import Path

    from g1stream.motion.motion import Motion

__all__ = ["is_parquet", "read_parquet", "write_parquet"]

_FRAME, *_ROOT = ROOT_COLUMNS
_POSITION, _QUAT_XYZW = _ROOT[:3], _ROOT[3:]
_FPS: Final = b"fps"
#: Bytes of a file unpacked, and numbers in it, which may be packed as one and a count.
_LARGEST: Final = 512 * 2**20
_MOST_NUMBERS: Final = 2**26


def is_parquet(data: bytes) -> bool:
    """Whether content begins as that of a Parquet file does."""
    return data.startswith(b"PAR1")


def read_parquet(data: bytes) -> dict[str, Any]:
    """The columns of a Parquet file as named arrays: `joint_pos` with `joint_names`, and the root.

    Columns that are no numbers are not read.

    Raises:
        ValueError: it is damaged or too large, or has no column of a joint, or two of one.
        ConfigError: pyarrow is not installed.
    """
    pyarrow, parquet = _pyarrow()
    try:
        file = parquet.ParquetFile(pyarrow.BufferReader(data))
        about = file.metadata
        size = sum(about.row_group(i).total_byte_size for i in range(about.num_row_groups))
        if size > _LARGEST or about.num_rows * about.num_columns > _MOST_NUMBERS:
            raise ValueError("it is too large: a motion has 512 MiB at most")
        numbers = [
            field.name
            for field in file.schema_arrow
            if pyarrow.types.is_integer(field.type) or pyarrow.types.is_floating(field.type)
        ]
        table = file.read(columns=numbers)
    except (pyarrow.ArrowException, OSError) as error:
        raise ValueError(f"it is damaged or cut off: {str(error).partition('.')[0]}") from error
    names = [canonical_column(name) for name in table.column_names]
    repeated = {name for name in names if names.count(name) > 1}
    if repeated:
        raise ValueError(f"it has two columns of {', '.join(sorted(repeated))}")
    columns = {
        name: column.to_numpy().astype(np.float64)
        for name, column in zip(names, table.columns, strict=True)
    }
    joints = [name for name in columns if name not in ROOT_COLUMNS]
    if not set(joints) & set(JOINT_NAMES):
        raise ValueError(f"no column is a joint; it has {', '.join(columns) or 'no numbers'}")
    arrays = {
        "joint_names": joints,
        "joint_pos": np.column_stack([columns[name] for name in joints]),
    }
    if set(_ROOT) <= columns.keys():
        arrays["root_pos"] = np.column_stack([columns[name] for name in _POSITION])
        arrays["root_quat_xyzw"] = np.column_stack([columns[name] for name in _QUAT_XYZW])
    fps = (table.schema.metadata or {}).get(_FPS)
    return arrays | ({"fps": float(fps)} if fps else {})


def write_parquet(motion: Motion, path: Path) -> None:
    """Write a motion, every number as it is.

    Raises:
        ConfigError: pyarrow is not installed.
    """
    pyarrow, parquet = _pyarrow()
    root = np.hstack([motion.root_pos, xyzw_from_wxyz(motion.root_quat_wxyz)])
    columns = {
        _FRAME: np.arange(motion.n_frames),
        **dict(zip(_ROOT, root.T, strict=True)),
        **dict(zip(motion.joint_names, motion.joint_pos.T, strict=True)),
    }
    table = pyarrow.table(columns).replace_schema_metadata({_FPS: repr(motion.fps)})
    parquet.write_table(table, path)


def _pyarrow() -> tuple[Any, Any]:
    extra = "export", "Parquet files need"
    return import_extra("pyarrow", *extra), import_extra("pyarrow.parquet", *extra)
