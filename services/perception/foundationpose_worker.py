"""FoundationPose in its own environment: `PYTHON foundationpose_worker.py REPOSITORY`, driven over its pipes.

Started by services.perception.foundationpose with the interpreter that has CUDA, torch and nvdiffrast; it
must run under Python 3.8 and may import nothing of this project. FoundationPose is licensed for research and
evaluation only (NVIDIA Source Code License, clause 3.3), and is no part of this project.

A message is a length (8 bytes, little endian), that many bytes of JSON, then the arrays that it names, raw.
Requests have `do` (open, register, seed, track); replies have `pose` (16 numbers, row by row) or `error`.
"""

# pyright: reportMissingImports=false, reportAttributeAccessIssue=false
# ruff: noqa: UP006, UP035, UP045 - newer ways of writing types, which its Python 3.8 lacks

import json
import os
import struct
import sys
from typing import Any, BinaryIO, Dict, Optional, Tuple

import numpy as np

Arrays = Dict[str, np.ndarray]
REGISTER_ITERATIONS, TRACK_ITERATIONS = 5, 2  # as in the authors' run_demo.py


def send(stream: BinaryIO, header: Dict[str, Any], arrays: Optional[Arrays] = None) -> None:
    """Write one message."""
    arrays = arrays or {}
    form = [[name, array.dtype.str, list(array.shape)] for name, array in arrays.items()]
    text = json.dumps({"header": header, "arrays": form}).encode()
    stream.write(struct.pack("<q", len(text)) + text)
    for array in arrays.values():
        stream.write(np.ascontiguousarray(array).tobytes())
    stream.flush()


def receive(stream: BinaryIO) -> Tuple[Dict[str, Any], Arrays]:
    """Read one message. Raises EOFError when the other side has gone."""
    (length,) = struct.unpack("<q", _exactly(stream, 8))
    message = json.loads(_exactly(stream, length))
    arrays = {}
    for name, dtype, shape in message["arrays"]:
        kind = np.dtype(dtype)
        raw = _exactly(stream, int(np.prod(shape)) * kind.itemsize)
        arrays[name] = np.frombuffer(raw, kind).reshape(shape)
    return message["header"], arrays


def _exactly(stream: BinaryIO, count: int) -> bytes:
    parts = []
    while count:
        part = stream.read(count)
        if not part:
            raise EOFError
        parts.append(part)
        count -= len(part)
    return b"".join(parts)


class Estimator:
    """The authors' object, made on `open`."""

    def __init__(self, repository: str) -> None:
        sys.path.insert(0, repository)
        self._estimator = None  # type: Any

    def open(self, header: Dict[str, Any], _: Arrays) -> None:
        """Load weights and mesh; takes a while."""
        import nvdiffrast.torch
        import trimesh
        from estimater import FoundationPose, PoseRefinePredictor, ScorePredictor

        mesh = trimesh.load(header["mesh"])
        self._estimator = FoundationPose(
            model_pts=np.asarray(mesh.vertices),
            model_normals=np.asarray(mesh.vertex_normals),
            # Not the die's 24 rotations: merging start rotations by them would delete right answers.
            symmetry_tfs=None,
            mesh=mesh,
            scorer=ScorePredictor(),
            refiner=PoseRefinePredictor(),
            glctx=nvdiffrast.torch.RasterizeCudaContext(),
            debug=0,
            debug_dir=header["debug_dir"],  # its default is a folder of the author's
        )

    def register(self, header: Dict[str, Any], arrays: Arrays) -> np.ndarray:
        """The first pose, within a mask."""
        return self._estimator.register(
            K=arrays["K"],
            rgb=arrays["rgb"].copy(),
            depth=arrays["depth"].copy(),
            ob_mask=arrays["mask"].astype(bool),
            iteration=REGISTER_ITERATIONS,
        )

    def seed(self, _: Dict[str, Any], arrays: Arrays) -> None:
        """Track from a pose of ours: theirs is that of the mesh moved to the centre of its box."""
        import torch

        centred = np.asarray(_numbers(self._estimator.get_tf_to_centered_mesh())).reshape(4, 4)
        pose = arrays["pose"] @ np.linalg.inv(centred)
        self._estimator.pose_last = torch.as_tensor(pose, device="cuda", dtype=torch.float32)

    def track(self, _: Dict[str, Any], arrays: Arrays) -> np.ndarray:
        """The pose from the one before."""
        return self._estimator.track_one(
            rgb=arrays["rgb"].copy(),
            depth=arrays["depth"].copy(),
            K=arrays["K"],
            iteration=TRACK_ITERATIONS,
        )


def _numbers(tensor: Any) -> Any:
    return tensor.detach().cpu().numpy() if hasattr(tensor, "detach") else tensor


def main() -> None:
    """Answer requests until the pipe closes."""
    replies = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # the library prints much: not into the replies
    estimator = Estimator(sys.argv[1])
    while True:
        try:
            header, arrays = receive(sys.stdin.buffer)
        except EOFError:
            return
        try:
            pose = getattr(estimator, header["do"])(header, arrays)
        except Exception as error:
            send(replies, {"error": f"{type(error).__name__}: {error}"})
            continue
        numbers = [] if pose is None else np.asarray(_numbers(pose), np.float64).reshape(-1).tolist()
        send(replies, {"pose": numbers})


if __name__ == "__main__":
    main()
