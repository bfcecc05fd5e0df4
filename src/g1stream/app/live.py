"""A WebSocket server that sends DDS messages live to Foxglove and Lichtblick.

It is a child process and only subscribes, like the recorder. Neither the loop nor a recording
waits for it or its clients. The SDK keeps a bounded queue for each client, and drops the oldest
messages if a client reads too slowly.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, Final

from g1stream.child_process import Parent, optional_child, run_child
from g1stream.config import Config
from g1stream.errors import ConfigError
from g1stream.events import ConsoleHandler, handled_by
from g1stream.optional import require_installed
from g1stream.realtime import lower_priority
from g1stream.recorder.receiver import Receiver
from g1stream.recorder.recorder import raw_messages
from g1stream.robot.model import G1
from g1stream.session.format import CHANNELS, MessageBatch
from g1stream.view.pipeline import MessagePipeline

if TYPE_CHECKING:
    from foxglove.websocket import ChannelView, Client

__all__ = ["live"]

#: Only programs on this host can connect.
_HOST: Final = "127.0.0.1"


@contextmanager
def live(config: Config | None = None) -> Iterator[str]:
    """Serve all data on a DDS domain to Foxglove and Lichtblick for the length of a `with`.

    The channels are those of a session file, with the log times of a recorder. Only clients on this
    machine can connect, and they can only read. If the server fails later, this is only logged.

        with g1stream.live() as address:
            g1stream.stream("demo")

    Args:
        config: all settings; the defaults if omitted.

    Yields:
        The address to open, such as `ws://localhost:8765`, once clients can connect.

    Raises:
        ConfigError: the extra `live` is not installed.
        ChildError: the port is in use, or a setting or the wire is not valid.
    """
    config = config or Config()
    require_installed("foxglove-sdk", "live", "A live view needs")
    with optional_child("live", config, "the live view ended"):
        yield f"ws://localhost:{config.live_port}"


class _Server:
    """Serves the channels of a session file on a WebSocket server, until the process ends.

    `WebSocketServer.stop` is never called: it would wait for a client that does not read.
    """

    def __init__(self, latched: list[MessageBatch], port: int) -> None:
        from foxglove import Channel, Context, Schema, start_server

        self._latched = {messages.topic: bytes(messages.payloads[0]) for messages in latched}
        self._context = Context()  # neither the server nor the channels keep a reference
        self._channels = {
            one.topic: Channel(
                one.topic,
                message_encoding=one.message_encoding,
                schema=Schema(
                    name=one.schema_name, encoding=one.schema_encoding, data=one.build_schema()
                ),
                context=self._context,
            )
            for one in CHANNELS.values()
        }
        listener: Any = self  # it has only the callbacks for what clients can do here
        try:
            self._server = start_server(
                name="g1stream",
                host=_HOST,
                port=port,
                context=self._context,
                server_listener=listener,
            )
        except RuntimeError as error:
            reason = str(error).rpartition(": ")[2]
            raise ConfigError(
                f"The live view cannot listen on port {port}: {reason}.",
                "Stop the program that uses it, or choose another port with --live-port.",
            ) from error

    def send(self, messages: MessageBatch) -> None:
        """Send messages to the clients that have subscribed to their topics. It never waits."""
        channel = self._channels[messages.topic]
        if messages.topic in self._latched or not channel.has_sinks():
            return
        for payload, logged in zip(messages.payloads, messages.log_times.tolist(), strict=True):
            channel.log(bytes(payload), log_time=logged)

    def on_subscribe(self, _: Client, view: ChannelView) -> None:
        """Called by the SDK. It can only send to all clients; they replace the previous message."""
        if view.topic in self._latched:
            channel = self._channels[view.topic]
            channel.log(self._latched[view.topic], log_time=time.time_ns())

    def on_unsubscribe(self, _: Client, view: ChannelView) -> None:
        """Called by the SDK."""


def _run_child(parent: Parent) -> None:
    """Serve the data that a recorder would write, for a parent process.

    The startup message is the config.
    """
    # The SDK logs connections of clients, but the viewer already shows them.
    logging.getLogger("foxglove").addHandler(logging.NullHandler())
    config: Config = parent.startup_message
    settings = config.record
    if settings.channels == "raw":  # reduces the size of a file; viewers would show nothing
        settings = settings.model_copy(update={"channels": "standard"})
    pipeline = MessagePipeline(G1.of_config(config), settings)
    header = pipeline.file_header(time.time_ns())
    with (
        handled_by(ConsoleHandler(logging.WARNING, "live")),
        Receiver(config) as receiver,
    ):
        lower_priority()  # not that of the receiver, which is already running
        server = _Server(header, config.live_port)
        receiver.wait_until_ready(parent.done.is_set)
        parent.ready()
        while not parent.done.is_set():
            time.sleep(settings.batch)
            batches = receiver.drain()
            for messages in (*raw_messages(batches), *pipeline.encode(batches)):
                server.send(messages)


if __name__ == "__main__":
    run_child(_run_child)
