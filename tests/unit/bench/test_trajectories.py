"""The picture of the case study: which episodes it shows, what they looked like, and that it is drawn."""

import json
import sys

import matplotlib.image
import numpy as np
import pytest

from bench import trajectories
from bench.trajectories import EPISODES, chosen, main, planned_episodes, task_of, trajectory
from common.dexhand021.tables import Hand
from common.geometry import multiply
from common.task import get_die_task
from services.learner.build import LearnerProcess, build
from services.learner.dataset import EpisodeStore
from services.learner.episode import Episode

TASK = get_die_task("die", Hand.RIGHT)
STEPS = 20
THUMB_ROT, RING_PIP = 2, 8


def about(axis, angle_rad):
    return np.array([np.cos(angle_rad / 2), *(np.sin(angle_rad / 2) * np.eye(3)[axis])])


def episode(number, face, left_rad, mode="plan", height_m=0.0):
    """The thumb's rotation goes to 60° and back; the die ends `left_rad` short, about the palm's normal."""
    goal = TASK.goal(face)
    states = np.zeros((STEPS + 1, 24))
    states[:, THUMB_ROT] = np.radians(60.0 - np.abs(np.linspace(-60.0, 60.0, STEPS + 1)))
    states[:, RING_PIP] = np.radians(np.linspace(10.0, 40.0, STEPS + 1))
    for k, angle in enumerate(np.linspace(1.5, left_rad, STEPS + 1)):
        states[k, 17:20] = goal[:3] + np.array([height_m * k / STEPS, 0.0, 0.003])
        states[k, 20:] = multiply(about(0, angle), goal[3:])
    arrays = (states.astype(np.float32), np.zeros((STEPS, 12), np.float32), goal.astype(np.float32))
    return Episode(5, number, mode, *arrays, np.ones(STEPS + 1, bool))


@pytest.fixture
def run(tmp_path):
    """Warm-up, then two planned episodes towards 2 and one each towards 4 and 5."""
    store = EpisodeStore(tmp_path / EPISODES, 24, 12)
    found = [episode(0, 5, 0.0, mode="random"), episode(1, 2, 0.2), episode(2, 2, 0.6)]
    for each in (*found, episode(3, 4, 1.2), episode(4, 5, 0.1, height_m=-0.4)):
        store.append(each)
    rows = [{"task": "die", "episode": number} for number in range(5)]
    (tmp_path / "episodes.jsonl").write_text("".join(json.dumps(row) + "\n" for row in rows))
    return tmp_path


def test_an_episode_in_degrees_and_millimetres():
    seen = trajectory(episode(7, 4, np.radians(25.0)), TASK)
    assert (seen.face, seen.episode, seen.reached, seen.dropped) == (4, 7, True, False)
    assert seen.angles_deg[:, THUMB_ROT] == pytest.approx([*range(0, 60, 6), *range(60, -1, -6)], abs=1e-4)
    assert seen.turn_deg[[0, -1]] == pytest.approx([np.degrees(1.5), 25.0], abs=1e-2)
    assert seen.distance_mm == pytest.approx(np.full(STEPS + 1, 3.0), abs=1e-3)
    assert seen.left_deg == seen.turn_deg[-1]
    assert {THUMB_ROT, RING_PIP} <= set(seen.most_active())
    assert trajectory(episode(7, 4, 0.1, height_m=-0.4), TASK).dropped


def test_what_was_not_measured_is_a_gap():
    whole = episode(7, 4, 0.5)
    whole.valid[[3, STEPS]] = False
    seen = trajectory(whole, TASK)
    gaps = np.isnan(seen.turn_deg)
    assert np.flatnonzero(gaps).tolist() == [3, STEPS]
    assert np.isnan(seen.angles_deg).all(axis=1).tolist() == gaps.tolist()
    assert not seen.reached and seen.left_deg == seen.turn_deg[STEPS - 1]
    whole.valid[:] = False
    assert trajectory(whole, TASK).left_deg == np.inf


def test_the_best_or_the_newest_of_each_face_is_shown(run):
    found = [trajectory(each, TASK) for each in planned_episodes(run, task_of(run))]
    assert [each.episode for each in found] == [1, 2, 3, 4]
    assert [(each.face, each.episode) for each in chosen(found)] == [(2, 1), (4, 3), (5, 4)]
    assert [(each.face, each.episode) for each in chosen(found, newest=True)] == [(2, 2), (4, 3), (5, 4)]
    dropped_nearer = [trajectory(episode(8, 2, 0.0, height_m=-0.4), TASK), *found]
    assert chosen(dropped_nearer)[0].episode == 1


def test_the_command_draws_and_tells(run, monkeypatch, capsys):
    (run / EPISODES / "00000009-5-9.safetensors").write_bytes(b"torn")
    out = run / "picture.png"
    monkeypatch.setattr(sys, "argv", ["trajectories", "--run", str(run), "--out", str(out)])
    main()
    first, second, third, last = capsys.readouterr().out.splitlines()
    assert first.startswith("face 2: episode 1, face up, 11° left; most active: ")
    assert first.endswith("Thumb Rot, RF PIP")
    assert second.startswith("face 4: episode 3, face up, 69° left")
    assert third.startswith("face 5: episode 4, dropped, 6° left")
    assert last == str(out)
    picture = matplotlib.image.imread(out)
    assert picture.shape[1] > picture.shape[0] > 900
    assert picture[..., :3].std() > 0.05


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (None, "is no run directory"),
        ("", "no episode has been finished"),
        ('{"task": "reach"}\n', "a run of reach"),
        ('{"task": "die"}\n', "no planned episode is stored"),
    ],
)
def test_without_such_an_episode_one_line_says_so(tmp_path, monkeypatch, text, said):
    if text is not None:
        (tmp_path / "episodes.jsonl").write_text(text)
    out = tmp_path / "p.png"
    monkeypatch.setattr(sys, "argv", ["trajectories", "--run", str(tmp_path), "--out", str(out)])
    with pytest.raises(SystemExit) as stopped:
        main()
    assert said in str(stopped.value) and "\n" not in str(stopped.value)
    assert not out.exists()


def test_it_looks_where_the_learner_stores(tmp_path):
    build(LearnerProcess(run_dir=tmp_path, task="die"), boot_id=1)
    assert (tmp_path / trajectories.EPISODES).is_dir()
