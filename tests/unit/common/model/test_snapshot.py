"""A snapshot survives the journey exactly, or is refused with one line."""

import json
from dataclasses import dataclass, replace

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from common.model.config import ModelConfig
from common.model.coordinates import RawCoordinates
from common.model.dynamics import Dynamics
from common.model.masks import MaskPool
from common.model.normaliser import Normaliser
from common.model.sealed import seal, unseal
from common.model.snapshot import Snapshot, SnapshotMeta, SnapshotRefused
from common.task.layout import Group

S, A = 5, 2
RAW = RawCoordinates(S, A, (slice(1, 5),))
MODEL = ModelConfig(members=2, hidden=(8, 6), plan_masks=3)


@dataclass(frozen=True)
class Toy:
    name: str = "toy"
    state_dim: int = S
    action_dim: int = A
    groups: tuple[Group, ...] = (
        Group("number", 0, 1, "m", -9, 9),
        Group("rotation", 1, 5, "1", 0, 9, "quaternion"),
    )


TOY = Toy()


def make(seed=0, **meta):
    generator = torch.Generator().manual_seed(seed)
    dynamics = Dynamics.create(MODEL, Normaliser.identity(S + A, S), RAW, generator)
    masks = MaskPool.draw(2, 3, MODEL.hidden, 0.05, generator)
    given = {"task": "toy", "state_dim": S, "action_dim": A, "inputs": S + A, "changes": S}
    given |= {"counter": 4, "episodes": 9, "model": MODEL}
    return Snapshot.of(dynamics, masks, SnapshotMeta(**(given | meta)))


PAYLOAD = make().to_bytes()


def resealed(change):
    """The payload with `change(tensors, meta)` applied and a correct digest."""
    tensors, text = unseal(PAYLOAD)
    meta = json.loads(text)
    change(tensors, meta)
    return seal(tensors, json.dumps(meta))


def refusal(payload):
    with pytest.raises(SnapshotRefused) as caught:
        Snapshot.from_bytes(payload)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_round_trip_keeps_every_bit():
    original, read = make(), Snapshot.from_bytes(PAYLOAD)
    assert read.meta == original.meta
    assert read.id == original.id
    assert read.digest == original.digest
    assert all(torch.equal(read.tensors()[name], tensor) for name, tensor in original.tensors().items())
    assert read.to_bytes() == PAYLOAD


def test_equal_content_gives_equal_bytes_and_other_content_another_id():
    assert make().to_bytes() == PAYLOAD
    assert make(seed=1).id != make().id
    assert make(episodes=10).id != make().id


def test_the_model_read_back_predicts_the_same():
    generator = torch.Generator().manual_seed(0)
    dynamics = Dynamics.create(MODEL, Normaliser.identity(S + A, S), RAW, generator)
    read = Snapshot.from_bytes(PAYLOAD).dynamics(TOY)
    state, action = (torch.randn(2, 3, n, generator=generator) for n in (S, A))
    assert torch.equal(read.predict(state, action)[0], dynamics.predict(state, action)[0])
    assert not any(parameter.requires_grad for parameter in read.ensemble.parameters())


def test_a_snapshot_is_a_copy():
    generator = torch.Generator().manual_seed(0)
    dynamics = Dynamics.create(MODEL, Normaliser.identity(S + A, S), RAW, generator)
    masks = MaskPool.draw(2, 3, MODEL.hidden, 0.05, generator)
    snapshot = Snapshot.of(dynamics, masks, make().meta)
    before = snapshot.weights[0].clone()
    with torch.no_grad():
        dynamics.ensemble.weights[0].add_(1.0)
    assert torch.equal(snapshot.weights[0], before)


def test_another_task_is_refused():
    with pytest.raises(SnapshotRefused, match=r"made for task, S, A = \(toy, 5, 2\), not \(toy, 5, 3\)"):
        make().dynamics(replace(TOY, action_dim=A + 1))


def test_a_changed_weight_is_refused():
    position = len(PAYLOAD) - 3
    flipped = PAYLOAD[:position] + bytes([PAYLOAD[position] ^ 1]) + PAYLOAD[position + 1 :]
    assert refusal(flipped).startswith("digest ")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda t, m: t.pop("bias.1"), "tensor 'bias.1' is missing or not known"),
        (lambda t, m: t.update(extra=torch.zeros(1)), "tensor 'extra' is missing or not known"),
        (lambda t, m: t.update({"bias.1": torch.zeros(2, 6)}), "bias.1 has shape (2, 6), not (2, 1, 6)"),
        (lambda t, m: t.update({"bias.1": torch.zeros(2, 1, 6).double()}), "bias.1 is torch.float64"),
        (lambda t, m: t["weight.0"].fill_(float("nan")), "weight.0 is not finite"),
        (lambda t, m: t["normaliser.input_std"].zero_(), "normaliser.input_std is not positive"),
        (lambda t, m: m.update(version=1), "version 1; this program reads 2"),
        (lambda t, m: m.update(changes=6), "max_log_var has shape (5,), not (6,)"),
        (lambda t, m: m.pop("task"), "metadata: task: missing"),
        (lambda t, m: m["model"].update(members=0), "metadata: model.members: greater_than_equal"),
    ],
)
def test_malformed_content_is_refused(change, message):
    assert refusal(resealed(change)).startswith(message)


@settings(max_examples=60, deadline=None)
@given(st.binary(max_size=300))
def test_garbage_is_refused(garbage):
    assert refusal(garbage)


@settings(max_examples=60, deadline=None)
@given(st.integers(0, len(PAYLOAD) - 1))
def test_truncation_is_refused(length):
    assert refusal(PAYLOAD[:length])


@settings(max_examples=150, deadline=None)
@given(st.integers(0, 2500), st.integers(1, 255))
def test_a_changed_byte_is_refused_or_changes_nothing(position, change):
    position %= len(PAYLOAD)
    payload = PAYLOAD[:position] + bytes([PAYLOAD[position] ^ change]) + PAYLOAD[position + 1 :]
    try:
        assert Snapshot.from_bytes(payload).digest == make().digest
    except SnapshotRefused as error:
        assert "\n" not in str(error)


@pytest.mark.parametrize("header", ["[" * 100_000, "{}", "[]", '{"__metadata__": {"sealed": "[]"}}', "null"])
def test_hostile_headers_are_refused(header):
    assert refusal(len(header).to_bytes(8, "little") + header.encode())
