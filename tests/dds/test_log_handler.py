import logging

import pytest

from g1stream.dds.domain import Participant
from g1stream.dds.endpoints import RawReader
from g1stream.dds.log_handler import dds_log_handler
from g1stream.dds.messages import LOG, Log
from g1stream.events import handled_by

pytestmark = pytest.mark.dds


def test_records_are_published_with_level_name_text_and_the_time_they_were_logged(domain_id, until):
    logger, records = logging.getLogger("g1stream.test"), []
    keep = logging.Handler()
    keep.emit = records.append
    with Participant(domain_id, "lo") as ours, Participant(domain_id, "lo") as other:
        handler = dds_log_handler(other, "stream")
        reader = RawReader(ours, LOG, depth=10)
        until(lambda: reader.matched, "the writer of events")
        samples = []
        with handled_by(handler, keep):
            logger.debug("not published")
            logger.info("phase %s", "PLAY")
            logger.warning("é" * 200)
            logger.error("tilt")
        until(lambda: samples.extend(reader.take()) or len(samples) >= 3, "the events")
    message, found = Log(), []
    for sample in samples:
        message.load(sample.data)
        found.append((int(message.level), message.name, message.text))
    assert found == [
        (2, "stream", "phase PLAY"),
        (3, "stream", "é" * 120),
        (4, "stream", "tilt"),
    ]
    assert [s.publish_time for s in samples] == [int(r.created * 1e9) for r in records]
