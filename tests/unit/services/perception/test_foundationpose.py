"""The FoundationPose adapter against a process that has the library's signatures and its documented traps."""

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from common.camera_messages import PoseState
from common.die import DIE
from services.perception import foundationpose_worker, rigid
from services.perception.backend import PoseEstimate, Quality, Unseen
from services.perception.config import FoundationPoseConfig
from services.perception.foreign import ForeignError, ForeignProcess
from services.perception.foundationpose import FoundationPoseBackend
from tests.unit.services.perception.cubes import frame
from tests.unit.services.perception.driven import HELD

FAKE = Path(__file__).parent / "fake_foundationpose"
AWAY = rigid.join((0.05, 0.0, 0.0), (1, 0, 0, 0)) @ HELD


def judge(frame, pose):
    """A gate that knows the truth: nothing else of the frame counts here."""
    good = np.linalg.norm(pose[:3, 3] - HELD[:3, 3]) < 0.01
    state = PoseState.TRACKING if good else PoseState.SUSPECT
    quality = Quality(0.9 if good else 0.2, 0.0, 0.0 if good else 0.5, 0.8)
    posterior = np.eye(24)[0]
    return PoseEstimate(
        state, good, pose, 1e-6 * np.eye(6), posterior, quality, frame.t_ns, frame.frame_number
    )


CONFIG = FoundationPoseConfig(python=sys.executable, repository=FAKE, open_s=60, register_s=30, track_s=30)


@pytest.fixture(scope="module")
def process(tmp_path_factory):
    """One process for all tests: it takes seconds to begin."""
    folder = tmp_path_factory.mktemp("foundationpose")
    backend = FoundationPoseBackend(CONFIG, DIE, judge, folder)
    yield backend, folder
    backend._process.close()


@pytest.fixture
def place(process):
    """A backend that knows nothing, and how to tell the process what to do."""
    backend, folder = process

    def script(pose=HELD, **values):
        (folder / "script.json").write_text(json.dumps({"pose": np.ravel(pose).tolist(), **values}))

    script()
    backend.reset()
    backend._config = CONFIG
    return backend, script


def test_it_registers_tracks_and_survives_the_librarys_prints_and_shapes(place):
    backend, _ = place
    seen = frame(HELD)
    assert backend.track(seen) == Unseen(PoseState.SEARCHING, "searching for the die", 0, 0)
    found = backend.register(seen, seen.depth < 600)
    assert found.T_camera_die == pytest.approx(HELD) and found.claimed
    backend.adopt(found)
    for _ in range(3):  # pose_last is 4x4 the first time, 1x4x4 from then on
        tracked = backend.track(seen)
        assert tracked.T_camera_die == pytest.approx(HELD, abs=1e-6) and tracked.claimed


def test_an_empty_mask_never_reaches_it(place):
    """It would answer with the identity and a guessed centre, and say nothing."""
    backend, _ = place
    seen = frame(HELD)
    answer = backend.register(seen, np.zeros(seen.depth.shape, np.bool_))
    assert answer.message == "no depth where the die may be"
    blind = replace(seen, depth=np.zeros_like(seen.depth))
    assert isinstance(backend.register(blind), Unseen)


def test_a_first_pose_that_fits_nothing_is_not_taken(place):
    backend, script = place
    script(AWAY)
    answer = backend.register(frame(HELD))
    assert isinstance(answer, Unseen) and "does not fit what is seen" in answer.message


def test_drift_is_noticed_by_the_gate_and_ends_in_lost(place):
    backend, script = place
    seen = frame(HELD)
    backend.adopt(backend.register(seen))
    script(drift_m=0.004)
    states = [backend.track(seen).state.value for _ in range(6)]
    assert states == ["tracking", "tracking", "suspect", "suspect", "lost", "lost"]
    script()
    backend.adopt(backend.register(seen))
    assert backend.track(seen).state is PoseState.TRACKING


def test_it_tracks_from_a_pose_of_ours(place):
    """A seed given to a process that was registered elsewhere: the next jump is small enough to follow."""
    backend, script = place
    seen = frame(HELD)
    script(rigid.join((0.5, 0, 0), (1, 0, 0, 0)) @ HELD)
    backend.register(seen)
    script()
    backend.adopt(judge(seen, HELD))
    assert backend.track(seen).claimed


@pytest.mark.parametrize(
    "trouble, message",
    [({"hang_s": 60}, "track: no answer within 0.5 s: ended"), ({"die": True}, "CUDA error: out of memory")],
)
def test_a_process_that_hangs_or_dies_is_ended_and_begun_anew(place, trouble, message):
    backend, script = place
    backend._config = backend._config.model_copy(update={"track_s": 0.5})
    seen = frame(HELD)
    backend.adopt(backend.register(seen))
    script(**trouble)
    with pytest.raises(ForeignError, match=message):
        backend.track(seen)
    assert backend.track(seen).message == "FoundationPose has ended: searching anew"
    script()
    backend.adopt(backend.register(seen))
    assert backend.track(seen).claimed


def test_what_the_library_raises_comes_back_as_an_error(place):
    backend, _ = place
    backend.register(frame(HELD))
    with pytest.raises(ForeignError, match=r"track: AssertionError"):
        backend._ask("track", {**arrays(), "K": np.eye(2)}, 5.0)


def arrays():
    seen = frame(HELD)
    return {"rgb": seen.colour, "depth": seen.depth_m(), "K": seen.camera_matrix}


def test_an_interpreter_that_is_not_there_is_named(tmp_path):
    config = FoundationPoseConfig(python=tmp_path / "none", repository=FAKE)
    backend = FoundationPoseBackend(config, DIE, judge, tmp_path)
    with pytest.raises(ForeignError, match="none: cannot be started: No such file or directory"):
        backend.register(frame(HELD))


def test_a_missing_checkout_is_named(tmp_path):
    config = FoundationPoseConfig(python=sys.executable, repository=tmp_path / "nowhere")
    backend = FoundationPoseBackend(config, DIE, judge, tmp_path)
    with pytest.raises(ForeignError, match="open: ModuleNotFoundError: No module named 'nvdiffrast'"):
        backend.register(frame(HELD))
    backend._process.close()


def test_it_ends_with_the_pipe_of_whoever_asked_it():
    worker = [sys.executable, foundationpose_worker.__file__, str(FAKE)]
    process = subprocess.Popen(worker, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL)
    with process:
        assert process.poll() is None
        process.stdin.close()
        assert process.wait(30) == 0


def test_last_words_are_quoted(tmp_path):
    process = ForeignProcess(
        [sys.executable, "-c", "raise SystemExit('no GPU here')"], tmp_path, tmp_path / "log"
    )
    with pytest.raises(ForeignError, match="open: it ended: no GPU here"):
        process.ask({"do": "open"}, None, 10.0)
