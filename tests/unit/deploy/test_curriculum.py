import json
from itertools import pairwise

import pytest

from common.config import ConfigError
from common.messages import Mode
from deploy.curriculum_files import STATE_FILE, CurriculumFiles, read_rows
from tests.unit.deploy.scripted_cell import (
    SECOND_NS,
    ScriptedCell,
    ScriptedLearner,
    ScriptedPlant,
    config,
)

WHOLE_RUN = [
    *["random"] * 4,
    *["evaluate"] * 2,
    *["plan"] * 2,
    *["evaluate"] * 2,
    "plan",
    *["evaluate"] * 2,
    "idle",
]


def test_a_run_goes_through_warm_up_goals_and_evaluations_and_ends(tmp_path):
    cell = ScriptedCell(config(tmp_path))
    assert cell.run()
    assert cell.modes == WHOLE_RUN
    assert [episode.episode for episode in cell.published] == list(range(len(WHOLE_RUN)))
    assert cell.dispatchers[1].finish is not None and cell.dispatchers[1].finish.code == 0
    report = cell.curriculum.report()
    assert report.state == "done"
    assert report.fields["done"] == 1 and report.fields["training_episodes_done"] == 3
    assert report.fields["episodes_total"] == report.fields["episode"] == len(WHOLE_RUN) - 1


def test_every_episode_has_one_row_in_order(tmp_path):
    cell = ScriptedCell(config(tmp_path))
    cell.run()
    rows = read_rows(tmp_path)
    assert [row["episode"] for row in rows] == list(range(len(WHOLE_RUN) - 1))
    assert [row["mode"] for row in rows] == WHOLE_RUN[:-1]
    assert all(row["steps"] == 5 and row["missing_steps"] == 0 for row in rows)
    assert [row["trained_episodes"] for row in rows if row["mode"] == "evaluate"] == [0, 0, 2, 2, 3, 3]


def test_held_out_goals_are_the_same_every_time_and_training_goals_differ(tmp_path):
    cell = ScriptedCell(config(tmp_path))
    cell.run()
    evaluated = [episode.seed for episode in cell.plant.seen if episode.mode is Mode.EVALUATE]
    trained = [episode.seed for episode in cell.plant.seen if episode.mode in (Mode.RANDOM, Mode.PLAN)]
    assert evaluated == [1_000_000, 1_000_001] * 3
    assert len(set(trained)) == len(trained) and max(trained) < 1_000_000


def test_the_first_goal_waits_for_the_first_update(tmp_path):
    cell = ScriptedCell(config(tmp_path))
    cell.run()
    assert cell.plant.times_ns[4] >= cell.learner.updated_ns[3]


def test_each_goal_waits_for_the_update_after_the_last(tmp_path):
    learner = ScriptedLearner(20, update_ns=100 * SECOND_NS)
    cell = ScriptedCell(config(tmp_path, evaluate_goals=0), learner=learner)
    assert cell.run()
    goals = [episode.episode for episode in cell.plant.seen if episode.mode is Mode.PLAN]
    for before, after in pairwise(goals):
        assert cell.plant.times_ns[after] >= learner.updated_ns[before]


def test_without_waiting_goals_follow_at_once_but_the_last_evaluation_sees_all(tmp_path):
    learner = ScriptedLearner(20, update_ns=100 * SECOND_NS)
    cell = ScriptedCell(config(tmp_path, wait_for_update=False), learner=learner)
    assert cell.run()
    goals = [episode.episode for episode in cell.plant.seen if episode.mode is Mode.PLAN]
    assert cell.plant.times_ns[goals[-1]] < learner.updated_ns[goals[0]]
    last_evaluation = [e.episode for e in cell.plant.seen if e.mode is Mode.EVALUATE][-2]
    assert cell.plant.times_ns[last_evaluation] >= learner.updated_ns[goals[-1]]


def test_never_two_episodes_ahead_of_the_acknowledgements(tmp_path):
    learner = ScriptedLearner(20, ack_ns=7 * SECOND_NS, update_ns=0)
    settings = config(tmp_path, wait_for_update=False, evaluate_goals=0, episodes=6)
    cell = ScriptedCell(settings, learner=learner)
    assert cell.run()
    for episode in cell.plant.seen[2:]:
        assert cell.plant.times_ns[episode.episode] >= learner.acked_ns[episode.episode - 2]


def test_a_lost_warm_up_episode_is_made_up_for(tmp_path):
    cell = ScriptedCell(config(tmp_path), learner=ScriptedLearner(20, loses=(1,)))
    assert cell.run()
    assert cell.modes.count("random") == 5
    assert cell.curriculum.report().fields["lost_episodes"] == 1


def test_a_lost_goal_is_counted_and_the_run_goes_on(tmp_path):
    settings = config(tmp_path, ack_timeout_s=30.0)
    cell = ScriptedCell(settings, learner=ScriptedLearner(20, loses=(6,)))
    assert not cell.run(seconds=20)
    assert cell.curriculum.report().state == "waiting for ack of episode 6"
    assert cell.run()
    assert cell.modes == WHOLE_RUN
    assert cell.curriculum.report().fields["lost_episodes"] == 1


def test_a_learner_that_died_before_its_ack_is_believed_by_its_update(tmp_path):
    learner = ScriptedLearner(20, loses=(6,))
    cell = ScriptedCell(config(tmp_path), learner=learner)
    cell.run(seconds=5)
    learner.loses = ()
    learner.due.append((0, 6))
    assert cell.run()
    assert cell.curriculum.report().fields["lost_episodes"] == 0


def test_an_ack_that_nobody_heard_shows_in_the_count_of_the_next(tmp_path):
    learner = ScriptedLearner(20)
    cell = ScriptedCell(config(tmp_path, ack_timeout_s=1000.0), learner=learner)
    learner.silent = (1,)
    assert cell.run(seconds=100)
    assert cell.modes == WHOLE_RUN
    assert cell.curriculum.report().fields["lost_episodes"] == 0


@pytest.mark.parametrize("number", [1, 5])
def test_an_episode_that_is_on_disk_from_an_earlier_life_of_the_plant_is_not_lost(tmp_path, number):
    cell = ScriptedCell(config(tmp_path, wait_for_update=False, evaluate_goals=0))
    cell.learner.stored_as = {number: cell.plant.boot_id + 1}
    assert cell.run(seconds=25)  # less than an acknowledgement is waited for
    assert cell.modes == [*["random"] * 4, *["plan"] * 3, "idle"]
    assert cell.curriculum.report().fields["lost_episodes"] == 0


def test_a_state_that_names_the_plant_of_a_pending_episode_is_understood(tmp_path):
    cell = ScriptedCell(config(tmp_path), learner=ScriptedLearner(20, loses=(6,)))
    cell.run(seconds=5)
    state = json.loads((tmp_path / STATE_FILE).read_text())
    assert [pending["episode"] for pending in state["progress"]["pending"]] == [6]
    state["progress"]["pending"][0]["boot_id"] = 1
    (tmp_path / STATE_FILE).write_text(json.dumps(state))
    assert CurriculumFiles(tmp_path, "reach", 7).load()[0].pending[0].episode == 6


def test_it_says_what_it_waits_for(tmp_path):
    cell = ScriptedCell(config(tmp_path), learner=ScriptedLearner(20, update_ns=50 * SECOND_NS))
    cell.run(seconds=10)
    assert cell.curriculum.report().state == "waiting for the first update"
    dead = ScriptedCell(config(tmp_path / "b"), plant=ScriptedPlant(dies_in=(0,)))
    dead.run(seconds=10)
    assert dead.curriculum.report().state == "warm-up, 0 of 20 steps done: step 2 of 5"


@pytest.mark.parametrize("instants", range(1, 70, 6))
def test_a_killed_run_goes_on_without_losing_or_repeating_anything(tmp_path, instants):
    first = ScriptedCell(config(tmp_path))
    first.run(instants=instants)
    second = ScriptedCell(config(tmp_path), plant=ScriptedPlant(boot_id=11), learner=ScriptedLearner(20))
    for name in ("steps", "episodes", "trained"):
        setattr(second.learner, name, getattr(first.learner, name))
    if first.learner.trained:  # a restarted learner makes up for the update that it owes
        second.learner.due.append((0, first.learner.newest))
    assert second.run()
    rows = read_rows(tmp_path)
    assert [row["episode"] for row in rows] == list(range(len(rows)))
    assert [row["mode"] for row in rows if row["mode"] != "random"] == WHOLE_RUN[4:-1]
    known = {episode.episode: episode.mode for episode in first.published}
    for episode in second.published:
        assert known.get(episode.episode, episode.mode) is episode.mode


def test_a_restarted_curriculum_follows_the_episode_that_goes_on_without_it(tmp_path):
    plant = ScriptedPlant(dies_in=(6,))
    cell = ScriptedCell(config(tmp_path), plant=plant)
    cell.run(seconds=10)
    assert plant.seen[-1].episode == 6
    again = ScriptedCell(config(tmp_path), plant=ScriptedPlant(boot_id=9), learner=cell.learner)
    assert again.run()
    assert again.plant.seen[0].episode == 6
    assert [row["episode"] for row in read_rows(tmp_path)] == list(range(13))


def test_lines_that_no_state_knows_of_are_cut_off(tmp_path):
    ScriptedCell(config(tmp_path)).run(seconds=1)
    whole = read_rows(tmp_path)
    with (tmp_path / "episodes.jsonl").open("a") as file:
        file.write(json.dumps(whole[-1]) + "\n" + '{"torn": ')
    cell = ScriptedCell(config(tmp_path))
    cell.learner.trained = True
    cell.run()
    episodes = [row["episode"] for row in read_rows(tmp_path)]
    assert episodes == sorted(set(episodes))


def test_a_finished_run_ends_at_once_and_a_longer_one_gets_new_ids(tmp_path):
    ScriptedCell(config(tmp_path)).run()
    rows = len(read_rows(tmp_path))
    again = ScriptedCell(config(tmp_path))
    assert again.run()
    assert again.modes == ["idle"] and len(read_rows(tmp_path)) == rows
    longer = ScriptedCell(config(tmp_path, episodes=4))
    longer.learner.trained = True
    assert longer.run()
    assert longer.modes == ["plan", "evaluate", "evaluate", "idle"]
    assert longer.published[0].episode > again.published[-1].episode


def test_another_run_is_refused(tmp_path):
    ScriptedCell(config(tmp_path)).run(seconds=1)
    with pytest.raises(ConfigError, match="belongs to a run with task reach, seed 7"):
        CurriculumFiles(tmp_path, "reach", 8).load()
    (tmp_path / STATE_FILE).write_text("{")
    with pytest.raises(ConfigError, match="cannot be read"):
        CurriculumFiles(tmp_path, "reach", 7).load()
    (tmp_path / STATE_FILE).unlink()
    with pytest.raises(ConfigError, match="is missing"):
        CurriculumFiles(tmp_path, "reach", 7).load()


def test_a_full_disk_is_told_and_tried_again(tmp_path, monkeypatch):
    cell = ScriptedCell(config(tmp_path))
    commit = CurriculumFiles.commit
    failures = iter([True, True])

    def failing(self, progress, rows):
        if next(failures, False):
            raise OSError(28, "No space left on device")
        commit(self, progress, rows)

    monkeypatch.setattr(cell.curriculum._files, "commit", failing.__get__(cell.curriculum._files))
    cell.run(seconds=3)
    assert "No space left" in cell.curriculum.report().state
    assert cell.run()
    assert [row["mode"] for row in read_rows(tmp_path)] == WHOLE_RUN[:-1]
