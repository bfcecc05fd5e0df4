"""A library is computed again where the parameters of the robot have changed."""

from pathlib import Path

from g1stream.config import load_config
from g1stream.extras.library.compute import LibraryCase


def fingerprint(path, command="simulate"):
    case = LibraryCase(command, Path(), load_config(over={"params": path}), "bolted")
    return case.fingerprint


def test_parameters_count_by_their_content(tmp_path):
    first, same, other = (tmp_path / name for name in ("a.toml", "b.toml", "c.toml"))
    first.write_text("[friction]\nlegs = 0.3\n")
    same.write_text("[friction]\nlegs = 0.3\n")
    other.write_text("[friction]\nlegs = 0.4\n")
    assert fingerprint(first) == fingerprint(same)
    assert fingerprint(first) != fingerprint(other)
    assert fingerprint(first) != fingerprint(None)
    assert fingerprint(first, "check") != fingerprint(other, "check")
    assert fingerprint(first, "convert") == fingerprint(None, "convert")
