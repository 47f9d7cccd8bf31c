"""Every message survives the wire unchanged; what is not a message of its topic is refused, and only that."""

from dataclasses import fields, replace
from enum import StrEnum
from typing import Annotated, get_args, get_origin, get_type_hints

import msgpack
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from common.codec import MAX_ENTRIES, MAX_LENGTH, MAX_TEXT, Codec, Refused
from common.messages import ArraySpec, Header, Range, SnapshotMessage
from common.topics import CHUNK, EPISODE, HEALTH, METRICS, PORTS, SNAPSHOT, STEP, TOPICS
from tests.samples import CODEC, HEALTH_0, METRICS_0, A, G, S, V, chunk, episode, snapshot, step

ALL = (*TOPICS, *PORTS)
HEADER = Header(5, 6, 7, True)
LENGTHS = {"S": S, "A": A, "G": G, "V": V, "Y": 2, "X": 3}  # one length within a message
TEXTS = st.text(st.characters(exclude_categories=("Cs",)), max_size=20)


def strategy(hint):
    """Values of one field's annotation; a kind of field that has none here fails the tests of its topic."""
    rule = None
    if get_origin(hint) is Annotated:
        hint, rule = get_args(hint)[:2]
    if isinstance(rule, ArraySpec):
        shape = st.tuples(*(axis_length(axis) for axis in rule.shape))
        return shape.flatmap(lambda found: array(rule, found))
    return container(hint) if get_origin(hint) else scalar(hint, rule)


def scalar(hint, rule):
    if isinstance(hint, type) and issubclass(hint, StrEnum):
        return st.sampled_from(hint)
    if hint is int:
        return st.integers(int(rule.low), int(rule.high)) if rule else st.integers(0, 2**60)
    if hint is float:
        low, high = (rule.low, rule.high) if isinstance(rule, Range) else (-1e300, 1e300)
        return st.floats(low, high)
    return {bool: st.booleans(), str: TEXTS, bytes: st.binary(max_size=50)}[hint]


def container(hint):
    if get_origin(hint) is dict:
        return st.dictionaries(TEXTS, strategy(get_args(hint)[1]), max_size=4)
    assert get_origin(hint) is tuple, f"no strategy for {hint}"
    return st.lists(TEXTS, max_size=4).map(tuple)


def axis_length(axis):
    if isinstance(axis, int):
        return st.just(axis)
    return st.just(LENGTHS[axis]) if axis in LENGTHS else st.integers(0, 6)


def array(rule, shape):
    kind = np.dtype(rule.dtype)
    if kind.kind == "u":
        return arrays(kind, shape, elements=st.integers(0, min(int(rule.limit), np.iinfo(kind).max)))
    return arrays(kind, shape, elements=st.floats(-rule.limit, rule.limit, width=8 * kind.itemsize))


def messages(kind):
    hints = get_type_hints(kind, include_extras=True)
    return st.builds(kind, **{name: strategy(hint) for name, hint in hints.items()})


HEADERS = st.builds(
    Header,
    st.integers(1, 2**62),
    st.integers(0, 2**62),
    st.integers(0, 2**62),
    st.booleans(),
)


def assert_equal(a, b):
    assert type(a) is type(b)
    for item in fields(a):
        old, new = getattr(a, item.name), getattr(b, item.name)
        if isinstance(old, np.ndarray):
            assert new.dtype == old.dtype and new.shape == old.shape and np.array_equal(new, old)
        else:
            assert type(new) is type(old) and new == old


def key_of(topic):
    return topic.key.replace("*", "somebody")


def raw(payload):
    return msgpack.unpackb(payload)


@pytest.mark.parametrize("topic", ALL, ids=lambda topic: topic.key)
def test_every_message_of_every_topic_survives_the_wire(topic):
    @settings(max_examples=60, deadline=None)
    @given(messages(topic.message), HEADERS)
    def check(message, header):
        payload = CODEC.encode(header, message)
        sample = CODEC.decode(key_of(topic), payload)
        assert sample.key == key_of(topic)
        assert_equal(sample.header, header)
        assert_equal(sample.message, message)
        assert CODEC.encode(sample.header, sample.message) == payload

    check()


def test_arrays_are_little_endian_raw_bytes_with_dtype_and_shape():
    body = raw(CODEC.encode(HEADER, chunk()))["body"]
    dtype, shape, data = body["actions"]
    assert (dtype, shape) == ("<f4", [5, A])
    assert data == np.full((5, A), 0.5, "<f4").tobytes()


def test_a_sender_may_hold_wider_or_strided_arrays():
    wide = np.linspace(0, 1, 2 * S)[::2]
    sample = CODEC.decode("control/step", CODEC.encode(HEADER, step(state=wide)))
    assert np.array_equal(sample.message.state, wide.astype(np.float32))
    assert sample.message.state.dtype == np.float32


# --- what a receiver refuses --------------------------------------------------------------------------


def changed(message, topic, change):
    """The payload of `message` after `change(envelope)`, decoded."""
    envelope = raw(CODEC.encode(HEADER, message))
    change(envelope)
    return CODEC.decode(key_of(topic), msgpack.packb(envelope))


def put(name, value):
    return lambda envelope: envelope["body"].__setitem__(name, value)


def head(name, value):
    return lambda envelope: envelope.__setitem__(name, value)


STATE = np.zeros(S, "<f4")


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        (head("v", 2), "version 2, expected 1"),
        (head("v", True), "version True, expected 1"),
        (head("v", 1.0), "version 1.0, expected 1"),
        (head("v", [[[]]]), "version list, expected 1"),
        (head("type", "Chunk"), "type Chunk, expected Step"),
        (head("type", None), "type None, expected Step"),
        (head("extra", 1), "envelope: unexpected fields"),
        (lambda envelope: envelope.pop("seq"), "envelope: unexpected fields"),
        (head("boot_id", 0), "boot_id: not an integer from 1"),
        (head("boot_id", 2**62 + 1), "boot_id: not an integer from 1"),
        (head("seq", -1), "seq: not an integer from 0"),
        (head("seq", True), "seq: not an integer from 0"),
        (head("t_ns", 1.5), "t_ns: not an integer from 0"),
        (head("valid", 1), "valid: not a boolean"),
        (head("body", []), "body: not a map"),
        (put("surprise", 1), "surprise: no such field"),
        (lambda envelope: envelope["body"].pop("k"), "k: missing"),
        (put("k", True), "k: not an integer"),
        (put("k", 1.0), "k: not an integer"),
        (put("k", "1"), "k: not an integer"),
        (put("k", -1), "k: outside 0 to"),
        (put("k", 2**63), "k: outside 0 to"),
        (put("chunk_seq", -2), "chunk_seq: outside -1 to"),
        (put("chunk_offset", 4097), "chunk_offset: outside -1 to 4096"),
        (put("first", 1), "first: not a boolean"),
        (put("mode", "party"), "mode: not one of random, plan"),
        (put("mode", ["plan"]), "mode: not one of random, plan"),
        (put("state", None), "state: not an array"),
        (put("state", ["<f4", [S]]), "state: not an array"),
        (put("state", ["<f8", [S], bytes(8 * S)]), "state: dtype <f8, expected <f4"),
        (put("state", [">f4", [S], bytes(4 * S)]), "state: dtype >f4, expected <f4"),
        (put("state", [[["<f4"]], [S], bytes(4 * S)]), "state: dtype list, expected <f4"),
        (put("state", ["<f4", [S - 1], bytes(4 * S - 4)]), f"state: S is {S - 1}, expected {S}"),
        (put("state", ["<f4", [1, S], bytes(4 * S)]), "state: 2 axes, expected 1"),
        (put("state", ["<f4", S, bytes(4 * S)]), "state: shape is not a list of lengths"),
        (put("state", ["<f4", [float(S)], bytes(4 * S)]), "state: shape is not a list of lengths"),
        (put("state", ["<f4", [-S], bytes(4 * S)]), "state: shape is not a list of lengths"),
        (put("state", ["<f4", [S], bytes(4 * S - 1)]), "state: wrong number of bytes"),
        (put("state", ["<f4", [S], bytes(4 * S + 4)]), "state: wrong number of bytes"),
        (put("state", ["<f4", [S], "x" * 4 * S]), "state: wrong number of bytes"),
        (put("state", ["<f4", [S], (STATE + np.nan).tobytes()]), "state: not finite"),
        (put("state", ["<f4", [S], (STATE - np.inf).tobytes()]), "state: not finite"),
        (put("state", ["<f4", [S], (STATE + np.float32(2e6)).tobytes()]), "state: beyond 1e+06"),
        (put("prev_action", ["<f4", [A], np.full(A, -1.01, "<f4").tobytes()]), "prev_action: beyond 1"),
        (put("part_valid", ["|u1", [V], bytes([2] * V)]), "part_valid: beyond 1"),
    ],
)
def test_a_wrong_step_is_refused_and_the_reason_says_what_is_wrong(change, complaint):
    with pytest.raises(Refused) as refusal:
        changed(step(), STEP, change)
    assert str(refusal.value).startswith(complaint)
    assert "\n" not in str(refusal.value)


@pytest.mark.parametrize(
    ("message", "topic", "change", "complaint"),
    [
        (chunk(), CHUNK, put("score", float("nan")), "score: not a finite number"),
        (chunk(), CHUNK, put("score", float("inf")), "score: not a finite number"),
        (chunk(), CHUNK, put("score", True), "score: not a finite number"),
        (chunk(), CHUNK, put("solve_ms", -0.1), "solve_ms: outside 0 to 10000000.0 ms"),
        (chunk(), CHUNK, put("commit", 0), "commit: outside 1 to 4096"),
        (chunk(), CHUNK, put("snapshot_id", b"abc"), "snapshot_id: not a text"),
        (chunk(), CHUNK, put("snapshot_id", "x" * (MAX_TEXT + 1)), "snapshot_id: not a text"),
        (
            chunk(),
            CHUNK,
            put("actions", ["<f4", [MAX_LENGTH + 1, 0], b""]),
            f"actions: T is {MAX_LENGTH + 1}, expected {MAX_LENGTH}",
        ),
        (chunk(), CHUNK, put("actions", ["<f4", [0, A + 1], b""]), f"actions: A is {A + 1}, expected {A}"),
        (snapshot(), SNAPSHOT, put("payload", "text"), "payload: not bytes"),
        (METRICS_0, METRICS, put("loss", {"nll": True}), "loss: not a finite number"),
        (METRICS_0, METRICS, put("loss", [1.0]), "loss: not a map"),
        (METRICS_0, METRICS, put("loss", {b"nll": 1.0}), "loss: not a text"),
        (METRICS_0, METRICS, put("loss", dict.fromkeys(map(str, range(MAX_ENTRIES + 1)), 1.0)), "loss: not"),
        (HEALTH_0, HEALTH, put("refused", {"b": 1.5}), "refused: not an integer"),
        (HEALTH_0, HEALTH, put("stale_inputs", "a"), "stale_inputs: not a list"),
        (HEALTH_0, HEALTH, put("stale_inputs", [1]), "stale_inputs: not a text"),
        (episode(), EPISODE, put("steps", 100_001), "steps: outside 0 to 100000"),
    ],
)
def test_other_wrong_messages_are_refused(message, topic, change, complaint):
    with pytest.raises(Refused) as refusal:
        changed(message, topic, change)
    assert str(refusal.value).startswith(complaint)


def test_integers_are_accepted_where_a_number_is_wanted():
    message = changed(chunk(), CHUNK, put("score", -3)).message
    assert message.score == -3.0 and type(message.score) is float


def test_an_oversized_payload_is_refused_before_it_is_read():
    with pytest.raises(Refused, match="65537 bytes, at most 65536"):
        CODEC.decode("control/step", bytes(65537))


def test_a_key_outside_the_table_is_refused():
    with pytest.raises(Refused, match="control/stop: no such topic"):
        CODEC.decode("control/stop", CODEC.encode(HEADER, step()))


def test_a_letter_that_the_cell_does_not_fix_is_one_length_within_a_message():
    free = Codec()
    with pytest.raises(Refused, match="predicted_std: S is 3, expected 4"):
        free.encode(
            HEADER, chunk(predicted_state=np.zeros(4, np.float32), predicted_std=np.zeros(3, np.float32))
        )


# --- what a sender refuses ----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("message", "complaint"),
    [
        (step(state=np.full(S, np.nan)), "state: not finite"),
        (step(state=np.zeros(S + 1)), "state: S is"),
        (step(state="text"), "state: not an array of <f4"),
        (step(state=[[1.0], [1.0, 2.0]]), "state: not an array of <f4"),
        (step(state=None), "state: not an array of <f4"),
        (step(part_valid=np.full(V, 257)), "part_valid: not an array of |u1"),
        (step(prev_action=np.full(A, 1.5)), "prev_action: beyond 1"),
        (step(k=-1), "k: outside"),
        (step(k=np.int64(1)), "k: not an integer"),
        (step(first=1), "first: not a boolean"),
        (step(mode="party"), "mode: not one of"),
        (chunk(score=float("nan")), "score: not a finite number"),
        (chunk(snapshot_id="\ud800"), "cannot be packed"),
        (replace(HEALTH_0, refused={"b": 2**70}), "cannot be packed"),
        (replace(HEALTH_0, state="x" * (MAX_TEXT + 1)), "state: not a text"),
        (replace(HEALTH_0, stale_inputs=("x" * 4000,) * 20), "80"),
        (SnapshotMessage("abc", 1, "text"), "payload: not bytes"),
    ],
)
def test_nothing_leaves_that_would_be_refused(message, complaint):
    with pytest.raises(Refused) as refusal:
        CODEC.encode(HEADER, message)
    assert str(refusal.value).startswith(complaint)


@pytest.mark.parametrize("change", [{"boot_id": 0}, {"seq": -1}, {"t_ns": 2**63}, {"valid": 1}])
def test_a_bad_envelope_does_not_leave_either(change):
    with pytest.raises(Refused, match=next(iter(change))):
        CODEC.encode(replace(HEADER, **change), step())
