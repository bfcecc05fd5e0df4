import os
import signal

import pytest

from g1stream.cli.stream import _go_on_by_key, playing


def test_before_there_is_a_loop_a_second_signal_ends_the_process():
    with playing():
        os.kill(os.getpid(), signal.SIGINT)
        with pytest.raises(SystemExit) as caught:
            os.kill(os.getpid(), signal.SIGTERM)
    assert caught.value.code == 128 + signal.SIGTERM


def test_each_line_of_standard_input_lets_the_motion_go_on(monkeypatch):
    called = []

    class Loop:
        def go_on(self):
            called.append("on")

        def end_at_rest(self, reason):
            called.append("end")

    texts = iter([b"\n", b"no line", b"\n", b""])
    monkeypatch.setattr(os, "read", lambda *_: next(texts))
    _go_on_by_key(Loop())
    assert called == ["on", "on", "end"]
