"""Programs and publishers in threads of this process."""

import threading
import time
from contextlib import contextmanager
from types import SimpleNamespace

import pytest

from g1stream.app.sim import simulate
from g1stream.config import Config
from threads import in_thread


@pytest.fixture
def beside():
    """Run a program of `g1stream.app` meanwhile; gives its event `ready`, and then its `result`."""

    @contextmanager
    def run(program, *arguments, **options):
        own = SimpleNamespace(ready=threading.Event())

        def work(stop):
            given = {"should_stop": stop.is_set, "on_ready": own.ready.set}
            own.result = program(*arguments, **options, **given)

        with in_thread(work):
            yield own

    return run


@pytest.fixture
def publishing(beside):
    """Call a function at 50 Hz meanwhile."""

    def publish(act, should_stop, on_ready):
        while not should_stop():
            act()
            time.sleep(0.02)

    return lambda act: beside(publish, act)


@pytest.fixture
def bridge(domain_id, beside):
    """Our bridge in a thread, with a mode of the motion service; gives where it is."""

    @contextmanager
    def run(onboard=None):
        config = Config.model_validate({"dds": {"domain": domain_id}, "sim": {"onboard": onboard}})
        with beside(simulate, config) as started:
            assert started.ready.wait(30)
            yield config.dds

    return run
