"""Processes killed or frozen in the middle of an episode: the others go on, the victim comes back."""

import re
import signal
import time

import pytest

from common.messages import Fallback, Mode
from common.topics import ACK, CHUNK, EPISODE, METRICS, STEP
from tests.faults.cell import STEPS, wait

pytestmark = [pytest.mark.processes, pytest.mark.timeout(300)]

PERIOD_NS = 40_000_000
PLANT_HOLDS = ("planner", "router")  # without them no plan reaches the plant


def takes_part(cell, name, since, boot, episode):
    """What the process that followed boot `boot` of `name` has done for an episode after `episode`."""
    ear = cell.heard
    if name == "router":  # everybody else speaks again
        return [s for s in ear.samples(ACK, since) if s.message.episode > episode]
    if name == "viewer":
        return ear.boot(name) != boot and ear.field(name, "drawn") > 0
    topic = {"planner": CHUNK, "learner": ACK, "curriculum": EPISODE}[name]
    return [s for s in ear.samples(topic, since) if s.header.boot_id != boot and s.message.episode > episode]


def assert_clock_kept(ear, episode, missed_before):
    """The plant never waited: all steps of the episode are there, at the times at which they were due."""
    steps = wait(lambda: whole(ear.steps_of(episode)), "every step of the episode")
    ended = time.monotonic()
    wait(lambda: ear.health("sim", ended), "a heartbeat after its end")
    missed = ear.field("sim", "missed_ticks") - missed_before
    took = steps[-1].header.t_ns - steps[0].header.t_ns
    assert STEPS * PERIOD_NS * 0.99 < took < (STEPS + 1 + missed) * PERIOD_NS
    return [s.message for s in steps]


def whole(steps):
    return steps if [s.message.k for s in steps] == list(range(STEPS + 1)) else None


def strike(cell, name, number):
    """Hit a process in mid-episode; wait until it takes part again. Returns the steps of that episode."""
    ear = cell.heard
    before, boot = cell.pids(), ear.boot(name)
    missed = ear.field("sim", "missed_ticks")
    hit = cell.mid_episode()
    at = cell.signal(name, number)
    wait(lambda: takes_part(cell, name, at, boot, hit.episode), f"{name} to take part again")
    print(f"{name} took part again after {time.monotonic() - at:.1f} s")
    after = cell.pids()
    assert after.pop(name) != before.pop(name)
    assert after == before  # nobody else had to be restarted
    return assert_clock_kept(ear, hit.episode, missed)


def held(steps):
    return sum(step.fallback in (Fallback.HOLD, Fallback.RELAX) for step in steps)


@pytest.mark.parametrize("name", ["planner", "learner", "curriculum", "viewer", "router"])
def test_a_process_killed_in_mid_episode_comes_back_and_the_plant_goes_on(cell, name):
    held_before, lost = cell.heard.field("sim", "held_steps"), cell.heard.field("curriculum", "lost_episodes")
    steps = strike(cell, name, signal.SIGKILL)
    if name in PLANT_HOLDS:
        assert held(steps) > 0
        wait(lambda: cell.heard.field("sim", "held_steps") >= held_before + held(steps), "the count of holds")
    assert cell.heard.field("curriculum", "lost_episodes") == lost
    assert_acknowledged_in_time(cell.heard)


def test_a_frozen_process_is_noticed_and_restarted_by_the_watchdog(cell):
    restarts = cell.heard.field("watchdog", "restarts_planner")
    steps = strike(cell, "planner", signal.SIGSTOP)
    assert held(steps) > 0
    wait(lambda: cell.heard.field("watchdog", "restarts_planner") == restarts + 1, "the watchdog's count")


def test_a_frozen_router_is_noticed_and_restarted_by_the_watchdog(cell):
    steps = strike(cell, "router", signal.SIGSTOP)
    assert held(steps) > 0
    wait(lambda: cell.heard.field("watchdog", "restarts_router") >= 1, "the watchdog's count")


def assert_acknowledged_in_time(ear):
    """When an episode begins, at most the one before it is finished and not acknowledged."""
    acks = {}
    for sample in ear.samples(ACK):
        key = (sample.message.plant_boot_id, sample.message.episode)
        acks[key] = min(sample.header.t_ns, acks.get(key, sample.header.t_ns))
    kept = [s for s in ear.samples(STEP) if s.message.mode in (Mode.PLAN, Mode.RANDOM)]
    ends = [(s.header.boot_id, s.message.episode) for s in kept if s.message.last]
    begins = [s for s in kept if s.message.k == 0]
    assert len(ends) > 3
    for begin in begins:
        older = [key for key in ends if key[0] == begin.header.boot_id and key[1] < begin.message.episode]
        for key in sorted(older)[:-1]:
            assert key in acks and acks[key] <= begin.header.t_ns


COUNTED = (("sim", "held_steps"), ("curriculum", "lost_episodes"))


def counts(ear):
    """The figures of COUNTED from heartbeats that are still to come."""
    now = time.monotonic()
    wait(lambda: ear.health("sim", now) and ear.health("curriculum", now), "new heartbeats")
    return [ear.field(name, field) for name, field in COUNTED]


def test_what_happened_is_visible_in_status(cell):
    """Restarts per service, holds and losses: the same figures as the processes themselves report."""
    strike(cell, "curriculum", signal.SIGKILL)
    log = (cell.run_dir / "logs" / "supervisord-local.log").read_text()
    before, out, after = counts(cell.heard), cell.do("status"), counts(cell.heard)
    rows = {line.split()[0]: re.split(r"\s{2,}", line.strip()) for line in out.splitlines()}
    column = rows["service"].index("restarts")
    for name in cell.pids():
        assert int(rows[name][column]) == log.count(f"spawned: '{name}'") - 1, out
    assert int(rows["curriculum"][column]) > 0
    for (_, field), low, high in zip(COUNTED, before, after, strict=True):
        shown = re.search(rf"\b{field} (\d+)", out)
        assert shown and low <= int(shown[1]) <= high, out


def test_training_went_on_from_where_it_was(cell):
    """A learner that was killed has not begun anew: its count of gradient steps never falls."""
    updates = [s.message.updates for s in cell.heard.samples(METRICS)]
    assert updates == sorted(updates)
