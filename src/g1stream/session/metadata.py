"""The metadata record of a session: any JSON values, kept in MCAP's map of strings.

Strings are kept as they are, so that every MCAP tool shows them plainly; everything else becomes
JSON. A string that would read as JSON (`0.10`, `true`) is quoted, so that it comes back a string.
"""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from collections.abc import Mapping

    from g1stream.session.mcap_reader import McapFile

__all__ = ["METADATA_NAME", "metadata_from_strings", "metadata_to_strings", "session_metadata"]

METADATA_NAME: Final = "g1stream"
"""The name of the record. A file may have several; a later one's values replace an earlier's."""


def metadata_to_strings(values: Mapping[str, Any]) -> dict[str, str]:
    """Flatten values for MCAP.

    Raises:
        TypeError: a value is neither JSON nor a numpy array or scalar.
    """
    return {key: _to_string(value) for key, value in values.items()}


def metadata_from_strings(strings: Mapping[str, str]) -> dict[str, Any]:
    """The values that `metadata_to_strings` flattened."""
    return {key: _from_string(string) for key, string in strings.items()}


def session_metadata(file: McapFile) -> dict[str, Any]:
    """What a file's recorder noted; what it noted later replaces what it noted earlier."""
    values: dict[str, Any] = {}
    for record in file.metadata:
        if record.name == METADATA_NAME:
            values |= metadata_from_strings(record.metadata)
    return values


def _to_string(value: Any) -> str:
    if isinstance(value, str) and _from_string(value) is value:
        return value
    return json.dumps(value, default=_from_numpy)


def _from_string(string: str) -> Any:
    try:
        return json.loads(string)
    except ValueError:
        return string


def _from_numpy(value: Any) -> Any:
    if hasattr(value, "tolist"):
        return value.tolist()
    raise TypeError(f"{type(value).__name__} is not JSON")
