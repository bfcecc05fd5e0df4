"""The observation normalisation of a network, which holds the statistics of the training.

A network of rsl_rl or holosoma begins with (observation - mean) / deviation, both constants.
onnxruntime does not expose constants, so this file reads the few needed fields of ONNX's protobuf.
"""

from __future__ import annotations

from io import BytesIO
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from g1stream.types import Floats

__all__ = ["normaliser"]

#: Field numbers of ModelProto, GraphProto, NodeProto, TensorProto and StringStringEntryProto.
_GRAPH, _NODE, _INITIALIZER = 7, 1, 5
_INPUT, _OUTPUT, _OP_TYPE = 1, 2, 4
_FLOATS, _NAME, _RAW, _EXTERNAL = 4, 8, 9, 13
_KEY, _VALUE = 1, 2
#: Operators that may be between the observation and its normalisation.
_PASSED: Final = {"Cast", "Squeeze", "Clip", "Identity"}

Fields = dict[int, list[bytes]]


class _Node(NamedTuple):
    kind: str
    takes: list[str]
    gives: list[str]


def normaliser(path: Path, observation: str, width: int) -> tuple[Floats, Floats] | None:
    """Mean and deviation, (width,) each, with which a network normalises its observation.

    Args:
        path: path of the ONNX file.
        observation: name of the input.
        width: width of the input.

    Returns:
        None if the network does not begin with a normalisation.
    """
    try:
        graph = _fields(_fields(path.read_bytes())[_GRAPH][0])
        nodes = [_node(_fields(one)) for one in graph.get(_NODE, [])]
        values = observation
        for node in nodes:
            if node.kind in _PASSED and node.takes[0] == values:
                values = node.gives[0]
            elif node.kind == "Sub" and node.takes[0] == values:
                divided = next(
                    one for one in nodes if one.kind == "Div" and one.takes[0] == node.gives[0]
                )
                tensors = {_text(one, _NAME): one for one in map(_fields, graph[_INITIALIZER])}
                mean, deviation = (
                    _values(tensors[name], path) for name in (node.takes[1], divided.takes[1])
                )
                sound = mean.size == deviation.size == width and (deviation > 0.0).all()
                return (mean, deviation) if sound and np.isfinite(mean).all() else None
    except (LookupError, OSError, StopIteration, UnicodeDecodeError, ValueError):
        pass  # another layout, which onnxruntime can still run
    return None


def _node(fields: Fields) -> _Node:
    names = ([one.decode() for one in fields.get(which, [])] for which in (_INPUT, _OUTPUT))
    return _Node(_text(fields, _OP_TYPE), *names)


def _text(fields: Fields, number: int) -> str:
    return fields.get(number, [b""])[0].decode()


def _values(tensor: Fields, path: Path) -> Floats:
    """The values of a tensor of floats, in the file or in external data."""
    data = b"".join(tensor.get(_RAW, []) or tensor.get(_FLOATS, []))
    if _EXTERNAL in tensor:
        entries = map(_fields, tensor[_EXTERNAL])
        told = {_text(one, _KEY): _text(one, _VALUE) for one in entries}
        with path.with_name(Path(told["location"]).name).open("rb") as file:
            file.seek(int(told.get("offset", 0)))
            data = file.read(int(told["length"]))
    return np.frombuffer(data, "<f4").astype(np.float64)


def _fields(message: bytes) -> Fields:
    """The fields of a protobuf message that have a length, by field number."""
    found: Fields = {}
    data = BytesIO(message)
    while (key := _varint(data)) is not None:
        kind = key & 7
        length = _varint(data) if kind in (0, 2) else {1: 8, 5: 4}[kind]  # ONNX has no groups
        if kind == 2:
            found.setdefault(key >> 3, []).append(data.read(length))
        elif kind:
            data.read(length)
    return found


def _varint(data: BytesIO) -> int | None:
    """The next number; None at the end."""
    value = shift = 0
    while byte := data.read(1):
        value |= (byte[0] & 0x7F) << shift
        shift += 7
        if byte[0] < 0x80:
            return value
    return None
