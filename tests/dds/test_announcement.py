"""How a bridge says how it holds its robot, over real discovery."""

import pytest

from g1stream.control.link import DdsLink
from g1stream.dds.announcement import support_announced, user_data_of_support
from g1stream.dds.domain import Participant
from g1stream.dds.endpoints import RawWriter
from g1stream.dds.topics import LOWSTATE


def test_a_support_is_discovered_and_forgotten(domain_id, until):
    with Participant(domain_id, "lo") as ours:
        link = DdsLink(ours)
        assert link.support() is None
        with Participant(domain_id, "lo") as bridge:
            RawWriter(bridge, LOWSTATE, user_data=user_data_of_support("hanging"))
            until(lambda: link.support() == "hanging", "the bridge to say how it holds")
        until(lambda: link.support() is None, "the bridge to be gone")


@pytest.mark.parametrize("user_data", [b"", b"somebody else's", b"g1stream"])
def test_a_writer_that_says_something_else_says_nothing(domain_id, until, user_data):
    with Participant(domain_id, "lo") as ours, Participant(domain_id, "lo") as bridge:
        RawWriter(bridge, LOWSTATE, user_data=user_data)
        until(lambda: ours.writers(LOWSTATE.name), "the writer to be discovered")
        assert support_announced(ours.writers(LOWSTATE.name)) is None


def test_two_that_contradict_each_other_say_nothing(domain_id, until):
    with Participant(domain_id, "lo") as ours, Participant(domain_id, "lo") as bridge:
        for support in ("bolted", "hanging"):
            RawWriter(bridge, LOWSTATE, user_data=user_data_of_support(support))
        until(lambda: len(ours.writers(LOWSTATE.name)) == 2, "both writers to be discovered")
        assert support_announced(ours.writers(LOWSTATE.name)) is None


def test_user_data_does_not_keep_a_reader_from_matching(domain_id, until):
    with Participant(domain_id, "lo") as ours, Participant(domain_id, "lo") as bridge:
        link = DdsLink(ours)
        writer = RawWriter(bridge, LOWSTATE, user_data=user_data_of_support("bolted"))
        until(lambda: writer.matched, "the reader of LowState to match")
        assert link.support() == "bolted"
