"""How a peer talks with the test that started it: JSON values, one a line.

A peer reports on stdout and is told things on stdin. It lives until its stdin is closed, so that it
never outlives the test.
"""

import json
import os
import queue
import sys
import threading


def open_reports():
    """Return a function that reports an event with its details.

    The SDKs print to stdout as they please. What they print goes to stderr from now on, so that
    stdout carries nothing but reports. An exception in one of the SDK's threads ends the process,
    so that the test need not wait for a report that cannot come.
    """
    reports = os.fdopen(os.dup(1), "w", buffering=1)
    os.dup2(2, 1)

    def fail(args):
        sys.excepthook(args.exc_type, args.exc_value, args.exc_traceback)
        os._exit(1)

    threading.excepthook = fail

    def report(event, **details):
        reports.write(json.dumps({"event": event, **details}) + "\n")

    return report


def instructions():
    """Return a queue of what the test says: the value of each line, and None when it is done."""
    inbox = queue.SimpleQueue()

    def listen():
        for line in sys.stdin:
            inbox.put(json.loads(line))
        inbox.put(None)

    threading.Thread(target=listen, daemon=True).start()
    return inbox


def hold(inbox, seconds, act):
    """Call `act` on the newest instruction, again and again at an interval, until the test is done.

    `act` gets None as long as there has been no instruction.
    """
    latest = None
    while True:
        try:
            latest = inbox.get(timeout=seconds)
        except queue.Empty:
            pass
        else:
            if latest is None:
                return
        act(latest)
