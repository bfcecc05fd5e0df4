"""The schemas and channels of a file, numbered as they are first used."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

from mcap.records import Channel, Schema

if TYPE_CHECKING:
    from collections.abc import Callable

__all__ = ["ChannelKind", "Registry"]


class ChannelKind(Protocol):
    """What a file says of a channel."""

    @property
    def topic(self) -> str:
        """The channel's name."""

    @property
    def message_encoding(self) -> str:
        """MCAP's well-known name, such as `cdr`."""

    @property
    def description(self) -> str:
        """One line, for people who look into the file."""

    @property
    def schema_name(self) -> str:
        """Channels with the same one share the schema."""

    @property
    def schema_encoding(self) -> str:
        """MCAP's well-known name, such as `ros2msg`."""

    @property
    def build_schema(self) -> Callable[[], bytes]:
        """Makes the schema's data; called once for each schema."""


class Registry:
    """The schemas and channels of one file, each numbered from 1.

    Attributes:
        schemas: by name.
        channels: by topic.
    """

    def __init__(self) -> None:
        self.schemas: dict[str, Schema] = {}
        self.channels: dict[str, Channel] = {}
        self._descriptions: dict[int, tuple[Schema, Channel]] = {}

    def number(self, kind: ChannelKind) -> int:
        """The number of the channel with the kind's topic; a new one is registered."""
        known = self.channels.get(kind.topic)
        if known is not None:
            return known.id
        schema = self.schemas.get(kind.schema_name)
        if schema is None:
            schema = self.schemas[kind.schema_name] = Schema(
                id=len(self.schemas) + 1,
                name=kind.schema_name,
                encoding=kind.schema_encoding,
                data=kind.build_schema(),
            )
        channel = self.channels[kind.topic] = Channel(
            id=len(self.channels) + 1,
            topic=kind.topic,
            message_encoding=kind.message_encoding,
            metadata={"description": kind.description},
            schema_id=schema.id,
        )
        self._descriptions[channel.id] = (schema, channel)
        return channel.id

    def describe(self, channel: int) -> tuple[Schema, Channel]:
        """The records that must precede the first message of a channel, by its number.

        Raises:
            KeyError: there is no such channel.
        """
        return self._descriptions[channel]
