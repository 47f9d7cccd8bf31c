"""The inbox shows a service only whole messages, and says whether its inputs can be trusted."""

from common.bus import ALL_WAITING, RATE_WINDOW, Inbox, Input, JobResult
from common.messages import Header
from common.topics import CHUNK, EPISODE, HEALTH, STEP
from tests.samples import CODEC, HEALTH_0, chunk, episode, step

SECOND = 1_000_000_000


def payload(message, seq=0, valid=True):
    return CODEC.encode(Header(5, seq, 0, valid), message)


def put(inbox, topic, message, seq=0, *, valid=True, key=None):
    inbox.sink(topic)(key or topic.key, payload(message, seq, valid))


def shown(inbox, topic):
    return [sample.header.seq for sample in inbox.take(topic)]


def test_all_keeps_every_sample_in_order_until_the_next_step():
    inbox = Inbox(CODEC, (Input(STEP),))
    for seq in range(3):
        put(inbox, STEP, step(seq), seq)
    assert shown(inbox, STEP) == []  # nothing is shown before it is collected
    arrived, results = inbox.collect(0, 1)
    assert [key for key, _ in arrived] == ["control/step"] * 3
    assert [p for _, p in arrived] == [payload(step(seq), seq) for seq in range(3)]
    assert results == []
    assert shown(inbox, STEP) == [0, 1, 2]
    inbox.collect(1, 1)
    assert shown(inbox, STEP) == []
    assert inbox.newest(STEP).header.seq == 2


def test_newest_keeps_one_sample_per_key_and_counts_no_loss():
    inbox = Inbox(CODEC, (Input(STEP, newest=True), Input(HEALTH, newest=True)))
    for seq in range(5):
        put(inbox, STEP, step(), seq)
        put(inbox, HEALTH, HEALTH_0, seq, key="health/sim")
        put(inbox, HEALTH, HEALTH_0, 10 + seq, key="health/planner")
    arrived, _ = inbox.collect(0, 1)
    assert shown(inbox, STEP) == [4]
    assert sorted(shown(inbox, HEALTH)) == [4, 14]
    assert len(arrived) == 3
    assert inbox.dropped == {}


def test_what_nobody_reads_in_time_is_lost_oldest_first_and_counted():
    inbox = Inbox(CODEC, (Input(EPISODE),))
    for seq in range(ALL_WAITING + 3):
        put(inbox, EPISODE, episode(), seq)
    inbox.collect(0, 1)
    assert shown(inbox, EPISODE) == list(range(3, ALL_WAITING + 3))
    assert inbox.dropped == {"task/episode": 3}


def test_a_refused_payload_is_counted_never_shown_and_wakes_nobody():
    inbox = Inbox(CODEC, (Input(STEP, wake=True), Input(CHUNK, wake=True)))
    for bad in (b"", b"garbage", payload(chunk())):
        inbox.sink(STEP)("control/step", bad)
    assert not inbox.wake.is_set()
    assert inbox.collect(0, 1) == ([], [])
    assert shown(inbox, STEP) == []
    assert inbox.newest(STEP) is None
    assert inbox.refused == {"control/step": 3}
    assert inbox.last_refusal == "control/step: type Chunk, expected Step"


def test_a_refused_payload_does_not_displace_the_newest_good_one():
    inbox = Inbox(CODEC, (Input(STEP, newest=True),))
    put(inbox, STEP, step(), 7)
    inbox.sink(STEP)("control/step", b"garbage")
    inbox.collect(0, 1)
    assert shown(inbox, STEP) == [7]
    assert inbox.refused == {"control/step": 1}


def test_only_waking_inputs_and_results_wake_and_collecting_ends_it():
    inbox = Inbox(CODEC, (Input(STEP, wake=True), Input(CHUNK)))
    put(inbox, CHUNK, chunk())
    assert not inbox.wake.is_set()
    put(inbox, STEP, step())
    assert inbox.wake.is_set()
    inbox.collect(0, 0)
    assert not inbox.wake.is_set()
    result = JobResult("plan", 1, "", 5)
    inbox.finish(result)
    assert inbox.wake.is_set()
    assert inbox.collect(0, 0) == ([], [result])
    assert inbox.results == [result]
    inbox.collect(0, 3)
    assert (inbox.results, inbox.ticks) == ([], 3)


def test_an_input_is_alive_for_ten_periods_but_at_least_two_seconds():
    inbox = Inbox(CODEC, (Input(STEP), Input(HEALTH)))
    assert inbox.status(STEP, 0) == inbox.status(HEALTH, 0)
    assert inbox.status(STEP, 0).age_ns == -1
    assert inbox.stale(0) == ("control/step", "health/*")
    put(inbox, STEP, step())
    put(inbox, HEALTH, HEALTH_0, key="health/sim")
    inbox.collect(SECOND, 1)
    assert inbox.status(STEP, 3 * SECOND).alive and not inbox.status(STEP, 3 * SECOND + 1).alive
    assert inbox.status(HEALTH, 6 * SECOND).alive and not inbox.status(HEALTH, 6 * SECOND + 1).alive
    assert inbox.stale(4 * SECOND) == ("control/step",)
    assert inbox.status(STEP, 4 * SECOND).age_ns == 3 * SECOND


def test_an_input_without_a_rate_is_alive_once_seen():
    inbox = Inbox(CODEC, (Input(EPISODE),))
    assert not inbox.status(EPISODE, 0).alive
    put(inbox, EPISODE, episode())
    inbox.collect(0, 1)
    status = inbox.status(EPISODE, 10**6 * SECOND)
    assert status.alive and status.rate_ok
    assert inbox.stale(10**6 * SECOND) == ()


def test_the_rate_is_right_from_nine_tenths_of_the_nominal_one():
    for period_ns, right in ((40_000_000, True), (44_000_000, True), (45_000_000, False)):
        inbox = Inbox(CODEC, (Input(STEP),))
        for i in range(2 * RATE_WINDOW):
            put(inbox, STEP, step())
            inbox.collect(i * period_ns, 1)
        status = inbox.status(STEP, 2 * RATE_WINDOW * period_ns)
        assert status.alive and status.rate_ok is right


def test_validity_is_that_of_the_newest_sample():
    inbox = Inbox(CODEC, (Input(STEP),))
    for valid in (True, False, True):
        put(inbox, STEP, step(), valid=valid)
        inbox.collect(0, 1)
        assert inbox.status(STEP, 0).valid is valid
