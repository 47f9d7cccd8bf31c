"""A wish to arm that was told to have failed is not carried out later; a wish to stop always is."""

import pytest

from common import desk
from common.codec import Codec
from common.hand_messages import ArmReply, ArmRequest, ArmWish
from common.messages import Header
from common.topics import ARM_REPLY, ARM_REQUEST
from services.hand_io.desk import ArmDesk
from tests.unit.services.hand_io.hand import FRAME_NS, DrivenService


def query(wish):
    return Codec().encode(Header(1, 0, 0, True), ArmRequest(wish))


def reply(payload):
    return Codec().decode(ARM_REPLY.key, payload).message


@pytest.fixture
def stopped(monkeypatch):
    """A desk whose service is stopped, and what piles up in its inbox."""
    monkeypatch.setattr(desk, "ANSWER_S", 0.1)
    monkeypatch.setattr(desk, "GRACE_S", 0.0)
    made, inbox = ArmDesk(5), []
    made.open(lambda _topic, message: inbox.append(message))
    return made, inbox


def delivered(request, late_ns, hand):
    """Have the service find a request so long after its deadline."""
    hand.send(ARM_REQUEST, ArmRequest(request.wish, hand.now_ns + FRAME_NS - late_ns))
    hand.turn()
    return hand


def test_what_the_desk_gave_up_carries_the_moment_at_which_it_did(stopped):
    front, inbox = stopped
    before_ns = front._clock.now_ns()
    assert "does not answer" in reply(front.answer(query(ArmWish.ARM))).reason
    assert before_ns + 1e8 <= inbox[0].deadline_ns <= front._clock.now_ns()


@pytest.mark.parametrize(("late_ns", "state"), [(0, "armed"), (1, "hold")])
def test_a_service_that_goes_on_again_drops_a_wish_to_arm_that_has_expired(late_ns, state):
    hand = DrivenService()
    hand.turn()
    delivered(ArmRequest(ArmWish.ARM), late_ns, hand)
    assert hand.words.startswith(state) and len(hand.replies) == 1 - late_ns
    assert hand.service.report().fields["late_wishes"] == late_ns


@pytest.mark.parametrize("wish", [ArmWish.DISARM, ArmWish.STATUS])
def test_a_wish_to_stop_never_expires(wish):
    hand = delivered(ArmRequest(wish), 10**12, DrivenService().armed())
    assert hand.replies[-1].accepted
    assert hand.words.startswith("hold" if wish is ArmWish.DISARM else "armed")


def test_who_waits_for_another_query_gets_no_longer_for_it(stopped):
    front, inbox = stopped
    front._one.acquire()
    assert "others are asking" in reply(front.answer(query(ArmWish.ARM))).reason and inbox == []
    front._one.release()
    front.answer(query(ArmWish.ARM))
    assert [message.wish for message in inbox] == [ArmWish.ARM]


def test_a_service_that_answers_is_heard():
    made = ArmDesk(5)
    made.open(lambda _topic, _message: made.write(ArmReply(True, "armed", "")))
    assert reply(made.answer(query(ArmWish.ARM))).state == "armed"
