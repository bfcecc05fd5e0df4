"""What tests of the commands share."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from collections.abc import Callable


@pytest.fixture
def matches_snapshot() -> Callable[[str, str], None]:
    """Compare a text with the file of a name; UPDATE_SNAPSHOTS=1 writes that anew."""

    def check(name: str, text: str) -> None:
        path = Path(__file__).with_name("snapshots") / f"{name}.txt"
        if os.environ.get("UPDATE_SNAPSHOTS"):
            path.write_text(f"{text}\n")
        assert f"{text}\n" == path.read_text()

    return check
