"""Messages as a plant with boot id 7 and a planner with boot id 8 would send them."""

from dataclasses import replace

import numpy as np

from common.hand_messages import HandJoints
from common.messages import Chunk, Fallback, Header, Mode, Sample, Step
from common.task import get_task

PERIOD_NS = 40_000_000
START_NS = 1_700_000_000_000_000_000


def step(task_name, k, episode=0, boot_id=7, seq=0, **changes):
    task = get_task(task_name)
    state = np.zeros(task.state_dim, np.float32)
    goal = np.zeros(task.goal_dim, np.float32)
    if task_name != "reach":
        state[task.group("object_rotation").start] = goal[3] = 1.0
    message = Step(
        episode=episode,
        goal_seq=0,
        k=k,
        steps=50,
        mode=Mode.PLAN,
        state=state,
        part_valid=np.ones(len(task.groups), np.uint8),
        part_age_ms=np.zeros(len(task.groups), np.float32),
        prev_action=np.zeros(task.action_dim, np.float32),
        goal=goal,
        chunk_seq=-1,
        chunk_offset=-1,
        fallback=Fallback.NONE,
        first=k == 0,
        last=False,
        waiting=False,
        dropped=False,
    )
    header = Header(boot_id, seq, START_NS + k * PERIOD_NS, True)
    return Sample("control/step", header, replace(message, **changes))


def chunk(task_name, first_k, episode=0, seq=0, **changes):
    task = get_task(task_name)
    state = np.zeros(task.state_dim, np.float32)
    if task_name != "reach":
        state[task.group("object_rotation").start] = 1.0
    message = Chunk(
        plant_boot_id=7,
        episode=episode,
        goal_seq=0,
        first_k=first_k,
        commit=2,
        actions=np.full((5, task.action_dim), 0.5, np.float32),
        source_k=first_k,
        source_t_ns=START_NS + first_k * PERIOD_NS,
        predicted_k=first_k + 2,
        predicted_state=state,
        predicted_std=np.full(task.state_dim, 0.1, np.float32),
        score=-1.0,
        snapshot_id="abc",
        solve_ms=30.0,
    )
    header = Header(8, seq, START_NS + first_k * PERIOD_NS + 1, True)
    return Sample("control/chunk", header, replace(message, **changes))


def joints(seq=0, at_ns=0, **changes):
    """What hand_io says; motor, board and fingertip i show i in their own unit."""
    motors, boards = np.arange(12, dtype=np.float32), np.arange(6, dtype=np.float32)
    message = HandJoints(
        state="running",
        faults=(),
        q_rad=motors / 10,
        target_rad=motors / 10 + 0.5,
        current_ma=motors,
        flags=np.zeros(12, np.uint8),
        force_n=np.arange(5, dtype=np.float32),
        force_valid=np.ones(5, np.uint8),
        temperature_c=30 + boards,
        temperature_valid=np.ones(6, np.uint8),
        board_age_ms=boards,
        board_rate_hz=50 + boards,
    )
    return Sample("hand/joints", Header(7, seq, START_NS + at_ns, True), replace(message, **changes))
