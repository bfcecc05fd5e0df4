import logging
import threading

import pytest

from g1stream.events import handled_by, severity

LOGGER = logging.getLogger("g1stream.tests")


class Collect(logging.Handler):
    def __init__(self, level=logging.NOTSET):
        super().__init__(level)
        self.texts: list[str] = []
        self.threads: set[int] = set()

    def emit(self, record):
        self.texts.append(record.getMessage())
        self.threads.add(threading.get_ident())


class Fail(logging.Handler):
    def emit(self, record):
        raise ValueError

    def handleError(self, record):
        del record


@pytest.mark.parametrize("name", ["root", "g1stream"])
def test_handlers_of_loggers_run_in_another_thread(name):
    logger, own = logging.getLogger(None if name == "root" else name), Collect()
    logger.addHandler(own)
    try:
        with handled_by():
            LOGGER.info("inside")
        assert own.threads == own.threads - {threading.get_ident()}
        LOGGER.warning("after")
    finally:
        logger.removeHandler(own)
    assert own.texts == ["inside", "after"]


def test_a_handler_that_blocks_does_not_block_the_caller():
    released, handled = threading.Event(), Collect()

    class Block(logging.Handler):
        def emit(self, record):
            released.wait(10)

    with handled_by(Block(), handled):
        LOGGER.info("one")
        assert not handled.texts  # still behind the handler that blocks
        released.set()
    assert handled.texts == ["one"]


def test_a_handler_that_fails_leaves_the_others_their_records():
    handled = Collect()
    with handled_by(Fail(), handled):
        for text in "abc":
            LOGGER.info(text)
    assert handled.texts == ["a", "b", "c"]


def test_a_handler_gets_its_level_and_above():
    handled = Collect(logging.WARNING)
    with handled_by(handled):
        LOGGER.info("info")
        LOGGER.error("error")
    assert handled.texts == ["error"]


@pytest.mark.parametrize("first_to_leave", [0, 1])
def test_contexts_may_overlap(first_to_leave):
    root, handlers = logging.getLogger("g1stream"), [Collect(), Collect()]
    before = root.handlers[:], root.propagate
    contexts = [handled_by(handler) for handler in handlers]
    for context in contexts:
        context.__enter__()
    contexts[first_to_leave].__exit__(None, None, None)
    LOGGER.info("one left")
    contexts[1 - first_to_leave].__exit__(None, None, None)
    assert handlers[1 - first_to_leave].texts == ["one left"]
    assert handlers[first_to_leave].texts == []
    assert (root.handlers, root.propagate) == before


@pytest.mark.parametrize(("level", "number"), [("DEBUG", 1), ("INFO", 2), ("CRITICAL", 5)])
def test_severity_is_numbered_as_foxglove_does(level, number):
    record = logging.makeLogRecord({"levelno": getattr(logging, level)})
    assert severity(record) == number
