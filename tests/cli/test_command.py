import json
import os
import pty
import signal
import subprocess
import sys
import threading
import time

import pytest

from g1stream.analysis.summary import Summary, Termination
from g1stream.cli.command import (
    _HANDLED,
    confirmed,
    exit_code,
    on_signals,
    print_summary,
)
from g1stream.session.records import RecorderSummary, StreamSummary


@pytest.mark.parametrize(
    ("reason", "signalled", "recorder", "code"),
    [
        ("", None, None, 0),
        ("", None, {"lost": {"/lowstate": 0}}, 0),
        ("", None, {"lost": {"/lowstate": 1}}, 1),
        ("", None, {"malformed": {"/lowstate": 1}}, 1),
        ("", None, {"dropped_datagrams": 1}, 1),
        ("", None, {"stopped": "The disk is full."}, 1),
        ("", None, {"first_ns": None}, 1),
        ("no LowState came within 1 s", None, None, 1),
        ("SIGINT", None, None, 1),  # the words of a program, not a signal
        ("any words", signal.SIGINT, None, 130),
        ("any words", signal.SIGTERM, {"lost": {"/lowstate": 1}}, 143),
        (None, None, {}, 0),
    ],
)
def test_the_exit_code(reason, signalled, recorder, code):
    received = None if recorder is None else RecorderSummary(**{"first_ns": 1, **recorder})
    summary = Summary(
        termination=Termination(reason=reason),
        stream=StreamSummary(signal=signalled),
        recorder=received,
    )
    assert exit_code(summary) == code


def test_a_file_without_the_recorders_summary_is_not_complete():
    assert exit_code(Summary(files_bytes={"s.mcap": 10}, termination=Termination(reason=""))) == 1


def test_json_is_the_record(capsys):
    summary = Summary(host="bench", recorder=RecorderSummary(lost={"/lowstate": 2}))
    print_summary(summary, as_json=True)
    assert Summary.model_validate(json.loads(capsys.readouterr().out)) == summary


@pytest.mark.parametrize(
    "number",
    [
        *(signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT, signal.SIGTSTP),
        *(signal.SIGUSR1, signal.SIGALRM, signal.SIGABRT, signal.SIGRTMIN + 3, signal.SIGPROF),
    ],
)
def test_every_signal_that_ends_a_process_is_handled(number):
    before, received = signal.getsignal(number), []
    with on_signals(received.append):
        os.kill(os.getpid(), number)
    assert received == [number]
    assert signal.getsignal(number) == before


def test_all_signals_but_these_are_handled():
    names = "KILL STOP CHLD CONT URG WINCH PIPE XFSZ SEGV BUS FPE ILL TRAP SYS"
    others = {signal.Signals[f"SIG{name}"] for name in names.split()}
    assert set(_HANDLED) == signal.valid_signals() - others


@pytest.mark.parametrize("number", [signal.SIGPIPE, signal.SIGSEGV, signal.SIGCHLD])
def test_signals_that_must_not_be_handled_are_not(number):
    before = signal.getsignal(number)
    with on_signals(lambda _: None):
        assert signal.getsignal(number) == before


def test_a_handler_that_is_not_python_s_stays():
    """`-X faulthandler` has one of SIGABRT, which Python could not put back."""
    program = (
        "import signal; from g1stream.cli.command import on_signals\n"
        "with on_signals(print): print(signal.getsignal(signal.SIGABRT))"
    )
    command = [sys.executable, "-X", "faulthandler", "-c", program]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (done.stdout, done.stderr, done.returncode) == ("None\n", "", 0)


@pytest.fixture
def terminal(monkeypatch):
    """The other end of the terminal that is standard input."""
    ours, theirs = pty.openpty()
    with os.fdopen(ours, "wb", buffering=0) as keyboard, os.fdopen(theirs) as screen:
        monkeypatch.setattr("sys.stdin", screen)
        yield keyboard


@pytest.mark.parametrize(("typed", "answer"), [(b"eth9\n", True), (b"eth0\n", False)])
def test_the_answer_is_the_name_of_the_interface(terminal, typed, answer):
    terminal.write(typed)
    assert confirmed("eth9", None) is answer


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_signals_end_the_question_also_where_they_end_a_stream_otherwise(terminal, number):
    stops = []
    with on_signals(stops.append):
        before = signal.getsignal(number)

        def send():
            while signal.getsignal(number) == before:  # not asked yet
                time.sleep(0.01)
            os.kill(os.getpid(), number)

        sender = threading.Thread(target=send)
        sender.start()
        with pytest.raises(SystemExit) as caught:
            confirmed("eth9", None)
        sender.join()
        assert signal.getsignal(number) == before
    assert caught.value.code == 128 + number
    assert stops == []
