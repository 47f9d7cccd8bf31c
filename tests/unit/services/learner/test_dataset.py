"""An acknowledged episode survives a kill; what is torn, corrupt or for evaluation is never learned from."""

import signal
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

from services.learner.dataset import EpisodeStore
from services.learner.episode import EpisodeRefused
from tests.unit.services.learner.toy import linear_episode

WRITER = """
import sys
from pathlib import Path
from services.learner.dataset import EpisodeStore
from tests.unit.services.learner.toy import linear_episode
store = EpisodeStore(Path(sys.argv[1]), 3, 2)
for number in range(100000):
    store.append(linear_episode(number, steps=2000))
    print(number, flush=True)
"""


def files(directory):
    return sorted(path.name for path in directory.glob("*.safetensors"))


def test_what_is_stored_is_read_back_exactly(tmp_path):
    store = EpisodeStore(tmp_path, 3, 2)
    for number in (3, 1, 2):
        assert store.append(linear_episode(number))
    again = EpisodeStore(tmp_path, 3, 2)
    assert len(again) == 3
    assert (again.corrupt, again.leftovers) == ([], 0)
    written = store.replay.trajectories(2, "train", 10**6)
    read = again.replay.trajectories(2, "train", 10**6)
    assert np.array_equal(written.states, read.states)
    assert np.array_equal(written.actions, read.actions)


def test_the_same_episode_is_stored_once(tmp_path):
    store = EpisodeStore(tmp_path, 3, 2)
    assert store.append(linear_episode(0))
    assert not store.append(linear_episode(0))
    assert not EpisodeStore(tmp_path, 3, 2).append(linear_episode(0))
    assert len(files(tmp_path)) == 1
    assert store.replay.steps == 50


def test_an_episode_that_a_restarted_plant_runs_again_is_the_same_episode(tmp_path):
    store = EpisodeStore(tmp_path, 3, 2)
    assert store.append(linear_episode(4))
    again = replace(linear_episode(4), boot_id=linear_episode(4).boot_id + 1)
    assert not store.append(again)
    assert (len(store), store.newest(5), len(files(tmp_path))) == (1, [(linear_episode(4).boot_id, 4)], 1)


def test_copies_that_an_older_version_stored_are_read_once(tmp_path):
    store = EpisodeStore(tmp_path, 3, 2)
    store.append(linear_episode(4))
    (tmp_path / "00000001-8-4.safetensors").write_bytes((tmp_path / files(tmp_path)[0]).read_bytes())
    again = EpisodeStore(tmp_path, 3, 2)
    assert (len(again), again.replay.steps, again.corrupt) == (1, 50, [])
    assert again.append(linear_episode(5))
    assert files(tmp_path)[-1].startswith("00000002-")


def broken(**changes):
    episode = linear_episode(0)
    return type(episode)(**(vars(episode) | changes))


@pytest.mark.parametrize(
    ("episode", "message"),
    [
        (linear_episode(0, mode="evaluate"), "evaluation episodes never enter the replay"),
        (broken(states=np.full((51, 3), np.nan, np.float32)), "states is not finite"),
        (broken(actions=np.zeros((50, 2))), "actions is float64, not float32"),
        (broken(states=np.zeros((50, 3), np.float32)), "states has shape (50, 3), not (51, 3)"),
        (broken(valid=np.ones(50, bool)), "valid has shape (50,), not (51,)"),
    ],
)
def test_what_must_not_be_learned_is_refused_and_not_written(tmp_path, episode, message):
    store = EpisodeStore(tmp_path, 3, 2)
    with pytest.raises(EpisodeRefused) as caught:
        store.append(episode)
    assert str(caught.value) == message
    assert list(tmp_path.iterdir()) == []
    assert store.replay.steps == 0


def test_corrupt_files_are_named_kept_and_passed_over(tmp_path):
    store = EpisodeStore(tmp_path, 3, 2)
    for number in range(4):
        store.append(linear_episode(number))
    whole = files(tmp_path)
    (tmp_path / whole[1]).write_bytes((tmp_path / whole[1]).read_bytes()[:-5])
    flipped = bytearray((tmp_path / whole[2]).read_bytes())
    flipped[-1] ^= 1
    (tmp_path / whole[2]).write_bytes(flipped)
    (tmp_path / "notes.safetensors").write_bytes(b"")
    again = EpisodeStore(tmp_path, 3, 2)
    assert again.corrupt == [whole[1], whole[2], "notes.safetensors"]
    assert len(again) == 2
    assert again.append(linear_episode(9))
    assert files(tmp_path)[4].startswith("00000004-")


def test_half_written_files_are_swept(tmp_path):
    EpisodeStore(tmp_path, 3, 2).append(linear_episode(0))
    payload = (tmp_path / files(tmp_path)[0]).read_bytes()
    (tmp_path / ".00000001-7-1.safetensors.partial").write_bytes(payload[: len(payload) // 2])
    again = EpisodeStore(tmp_path, 3, 2)
    assert (len(again), again.leftovers, again.corrupt) == (1, 1, [])
    assert [path.name for path in tmp_path.iterdir()] == files(tmp_path)


def test_a_killed_writer_loses_nothing_that_it_acknowledged(tmp_path):
    process = subprocess.Popen(
        [sys.executable, "-c", WRITER, str(tmp_path)], stdout=subprocess.PIPE, text=True
    )
    assert process.stdout is not None
    acknowledged = [int(process.stdout.readline()) for _ in range(5)]
    process.send_signal(signal.SIGKILL)
    acknowledged += [int(line) for line in process.stdout.read().splitlines()]
    process.wait()
    store = EpisodeStore(tmp_path, 3, 2)
    assert store.corrupt == []
    assert all(number in store for number in acknowledged)
    assert len(store) - len(acknowledged) in (0, 1)
