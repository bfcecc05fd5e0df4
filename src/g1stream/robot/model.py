"""The robot that everything else is given: the default one, or a URDF of the user's."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from importlib import resources
from pathlib import Path

from g1stream.errors import RobotError
from g1stream.robot.table import read_table
from g1stream.robot.tree import KinematicTree
from g1stream.robot.urdf import parse_urdf

__all__ = ["DEFAULT_TABLE", "DEFAULT_URDF", "G1"]

DEFAULT_URDF = resources.files(__package__) / "g1_29dof.urdf"
DEFAULT_TABLE = resources.files(__package__) / "g1_29dof.json"


@dataclass(frozen=True, eq=False, repr=False)
class G1(KinematicTree):
    """A 29-joint G1: its links and joints as arrays, and the URDF they were read from.

    Attributes:
        source: path of the URDF, or "default".
        urdf: the URDF's XML text.
    """

    source: str
    urdf: str

    def __repr__(self) -> str:
        return f"G1(name={self.name!r}, source={self.source!r}, links={len(self.link_names)})"

    @classmethod
    @cache
    def default(cls) -> G1:
        """The robot that comes with this package: figures of g1_29dof_rev_1_0, primitive shapes.

        Takes milliseconds, as its URDF was compiled beforehand. Every call returns the same object.
        """
        urdf = DEFAULT_URDF.read_text(encoding="utf-8")
        tree = read_table(DEFAULT_TABLE.read_text(encoding="utf-8"), urdf)
        return cls(**vars(tree or parse_urdf(urdf, "default")), source="default", urdf=urdf)

    @classmethod
    def load(cls, path: str | Path | None = None) -> G1:
        """The robot of a URDF file; without a path, the default one.

        Mesh files need not exist: only names, frames and limits are read.

        Raises:
            RobotError: there is no such file, or it does not describe a 29-joint G1.
        """
        if path is None:
            return cls.default()
        urdf = _read_text(Path(path))
        return cls(**vars(parse_urdf(urdf, str(path))), source=str(path), urdf=urdf)


def _read_text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except OSError as error:
        raise RobotError(
            f"The URDF {path} cannot be read: {error.strerror}.",
            "Give the path of a URDF file, or none for the robot that g1stream brings.",
        ) from error
    except UnicodeDecodeError as error:
        raise RobotError(
            f"The URDF {path} is not text: its byte {error.start} is not UTF-8.",
            "Give a URDF in XML, saved as UTF-8.",
        ) from error
