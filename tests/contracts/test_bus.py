"""What every bus promises, checked on each of them."""

from __future__ import annotations

import tempfile
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from common.bus import Bus, LocalBus
from common.bus_config import BusConfig
from common.clock import WallClock
from common.clock_offset import ClockServer, measure_offset
from common.config import ConfigError, parse
from common.topics import CHUNK, EPISODE, HEALTH, SNAPSHOT, STEP, TOPICS, Topic
from common.zenoh_bus import ZenohBus
from common.zenoh_router import BusError, Router

PATIENCE_S = 5.0


class Heard:
    """A sink that remembers."""

    def __init__(self) -> None:
        self.items: list[tuple[str, bytes]] = []

    def __call__(self, key: str, payload: bytes) -> None:
        self.items.append((key, payload))

    @property
    def payloads(self) -> list[bytes]:
        return [payload for _, payload in self.items]

    def wait(self, count: int) -> None:
        deadline = time.monotonic() + PATIENCE_S
        while len(self.items) < count and time.monotonic() < deadline:
            time.sleep(0.002)
        assert len(self.items) >= count


@pytest.fixture
def endpoint() -> Iterator[str]:
    with tempfile.TemporaryDirectory(prefix="bus") as folder:  # short: socket paths hold about 100 characters
        endpoint = f"unixsock-stream/{Path(folder) / 'bus.sock'}"
        with Router((endpoint,)):
            yield endpoint


@pytest.fixture(params=["local", "zenoh", "zenoh-same-process"])
def pair(request: pytest.FixtureRequest) -> Iterator[tuple[Bus, Bus]]:
    """Yield the bus of a sender and the bus of a receiver."""
    if request.param == "local":
        local = LocalBus()
        yield local, local
        local.close()
        return
    config = BusConfig(connect=(request.getfixturevalue("endpoint"),))
    sender = ZenohBus(config, "cell", "sender")
    receiver = ZenohBus(config, "cell", "receiver") if request.param == "zenoh" else sender
    yield sender, receiver
    sender.close()
    receiver.close()


def settle(sender: Bus, receiver: Bus, topic: Topic, key: str) -> Heard:
    """Subscribe and wait until the first payload passes: the router has learnt of both ends."""
    heard = Heard()
    receiver.subscribe(topic, heard)
    deadline = time.monotonic() + PATIENCE_S
    while not heard.items and time.monotonic() < deadline:
        sender.publish(topic, key, b"hello")
        time.sleep(0.01)
    time.sleep(0.05)
    heard.items.clear()
    return heard


def join_late(receiver: Bus, topic: Topic) -> Heard:
    """Subscribe once nothing is on its way any more."""
    time.sleep(0.1)
    heard = Heard()
    receiver.subscribe(topic, heard)
    return heard


@pytest.mark.parametrize("topic", [STEP, CHUNK, EPISODE], ids=lambda topic: topic.key)
def test_payloads_arrive_once_and_in_order(pair: tuple[Bus, Bus], topic: Topic) -> None:
    sender, receiver = pair
    heard = settle(sender, receiver, topic, topic.key)
    sent = [b"%d" % i for i in range(300)]
    for payload in sent:
        sender.publish(topic, topic.key, payload)
    heard.wait(len(sent))
    assert heard.payloads == sent
    assert {key for key, _ in heard.items} == {topic.key}


def test_a_late_joiner_gets_what_is_latched_and_then_what_follows(pair: tuple[Bus, Bus]) -> None:
    sender, receiver = pair
    for i in range(STEP.latched + 50):
        sender.publish(STEP, STEP.key, b"%d" % i)
    heard = join_late(receiver, STEP)
    heard.wait(STEP.latched)
    sender.publish(STEP, STEP.key, b"live")
    heard.wait(STEP.latched + 1)
    assert heard.payloads == [b"%d" % i for i in range(50, STEP.latched + 50)] + [b"live"]


@pytest.mark.parametrize("topic", [EPISODE, SNAPSHOT], ids=lambda topic: topic.key)
def test_a_late_joiner_gets_only_the_newest_of_a_topic_latched_once(
    pair: tuple[Bus, Bus], topic: Topic
) -> None:
    sender, receiver = pair
    for i in range(5):
        sender.publish(topic, topic.key, b"%d" % i)
    heard = join_late(receiver, topic)
    heard.wait(1)
    time.sleep(0.1)
    assert heard.payloads == [b"4"]


def test_an_unlatched_topic_keeps_nothing(pair: tuple[Bus, Bus]) -> None:
    sender, receiver = pair
    sender.publish(CHUNK, CHUNK.key, b"gone")
    heard = settle(sender, receiver, CHUNK, CHUNK.key)
    assert b"gone" not in heard.payloads


def test_a_wildcard_topic_latches_per_key(pair: tuple[Bus, Bus]) -> None:
    sender, receiver = pair
    for i in range(3):
        for name in ("planner", "learner"):
            sender.publish(HEALTH, f"health/{name}", b"%d" % i)
    heard = join_late(receiver, HEALTH)
    heard.wait(2)
    sender.publish(HEALTH, "health/sim", b"live")
    heard.wait(3)
    assert sorted(heard.items) == [
        ("health/learner", b"2"),
        ("health/planner", b"2"),
        ("health/sim", b"live"),
    ]


def test_topics_do_not_mix(pair: tuple[Bus, Bus]) -> None:
    sender, receiver = pair
    steps = settle(sender, receiver, STEP, STEP.key)
    chunks = settle(sender, receiver, CHUNK, CHUNK.key)
    sender.publish(STEP, STEP.key, b"step")
    sender.publish(CHUNK, CHUNK.key, b"chunk")
    steps.wait(1)
    chunks.wait(1)
    assert (steps.payloads, chunks.payloads) == ([b"step"], [b"chunk"])


@pytest.mark.parametrize("topic", TOPICS, ids=lambda topic: topic.key)
def test_publishing_with_nobody_there_neither_fails_nor_blocks(pair: tuple[Bus, Bus], topic: Topic) -> None:
    started = time.monotonic()
    for _ in range(20):
        pair[0].publish(topic, topic.key.replace("*", "someone"), bytes(1000))
    assert time.monotonic() - started < 1.0


@pytest.mark.parametrize("topic", [STEP, SNAPSHOT], ids=lambda topic: topic.key)
def test_publishing_does_not_wait_for_a_slow_receiver(endpoint: str, topic: Topic) -> None:
    config = BusConfig(connect=(endpoint,))
    sender, receiver = ZenohBus(config, "cell", "sender"), ZenohBus(config, "cell", "receiver")
    release = threading.Event()

    def dawdle(_key: str, _payload: bytes) -> None:
        release.wait(PATIENCE_S)

    receiver.subscribe(topic, dawdle)
    started = time.monotonic()
    for _ in range(50):
        sender.publish(topic, topic.key, bytes(1000))
    assert time.monotonic() - started < 1.0
    release.set()
    sender.close()
    receiver.close()


def test_close_is_idempotent_and_silences_the_bus(pair: tuple[Bus, Bus]) -> None:
    sender, receiver = pair
    heard = settle(sender, receiver, STEP, STEP.key)
    started = time.monotonic()
    for bus in (receiver, receiver, sender, sender):
        bus.close()
    assert time.monotonic() - started < 5.0
    sender.publish(STEP, STEP.key, b"late")
    time.sleep(0.05)
    assert heard.items == []


def test_what_was_published_just_before_close_still_arrives(endpoint: str) -> None:
    config = BusConfig(connect=(endpoint,))
    sender, receiver = ZenohBus(config, "cell", "sender"), ZenohBus(config, "cell", "receiver")
    heard = settle(sender, receiver, STEP, STEP.key)
    snapshots = settle(sender, receiver, SNAPSHOT, SNAPSHOT.key)
    for i in range(100):
        sender.publish(STEP, STEP.key, b"%d" % i)
    sender.publish(SNAPSHOT, SNAPSHOT.key, b"last")
    sender.close()
    heard.wait(100)
    snapshots.wait(1)
    assert heard.payloads == [b"%d" % i for i in range(100)]
    assert snapshots.payloads[-1] == b"last"
    receiver.close()


def test_a_failing_sink_is_counted_and_the_others_go_on(endpoint: str) -> None:
    config = BusConfig(connect=(endpoint,))
    sender, receiver = ZenohBus(config, "cell", "sender"), ZenohBus(config, "cell", "receiver")

    def fail(_key: str, _payload: bytes) -> None:
        raise ValueError("a bug in a sink")

    receiver.subscribe(STEP, fail)
    heard = settle(sender, receiver, STEP, STEP.key)
    sender.publish(STEP, STEP.key, b"more")
    heard.wait(1)
    assert receiver.callback_errors >= 1
    assert receiver.misses == {}
    sender.close()
    receiver.close()


def test_cells_are_apart_and_the_living_are_known_by_name(endpoint: str) -> None:
    config = BusConfig(connect=(endpoint,))
    mine, friend = ZenohBus(config, "reach", "planner"), ZenohBus(config, "reach", "learner")
    other = ZenohBus(config, "egg", "planner")
    foreign = Heard()
    other.subscribe(STEP, foreign)
    settle(mine, friend, STEP, STEP.key)
    assert foreign.items == []
    assert mine.alive() == ("learner", "planner")
    assert other.alive() == ("planner",)
    friend.close()
    assert mine.alive() == ("planner",)
    mine.close()
    other.close()


def test_questions_are_answered_or_come_back_empty(endpoint: str) -> None:
    config = BusConfig(connect=(endpoint,))
    server, client = ZenohBus(config, "cell", "server"), ZenohBus(config, "cell", "client")
    server.serve("hand/arm", lambda payload: payload[::-1])
    server.serve("hand/broken", lambda payload: payload.decode().encode("ascii"))
    deadline = time.monotonic() + PATIENCE_S
    while client.ask("hand/arm", b"abc", 1.0) is None and time.monotonic() < deadline:
        time.sleep(0.01)
    assert client.ask("hand/arm", b"abc", 1.0) == b"cba"
    assert client.ask("hand/broken", b"\xff", 1.0) is None
    assert server.callback_errors == 1
    assert client.ask("nobody/there", b"", 1.0) is None
    server.close()
    client.close()


def test_a_missing_router_is_one_line_that_says_what_to_do() -> None:
    config = BusConfig(connect=("tcp/127.0.0.1:1",), connect_timeout_s=0.3)
    with pytest.raises(BusError) as failure:
        ZenohBus(config, "cell", "lonely")
    text = str(failure.value)
    assert "tcp/127.0.0.1:1 within 0.3 s" in text
    assert "python -m deploy.router" in text
    assert "\n" not in text


@pytest.mark.parametrize(
    ("data", "complaint"),
    [
        ({"retry_ms": 400, "retry_max_ms": 300}, "retry_max_ms"),
        ({"mode": "peer"}, "peer_listen"),
        ({"endpiont": "x"}, "no such key"),
    ],
)
def test_an_implausible_bus_section_is_refused(data: dict[str, object], complaint: str) -> None:
    with pytest.raises(ConfigError, match=complaint):
        parse(BusConfig, data, "cell.yaml")


def test_the_clock_of_another_process_is_measured_over_the_bus(endpoint: str) -> None:
    class Ahead(WallClock):
        def now_ns(self) -> int:
            return super().now_ns() + 3_000_000_000

    config = BusConfig(connect=(endpoint,))
    server, client = ZenohBus(config, "cell", "server"), ZenohBus(config, "cell", "client")
    with pytest.raises(TimeoutError, match="somebody does not answer"):
        measure_offset(client, "somebody", 3)
    ClockServer(server, "server", Ahead())
    offset = measure_offset(client, "server", 50)
    assert abs(offset.offset_ns - 3_000_000_000) < 50_000_000
    server.close()
    client.close()
