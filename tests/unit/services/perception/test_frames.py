"""A frame is refused unless its parts fit together; order and skew are judged to the nanosecond."""

from dataclasses import replace

import numpy as np
import pytest

from services.perception.frames import MAX_SKEW_NS, Frame, Refusal, check_order

K = np.array([[600.0, 0.0, 2.5], [0.0, 600.0, 1.5], [0.0, 0.0, 1.0]])
FRAME = Frame(
    np.zeros((4, 6, 3), np.uint8), np.full((4, 6), 420, np.uint16), 1e-3, K, 1_000_000, 1_000_000, 7
)


def with_k(row, column, value):
    matrix = K.copy()
    matrix[row, column] = value
    return {"camera_matrix": matrix}


@pytest.mark.parametrize(
    ("change", "word"),
    [
        ({"depth": np.zeros((4, 6), np.float32)}, "depth"),
        ({"depth": np.zeros((6, 4), np.uint16)}, "colour"),
        ({"colour": np.zeros((4, 6, 4), np.uint8)}, "colour"),
        ({"colour": np.zeros((4, 6, 3), np.float32)}, "colour"),
        ({"depth_unit_m": 0.0}, "depth_unit_m"),
        ({"depth_unit_m": float("nan")}, "depth_unit_m"),
        ({"camera_matrix": np.eye(3, dtype=np.float32)}, "camera_matrix"),
        (with_k(0, 0, -600.0), "camera_matrix"),
        (with_k(0, 2, np.nan), "camera_matrix"),
        *((with_k(row, column, 0.1), "camera_matrix") for row, column in ((0, 1), (1, 0), (2, 0), (2, 1))),
    ],
)
def test_parts_that_do_not_fit_are_refused_by_name(change, word):
    with pytest.raises(ValueError, match=word):
        replace(FRAME, **change)


def test_depth_in_metres_and_times():
    assert np.allclose(FRAME.depth_m(), 0.42)
    frame = replace(FRAME, colour_time_ns=5_000_001, depth_time_ns=1_000_000)
    assert (frame.t_ns, frame.skew_ns) == (3_000_000, 4_000_001)


def test_skew_is_refused_beyond_the_limit_only():
    at_limit = replace(FRAME, depth_time_ns=FRAME.colour_time_ns + MAX_SKEW_NS)
    assert check_order(at_limit, None) is None
    refused = check_order(replace(at_limit, depth_time_ns=at_limit.depth_time_ns + 1), None)
    assert refused is not None
    assert refused.reason is Refusal.SKEW


@pytest.mark.parametrize("late", [{"colour_time_ns": 1_000_000}, {"depth_time_ns": 1_000_000}])
def test_each_picture_must_be_newer_than_the_one_before(late):
    after = replace(FRAME, colour_time_ns=1_000_001, depth_time_ns=1_000_001, frame_number=8)
    assert check_order(after, FRAME) is None
    refused = check_order(replace(after, **late), FRAME)
    assert refused is not None
    assert refused.reason is Refusal.BACKWARDS
    assert "frame 8" in refused.message
