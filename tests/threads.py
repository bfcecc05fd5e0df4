"""Work in a thread of the test's own process."""

import threading
from contextlib import contextmanager


@contextmanager
def in_thread(work):
    """Run `work(stop)` meanwhile; it returns soon after the event `stop` is set."""
    stop = threading.Event()
    thread = threading.Thread(target=work, args=(stop,))
    thread.start()
    try:
        yield
    finally:
        stop.set()
        thread.join()
