"""A WebSocket server that sends DDS messages live to Foxglove and Lichtblick.

It is a child process and only subscribes, like the recorder. Neither the loop nor a recording
waits for it or its clients. The SDK keeps a bounded queue for each client, and drops the oldest
messages if a client reads too slowly.
"""

from __future__ import annotations

import logging
import time
from collections import deque
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from g1stream.analysis.attached import Recorded, encode_references, find_motion
from g1stream.child_process import Parent, optional_child, run_child
from g1stream.config import Config
from g1stream.dds.messages import LOG, LOWCMD, LOWSTATE, REFERENCE, Batch, Log, Samples
from g1stream.errors import ConfigError
from g1stream.events import ConsoleHandler, handled_by
from g1stream.motion.trajectory import Trajectory
from g1stream.optional import require_installed
from g1stream.realtime import lower_priority
from g1stream.recorder.receiver import Receiver
from g1stream.recorder.recorder import raw_messages
from g1stream.robot.model import G1
from g1stream.robot.rotations import quat_from_yaw
from g1stream.session.format import CHANNELS, MessageBatch
from g1stream.view.pipeline import Decimator, MessagePipeline

if TYPE_CHECKING:
    from concurrent.futures import Future

    from foxglove.websocket import ChannelView, Client

    from g1stream.analysis.attached import Found
    from g1stream.dds.messages import Topic
    from g1stream.motion.motion import Motion
    from g1stream.session.records import AttachedBy
    from g1stream.types import Floats

__all__ = ["FoundReferences", "live"]

#: Search for a motion: samples compared per second, their number, ns between two searches, and
#: references shown per second.
_LOOKED_AT, _SEARCHED_SAMPLES = 50, 1500
_SEARCH_PERIOD_NS: Final = 3_000_000_000
_SHOWN: Final = 100
#: Level of an event in /log.
_INFO: Final = 2
#: Streams that are compared with the motion, commands first.
_SEARCHED: Final[tuple[tuple[Topic, str, AttachedBy], ...]] = (
    (LOWCMD, "motor_cmd.q", "commands"),
    (LOWSTATE, "motor_state.q", "measured joints"),
)
#: Only programs on this host can connect.
_HOST: Final = "127.0.0.1"


@contextmanager
def live(config: Config | None = None, *, motion: Motion | None = None) -> Iterator[str]:
    """Serve all data on a DDS domain to Foxglove and Lichtblick for the length of a `with`.

    The channels are those of a session file, with the log times of a recorder. Only clients on this
    machine can connect, and they can only read. If the server fails later, this is only logged.

        with g1stream.live() as address:
            g1stream.stream("demo")

    Args:
        config: all settings; the defaults if omitted.
        motion: motion that another controller plays without publishing references. References are
            shown once the motion is found in the commands or in the measured joints.

    Yields:
        The address to open, such as `ws://localhost:8765`, once clients can connect.

    Raises:
        ConfigError: the extra `live` is not installed.
        ChildError: the port is in use, or a setting or the wire is not valid.
    """
    config = config or Config()
    require_installed("foxglove-sdk", "live", "A live view needs")
    with optional_child("live", (config, motion), "the live view ended"):
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


class FoundReferences:
    """References of a motion that another program plays, once it is found in the received data.

    Args:
        motion: motion to find, played at its own speed. A thread searches the last half minute
            every few seconds.
    """

    def __init__(self, motion: Motion) -> None:
        self._trajectory, self._name = Trajectory(motion), motion.name
        self._few = {topic.name: Decimator(_LOOKED_AT) for topic, _, _ in _SEARCHED}
        self._received: dict[str, deque[tuple[int, Floats]]] = {
            topic.name: deque(maxlen=_SEARCHED_SAMPLES) for topic, _, _ in _SEARCHED
        }
        self._pool = ThreadPoolExecutor(1)
        self._search: Future[Found | None] | None = None
        self._next = 0
        self._found: Found | None = None
        self._given = 0  # time up to which references were added, ns

    def add_to(self, batches: dict[str, Batch]) -> None:
        """Process received batches, and add references up to their end if none were published."""
        newest: dict[AttachedBy, int] = {}
        for topic, field, by in _SEARCHED:
            if batch := batches.get(topic.name):
                times = np.array(batch.publish_times)
                rows = self._few[topic.name].pick(times)
                q = Samples(topic, [batch.data[i] for i in rows])[field].astype(float)
                self._received[topic.name].extend(zip(times[rows].tolist(), q, strict=True))
                newest[by] = int(times[-1])
        if not newest:
            return
        self._look(max(newest.values()), batches)
        now = newest.get(self._found.by, 0) if self._found else 0
        if now and REFERENCE.name not in batches:
            references = self._references(now)
            if references.data:
                batches[REFERENCE.name] = references
        self._given = now or self._given

    @property
    def searched(self) -> bool:
        """Whether no search is running."""
        return self._search is None or self._search.done()

    def _look(self, now: int, batches: dict[str, Batch]) -> None:
        """Start a search if it is due, and process the result of a finished one."""
        if self._search and self.searched:
            found = self._search.result()
            if found and found.alignment.best and not found.alignment.ambiguous:
                if self._found is None:
                    batch = batches.setdefault(LOG.name, Batch())
                    batch.data.append(self._event(found.alignment.plays[-1].last))
                    batch.publish_times.append(now)
                    batch.log_times.append(now)
                self._found = found
            self._search = None
        if self._search is None and now > self._next:
            self._next = now + _SEARCH_PERIOD_NS
            recorded = [
                Recorded(by, np.array([t for t, _ in samples]), np.array([q for _, q in samples]))
                for topic, _, by in _SEARCHED
                if len(samples := list(self._received[topic.name])) > _LOOKED_AT
            ]
            self._search = self._pool.submit(
                find_motion, recorded, self._trajectory, any_speed=False
            )

    def _event(self, seconds: float) -> bytes:
        event = Log()
        event.level[()], event.name = _INFO, "live"
        event.text = f"{self._name} was found, {seconds:.1f} s after its start"
        return event.tobytes()

    def _references(self, now: int) -> Batch:
        """The references up to `now`, ns, as long as the motion found last may still be playing."""
        assert self._found
        play = self._found.alignment.plays[-1]
        start = self._found.zero + round(play.start * 1e9)
        published = np.arange(self._given or now, now, round(1e9 / _SHOWN))
        at = play.speed * ((published - start) / 1e9)
        # A search detects the end of a playback two periods later at the latest.
        until = min(self._trajectory.duration, play.last + 2e-9 * _SEARCH_PERIOD_NS)
        inside = (at >= 0.0) & (at <= until)
        published, at = published[inside], at[inside]
        if not len(at):
            return Batch()
        point = self._trajectory.sample_many(at)
        turn = quat_from_yaw(0.0)  # the pipeline turns the measured robot instead
        rows = encode_references(point, at, play.speed, play.joints, turn, point.root_pos[0])
        times = published.tolist()
        return Batch([row.tobytes() for row in rows], times, times)


def _run_child(parent: Parent) -> None:
    """Serve the data that a recorder would write, for a parent process.

    The startup message is the config and the motion to find, or None.
    """
    # The SDK logs connections of clients, but the viewer already shows them.
    logging.getLogger("foxglove").addHandler(logging.NullHandler())
    config: Config
    config, motion = parent.startup_message
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
        found = FoundReferences(motion) if motion else None
        server = _Server(header, config.live_port)
        receiver.wait_until_ready(parent.done.is_set)
        parent.ready()
        while not parent.done.is_set():
            time.sleep(settings.batch)
            batches = receiver.drain()
            if found:
                found.add_to(batches)
            for messages in (*raw_messages(batches), *pipeline.encode(batches)):
                server.send(messages)


if __name__ == "__main__":
    run_child(_run_child)
