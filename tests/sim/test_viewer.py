"""The viewer where there is nothing to show it on."""

from __future__ import annotations

import sys

import pytest

from g1stream.errors import SimError
from g1stream.robot.model import G1
from g1stream.sim.viewer import open_viewer
from g1stream.sim.world import World


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="displays are looked up otherwise")
def test_a_missing_display_is_an_error_at_once(monkeypatch):
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    with pytest.raises(SimError, match="display"):
        open_viewer(World(G1.default()))
