"""Stands where FoundationPose's `estimater` would: its three classes and signatures, and its traps.

Told what to do by `script.json` beside the mesh: `pose` (16 numbers, the truth), `drift_m` a frame,
`hang_s`, `die`.
"""

# ruff: noqa: PLR0917 - the signatures are the library's

import json
import os
import time
from pathlib import Path

import numpy as np

print("warp compiling ...")  # to standard output, as the library does


class ScorePredictor:
    def predict(self, mesh, rgb, depth, K, ob_in_cams, mesh_tensors, glctx, mesh_diameter):
        raise NotImplementedError


class PoseRefinePredictor:
    pass


class FoundationPose:
    def __init__(
        self,
        model_pts,
        model_normals,
        symmetry_tfs=None,
        mesh=None,
        scorer=None,
        refiner=None,
        glctx=None,
        debug=0,
        debug_dir="/home/bowen/debug",
    ):
        assert mesh is not None, "mesh is mandatory in practice"
        assert symmetry_tfs is None, "24 rotations would delete right answers"
        assert scorer is not None and refiner is not None and glctx is not None
        Path(debug_dir).mkdir(parents=True, exist_ok=True)
        extents = np.ptp(np.asarray(mesh.vertices), axis=0)
        assert extents.max() < 1.0, "a mesh in millimetres: poses would be wrong by a thousand"
        self._script = Path(debug_dir).parent / "script.json"
        self.pose_last = None
        self._centre = np.asarray(mesh.vertices).mean(axis=0)
        self._frames = 0

    def get_tf_to_centered_mesh(self):
        moved = np.eye(4)
        moved[:3, 3] = -self._centre
        return moved

    def register(self, K, rgb, depth, ob_mask, ob_id=None, glctx=None, iteration=5):
        _check(K, rgb, depth)
        print("register", flush=True)
        script = self._read()
        valid = (depth >= 0.001) & (ob_mask > 0)
        if valid.sum() < 4:  # no exception, and pose_last stays unset
            guess = np.eye(4)
            guess[:3, 3] = 0.1
            return guess
        self.pose_last = script["pose"] @ np.linalg.inv(self.get_tf_to_centered_mesh())
        self._frames = 0
        return script["pose"]

    def track_one(self, rgb, depth, K, iteration, extra={}):  # noqa: B006
        _check(K, rgb, depth)
        if self.pose_last is None:
            raise RuntimeError("please init pose by register first")
        script = self._read()
        if script.get("hang_s"):
            time.sleep(script["hang_s"])
        if script.get("die"):
            print("CUDA error: out of memory")
            os._exit(1)
        self._frames += 1
        pose = script["pose"].copy()
        pose[0, 3] += script.get("drift_m", 0.0) * self._frames
        last = np.reshape(np.asarray(self.pose_last), (4, 4))
        moved = np.linalg.norm((last @ self.get_tf_to_centered_mesh() - pose)[:3, 3])
        if moved > 0.1:  # a big jump is not followed
            pose = last @ self.get_tf_to_centered_mesh()
        self.pose_last = (pose @ np.linalg.inv(self.get_tf_to_centered_mesh()))[None]  # 1x4x4 now
        return pose

    def _read(self):
        script = json.loads(self._script.read_text())
        return {**script, "pose": np.reshape(script["pose"], (4, 4))}


def _check(K, rgb, depth):
    assert K.shape == (3, 3) and K.dtype == np.float64
    assert rgb.dtype == np.uint8 and rgb.ndim == 3 and rgb.flags.writeable
    assert depth.dtype == np.float32 and depth.max() < 20, "depth in millimetres?"
