"""Numbers of schemas and channels."""

from __future__ import annotations

from dataclasses import dataclass

import pytest

from g1stream.session.registry import Registry


@dataclass(frozen=True)
class Kind:
    """What the registry asks of a channel."""

    topic: str
    schema_name: str
    schema_encoding: str = "ros2msg"
    message_encoding: str = "cdr"
    description: str = "something"
    built: tuple[list[str]] = ([],)

    def build_schema(self):
        self.built[0].append(self.schema_name)
        return self.schema_name.encode()


def test_each_is_numbered_once_and_channels_of_a_type_share_its_schema():
    registry, built = Registry(), []
    kinds = [Kind(topic, name, built=(built,)) for topic, name in zip("abc", "xyx", strict=True)]
    assert [registry.number(kind) for kind in (*kinds, *kinds)] == [1, 2, 3, 1, 2, 3]
    assert built == ["x", "y"]
    assert {s.name: (s.id, s.data) for s in registry.schemas.values()} == {
        "x": (1, b"x"),
        "y": (2, b"y"),
    }
    schema, channel = registry.describe(3)
    assert (schema.id, channel.id, channel.schema_id, channel.topic) == (1, 3, 1, "c")


def test_a_number_that_was_never_given_is_not_described():
    with pytest.raises(KeyError):
        Registry().describe(1)
