"""Ended at any time: within ten seconds, without a trace in the process table, and ready to go on."""

import signal
import subprocess
import time

import pytest

from common.messages import Mode
from common.topics import CHUNK, EPISODE, METRICS, STEP
from services.learner.dataset import EpisodeStore
from tests.faults.cell import END_S, PATIENCE_S, acknowledged, stored, wait
from tests.samples import A, S

pytestmark = [pytest.mark.processes, pytest.mark.timeout(300)]


def terminate(cell, running, number):
    """Send a signal to a foreground run; what it printed."""
    begin = time.monotonic()
    running.send_signal(number)
    try:
        out, _ = running.communicate(timeout=PATIENCE_S)
    except subprocess.TimeoutExpired:
        running.kill()
        raise
    took = time.monotonic() - begin
    assert running.returncode == 128 + number, out
    assert took < END_S, out
    assert cell.alive() == {}
    print(f"ended in {took:.1f} s")
    return out


def assert_stored(cell, acks):
    """Every acknowledged episode is on disk and can be read again."""
    directory = cell.run_dir / "learner" / "episodes"
    assert acks and acks <= stored(cell.run_dir)
    store = EpisodeStore(directory, S, A)
    assert (store.corrupt, len(store)) == ([], len(stored(cell.run_dir)))


def test_down_in_mid_episode_ends_everything_and_keeps_what_was_acknowledged(cell):
    cell.mid_episode()
    begin = time.monotonic()
    assert "stopped in" in cell.do("down")
    took = time.monotonic() - begin
    assert took < END_S
    print(f"down in {took:.1f} s")
    assert cell.alive() == {}
    assert_stored(cell, acknowledged(cell.heard))


@pytest.mark.parametrize("after_s", [0.0, 2.0])
def test_term_while_everything_is_only_starting(shared, after_s):
    down(shared)
    running = shared.begin("run")
    wait(lambda: "supervisord" in " ".join(shared.alive().values()), "supervisord")
    time.sleep(after_s)
    terminate(shared, running, signal.SIGTERM)


def down(cell):
    if cell.supervisor.running():
        cell.do("down")
    cell.heard.close()


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_second_start_goes_on_and_ends_at_a_signal_in_mid_episode(shared, number):
    before = shared.heard
    down(shared)
    last_id = before.newest(EPISODE).message.episode
    updates = max(s.message.updates for s in before.samples(METRICS))
    acks = acknowledged(before)
    running = shared.begin("run")
    ear = shared.listen()
    wait(lambda: ear.samples(CHUNK) or running.poll() is not None, "the first plan")
    shared.mid_episode()
    wait(lambda: ear.samples(METRICS), "what the learner knows")
    out = terminate(shared, running, number)
    assert "goes on from here" in out
    ids = [s.message.episode for s in ear.samples(EPISODE)]
    assert ids[0] in (last_id, last_id + 1)  # the one that was running is run again
    assert ids == list(range(ids[0], ids[0] + len(ids)))
    assert all(s.message.mode is not Mode.RANDOM for s in ear.samples(STEP))
    assert min(s.message.updates for s in ear.samples(METRICS)) >= updates
    assert_stored(shared, acks | acknowledged(ear))
