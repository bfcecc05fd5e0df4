"""Every reader of a file or of bytes from the wire, with bytes that nobody should have sent.

What comes out is a valid result or a G1StreamError; anything else fails. The examples are the same
in every run; FUZZ=20 takes twenty times as many, and others each time.
"""

import io
import json
import os
import pickle
import resource
import struct
import subprocess
import sys
import zipfile
import zlib
from contextlib import suppress
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
import zstandard
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mcap.writer import CompressionType, Writer
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as BagWriter
from rosbags.typesys import Stores, get_typestore

from g1stream.app.convert import convert
from g1stream.app.session import open_session
from g1stream.cli.main import main
from g1stream.config import load_config
from g1stream.control.gains import read_gains
from g1stream.dds.layout import CDR_HEADER
from g1stream.dds.messages import Log, LowCmd, LowState, Reference
from g1stream.errors import ConfigError, G1StreamError, MotionError, RecordingError, RobotError
from g1stream.extras.attach.recorded_motion import FramePose
from g1stream.extras.ros2.messages import joint_state, tf_message
from g1stream.motion.motion import Motion
from g1stream.motion.readers import load_motion
from g1stream.robot.joints import JOINT_NAMES
from g1stream.robot.model import DEFAULT_URDF, G1
from g1stream.session.format import CHANNELS, encode_log
from g1stream.session.source import SessionFiles
from g1stream.types import Phase

#: What numpy complains about would be printed on the terminal.
pytestmark = pytest.mark.filterwarnings("error::RuntimeWarning", "error::UserWarning")

MORE = int(os.environ.get("FUZZ", "0"))
T0 = 1_700_000_000_000_000_000
MIB = 2**20
CASES = Path(__file__).parents[3] / "shared" / "cases"


def examples(number):
    return settings(
        max_examples=number * max(1, MORE),
        derandomize=not MORE,
        database=None,
        deadline=None,
        suppress_health_check=list(HealthCheck),
    )


def edited(*valid):
    """Bytes made of valid ones: some replaced, cut out, repeated or put in."""

    def apply(case):
        content, edits = case
        for where, kind, put in edits:
            at = int(where * len(content))
            skip = {"replace": len(put), "insert": 0, "cut": 64, "truncate": len(content)}[kind]
            content = content[:at] + (b"" if kind == "truncate" else put) + content[at + skip :]
        return content

    numbers = b"\xff" * 8, b"\0" * 8, struct.pack("<Q", 2**40)
    words = st.sampled_from([*numbers, b"\x1b[2J", b"nan", b"1e308", b"[" * 3000])
    edit = st.tuples(
        st.floats(0, 1, exclude_max=True),
        st.sampled_from(("replace", "replace", "insert", "cut", "truncate")),
        st.one_of(st.binary(min_size=1, max_size=8), words),
    )
    return st.tuples(st.sampled_from(valid), st.lists(edit, min_size=1, max_size=4)).map(apply)


def session_bytes(metadata=None, log=None, attachments=(), n=12, rate=500, change=lambda *_: None):
    """A session without compression or checksums, so that any byte of it can be another."""
    file = io.BytesIO()
    writer = Writer(file, compression=CompressionType.NONE, chunk_size=1 << 20, enable_crcs=False)
    writer.start()
    ids = {}
    for topic in ("/reference", "/lowcmd", "/lowstate", "/log"):
        channel = CHANNELS[topic]
        schema = writer.register_schema(channel.schema_name, channel.schema_encoding, b"")
        ids[topic] = writer.register_channel(topic, channel.message_encoding, schema)
    command, state, reference = LowCmd(), LowState(), Reference()
    for i in range(n):
        time = T0 + i * 1_000_000_000 // rate
        reference.tick[()], reference.motion_time[()] = i, i / rate
        reference.phase[()] = Phase.PLAY
        reference.q[:] = state.q[:] = command.q[:] = 0.01 * i
        reference.root_quat_wxyz[:] = state.quaternion[:] = 1, 0, 0, 0
        command.kp[:], command.motor_mode = 40.0, 1
        change(reference, state)
        writer.add_message(ids["/reference"], time, reference.tobytes(), time, i)
        writer.add_message(ids["/lowcmd"], time, command.seal(), time, i)
        writer.add_message(ids["/lowstate"], time + 500, state.seal(), time + 400, i)
    line = encode_log(T0, 3, "stream", "late") if log is None else log
    writer.add_message(ids["/log"], T0, line, T0, 0)
    for name, data in attachments:
        writer.add_attachment(T0, T0, name, "", data)
    writer.add_metadata("g1stream", metadata or {"domain": "1", "stream": '{"reason": ""}'})
    writer.finish()
    return file.getvalue()


SESSION = session_bytes()
URDF = DEFAULT_URDF.read_bytes()
CSV = (Path(load_motion("demo").source).read_bytes()).splitlines(keepends=True)
CSV = b"".join(CSV[:6])


def array_files():
    """A motion as NPZ, ours and of others, as pickle of two protocols, and one of PyTorch."""
    motion = load_motion("demo").frames(0, 4)
    own = io.BytesIO()
    arrays = {name: getattr(motion, name) for name in ("joint_pos", "root_pos", "root_quat_wxyz")}
    np.savez(own, fps=30.0, joint_names=JOINT_NAMES, **arrays)
    arrays = {"fps": 30, "dof": motion.joint_pos, "dof_names": list(JOINT_NAMES)}
    arrays |= {"root_pos": motion.root_pos, "root_rot": motion.root_quat_wxyz}
    npz = io.BytesIO()
    np.savez(npz, **arrays)
    pickles = pickle.dumps(arrays, protocol=2), pickle.dumps(arrays)
    tensors = Path(__file__).parents[1] / "data" / "protomotions.pt"
    return own.getvalue(), npz.getvalue(), *pickles, tensors.read_bytes()


def bags():
    """Joint states and a transform in SQLite, and as `convert` writes them."""
    motion = load_motion("demo").frames(0, 4)
    types = {"/joint_states": "sensor_msgs/msg/JointState", "/tf": "tf2_msgs/msg/TFMessage"}
    pose = tf_message([FramePose(0, "world", "pelvis", (0, 0, 0), (1, 0, 0, 0))])
    with TemporaryDirectory() as directory:
        bag, converted = Path(directory) / "bag", Path(directory) / "motion.mcap"
        with BagWriter(bag, version=9, storage_plugin=StoragePlugin.SQLITE3) as writer:
            store = get_typestore(Stores.ROS2_HUMBLE)
            joints, frames = (
                writer.add_connection(name, kind, typestore=store) for name, kind in types.items()
            )
            for i, row in enumerate(motion.joint_pos.tolist()):
                writer.write(joints, i * 10**8, joint_state(i * 10**8, JOINT_NAMES, row, [], []))
                writer.write(frames, i * 10**8, pose)
        convert(motion, converted)
        return (bag / "bag.db3").read_bytes(), converted.read_bytes()


ARRAYS = array_files()
BAGS = bags()


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    return tmp_path_factory.mktemp("hostile") / "input"


def use_motion(path):
    with suppress(G1StreamError):
        assert np.isfinite(load_motion(path).joint_pos).all()


def use_session(path):
    """All that commands ask of a session file; each part may refuse it."""
    session = open_session(path)
    for part in (
        lambda: json.dumps(session.summary().model_dump(mode="json")),
        lambda: str(session.summary()).encode(),
        lambda: session.attachments,
        lambda: load_motion(path),
        lambda: session.sel(time=slice(0, 1)).log,
    ):
        with suppress(G1StreamError):
            part()
    with suppress(G1StreamError):
        assert str(session.summary()).replace("\n", "").isprintable()


@examples(80)
@given(edited(SESSION))
def test_session(path, content):
    path.write_bytes(content)
    with suppress(G1StreamError):
        use_session(path)


@pytest.mark.parametrize("field", ["motion_time", "q", "root_pos", "root_quat_wxyz"])
@pytest.mark.parametrize("value", [np.nan, -np.inf, 1e12, 1e308, 0.0])
def test_numbers_in_a_reference(path, field, value):
    def change(reference, state):
        if reference.tick == 7:
            getattr(reference, field)[...] = value

    path.write_bytes(session_bytes(change=change))
    use_session(path)


@pytest.mark.parametrize("field", ["q", "dq", "tau_est", "quaternion", "gyroscope"])
@pytest.mark.parametrize("value", [np.nan, 3e38, 0.0])
def test_numbers_in_a_state(path, field, value):
    def change(reference, state):
        if reference.tick % 9 == 3:
            getattr(state, field)[...] = value

    path.write_bytes(session_bytes(change=change, n=120))
    use_session(path)


JSON = st.recursive(
    st.one_of(
        st.none(),
        st.booleans(),
        st.integers(-(2**70), 2**70),
        st.floats(),
        st.sampled_from(["\x1b[31m\x07", "PLAY", "bolted", "1e999", "\udcff", "x" * 5000]),
    ),
    lambda inner: st.one_of(
        st.lists(inner, max_size=3),
        st.dictionaries(
            st.sampled_from(["stream", "kp", "kd", "start", "rate", "q", "reason"]), inner
        ),
    ),
    max_leaves=8,
)
KEYS = [
    *("stream", "recorder", "motion", "config", "gains", "host", "domain", "interface"),
    *("versions", "started_ns", "measured_tf", "g1stream"),
]


HARDLY_JSON = st.sampled_from(["[" * 100_000, "9" * 10_000, "\x1b[2J"])


@examples(40)
@given(st.dictionaries(st.sampled_from(KEYS), JSON.map(json.dumps) | HARDLY_JSON))
def test_metadata(path, values):
    path.write_bytes(session_bytes(metadata=values))
    use_session(path)


@examples(30)
@given(st.one_of(st.binary(max_size=60), edited(encode_log(T0, 3, "stream", "late"))))
def test_log_messages(path, data):
    path.write_bytes(session_bytes(log=data))
    use_session(path)


def test_bags_are_motions(path):
    path = path.with_suffix(".db3")  # by which rosbags knows SQLite
    for content in BAGS:
        path.write_bytes(content)
        assert load_motion(path).n_frames == 4


TABLES = st.one_of(st.binary(max_size=300), edited(CSV, CSV.split(b"\n", 1)[1]))
PICKLES = st.one_of(st.binary(max_size=80).map(b"\x80\x04".__add__), edited(*ARRAYS))


@examples(300)
@given(
    st.one_of(st.tuples(st.just(""), TABLES | PICKLES), st.tuples(st.just(".db3"), edited(*BAGS)))
)
def test_motions(path, file):
    suffix, content = file
    path = path.with_suffix(suffix)
    path.write_bytes(content)
    use_motion(path)


@pytest.fixture(scope="module")
def published(tmp_path_factory):
    """Files as other programs write them: name and content."""
    if not CASES.is_dir():
        pytest.skip("the files of other programs are not there: ../shared/cases")
    directory = tmp_path_factory.mktemp("published")
    for script in ("make_motions.py", "make_mcaps.py"):
        command = [sys.executable, str(CASES / script), str(directory)]
        subprocess.run(command, check=True, capture_output=True)
    return {one.name: one.read_bytes() for one in directory.rglob("*") if one.is_file()}


@examples(100)
@given(st.data())
def test_files_of_other_programs(path, published, data):
    name = data.draw(st.sampled_from(sorted(published)))
    path = path.with_name(f"published{Path(name).suffix}")
    path.write_bytes(data.draw(edited(published[name])))
    use_motion(path)
    if path.suffix == ".mcap":
        with suppress(G1StreamError):
            use_session(path)


@examples(60)
@given(edited(URDF))
def test_urdf(path, content):
    path.write_bytes(content)
    with suppress(RobotError):
        assert len(G1.load(path).lower) == 29


TOML = b'robot = "g1_29dof"\n[stream]\nrate = 500.0\n[gains]\nkp = {"*_knee_joint" = 100.0}\n'


@examples(100)
@given(st.one_of(st.binary(max_size=80), edited(TOML, b"[kp]\nwaist_yaw_joint = 80.0\n")))
def test_config_and_gains(path, content):
    path.write_bytes(content)
    for read in (load_config, read_gains):
        with suppress(ConfigError):
            read(path)


YAML = b"rosbag2_bagfile_information:\n  relative_file_paths:\n  - s_0.mcap\n  version: 6\n"


@examples(60)
@given(st.one_of(st.binary(max_size=60), edited(YAML)))
def test_metadata_of_a_split_recording(path, content):
    directory = path.parent / "s"
    directory.mkdir(exist_ok=True)
    (directory / "s_0.mcap").write_bytes(SESSION)
    (directory / "metadata.yaml").write_bytes(content)
    with suppress(RecordingError):
        SessionFiles(directory)


@examples(100)
@given(st.sampled_from((LowState, LowCmd, Reference, Log)), st.binary(max_size=2200), st.booleans())
def test_samples_from_the_wire(kind, data, right_size):
    message = kind()
    if right_size:
        size = message.layout.sample_size - len(CDR_HEADER)
        data = CDR_HEADER + data[:size].ljust(size, b"\xff")
    with suppress(G1StreamError):
        message.load(data)
        assert message.tobytes() == data
        assert kind is not Log or isinstance(message.text + message.name, str)


ENTITIES = "".join(f'<!ENTITY a{i} "{f"&a{i - 1};" * 10}">' for i in range(1, 12))


@pytest.mark.parametrize(
    "head",
    [
        f'<!DOCTYPE robot [<!ENTITY a0 "aaaaaaaaaa">{ENTITIES}]>',
        '<!DOCTYPE robot [<!ENTITY x SYSTEM "file:///etc/passwd">]>',
        '<!DOCTYPE robot SYSTEM "http://127.0.0.1:1/robot.dtd">',
    ],
)
def test_xml_entities_are_refused(path, head):
    path.write_text(head + URDF.decode().split("?>", 1)[-1])
    with pytest.raises(RobotError) as error:
        G1.load(path)
    assert "<!DOCTYPE" in error.value.cause


def chunk(size, data, compression=b"zstd", claimed=None):
    head = struct.pack("<QQQII", T0, T0, size if claimed is None else claimed, 0, len(compression))
    content = head + compression + struct.pack("<Q", len(data)) + data
    return b"\x06" + struct.pack("<Q", len(content)) + content


def zipped(name, data, **how):
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", **how) as archive:
        archive.writestr(name, data)
    return file.getvalue()


def bomb(kind):
    """A small file that has, or claims to have, gigabytes."""
    if kind == "npz":
        how = {"compression": zipfile.ZIP_DEFLATED, "compresslevel": 1}
        return zipped("time.npy", bytes(600 * MIB), **how)
    if kind == "npz header":
        head = b"{'descr': '<f8', 'fortran_order': False, 'shape': (99999999999,), }\n".ljust(118)
        return zipped("joint_names.npy", b"\x93NUMPY\1\0" + struct.pack("<H", 118) + head)
    if kind == "pickle":
        return zlib.compress(bytes(600 * MIB), 1)
    packed = zstandard.compress(bytes(64 * MIB))
    chunks = {
        "frame": [chunk(64 * MIB, packed, claimed=100)],
        "claim": [chunk(0, packed, claimed=2**60)],
        "chunks": [chunk(64 * MIB, packed)] * 40,
        "attachment": [b"\x09" + struct.pack("<Q", 2**50)],
    }[kind]
    at = SESSION.index(b"\x06", 8)
    return SESSION[:at] + b"".join(chunks) + SESSION[at:]


@pytest.mark.slow
@pytest.mark.parametrize(
    "kind", ["frame", "claim", "chunks", "attachment", "npz", "npz header", "pickle"]
)
def test_a_small_file_takes_little_memory(path, kind):
    content = bomb(kind)
    assert len(content) < 3 * MIB
    path.write_bytes(content)
    command = "motion" if "npz" in kind or kind == "pickle" else "info"
    ended = subprocess.run(
        [sys.executable, "-m", "g1stream", command, path],
        capture_output=True,
        text=True,
        timeout=60,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_AS, (1536 * MIB, 1536 * MIB)),
        check=False,
    )
    assert ended.returncode == 2, ended.stderr
    assert ended.stderr.startswith("error: ")
    assert "Traceback" not in ended.stderr


@pytest.fixture
def odd(tmp_path):
    """Paths that are no regular file with content."""
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "directory").mkdir()
    (tmp_path / "loop").symlink_to("loop")
    (tmp_path / "empty").touch()
    names = ("pipe", "directory", "loop", "empty", "nowhere")
    return [tmp_path / name for name in names] + [Path("/dev/zero"), Path("/proc/x.mcap")]


COMMANDS = (
    ("info", "{}"),
    ("motion", "{}"),
    ("convert", "{}", "{out}.mcap"),
    ("stream", "{}"),
    ("stream", "demo", "--gains", "{}", "--robot", "/dev/null"),
    ("motion", "demo", "--config", "{}", "--robot", "/dev/null"),
    ("motion", "demo", "--robot", "{}"),
)


@pytest.mark.parametrize("command", COMMANDS, ids=" ".join)
def test_paths_without_content(odd, tmp_path, capsys, command):
    for one in odd:
        arguments = [word.format(one, out=tmp_path / "out") for word in command]
        assert main(arguments) == 2, one
        cause, remedy = capsys.readouterr().err.removesuffix("\n").split("\n")
        assert cause.startswith("error: ")
        assert remedy.strip()


def test_control_characters_are_escaped_on_a_terminal(path, capsys):
    evil = "\x1b]0;title\x07\x9b2J\u202e"
    metadata = {"host": evil, "interface": evil, "motion": json.dumps({"name": evil})}
    log = encode_log(T0, 3, evil, f"gap {evil}\nerror: faked")
    path.write_bytes(session_bytes(metadata, log, [(evil, b"x")]))
    assert main(["info", str(path)]) == 0
    shown = capsys.readouterr().out
    assert "\\x1b]0;title\\x07" in shown
    assert shown.replace("\n", "").isprintable()
    assert main(["motion", str(path.with_name(f"{evil}.csv"))]) == 2
    assert capsys.readouterr().err.replace("\n", "").isprintable()


@pytest.mark.parametrize("field", ["joint_pos", "root_pos", "root_quat_wxyz"])
def test_a_motion_of_large_numbers(field):
    arrays = {"joint_pos": np.zeros((3, len(JOINT_NAMES))), "root_pos": np.zeros((3, 3))}
    arrays["root_quat_wxyz"] = np.tile([1.0, 0, 0, 0], (3, 1))
    arrays[field][1, 1] = 1e308
    with pytest.raises(MotionError, match=field):
        Motion.from_arrays(**arrays, fps=30)


def test_a_large_number_in_a_csv_is_named_by_line_and_column(path):
    lines = CSV.decode().splitlines()
    cells = lines[2].split(",")
    cells[9] = "1e308"
    path.write_text("\n".join([*lines[:2], ",".join(cells), *lines[3:]]))
    with pytest.raises(MotionError, match="line 3, column 10"):
        load_motion(path)
