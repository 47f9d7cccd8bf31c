"""Whatever bytes come, decoding gives a sample or a refusal and never anything else."""

import random

import msgpack
import pytest

from common.codec import Refused
from common.messages import Header, Sample
from common.topics import CHUNK, EPISODE, HEALTH, METRICS, SNAPSHOT, STEP
from tests.samples import CODEC, HEALTH_0, METRICS_0, chunk, episode, snapshot, step

HEADER = Header(5, 6, 7, True)


def strange(draw, depth=3):
    """A random object that MessagePack can carry, the odd ones included."""
    simple = [
        None,
        True,
        draw.getrandbits(64),
        -draw.getrandbits(63),
        draw.uniform(-1e308, 1e308),
        float("nan"),
        draw.randbytes(draw.randrange(30)),
        "téxt",
        msgpack.ExtType(draw.randrange(128), draw.randbytes(draw.randrange(20))),
        msgpack.Timestamp(draw.getrandbits(40), draw.randrange(10**9)),
    ]
    kind = draw.randrange(4)
    if depth == 0 or kind < 2:
        return draw.choice(simple)
    if kind == 2:
        return [strange(draw, depth - 1) for _ in range(draw.randrange(4))]
    return {draw.choice(["a", "v", b"k", "seq"]): strange(draw, depth - 1) for _ in range(draw.randrange(4))}


def flipped(draw, payload):
    data = bytearray(payload)
    for _ in range(draw.randrange(1, 4)):
        data[draw.randrange(len(data))] ^= 1 << draw.randrange(8)
    return bytes(data)


def replaced(draw, payload):
    """One field of the envelope, of the body or of an array becomes something strange."""
    envelope = msgpack.unpackb(payload)
    body = envelope["body"]
    where = draw.choice([envelope, body, *(value for value in body.values() if isinstance(value, list))])
    if where:
        key = draw.randrange(len(where)) if isinstance(where, list) else draw.choice(list(where))
        where[key] = strange(draw)
    return msgpack.packb(envelope)


def fuzzed(draw, payload):
    kind = draw.randrange(5)
    if kind == 0:
        return draw.randbytes(draw.randrange(200))
    if kind == 1:
        return payload[: draw.randrange(len(payload))]
    if kind == 2:
        return flipped(draw, payload)
    return replaced(draw, payload) if kind == 3 else msgpack.packb(strange(draw))


def valid_payloads():
    samples = [step(), chunk(), episode(), snapshot(), METRICS_0, HEALTH_0]
    topics = [STEP, CHUNK, EPISODE, SNAPSHOT, METRICS, HEALTH]
    return [
        (t.key.replace("*", "somebody"), CODEC.encode(HEADER, m))
        for t, m in zip(topics, samples, strict=True)
    ]


def test_three_thousand_broken_payloads_give_a_sample_or_a_refusal_and_nothing_else():
    draw = random.Random(0)
    valid = valid_payloads()
    refused = 0
    for i in range(3000):
        key, payload = valid[i % len(valid)]
        try:
            assert isinstance(CODEC.decode(key, fuzzed(draw, payload)), Sample)
        except Refused as error:
            refused += 1
            assert "\n" not in str(error) and len(str(error)) < 200
    assert refused > 2500  # flipped bits within numbers may well be plausible


@pytest.mark.parametrize(
    "payload",
    [
        b"",
        b"\xc1",  # never used
        b"\x91" * 100_000,  # nested without end
        b"\x91" * 1000 + b"\x01",
        b"\xdd\xff\xff\xff\xff",  # announces four billion entries
        b"\xc6\xff\xff\xff\xff",
        b"\xc7\x05\xff" + bytes(5),  # a timestamp of no known length
        b"\xc7\x0c\xff" + b"\xff" * 12,  # a timestamp with too many nanoseconds
        b"\xa2\xff\xfe",  # not UTF-8
        b"\x81\x01\x02",  # a key that is no text
        b"\x81\x91\x01\x02",  # a key that cannot be one
        msgpack.packb({"v": 1}) + b"\x00",
    ],
    ids=lambda payload: payload[:6].hex() or "empty",
)
def test_strange_message_pack_is_refused(payload):
    with pytest.raises(Refused):
        CODEC.decode("model/snapshot", payload)


@pytest.mark.parametrize("name", ["v", "type", "body", "seq"])
def test_a_field_nested_almost_too_deep_is_refused(name):
    envelope = msgpack.unpackb(CODEC.encode(HEADER, step()))
    envelope[name] = None
    deep = b"\x91" * 990 + b"\x01"
    field = msgpack.packb(name)
    payload = msgpack.packb(envelope).replace(field + b"\xc0", field + deep)
    assert deep in payload
    with pytest.raises(Refused):
        CODEC.decode("control/step", payload)
