"""The SAM-6D adapter against a command with its arguments, files, units, and its crash without detections."""

import json
import sys
import textwrap

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays

from common.die import DIE
from services.perception.config import Sam6dConfig
from services.perception.rle import mask_of
from services.perception.sam6d import Sam6dSegmenter
from tests.unit.services.perception.cubes import frame
from tests.unit.services.perception.driven import HELD

FAKE = """
    import argparse, json, os
    import numpy as np, cv2, trimesh
    parser = argparse.ArgumentParser()
    names = "segmentor_model output_dir cad_path rgb_path depth_path cam_path template_dir"
    for name in names.split():
        parser.add_argument("--" + name, required=True)
    given = parser.parse_args()
    assert os.path.basename(os.getcwd()) == "Instance_Segmentation_Model"
    camera = json.load(open(given.cam_path))
    K = np.array(camera["cam_K"]).reshape(3, 3)
    depth_mm = cv2.imread(given.depth_path, cv2.IMREAD_UNCHANGED) * camera["depth_scale"]
    extents = trimesh.load(given.cad_path).extents
    assert abs(extents - 60.0).max() < 0.01, "the mesh must be in millimetres"
    assert cv2.imread(given.rgb_path) is not None and given.segmentor_model == "sam"
    mask = ((depth_mm > 0) & (depth_mm < 600)).astype(np.uint8)
    if not mask.any():
        raise RuntimeError("stack expects a non-empty TensorList")
    flat = np.concatenate([[0], mask.ravel(order="F"), [0]])
    edges = np.flatnonzero(np.diff(flat))
    counts = np.diff(np.concatenate([[0], edges, [mask.size]])).tolist()
    wrong = {"counts": [mask.size], "size": list(mask.shape)}
    os.makedirs(given.output_dir + "/sam6d_results", exist_ok=True)
    found = [{"score": 0.1, "segmentation": wrong, "bbox": [0, 0, 1, 1]}]
    found.append({"score": SCORE, "segmentation": {"counts": counts, "size": list(mask.shape)}, "bbox": []})
    json.dump(found, open(given.output_dir + "/sam6d_results/detection_ism.json", "w"))
"""


@pytest.fixture
def segmenter(tmp_path):
    def made(score=0.7, source=FAKE, **options):
        model = tmp_path / "SAM-6D" / "Instance_Segmentation_Model"
        model.mkdir(parents=True, exist_ok=True)
        text = textwrap.dedent(source).replace("SCORE", str(score))
        (model / "run_inference_custom.py").write_text(text)
        config = Sam6dConfig(python=sys.executable, repository=model.parent, **options)
        return Sam6dSegmenter(config, DIE, tmp_path / "work")

    return made


def test_the_best_mask_comes_back_in_the_pictures_orientation(segmenter):
    seen = frame(HELD)
    mask = segmenter().mask(seen)
    assert mask.dtype == np.bool_ and np.array_equal(mask, seen.depth < 600)


def test_nothing_found_is_said_and_an_older_result_is_not_taken_for_it(segmenter):
    made = segmenter()
    assert made.mask(frame(HELD)).any()
    told = made.mask(frame(None))
    assert told.startswith("SAM-6D found nothing (exit code 1: RuntimeError: stack expects a non-empty")


def test_an_unsure_mask_is_not_used(segmenter):
    assert segmenter(score=0.3).mask(frame(HELD)) == "SAM-6D is not sure: score 0.30, 0.4 wanted"


@pytest.mark.parametrize(
    "source, message",
    [
        ("import time; time.sleep(9)", "did not answer within 0.5 s"),
        ("open('../../work/sam6d_results/detection_ism.json', 'w').write('[]')", "cannot be read"),
        (
            "import json; json.dump([{'score': 1, 'segmentation': {'counts': [4], 'size': [2, 2]}}], "
            "open('../../work/sam6d_results/detection_ism.json', 'w'))",
            "mask is (2, 2), the picture (480, 640)",
        ),
    ],
)
def test_what_goes_wrong_is_said(segmenter, tmp_path, source, message):
    (tmp_path / "work" / "sam6d_results").mkdir(parents=True)
    slow = {"timeout_s": 0.5} if "sleep" in source else {}
    assert message in segmenter(source=source, **slow).mask(frame(HELD))


def test_an_environment_that_is_not_there_is_said(tmp_path):
    config = Sam6dConfig(python=tmp_path / "none", repository=tmp_path)
    assert "SAM-6D did not run" in Sam6dSegmenter(config, DIE, tmp_path / "work").mask(frame(HELD))


@settings(max_examples=60, deadline=None)
@given(arrays(np.bool_, array_shapes(min_dims=2, max_dims=2, max_side=9), elements=st.booleans()))
def test_masks_survive_run_lengths(mask):
    counts, value = [0], False
    for pixel in mask.ravel(order="F"):
        if pixel != value:
            counts.append(0)
            value = not value
        counts[-1] += 1
    assert np.array_equal(mask_of(json.loads(json.dumps(counts)), *mask.shape), mask)


@pytest.mark.parametrize("counts", [[3], [1, 4], [-1, 5], []])
def test_run_lengths_that_do_not_add_up_are_refused(counts):
    with pytest.raises(ValueError, match="run lengths sum to"):
        mask_of(counts, 2, 2)
