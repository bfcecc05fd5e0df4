"""Replacement for the parts of cyclonedds in `g1stream.dds.types`, if it cannot be imported."""

from types import SimpleNamespace
from typing import Annotated, Any, Final, NamedTuple

__all__ = ["annotations", "make_idl_struct", "types"]


class _Length(NamedTuple):
    subtype: Any
    length: int


class _Array:
    def __class_getitem__(cls, about: tuple[Any, int]) -> Any:
        return Annotated[list, _Length(*about)]


def _same(kind: Any) -> Any:
    return kind


def make_idl_struct(_: str, typename: str, fields: dict[str, Any]) -> Any:
    """Make a class with the annotations of a struct, without a serialiser."""
    return type(typename, (), {"__annotations__": fields, "__idl_typename__": typename})


annotations: Final = SimpleNamespace(final=_same, autoid=lambda _: _same)
_NAMES: Final = ("byte", "int16", "int32", "uint32", "uint64", "float32", "float64")
types: Final = SimpleNamespace(array=_Array, **{name: Annotated[Any, name] for name in _NAMES})
