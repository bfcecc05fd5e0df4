"""What is read back from /log."""

from __future__ import annotations

import pytest

from g1stream.foxglove.encoders import encode_log
from g1stream.session.events import log_event

T0 = 1_700_000_000_000_000_000


@pytest.mark.parametrize(("level", "name"), [(2, "INFO"), (5, "FATAL"), (9, "UNKNOWN")])
def test_an_event_has_the_name_of_its_level(level, name):
    assert log_event(encode_log(T0, level, "stream", "late")) == (T0, name, "stream", "late")
