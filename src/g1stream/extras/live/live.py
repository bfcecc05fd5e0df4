"""A WebSocket server that sends DDS messages live to Foxglove and Lichtblick.

It is a child process and only subscribes, like the recorder. Neither the loop nor a recording
waits for it or its clients. The SDK keeps a bounded queue for each client, and drops the oldest
messages if a client reads too slowly.

The SDK's server does not see the Origin of a client, which tells a web page from a viewer, and
takes any number of clients. So it listens on a random address of 127.0.0.0/8, and viewers come
through a port that checks both.
"""

from __future__ import annotations

import asyncio
import logging
import secrets
import threading
import time
from collections.abc import Collection, Iterator
from contextlib import ExitStack, closing, contextmanager, suppress
from ipaddress import ip_address
from socket import SO_RCVBUF, SOL_SOCKET
from typing import TYPE_CHECKING, Any, Final
from urllib.parse import urlsplit

from g1stream.child_process import Parent, optional_child, run_child
from g1stream.config import Config
from g1stream.errors import ConfigError
from g1stream.events import ConsoleHandler, handled_by
from g1stream.optional import require_installed
from g1stream.realtime import lower_priority
from g1stream.recorder.receiver import SampleReceiver
from g1stream.recorder.recorder import BATCH, raw_messages
from g1stream.robot.model import G1
from g1stream.session.format import CHANNELS, MessageBatch
from g1stream.view.pipeline import MessagePipeline

if TYPE_CHECKING:
    from foxglove.websocket import ChannelView, Client

__all__ = ["live"]

_LOGGER = logging.getLogger(__name__)

#: Only programs on this host can connect.
_HOST: Final = "127.0.0.1"
#: Origins of viewers that are web pages of others; `file://` is a desktop application's.
_VIEWERS: Final = ("https://app.foxglove.dev", "https://studio.foxglove.dev", "file://")
_MOST_CLIENTS: Final = 16
#: Time for a client to send its request, s, and bytes of it and of a part that is passed on.
_REQUEST_TIMEOUT: Final = 5.0
_PART: Final = 2**16


@contextmanager
def live(config: Config | None = None, *, origins: Collection[str] = ()) -> Iterator[str]:
    """Serve all data on a DDS domain to Foxglove and Lichtblick for the length of a `with`.

    The channels are those of a session file, with the log times of a recorder. Only clients on this
    machine can connect, 16 at a time, and they can only read. Web pages are refused except those of
    this machine and of Foxglove. If the server fails later, this is only logged.

        with g1stream.live() as address:
            g1stream.stream("demo")

    Args:
        config: all settings; the defaults if omitted.
        origins: other web pages that may read, such as `https://viewer.example`.

    Yields:
        The address to open, such as `ws://localhost:8765`, once clients can connect.

    Raises:
        ConfigError: the extra `live` is not installed.
        ChildError: the port is in use, or a setting or the wire is not valid.
    """
    config = config or Config()
    require_installed("foxglove-sdk", "live", "A live view needs")
    with optional_child("live", (config, frozenset(origins)), "the live view ended"):
        yield f"ws://localhost:{config.live_port}"


class _Server:
    """Serves the channels of a session file on a WebSocket server, until the process ends.

    `WebSocketServer.stop` is never called: it would wait for a client that does not read.
    """

    def __init__(
        self, latched: list[MessageBatch], port: int, origins: Collection[str] = ()
    ) -> None:
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
        host = ".".join(["127", *(str(1 + secrets.randbelow(254)) for _ in range(3))])
        try:
            self._server = start_server(
                name="g1stream", host=host, port=0, context=self._context, server_listener=listener
            )
            _Entrance(port, origins, (host, self._server.port))
        except (OSError, RuntimeError) as error:
            why = getattr(error, "strerror", None) or error
            raise ConfigError(
                f"The live view cannot listen on port {port}: {why}.",
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


class _Entrance:
    """Listens for clients, and connects those that may read to a server, until the process ends.

    Args:
        port: port on loopback.
        origins: web pages that may read, beside those of this machine and of viewers.
        server: address of the server.

    Raises:
        OSError: the port cannot be used.
    """

    def __init__(self, port: int, origins: Collection[str], server: tuple[str, int]) -> None:
        self._origins, self._server = {*_VIEWERS, *origins}, server
        self._clients = 0
        loop = asyncio.new_event_loop()
        listening = asyncio.start_server(self._enter, _HOST, port, limit=_PART)
        try:
            self._listener = loop.run_until_complete(listening)
        except OSError:
            loop.close()
            raise
        threading.Thread(target=loop.run_forever, name="entrance", daemon=True).start()

    async def _enter(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self._clients += 1
        gone = OSError, asyncio.IncompleteReadError, asyncio.LimitOverrunError, asyncio.TimeoutError
        with closing(writer), suppress(*gone), ExitStack() as entered:
            try:
                request = await asyncio.wait_for(reader.readuntil(b"\r\n\r\n"), _REQUEST_TIMEOUT)
                if refused := self._refusal(request):
                    writer.write(f"HTTP/1.1 {refused}\r\nConnection: close\r\n\r\n".encode())
                    await writer.drain()
                    return
                from_server, to_server = await asyncio.open_connection(*self._server, limit=_PART)
                # What lies here would be sent to a slow client before what is new.
                to_server.get_extra_info("socket").setsockopt(SOL_SOCKET, SO_RCVBUF, _PART)
                to_server.write(request)
                entered.callback(to_server.close)
                answer = await asyncio.wait_for(from_server.readuntil(b"\r\n"), _REQUEST_TIMEOUT)
                if b" 101 " not in answer:  # the SDK refuses a client of an older protocol
                    _LOGGER.warning(
                        "a viewer was refused (%s); --live needs Lichtblick of December 2025 or "
                        "later, PlotJuggler 3.16, or Foxglove",
                        answer.decode("latin-1").strip()[:80],
                    )
                writer.write(answer)
                await asyncio.gather(_pass_on(reader, to_server), _pass_on(from_server, writer))
            finally:
                self._clients -= 1

    def _refusal(self, request: bytes) -> str:
        """The HTTP status with which a request is refused, or ""."""
        lines = [line.partition(":") for line in request.decode("latin-1").split("\r\n")[1:]]
        headers = [(name.strip().lower(), value.strip()) for name, _, value in lines]
        strange = [v[:200] for name, v in headers if name == "origin" and not self._reads(v)]
        if strange:
            _LOGGER.warning(
                "a web page of %s was refused; --live-origin %s lets it read", *strange[:1] * 2
            )
            return "403 Forbidden"
        if ("upgrade", "websocket") not in [(name, value.lower()) for name, value in headers]:
            return "426 Upgrade Required"
        return "503 Service Unavailable" if self._clients > _MOST_CLIENTS else ""

    def _reads(self, origin: str) -> bool:
        """Whether a web page of this origin may read."""
        with suppress(ValueError):
            host = urlsplit(origin).hostname or ""
            return origin in self._origins or host == "localhost" or ip_address(host).is_loopback
        return False


async def _pass_on(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    with closing(writer):
        while data := await reader.read(_PART):
            writer.write(data)
            await writer.drain()  # a client that does not read stops the server's queue, not ours


def _run_child(parent: Parent) -> None:
    """Serve the data that a recorder would write, for a parent process.

    The startup message is the config and `origins`.
    """
    # The SDK logs connections of clients, but the viewer already shows them.
    logging.getLogger("foxglove").addHandler(logging.NullHandler())
    config: Config
    config, origins = parent.startup_message
    settings = config.record
    if settings.channels == "raw":  # reduces the size of a file; viewers would show nothing
        settings = settings.model_copy(update={"channels": "standard"})
    pipeline = MessagePipeline(G1.of_config(config), settings)
    header = pipeline.file_header(time.time_ns())
    with (
        handled_by(ConsoleHandler(logging.WARNING, "live")),
        SampleReceiver(config) as receiver,
    ):
        lower_priority()  # not that of the receiver, which is already running
        server = _Server(header, config.live_port, origins)
        receiver.wait_until_ready(parent.done.is_set)
        parent.ready()
        while not parent.done.is_set():
            time.sleep(BATCH)
            batches = receiver.drain()
            for messages in (*raw_messages(batches), *pipeline.encode(batches)):
                server.send(messages)


if __name__ == "__main__":
    run_child(_run_child)
