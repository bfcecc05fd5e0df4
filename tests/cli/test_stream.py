import os
import signal
import sys

import pytest

from g1stream.cli.stream import _go_on_by_key, playing


def test_before_there_is_a_loop_a_second_signal_ends_the_process():
    with playing():
        os.kill(os.getpid(), signal.SIGINT)
        with pytest.raises(SystemExit) as caught:
            os.kill(os.getpid(), signal.SIGTERM)
    assert caught.value.code == 128 + signal.SIGTERM


def test_each_line_of_standard_input_lets_the_motion_go_on(monkeypatch):
    begin, end = os.pipe()
    rest = [b"no line", b"\n"]
    called = []

    class Loop:
        def go_on(self):
            called.append("on")
            if rest:
                os.write(end, rest.pop(0) + rest.pop(0))
            else:
                os.close(end)

        def request_stop(self, reason):
            called.append("stop")

    os.write(end, b"\n")
    with os.fdopen(begin) as given:
        monkeypatch.setattr(sys, "stdin", given)
        _go_on_by_key(Loop())
    assert called == ["on", "on", "stop"]
