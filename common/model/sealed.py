"""Named tensors and one text as a safetensors byte string that carries its own digest; never a pickle."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping
from typing import Any

import safetensors
import torch
from safetensors.torch import save
from torch import Tensor

_DTYPES = {
    "F32": torch.float32,
    "F64": torch.float64,
    "I64": torch.int64,
    "U8": torch.uint8,
    "BOOL": torch.bool,
}
_NAMES = {dtype: name for name, dtype in _DTYPES.items()}
_LONGEST_HEADER = 1 << 20


class SealError(Exception):
    """Bytes that are not what `seal` made; the message is one line."""


def content_digest(tensors: Mapping[str, Tensor], text: str) -> str:
    """SHA-256, in hex, over the text and every tensor's name, dtype, shape and bytes."""
    sha = hashlib.sha256(text.encode())
    for name in sorted(tensors):
        tensor = tensors[name].detach().cpu().contiguous()
        sha.update(f"\n{name} {_NAMES[tensor.dtype]} {list(tensor.shape)}\n".encode())
        sha.update(tensor.flatten().view(torch.uint8).numpy().data)
    return sha.hexdigest()


def seal(tensors: Mapping[str, Tensor], text: str) -> bytes:
    """Tensors and text → bytes; equal content gives equal bytes."""
    held = {name: tensor.detach().cpu().contiguous() for name, tensor in tensors.items()}
    # One key only: safetensors writes several in a random order.
    note = json.dumps({"digest": content_digest(held, text), "text": text}, sort_keys=True)
    return save(held, metadata={"sealed": note})


def unseal(payload: bytes) -> tuple[dict[str, Tensor], str]:
    """Bytes → the tensors and the text that `seal` was given. Raises SealError, and nothing else."""
    try:
        digest, text = _note(payload)
        tensors = {name: _tensor(part) for name, part in _parts(payload)}
        actual = content_digest(tensors, text)
    except Exception as error:  # whatever foreign bytes provoke in three parsers is one refusal here
        raise SealError(f"not a sealed safetensors file ({_one_line(error)})") from None
    if actual != digest:
        raise SealError(f"digest {actual[:12]} found where {digest[:12]} was written")
    return tensors, text


def _note(payload: bytes) -> tuple[str, str]:
    """Digest and text from the header: its length in 8 bytes, little-endian, then JSON."""
    length = int.from_bytes(payload[:8], "little")
    if not 0 < length <= min(_LONGEST_HEADER, len(payload) - 8):
        raise ValueError("header length out of range")
    header: dict[str, Any] = json.loads(payload[8 : 8 + length])
    note: dict[str, Any] = json.loads(header["__metadata__"]["sealed"])
    return str(note["digest"]), str(note["text"])


def _parts(payload: bytes) -> list[tuple[str, dict[str, Any]]]:
    return safetensors.deserialize(payload)  # pyright: ignore[reportUnknownMemberType, reportUnknownVariableType]


def _tensor(part: Mapping[str, Any]) -> Tensor:
    dtype, shape, data = _DTYPES[part["dtype"]], list(part["shape"]), part["data"]
    if math.prod(shape) == 0:  # frombuffer refuses an empty buffer
        return torch.empty(shape, dtype=dtype)
    return torch.frombuffer(data, dtype=dtype).reshape(shape)


def _one_line(error: Exception) -> str:
    return f"{type(error).__name__}: {' '.join(str(error).split())[:120]}"
