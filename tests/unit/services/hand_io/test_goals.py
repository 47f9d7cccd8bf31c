"""hand_io pursues the goals of its own hand's task, the same as the simulated hand for the same episode."""

import numpy as np
import pytest

from common.config import ConfigError
from common.dexhand021.config import DexHandConfig
from common.dexhand021.tables import Hand
from common.messages import Episode, Mode, PlantCommand, Warmup
from common.task.die import TASK_OF
from common.topics import EPISODE
from services.hand_io import build as hand_io
from services.hand_io.config import HandIoProcess
from services.sim import emulator
from services.sim.dexhand_twin import DexHandTwin
from services.sim.emulator_config import EmulatorProcess
from services.sim.port import PlantPort
from tests.unit.services.hand_io.hand import DrivenService
from tests.unit.services.hand_io.rig import Rig

SEEDS = (0, 1, 11, 71_077, 1_000_000, 1_000_008)
EMPTY = np.zeros(0, np.float32)


def driven(hand, seed, goal=EMPTY):
    """The goal that hand_io shows at step 0 of an episode."""
    service = DrivenService(hand=hand).armed()
    service.send(EPISODE, Episode(3, 0, goal, Mode.PLAN, Warmup.NONE, 5, seed))
    while not service.turn(ticks=1):
        pass
    return service.steps[0].goal


@pytest.mark.parametrize("hand", Hand)
def test_the_goal_of_a_seed_is_that_of_the_simulated_hand(hand):
    frames = []
    port = PlantPort(DexHandTwin(hand))
    port.open(lambda _topic, frame: frames.append(frame))
    for seed in SEEDS:
        port.write(PlantCommand(True, seed, EMPTY, EMPTY))
        assert np.array_equal(driven(hand, seed), frames[-1].goal)
    assert len({tuple(frame.goal) for frame in frames}) == 3


def test_a_goal_that_is_given_is_taken():
    wanted = np.array([0.05, 0.0, 0.15, 0.0, 1.0, 0.0, 0.0], np.float32)
    assert np.array_equal(driven(Hand.LEFT, 5, wanted), wanted)


def test_each_hand_drops_its_die_on_its_own_side():
    beside_the_right_thumb = np.array([0.01, 0.06, 0.15], np.float32)
    for hand in Hand:
        service = DrivenService(hand=hand).armed()
        service.send(EPISODE, Episode(3, 0, EMPTY, Mode.RANDOM, Warmup.UNIFORM, 5, 0))
        for turn in range(20):
            if turn == 10:
                service.lay(beside_the_right_thumb)
            service.turn(ticks=1)
        assert [service.steps[0].dropped, service.steps[-1].dropped] == [False, hand is Hand.RIGHT]


def test_a_left_hand_runs_on_its_own_boards():
    rig = Rig(hand=Hand.LEFT)
    try:
        rig.run()
        step = rig.next_steps(5)[-1]
    finally:
        rig.close()
    assert step.part_valid.all()
    assert rig.twin.moved_rad > 0.0
    assert rig.twin.within_limits


@pytest.mark.parametrize("hand", Hand)
@pytest.mark.parametrize(("build", "process"), [(hand_io, HandIoProcess), (emulator, EmulatorProcess)])
def test_the_other_hands_task_is_refused(hand, build, process):
    other = next(each for each in Hand if each is not hand)
    config = process(task=TASK_OF[other], hand=DexHandConfig(hand=hand))
    with pytest.raises(ConfigError, match=f"it has: {TASK_OF[hand]}$"):
        build.build(config, 1)
