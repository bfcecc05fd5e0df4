import os
import signal

import pytest

from g1stream.cli.stream import playing


def test_before_there_is_a_loop_a_second_signal_ends_the_process():
    with playing():
        os.kill(os.getpid(), signal.SIGINT)
        with pytest.raises(SystemExit) as caught:
            os.kill(os.getpid(), signal.SIGTERM)
    assert caught.value.code == 128 + signal.SIGTERM
