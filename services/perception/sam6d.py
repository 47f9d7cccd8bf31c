"""SAM-6D's instance segmentation as a first mask: files in, one command line, a result file out.

The command runs its `Instance_Segmentation_Model/run_inference_custom.py` in an environment of its own; it
takes 5 to 30 s a picture, so it only ever begins a search. That folder is under the MIT licence, the rest of
SAM-6D under none: nothing of it is part of this project.
"""

from __future__ import annotations

import json
import subprocess
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from common.die import Die
from services.perception.config import Sam6dConfig
from services.perception.frames import Frame
from services.perception.mesh_file import textured_mesh
from services.perception.rle import mask_of

_MM = 1000.0  # it counts in millimetres, meshes too
_WORDS = 160  # of the command's last line, in an error


class Sam6dSegmenter:
    """Finds the die's mask in a frame."""

    def __init__(self, config: Sam6dConfig, die: Die, folder: Path) -> None:
        """Write the mesh into `folder`, where pictures and results go too."""
        self._config, self._folder = config, folder
        self._result = folder / "sam6d_results" / "detection_ism.json"
        folder.mkdir(parents=True, exist_ok=True)
        textured_mesh(die, _MM).export(folder / "die.ply")

    def mask(self, frame: Frame) -> NDArray[np.bool_] | str:
        """The best mask (H, W); or in a few words why there is none. Never an older picture's."""
        self._result.unlink(missing_ok=True)
        self._write(frame)
        try:
            done = subprocess.run(
                self._command(),
                cwd=self._config.repository / "Instance_Segmentation_Model",
                capture_output=True,
                timeout=self._config.timeout_s,
                check=False,
            )
        except subprocess.TimeoutExpired:
            return f"SAM-6D did not answer within {self._config.timeout_s:g} s"
        except OSError as error:
            return f"SAM-6D did not run: {error.filename}: {error.strerror}"
        if not self._result.exists():
            # Without a detection it stacks an empty list and ends in a traceback, or writes nothing.
            lines = done.stderr.decode(errors="replace").strip().splitlines() or [""]
            return f"SAM-6D found nothing (exit code {done.returncode}: {lines[-1][:_WORDS]})"
        return self._best(frame)

    def _write(self, frame: Frame) -> None:
        cv2.imwrite(str(self._folder / "rgb.png"), cv2.cvtColor(frame.colour, cv2.COLOR_RGB2BGR))
        cv2.imwrite(str(self._folder / "depth.png"), frame.depth)
        camera = {
            "cam_K": frame.camera_matrix.ravel().tolist(),
            "depth_scale": _MM * frame.depth_unit_m,  # of a count of depth.png, in mm
        }
        (self._folder / "camera.json").write_text(json.dumps(camera))

    def _command(self) -> list[str]:
        files = {"cad": "die.ply", "rgb": "rgb.png", "depth": "depth.png", "cam": "camera.json"}
        arguments = [str(self._config.python), "run_inference_custom.py", "--segmentor_model", "sam"]
        arguments += ["--output_dir", str(self._folder), "--template_dir", str(self._config.templates)]
        for name, file in files.items():
            arguments += [f"--{name}_path", str(self._folder / file)]
        return arguments

    def _best(self, frame: Frame) -> NDArray[np.bool_] | str:
        try:
            found: list[dict[str, Any]] = json.loads(self._result.read_text())
            best = max(found, key=lambda one: float(one["score"]))
            height, width = best["segmentation"]["size"]
            mask = mask_of(best["segmentation"]["counts"], int(height), int(width))
        except (ValueError, KeyError, TypeError) as error:
            return f"SAM-6D's result cannot be read: {error}"
        if best["score"] < self._config.min_score:
            return f"SAM-6D is not sure: score {best['score']:.2f}, {self._config.min_score:g} wanted"
        if mask.shape != frame.depth.shape:
            return f"SAM-6D's mask is {mask.shape}, the picture {frame.depth.shape}"
        return mask
