"""The live view: what a WebSocket client receives, and what it cannot disturb."""

import json
import logging
import socket
import struct
import time
from base64 import b64decode
from contextlib import ExitStack, contextmanager, nullcontext, suppress

import numpy as np
import pytest
from google.protobuf.descriptor_pb2 import FileDescriptorSet
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.message_factory import GetMessageClass
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect

from g1stream import child_process
from g1stream.app.record import record
from g1stream.app.session import open_session
from g1stream.child_process import Child
from g1stream.cli.flags import parse_flags
from g1stream.cli.main import EXIT_BAD_INPUT, load_command, main
from g1stream.config import Config, RecordConfig
from g1stream.dds.domain import Participant
from g1stream.dds.endpoints import RawReader, RawWriter
from g1stream.dds.messages import (
    LOWCMD,
    LOWSTATE,
    LowState,
    Samples,
)
from g1stream.extras.live import live as program
from g1stream.robot.joints import JOINT_NAMES
from g1stream.session.format import CHANNELS

T0 = 1_700_000_000_000_000_000
#: More than a socket's buffers and the queue of a client take.
STATES = 2500


def free_port():
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        return taken.getsockname()[1]


@pytest.fixture
def port():
    return free_port()


@pytest.fixture
def config(domain_id, port):
    return Config.model_validate({"dds": {"domain": domain_id}, "live_port": port})


@pytest.fixture
def states(domain_id):
    with Participant(domain_id, "lo") as participant:
        yield RawWriter(participant, LOWSTATE, STATES)


@pytest.fixture
def children(monkeypatch):
    """The child processes of live views."""
    started = []

    def start(*arguments, **keywords):
        started.append(Child(*arguments, **keywords))
        return started[-1]

    monkeypatch.setattr(child_process, "Child", start)
    return started


class Client:
    """A viewer that knows the protocol and nothing of ours.

    Attributes:
        channels: as the server advertises them, by topic.
    """

    def __init__(self, websocket):
        self._websocket = websocket
        assert json.loads(websocket.recv(10))["op"] == "serverInfo"
        self.channels = {c["topic"]: c for c in json.loads(websocket.recv(10))["channels"]}

    def subscribe(self, *topics):
        wanted = [{"id": n, "channelId": self.channels[t]["id"]} for n, t in enumerate(topics)]
        self._topics = topics
        self._websocket.send(json.dumps({"op": "subscribe", "subscriptions": wanted}))

    def receive(self, timeout=10.0):
        """Topic, log time and payload of the next message."""
        message = self._websocket.recv(timeout)
        opcode, subscription, log_time = struct.unpack("<BIQ", message[:13])
        assert opcode == 1
        return self._topics[subscription], log_time, message[13:]

    def decode(self, topic, payload):
        """Read a payload by the schema that was advertised for its topic."""
        pool, channel = DescriptorPool(), self.channels[topic]
        for file in FileDescriptorSet.FromString(b64decode(channel["schema"])).file:
            pool.Add(file)
        descriptor = pool.FindMessageTypeByName(channel["schemaName"])
        return GetMessageClass(descriptor).FromString(payload)


@contextmanager
def client(port, **options):
    """A client; options go to the library."""
    address = f"ws://127.0.0.1:{port}"
    with connect(address, subprotocols=["foxglove.sdk.v1"], compression=None, **options) as opened:
        yield Client(opened)


def test_a_client_receives_channels_scenes_and_the_state_that_was_published(config, states, port):
    state = LowState()
    state.q[:] = np.linspace(-1.0, 1.0, len(JOINT_NAMES))
    with program.live(config) as address, client(port) as first, client(port) as late:
        assert address == f"ws://localhost:{port}"
        assert set(first.channels) == set(CHANNELS)
        for topic, channel in CHANNELS.items():
            given = first.channels[topic]
            assert given["schemaName"] == channel.schema_name
            assert given["encoding"] == channel.message_encoding
            assert given["schemaEncoding"] == channel.schema_encoding
            is_text = channel.schema_encoding != "protobuf"
            schema = given["schema"].encode() if is_text else b64decode(given["schema"])
            assert schema == channel.build_schema()

        first.subscribe("/measured/scene", "/lowstate", "/measured/joint_states")
        topic, _, shown = first.receive()
        scene = first.decode(topic, shown)
        assert topic == "/measured/scene"
        assert "measured/pelvis" in {entity.frame_id for entity in scene.entities}

        before = time.time_ns()
        states.write(state.tobytes(), T0)
        arrived = [first.receive() for _ in range(2)]
        assert all(before < log_time < time.time_ns() for _, log_time, _ in arrived)
        payloads = {topic: payload for topic, _, payload in arrived}
        assert payloads["/lowstate"] == state.tobytes()
        joints = first.decode("/measured/joint_states", payloads["/measured/joint_states"])
        assert joints.timestamp.seconds * 10**9 == T0
        measured = {joint.name: joint.position for joint in joints.joints}
        assert measured == dict(zip(JOINT_NAMES, state.q.tolist(), strict=True))

        late.subscribe("/measured/robot_description", "/measured/scene")
        once = {topic: payload for topic, _, payload in (late.receive(), late.receive())}
        assert once["/measured/scene"] == shown
        assert b"<robot" in once["/measured/robot_description"]


def test_clients_that_never_read_cost_neither_others_nor_a_recording(
    config, states, port, children, beside, tmp_path, until
):
    config = config.model_copy(update={"record": RecordConfig(channels="full")})
    state, path = LowState(), tmp_path / "s.mcap"
    never_reads = {"max_queue": 1, "ping_interval": None, "close_timeout": 0.1}
    with (
        ExitStack() as open_to_the_end,
        program.live(config),
        client(port) as reader,
        client(port, **never_reads) as stuck,
    ):
        open_to_the_end.enter_context(client(port, **never_reads)).subscribe(*CHANNELS)
        stuck.subscribe(*CHANNELS)
        reader.subscribe("/lowstate")
        with beside(record, path, config):
            until(lambda: states.matched == 2, "the live view and the recorder")
            for tick in range(STATES):
                state.tick[()] = tick
                states.write(state.tobytes())
                time.sleep(0.0005)
            received = [reader.receive() for _ in range(STATES)]
        left = 0
        with suppress(TimeoutError):
            while True:
                left += stuck.receive(1.0)[0] == "/lowstate"
    ticks = Samples(LOWSTATE, [payload for _, _, payload in received])["tick"]
    assert ticks.tolist() == list(range(STATES))
    assert left < STATES  # else none was stuck
    assert open_session(path).summary().recorder.counts["/lowstate"] == STATES
    assert [child._process.returncode for child in children] == [0]


def test_a_port_in_use_is_refused_before_anything_is_commanded(domain_id, port, capsys):
    with Participant(domain_id, "lo") as participant, socket.socket() as other:
        commands = RawReader(participant, LOWCMD)
        other.bind(("127.0.0.1", port))
        other.listen()
        flags = [f"--domain={domain_id}", "--live", f"--live-port={port}"]
        assert main(["stream", "demo", *flags]) == EXIT_BAD_INPUT
        assert str(port) in capsys.readouterr().err
        assert commands.matches == (0, 0)


def test_a_server_that_fails_is_logged_and_ends_nothing(config, children, caplog, until):
    with program.live(config):
        children[0]._process.kill()
        until(lambda: caplog.records, "the warning")
    assert [record.levelno for record in caplog.records] == [logging.WARNING]


@pytest.mark.parametrize(
    ("origin", "reads"),
    [
        *((None, True), ("http://localhost:8080", True), ("http://127.0.0.1", True)),
        *(("http://[::1]:8080", True), ("https://app.foxglove.dev", True), ("file://", True)),
        *(("https://viewer.example", True), ("https://viewer.example:444", False)),
        *(("https://evil.example", False), ("http://localhost.evil.example", False)),
        *(("null", False), ("https://app.foxglove.dev.evil.example", False), ("", False)),
        ("http://127.0.0.1.evil.example:8765", False),
    ],
)
def test_only_some_web_pages_may_read(entrance, origin, reads):
    refused = pytest.raises(InvalidStatus, match="403")
    headers = {} if origin is None else {"Origin": origin}
    with nullcontext() if reads else refused, client(entrance, additional_headers=headers) as one:
        assert "/lowstate" in one.channels


@pytest.fixture(scope="module")
def entrance():
    """A server, and the port at which clients are let in to it."""
    server = program._Server([], port := free_port(), ["https://viewer.example"])
    assert server._server.port != port
    return port


@pytest.mark.parametrize(
    "request_",
    [
        b"GET / HTTP/1.1\r\nHost: localhost\r\n\r\n",
        b"GET / HTTP/1.1\r\nUpgrade: websocket\r\norigin : https://evil.example\r\n\r\n",
        b"GET / HTTP/1.1\r\nOrigin: http://localhost\r\nOrigin: https://evil.example\r\n\r\n",
        b"x" * 200_000,
    ],
)
def test_what_asks_for_no_websocket_gets_nothing(entrance, request_):
    with socket.create_connection(("127.0.0.1", entrance), 5.0) as one, suppress(OSError):
        one.sendall(request_)
        answer = one.recv(1000)
        assert answer[:12] in (b"HTTP/1.1 403", b"HTTP/1.1 426", b"")
        assert one.recv(1000) == b""


def test_a_viewer_with_an_older_protocol_is_refused_and_named(entrance, caplog):
    refused = pytest.raises(InvalidStatus, match="400")
    with refused, connect(f"ws://localhost:{entrance}", subprotocols=["foxglove.websocket.v1"]):
        pass
    with client(entrance) as one:
        assert one.channels
    (told,) = (one for one in caplog.records if one.name.startswith("g1stream."))
    assert (told.levelno, "400" in told.getMessage()) == (logging.WARNING, True)


def test_the_number_of_clients_is_limited(entrance, until):
    with ExitStack() as some:
        for _ in range(16):
            some.enter_context(client(entrance))
        with pytest.raises(InvalidStatus, match="503"), client(entrance):
            pass

    def lets_in():
        with suppress(InvalidStatus), client(entrance):
            return True

    until(lets_in, "a place")


def test_a_flag_lets_other_web_pages_in(monkeypatch):
    asked = []

    @contextmanager
    def live(_, **given):
        asked.append(given["origins"])
        yield "ws://localhost"

    monkeypatch.setattr(program, "live", live)
    command = parse_flags(
        load_command("sim"), "sim", "", ["--live", "--live-origin", "https://viewer.example"]
    )
    with command.serving(Config()):
        assert asked == [["https://viewer.example"]]
