import os
from pathlib import Path

import pytest


@pytest.fixture
def matches_snapshot():
    """Compare a text with the file of a name; UPDATE_SNAPSHOTS=1 writes that anew."""

    def check(name, text):
        path = Path(__file__).with_name("snapshots") / f"{name}.txt"
        if os.environ.get("UPDATE_SNAPSHOTS"):
            path.write_text(f"{text}\n")
        assert f"{text}\n" == path.read_text()

    return check
