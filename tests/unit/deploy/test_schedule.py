import pytest

from common.messages import Mode
from deploy import schedule
from deploy.schedule import Assignment, Done, Pending, Progress, Waiting
from tests.unit.deploy.scripted_cell import config


def play(settings, lose=lambda assignment: False):
    """Run a schedule with partners that answer at once; returns (assignment, progress before it)."""
    progress, played = Progress(), []
    while True:
        chosen = schedule.decide(progress, settings)
        if isinstance(chosen, Done):
            return played, progress
        if isinstance(chosen, Waiting):
            progress = progress.model_copy(update={"updated_after": progress.next_id - 1})
            continue
        progress = schedule.assign(progress, chosen)
        played.append((chosen, progress))
        progress = schedule.finish(progress, settings.curriculum.episode_steps, settings)
        for pending in progress.pending:
            settle = schedule.lose if lose(chosen) else schedule.acknowledge
            progress = settle(progress, pending)


@pytest.mark.parametrize("episodes, every, goals", [(0, 1, 3), (1, 5, 1), (6, 2, 2), (7, 3, 1), (4, 9, 0)])
def test_what_is_left_counts_down_to_nothing(tmp_path, episodes, every, goals):
    settings = config(tmp_path, episodes=episodes, evaluate_every=every, evaluate_goals=goals)
    played, end = play(settings)
    totals = {schedule.episodes_total(progress, settings) for _, progress in played}
    assert totals == {len(played)}
    assert schedule.planned_left(end, settings) == 0
    evaluations = {p.trained for a, p in played if a.mode is Mode.EVALUATE}
    expected = {n for n in range(episodes + 1) if n % every == 0 or n == episodes}
    assert evaluations == (expected if goals else set())


def test_the_same_seed_gives_the_same_goals_whatever_the_evaluations(tmp_path):
    def goals(**plan):
        return [a.seed for a, _ in play(config(tmp_path, episodes=5, **plan))[0] if a.mode is Mode.PLAN]

    assert goals(evaluate_every=1) == goals(evaluate_goals=0)


def test_lost_warm_up_steps_are_collected_again(tmp_path):
    played, end = play(config(tmp_path), lose=lambda a: a.mode is Mode.RANDOM and a.index < 2)
    assert sum(a.mode is Mode.RANDOM for a, _ in played) == 6
    assert (end.lost, end.warmup_steps) == (2, 20)


def test_a_lost_goal_is_not_waited_for(tmp_path):
    pending = Pending(episode=9, mode=Mode.PLAN, steps=5)
    before = Progress(
        next_id=10, warmup_steps=20, trained=2, evaluated_at=2, updated_after=8, pending=(pending,)
    )
    assert isinstance(schedule.decide(before, config(tmp_path)), Waiting)
    assert isinstance(schedule.decide(schedule.lose(before, pending), config(tmp_path)), Assignment)


def test_without_a_warm_up_a_model_is_taken_for_granted(tmp_path):
    settings = config(tmp_path, episodes=0, evaluate_goals=3).model_copy(update={"warmup_steps": 0})
    assert [a.mode for a, _ in play(settings)[0]] == [Mode.EVALUATE] * 3


def test_a_warm_up_by_glove_is_scheduled_like_a_random_one(tmp_path):
    def warmups(kind, mode):
        settings = config(tmp_path, warmup=kind)
        played, end = play(settings, lose=lambda a: a.mode is mode and a.index == 1)
        assert (end.lost, end.warmup_steps) == (1, 20)
        return [(a.mode, a.episode, a.index, a.seed) for a, _ in played]

    random, glove = warmups("mix", Mode.RANDOM), warmups("glove", Mode.GLOVE)
    assert [mode for mode, *_ in glove[:6]] == [Mode.GLOVE] * 5 + [Mode.EVALUATE]
    assert [rest for _, *rest in glove] == [rest for _, *rest in random]
