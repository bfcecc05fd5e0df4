"""The public names: what is promised is there, and importing the package is cheap."""

from __future__ import annotations

import subprocess
import sys

import pytest

import g1stream


@pytest.mark.parametrize("name", g1stream.__all__)
def test_every_public_name_is_there(name):
    assert getattr(g1stream, name) is not None


def test_dir_shows_the_public_names():
    assert dir(g1stream) == sorted(g1stream.__all__)


def test_an_unknown_name_is_an_attribute_error():
    with pytest.raises(AttributeError, match="no attribute 'wave'"):
        _ = g1stream.wave


def test_importing_loads_nothing_heavy():
    code = "import sys, g1stream; print('numpy' in sys.modules, 'cyclonedds' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["False", "False"]
