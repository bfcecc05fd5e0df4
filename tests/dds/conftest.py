import re
import subprocess
import sys
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from g1stream.dds import types
from g1stream.dds.layout import Layout, members

IDL_DIR = Path(__file__).parents[2] / "idl"


class Declared(NamedTuple):
    """A struct of an IDL file.

    Attributes:
        annotations: those above it, such as `@final`.
        fields: name -> (IDL name of the element's type, array length or None), in order.
    """

    annotations: list[str]
    fields: dict[str, tuple[str, int | None]]


@pytest.fixture(scope="session")
def declared():
    """Every struct of idl/ by its full name, such as `unitree_hg.msg.dds_.LowCmd_`."""
    found: dict[str, Declared] = {}
    for file in sorted(IDL_DIR.glob("*/*.idl")):
        found |= _parse(file.read_text())
    return found


def _parse(text):
    text = re.sub(r"//.*|/\*.*?\*/|^\s*#.*", "", text, flags=re.MULTILINE)
    found: dict[str, Declared] = {}
    scope: list[str] = []
    annotations: list[str] = []
    statement = re.compile(
        r"(?P<annotation>@\w+)"
        r"|module\s+(?P<module>\w+)\s*{"
        r"|struct\s+(?P<struct>\w+)\s*{(?P<body>[^}]*)}\s*;"
        r"|(?P<end>}\s*;)"
        r"|(?P<other>\S)"
    )
    for match in statement.finditer(text):
        assert not match["other"], f"not in the subset of IDL: {text[match.start() :][:40]}"
        if match["annotation"]:
            annotations.append(match["annotation"])
        elif match["module"]:
            scope.append(match["module"])
        elif match["end"]:
            scope.pop()
        else:
            found[".".join([*scope, match["struct"]])] = Declared(
                annotations, _parse_fields(match["body"])
            )
            annotations = []
    assert not scope
    return found


def _parse_fields(body):
    fields: dict[str, tuple[str, int | None]] = {}
    *fields_text, rest = body.split(";")
    assert not rest.strip()
    for text in fields_text:
        match = re.fullmatch(r"\s*([\w\s<>]+?)\s+(\w+)\s*(?:\[(\d+)\])?\s*", text)
        assert match, f"not in the subset of IDL: {text}"
        fields[match[2]] = (" ".join(match[1].split()), int(match[3]) if match[3] else None)
    return fields


def all_types():
    """Every cyclonedds class of ours with a fixed size, those inside others included."""
    found = {}
    pending = [getattr(types, name) for name in types.__all__]
    while pending:
        idl_type = pending.pop()
        found[idl_type.__idl_typename__] = idl_type
        pending += [
            element for element, _ in members(idl_type).values() if not isinstance(element, str)
        ]
    return [found[name] for name in sorted(found)]


@pytest.fixture(params=all_types(), ids=lambda t: t.__idl_typename__)
def idl_type(request):
    """Each type in turn."""
    return request.param


@pytest.fixture(scope="session")
def our_types():
    return all_types()


@pytest.fixture(scope="session")
def random_payload():
    """Random bytes as long as a type's payload."""
    return lambda idl_type, seed: np.random.default_rng(seed).integers(
        0, 256, Layout.of(idl_type).size, dtype=np.uint8
    )


PEER = """
import sys
import time
from g1stream.dds.domain import Participant
from g1stream.dds.endpoints import RawReader, RawWriter
from g1stream.dds.messages import LOWCMD, TOPICS

with Participant(int(sys.argv[1]), "lo") as participant:
    writers = {topic.name: RawWriter(participant, topic) for topic in TOPICS}
    reader = RawReader(participant, LOWCMD, ignore_own=True)
    print("ready", flush=True)
    for line in sys.stdin:
        topic, stamp, data = line.split()
        while not writers[topic].matched:  # that a reader sees us is not yet that we see it
            time.sleep(0.001)
        writers[topic].write(bytes.fromhex(data), int(stamp))
"""


class Peer:
    """Another process of ours, with a writer of every topic and a reader of LowCmd."""

    def __init__(self, process):
        self._process = process
        self.pid = process.pid

    def write(self, topic, stamp, data):
        assert self._process.stdin
        self._process.stdin.write(f"{topic} {stamp} {data.hex()}\n")
        self._process.stdin.flush()


@pytest.fixture
def peer_on():
    """Starts a Peer on a domain, for the length of a `with`; it must end in good order."""

    @contextmanager
    def start(domain_id):
        with subprocess.Popen(
            [sys.executable, "-c", PEER, str(domain_id)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        ) as process:
            try:
                assert process.stdout
                assert process.stdin
                assert process.stdout.readline() == "ready\n"
                yield Peer(process)
                process.stdin.close()
                assert process.wait(20) == 0
            finally:
                process.kill()

    return start
