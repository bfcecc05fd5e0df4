"""Schemas of the wire as ROS 2 message text, so that any reader decodes a session's samples."""

from __future__ import annotations

from typing import Any, Final

from g1stream.dds.layout import members

__all__ = ["ros2_name", "ros2msg"]

_SEPARATOR: Final = "=" * 80


def ros2_name(idl_type: Any) -> str:
    """The ROS 2 name of a type: `unitree_hg.msg.dds_.LowCmd_` is `unitree_hg/msg/LowCmd`."""
    package, name = _split(idl_type)
    return f"{package}/msg/{name}"


def ros2msg(idl_type: Any) -> str:
    """A type as ROS 2 message text, with the definitions of all the types inside it.

    Raw samples decode with it as they are: ROS 2 has the same plain CDR on the wire.
    """
    nested = (
        f"{_SEPARATOR}\nMSG: {_field_type(struct)}\n{_definition(struct)}"
        for struct in _nested(idl_type)
    )
    return _definition(idl_type) + "".join(nested)


def _definition(idl_type: Any) -> str:
    lines = []
    for name, (element, length) in members(idl_type).items():
        size = "" if length is None else f"[{length}]"
        lines.append(f"{_field_type(element)}{size} {name}\n")
    return "".join(lines)


def _field_type(element: Any) -> str:
    if isinstance(element, str):
        return "uint8" if element == "byte" else element
    return "/".join(_split(element))


def _nested(idl_type: Any) -> list[Any]:
    """The struct types inside a type, each once, those used first first."""
    found: dict[str, Any] = {}
    for element, _ in members(idl_type).values():
        if not isinstance(element, str):
            for struct in (element, *_nested(element)):
                found.setdefault(struct.__idl_typename__, struct)
    return list(found.values())


def _split(idl_type: Any) -> tuple[str, str]:
    """Package and bare name, without the `dds_` and the underscore that mark DDS names."""
    parts = idl_type.__idl_typename__.split(".")
    return parts[0], parts[-1].removesuffix("_")
