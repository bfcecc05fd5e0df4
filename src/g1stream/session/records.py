"""Records: what is written as JSON into a session file, and read back from one of any version."""

from __future__ import annotations

from typing import Annotated, Any, TypeVar

from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    PlainSerializer,
    ValidationError,
)

from g1stream.types import Phase

__all__ = ["Int", "Percentiles", "PhaseName", "Record", "read_record"]

Int = Annotated[int, Field(ge=-(2**63), lt=2**63)]
PhaseName = Annotated[
    Phase,
    BeforeValidator(
        lambda value: Phase.__members__.get(value) if isinstance(value, str) else value
    ),
    PlainSerializer(lambda phase: phase.name, return_type=str, when_used="json"),
]
"""A phase, in JSON by its name."""


class Record(BaseModel):
    """What is written as JSON; its numbers are finite."""

    # A file of another version may have more fields, or fewer.
    model_config = ConfigDict(extra="ignore", allow_inf_nan=False, validate_default=False)


RecordT = TypeVar("RecordT", bound=BaseModel)


def read_record(
    kind: type[RecordT], values: Any, where: str = ""
) -> tuple[RecordT | None, list[str]]:
    """A record from the metadata of a session file, whoever wrote it.

    Args:
        kind: the class of the record; all its fields have defaults.
        values: as they are in the file; None where there are none.
        where: the key that they are under, for the sentences.

    Returns:
        The record without the fields whose values are not valid, None where there is no record at
        all; and a sentence for each value that was left out.
    """
    if values is None:
        return None, []
    if not isinstance(values, dict):
        return None, [f"The metadata {where or 'record'} is not a table: {values!r:.60}."]
    try:
        return kind.model_validate(values), []
    except ValidationError as error:
        wrong = list(dict.fromkeys(one["loc"][0] for one in error.errors()))
    record, more = read_record(kind, {k: v for k, v in values.items() if k not in wrong}, where)
    keys = [f"{where}.{name}" if where else name for name in wrong]
    problems = [
        f"The metadata {k} is not valid: {values[w]!r:.60}."
        for k, w in zip(keys, wrong, strict=True)
    ]
    return record, problems + more


class Percentiles(Record):
    """Of a latency or lateness; the field that it is in names the unit."""

    p50: float
    p99: float
    p99_9: float
    max: float
