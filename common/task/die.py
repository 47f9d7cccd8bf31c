"""The die in the DexHand 021: bring a given face up (Sec. II-B and Eq. (2) of the paper)."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from common import geometry
from common.dexhand021.tables import BOARDS, JOINTS, Hand
from common.die import DIE, Die
from common.geometry import Array, namespace
from common.task.layout import Group
from common.task.manipulate import ManipulateTask

Vector = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]

# A joint pushed beyond its range, a blow on a fingertip, a die on the table below the hand: all within.
DIE_GROUPS = (
    Group("qpos", 0, 12, "rad", -1.0, 3.5),
    Group("tip_force", 12, 17, "N", -50.0, 200.0),
    Group("object_position", 17, 20, "m", -1.0, 1.0),
    Group("object_rotation", 20, 24, "1", 0.5, 1.5, "quaternion"),
)
TACTILE_FINGERS = tuple(board.name for board in BOARDS if board.has_tactile)
JOINT_NAMES = tuple(joint.name for joint in JOINTS)
GOAL_FACES = (2, 4, 5)
TASK_OF: Mapping[Hand, str] = MappingProxyType({Hand.RIGHT: "die", Hand.LEFT: "die_left"})
OUT_OF_PALM: Vector = (1.0, 0.0, 0.0)
# Paper: how the hand is mounted is not said. Palm up, turned about its long axis so that the thumb is the
# lower side: a die that is rolled to either side then stays within reach.
MOUNT_ROLL_RAD = math.radians(15.0)


@dataclass(frozen=True)
class DieTask(ManipulateTask):
    """State (24,): 12 joint angles, 5 fingertip normal forces, die's position 3 and rotation 4; goal (7,).

    Poses are those of the die in the palm's frame: +z to the fingertips, +x out of the palm, +y to the
    thumb of a right hand. `up` is where the world's up is in that frame; the hand has no wrist to change it.
    `start_position` (3,) and `start_rotation` (4,) are the fixed initial pose: flat on the palm, 1 up, 2 to
    the fingertips; in a right hand 4 is then on the thumb's side.
    """

    action_dim: int = len(JOINT_NAMES)
    joint_names: tuple[str, ...] = JOINT_NAMES
    actuator_names: tuple[str, ...] = JOINT_NAMES
    finger_names: tuple[str, ...] = TACTILE_FINGERS
    # Paper: the unit of p is not given (Eq. 2); metres, with which the weight is as small as its text says.
    position_weight: float = 0.1
    drop_penalty: float = 2.0
    drop_height_m: float = 0.0
    die: Die = field(default=DIE)
    up: Vector = (math.cos(MOUNT_ROLL_RAD), -math.sin(MOUNT_ROLL_RAD), 0.0)
    start_position: Vector = (0.055, 0.0, 0.154)
    start_rotation: Quaternion = (0.5**0.5, 0.5**0.5, 0.0, 0.0)
    hand: Hand = Hand.RIGHT

    def dropped(self, state: Array) -> Array:
        """Whether the die's centre is lower than the palm's frame plus `drop_height_m`: bool (...)."""
        return self._below(self.achieved(state))

    def straying(self, state: Array) -> Array:
        """How far (...), m, the die's centre is beyond `middle_radius_m` from the vertical of its start."""
        xp, (right, _, along) = namespace(state), self._offset(state)
        return xp.clip(xp.sqrt(right * right + along * along + 1e-12) - self.middle_radius_m, 0.0, None)

    def sinking(self, state: Array) -> Array:
        """How far (...), m, the die's centre is lower than at its start."""
        return namespace(state).clip(-self._offset(state)[1], 0.0, None)

    def reward(self, state: Array, goal: Array) -> Array:
        """Eq. (2) of the state's pose, less the penalty where the die is dropped: (...)."""
        return self.env_reward(state, goal)  # the real hand's environment has no other

    def residuals(self, state: Array, goal: Array) -> tuple[Array, ...]:
        """The weighted offset (..., 3) and the turn that is left (..., 3), rad: Eq. (2) without the drop."""
        pose = self.achieved(state)
        turn = geometry.turn(pose[..., 3:], goal[..., 3:])
        return self.position_weight * (pose[..., :3] - goal[..., :3]), turn

    def compute_reward(self, achieved: Array, goal: Array) -> Array:
        """-(0.1·‖p - p*‖ + 2·arccos|⟨q, q*⟩|), p in m, and 2 less when dropped: (...) of poses (..., 7)."""
        xp = namespace(achieved)
        distance = xp.linalg.vector_norm(achieved[..., :3] - goal[..., :3], axis=-1)
        rotation = geometry.angle(achieved[..., 3:], goal[..., 3:])
        penalty = xp.where(self._below(achieved), self.drop_penalty, 0.0)
        return -(self.position_weight * distance + rotation) - penalty

    def errors(self, state: Array, goal: Array) -> dict[str, Array]:
        """Distance (m), shortest angle (rad), and how far the wanted face leans away (rad), each (...)."""
        xp = namespace(state)
        seen, wanted = (_seen(q, OUT_OF_PALM) for q in (self._rotation(state), goal[..., 3:]))
        lean = xp.sum(seen * wanted, axis=-1)
        return {
            "position_m": self._position_error(state, goal),
            "rotation_rad": geometry.angle(self._rotation(state), goal[..., 3:]),
            "lean_rad": xp.acos(xp.clip(lean, -1.0, 1.0)),
        }

    def successes(self, state: Array, goal: Array) -> dict[str, Array]:
        """bool (...), in the hand: the goal's face uppermost (`paper`); within 0.5 rad of the goal (`env`).

        # Paper: success on the real hand is "faces 4, 5 and 2 upward" (Sec. IV-C) without a threshold.
        """
        held = namespace(state).logical_not(self.dropped(state))
        shown = self._uppermost(self._rotation(state)) == self._uppermost(goal[..., 3:])
        close = self.errors(state, goal)["rotation_rad"] < self.paper_threshold_rad
        return {"success_paper": held & shown, "success_env": held & close}

    def goal(self, face: int) -> NDArray[np.float64]:
        """The paper's single target pose (7,) for a face: the initial one, turned the short way."""
        return self.goals(face, 1)[0]

    def goals(self, face: int, count: int = 4) -> NDArray[np.float64]:
        """Target poses (count, 7): flat on the palm, `face` up, turned evenly; the first is `goal`."""
        rotations = self.die.turns(face, OUT_OF_PALM, self.start_rotation, count)
        return np.concatenate([np.broadcast_to(self.start_position, (count, 3)), rotations], axis=1)

    def draw_goal(self, rng: np.random.Generator) -> NDArray[np.float64]:
        """The goal (7,) of an episode that names none: the first draw from a generator of its seed."""
        return self.goal(int(rng.choice(GOAL_FACES)))

    def face_of(self, goal: NDArray[Any]) -> int:
        """The face, 1 to 6, that a goal (7,) wants uppermost on a level palm."""
        return int(self.die.uppermost(np.asarray(goal[3:], np.float64), OUT_OF_PALM))

    def mirrored(self) -> DieTask:
        """The same for the other hand, whose thumb is on the other side."""
        (ux, uy, uz), (x, y, z) = self.up, self.start_position
        hand = Hand.LEFT if self.hand is Hand.RIGHT else Hand.RIGHT
        up, start = (ux, -uy, uz), (x, -y, z)
        return replace(self, name=TASK_OF[hand], up=up, start_position=start, hand=hand)

    def _offset(self, state: Array) -> tuple[Array, Array, Array]:
        """From the start position (...), m: sidewards, up, and towards the fingertips."""
        position, (ux, uy, _) = self.achieved(state), self.up
        x, y, z = (position[..., i] - start for i, start in enumerate(self.start_position))
        return ux * y - uy * x, ux * x + uy * y, z

    def _below(self, pose: Array) -> Array:
        ux, uy, uz = self.up
        return ux * pose[..., 0] + uy * pose[..., 1] + uz * pose[..., 2] < self.drop_height_m

    def _uppermost(self, q: Array) -> Array:
        """Index (...) of the face that looks most upwards."""
        xp, seen = namespace(q), _seen(q, self.up)
        return xp.argmax(xp.concat([seen, -seen], axis=-1), axis=-1)


def _seen(q: Array, direction: Vector) -> Array:
    """A direction of the palm's frame as dice with rotations `q` (..., 4) see it: (..., 3)."""
    xp = namespace(q)
    same = xp.stack([xp.full_like(q[..., 0], share) for share in direction], axis=-1)
    return geometry.rotate(geometry.conjugate(geometry.normalise(q)), same)
