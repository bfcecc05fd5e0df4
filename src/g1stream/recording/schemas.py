"""Schemas as a session file carries them, so that any reader can decode it without this package."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

from google.protobuf.descriptor_pb2 import FileDescriptorSet

from g1stream.dds.layout import members

if TYPE_CHECKING:
    from google.protobuf.message import Message

__all__ = ["protobuf_schema", "ros2_name", "ros2msg"]

_SEPARATOR: Final = "=" * 80


def protobuf_schema(message_class: type[Message]) -> bytes:
    """A serialised FileDescriptorSet of a message and all that it imports, the imported first."""
    files: dict[str, Any] = {}
    _collect(message_class.DESCRIPTOR.file, files)
    collected = FileDescriptorSet()
    for file in files.values():
        file.CopyToProto(collected.file.add())
    schema: bytes = collected.SerializeToString()
    return schema


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


def _collect(file: Any, found: dict[str, Any]) -> None:
    if file.name not in found:
        for imported in file.dependencies:
            _collect(imported, found)
        found[file.name] = file


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
