"""The plant's action buffer: chunks are addressed by step index, never popped from a queue.

A late chunk contributes its still-future part; with nothing left the last command is held, then relaxed to
zero. The planner keeps one as well, to know which actions are already committed.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass

import numpy as np

from common.messages import Chunk, Fallback, Float32


@dataclass(frozen=True)
class Executed:
    """One action as it goes to the hand: (A,) normalised, and where it came from."""

    action: Float32
    chunk_seq: int  # -1: no chunk
    chunk_offset: int  # index within the chunk; -1: none
    fallback: Fallback
    late: bool  # planned, but not among the first x of its chunk


@dataclass(frozen=True)
class _Slot:
    action: Float32
    chunk_seq: int
    offset: int
    commit: int


class ActionBuffer:
    """Actions of one episode by step index.

    `start_steps` is the number of zero actions that `start: zero` executes first (the paper's x; 0 for
    `start: plan`); `hold_steps` is how long the last command is repeated before zero is commanded.
    """

    def __init__(self, action_dim: int, start_steps: int, hold_steps: int) -> None:
        self._zero: Float32 = np.zeros(action_dim, np.float32)
        self._start_steps = start_steps
        self._hold_steps = hold_steps
        self._slots: dict[int, _Slot] = {}
        self._last = self._zero
        self._held = 0
        self._identity = (0, 0, 0)
        self._newest = (0, -1)  # boot of the planner and seq of the chunk in use
        self.refused: Counter[str] = Counter()
        self.counts: Counter[str] = Counter()  # planned, late, start, hold, relax; over the buffer's life

    def reset(self, plant_boot_id: int, episode: int, goal_seq: int) -> None:
        """Begin an episode: forget every action, the last command included."""
        self._last = self._zero
        self._held = 0
        self._held_from = 0  # of a mirror: the first step without a plan
        self._newest = (0, -1)
        self.change_goal(plant_boot_id, episode, goal_seq)

    def change_goal(self, plant_boot_id: int, episode: int, goal_seq: int) -> None:
        """Drop the plans for the old goal; the hand holds until a plan for the new one arrives."""
        self._identity = (plant_boot_id, episode, goal_seq)
        self._slots.clear()

    def offer(self, chunk: Chunk, seq: int, k: int, sender: int = 0) -> str:
        """Take over a chunk while step k is the next to execute; return "" or why it was refused.

        `seq` counts the chunks of the planner whose boot is `sender`; a restarted planner counts anew.
        """
        reason = self._refusal(chunk, seq, k, sender)
        if reason:
            self.refused[reason] += 1
            return reason
        self._newest = (sender, seq)
        end = chunk.first_k + len(chunk.actions)
        begin = max(chunk.first_k, k)  # what is before stays: a mirror of this buffer has not taken it yet
        self._slots = {index: slot for index, slot in self._slots.items() if index < begin}
        for index in range(begin, end):
            offset = index - chunk.first_k
            self._slots[index] = _Slot(chunk.actions[offset], seq, offset, chunk.commit)
        return ""

    def _refusal(self, chunk: Chunk, seq: int, k: int, sender: int) -> str:
        named = (chunk.plant_boot_id, chunk.episode, chunk.goal_seq)
        for what, given, wanted in zip(("boot", "episode", "goal"), named, self._identity, strict=True):
            if given != wanted:
                return f"other {what}"
        if sender == self._newest[0] and seq <= self._newest[1]:
            return "older than the one in use"
        if not len(chunk.actions):
            return "empty"
        return "all late" if chunk.first_k + len(chunk.actions) <= k else ""

    def covers(self, k: int, committed: bool = False) -> bool:
        """Tell whether step k has a planned action (`committed`: among the first x of its chunk)."""
        slot = self._slots.get(k)
        return slot is not None and (not committed or slot.offset < slot.commit)

    def take(self, k: int) -> Executed:
        """Return the action of step k and count where it came from."""
        slot = self._slots.pop(k, None)
        executed = self._planned(slot) if slot else self._fallback(k)
        self._last = executed.action
        self.counts["planned" if slot else executed.fallback.value] += 1
        self.counts["late"] += executed.late
        return executed

    def _planned(self, slot: _Slot) -> Executed:
        self._held = 0
        late = slot.offset >= slot.commit
        return Executed(slot.action, slot.chunk_seq, slot.offset, Fallback.NONE, late)

    def _fallback(self, k: int) -> Executed:
        if k < self._start_steps:
            return Executed(self._zero, -1, -1, Fallback.START, False)
        self._held += 1
        if self._held > self._hold_steps:
            return Executed(self._zero, -1, -1, Fallback.RELAX, False)
        return Executed(self._last, -1, -1, Fallback.HOLD, False)

    def peek(self, k: int, count: int) -> Float32:
        """Return the (count, A) actions that steps k, k+1, ... will execute if nothing new arrives."""
        actions = np.empty((count, len(self._zero)), np.float32)
        last, held = self._last, self._held
        for row, index in enumerate(range(k, k + count)):
            slot = self._slots.get(index)
            if slot:
                last, held = slot.action, 0
            elif index < self._start_steps:
                last = self._zero
            else:
                held += 1
                last = last if held <= self._hold_steps else self._zero
            actions[row] = last
        return actions

    def follow(self, k: int, action: Float32, held: bool) -> None:
        """Keep a mirror in step: before step k the plant executed `action`, for want of a plan if `held`."""
        self._slots = {index: slot for index, slot in self._slots.items() if index >= k}
        self._last = action
        self._held_from = self._held_from if held else k
        self._held = max(0, k - self._held_from)

    def executed(self, action: Float32) -> None:
        """Tell a mirror of the plant's buffer what the plant last executed, so that a hold is predicted."""
        self._last = action
