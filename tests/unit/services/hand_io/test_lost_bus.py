"""After a lost bus nothing moves until a person has armed the hand again, whatever order messages come in."""

import pytest

from common.dexhand021.angles import to_normalised
from common.hand_messages import Drive, HandCommand, Link
from common.topics import EPISODE
from tests.unit.services.hand_io.hand import DrivenService
from tests.unit.services.hand_io.test_driver import HOLD, Driven, LinkError
from tests.unit.services.hand_io.test_hand_service import episode, running

FOLLOW = HandCommand(Drive.FOLLOW, to_normalised([0.3] * 12).astype("float32"), 300_000_000)
OFF = HandCommand(Drive.OFF, HOLD.action, 0)


@pytest.fixture
def lost():
    """A hand that held when its bus was lost; it cannot be opened again before the test says so."""
    hand = Driven()
    hand.wait(lambda frame: frame.link is Link.UP and frame.age_ms.max() < 50)
    hand.port.write(HOLD)
    hand.wait(lambda frame: frame.enabled.all())
    hand.fails, hand.links[0].send_error = True, LinkError("network is down")
    hand.wait(lambda frame: frame.link is Link.DOWN)
    yield hand
    hand.port.close()


def reopened(hand):
    hand.fails = False
    return hand.wait(lambda frame: frame.link is Link.UP and frame.age_ms.max() < 50)


@pytest.mark.parametrize("order", [FOLLOW, HOLD])
def test_an_order_that_was_on_its_way_when_the_bus_was_lost_has_no_effect(lost, order):
    lost.port.write(order)
    frame = reopened(lost)
    assert frame.drive is Drive.OFF and not frame.enabled.any()
    assert frame.counts["refused_commands"] == 1


def test_an_order_of_a_sender_who_has_not_heard_of_the_loss_has_no_effect_when_the_bus_is_back(lost):
    reopened(lost)
    lost.port.write(FOLLOW)
    count = len(lost.frames)
    frame = lost.wait(lambda _frame: len(lost.frames) > count + 3)
    assert frame.drive is Drive.OFF and not frame.enabled.any()
    lost.port.write(OFF)
    lost.port.write(HOLD)
    lost.wait(lambda frame: frame.enabled.all())


@pytest.mark.parametrize("drive", [Drive.OFF, Drive.FOLLOW])
@pytest.mark.parametrize("link", [Link.DOWN, Link.BUS_OFF])
def test_a_lost_bus_is_answered_with_off_whatever_the_driver_says_that_it_does(drive, link):
    hand = running()
    hand.turn(link=link, drive=drive)
    assert hand.drives[-1] is Drive.OFF and hand.words.startswith(("hold", "fault"))


@pytest.mark.parametrize("count", ["down", "bus_off"])
def test_a_loss_between_two_frames_ends_what_runs(count):
    hand = DrivenService().armed()
    hand.send(EPISODE, episode())
    hand.turn()
    hand.turn(counts={**hand.frame.counts, count: 1.0})
    assert hand.words == "hold: the bus was lost"
