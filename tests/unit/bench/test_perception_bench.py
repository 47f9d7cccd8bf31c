"""The bench's whole way from sequences to JSON, with a backend that knows the truth about blank pictures."""

import json

import numpy as np
import pytest

from bench.perception import __main__ as bench
from bench.perception import figure, library
from bench.perception.sequence import Spec, Truth
from services.perception.backend import PoseEstimate, PoseState, Quality, Unseen
from services.perception.frames import Frame

K = np.array([[5.0, 0, 3], [0, 5.0, 2], [0, 0, 1]])
SPECS = [
    Spec("held_slow-10", 10, 130, speed_deg_s=70.0),
    Spec("held_fast-10", 10, 40, speed_deg_s=175.0),
    Spec("far-10", 10, 40, rate_hz=30.0, distance_m=0.6),
]
OFF_M = 0.02


def pose(number):
    made = np.eye(4)
    made[:3, 3] = 0.0001 * number, 0.0, 0.42
    return made


def cheap(spec):
    """Covered by 10 % and 30 % in turns."""
    for number in range(spec.frames):
        picture = np.full((4, 6), 400, np.uint16)
        yield (
            Frame(np.zeros((4, 6, 3), np.uint8), picture, 1e-3, K, number + 1, number + 1, number),
            Truth(pose(number), 0.1 if number % 2 else 0.3),
        )


class Oracle:
    """Right from the first registration on, but for every fifth frame; knows nothing where all is near."""

    def __init__(self, die):
        self.size_m, self.found = die.size_m, False

    def register(self, frame, mask=None):
        return self.answer(frame)

    def adopt(self, found):
        self.found = True

    def track(self, frame):
        near = np.median(frame.depth[frame.depth > 0]) < 350
        lost = Unseen(PoseState.LOST, "", frame.t_ns, frame.frame_number)
        return self.answer(frame) if self.found and not near else lost

    def reset(self):
        self.found = False

    def answer(self, frame):
        made = pose(frame.frame_number)
        made[0, 3] += OFF_M * (frame.frame_number % 5 == 0)
        quality = Quality(1.0, 0.0, 0.0, 1.0)
        state, number = PoseState.TRACKING, frame.frame_number
        return PoseEstimate(state, True, made, np.eye(6), np.eye(24)[0], quality, frame.t_ns, number)


@pytest.fixture
def report(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(library, "film", cheap)
    monkeypatch.setattr(bench, "suite", lambda name, seeds: SPECS)
    backend = f"{__name__}:Oracle"
    assert bench.main(["--sequences", str(tmp_path), "--json", "--backend", backend]) == 0
    return json.loads(capsys.readouterr().out)


def test_the_report_has_what_is_asked_for_and_it_adds_up(report):
    low, middle, high = report["bands"]
    # Registered at frame 0, used from frame 1 on: odd frames are covered by 10 %, even ones by 30 %.
    assert [band["frames"] for band in report["bands"]] == [65 + 20, 64 + 19, 0]
    wrong = sum(number % 5 == 0 for count in (130, 40) for number in range(1, count, 2))
    assert low["within_5deg_3mm"] == pytest.approx(1 - wrong / 85, rel=1e-4)
    assert set(middle["by_speed_deg_s"]) == {"70", "175"}
    assert high["within_5deg_3mm"] is None
    assert report["gross_claimed"] == pytest.approx((25 + 7) / 168, rel=1e-4)
    assert report["gross_claimed_far"] == pytest.approx(7 / 39, rel=1e-4)
    # The longest sequence has room for one trial in each of three phases.
    assert report["reacquisition"]["trials"] == 3
    assert (report["reacquired"], report["reacquisition"]["claimed_while_hidden"]) == (1.0, 0)
    assert report["seeds"] == [10]
    assert report["conditions"]["depth_noise"]["disparity_px"] == 0.085
    assert {"frame_ms_median", "frame_ms_p95", "baseline", "frame_ms_to_baseline"} <= set(report)


def test_a_backend_that_is_not_there_is_named(tmp_path):
    with pytest.raises(SystemExit, match="no_such_module:Backend"):
        bench.main(["--sequences", str(tmp_path), "--backend", "no_such_module:Backend"])


def test_errors_by_occlusion_are_drawn_from_the_report(report, tmp_path):
    rows = report["errors_by_occlusion"]
    assert [(row["occlusion"], row["frames"]) for row in rows] == [([0.1, 0.2], 85), ([0.3, 0.4], 83)]
    for row in rows:  # the oracle errs by nothing, of which there is no logarithm
        row.update({kind: {"median": 1.0, "p90": 2.0} for kind in ("rotation_deg", "translation_mm")})
    (tmp_path / "result.json").write_text(json.dumps(report))
    out = tmp_path / "errors.png"
    assert figure.main([str(tmp_path / "result.json"), str(out)]) == 0
    assert 5_000 < out.stat().st_size < 500_000
