"""The die in the DexHand 021: bring a given face up (Sec. II-B and Eq. (2) of the paper)."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from common import geometry
from common.dexhand021.tables import BOARDS, JOINTS
from common.die import DIE, Die
from common.geometry import Array, namespace
from common.task.layout import Group
from common.task.manipulate import ManipulateTask

# A joint pushed beyond its range, a blow on a fingertip, a die on the table below the hand: all within.
DIE_GROUPS = (
    Group("qpos", 0, 12, "rad", -1.0, 3.5),
    Group("tip_force", 12, 17, "N", -50.0, 100.0),
    Group("object_position", 17, 20, "m", -1.0, 1.0),
    Group("object_rotation", 20, 24, "1", 0.5, 1.5, "quaternion"),
)
TACTILE_FINGERS = tuple(board.name for board in BOARDS if board.has_tactile)
JOINT_NAMES = tuple(joint.name for joint in JOINTS)
GOAL_FACES = (2, 4, 5)

Vector = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]


@dataclass(frozen=True)
class DieTask(ManipulateTask):
    """State (24,): 12 joint angles, 5 fingertip normal forces, die position 3 and rotation 4; goal (7,): pose.

    Poses are those of the die in the palm's frame: +z to the fingertips, +x out of the palm, +y to the
    thumb of a right hand. `up` is where the world's up is in that frame; the hand has no wrist to change it.
    `start_position` (3,) and `start_rotation` (4,) are the fixed initial pose: 1 up, 2 to the fingertips.
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
    up: Vector = (1.0, 0.0, 0.0)
    start_position: Vector = (0.0555, -0.018, 0.138)
    start_rotation: Quaternion = (0.5**0.5, 0.5**0.5, 0.0, 0.0)

    def dropped(self, state: Array) -> Array:
        """Whether the die's centre is lower than the palm's frame plus `drop_height_m`: bool (...)."""
        return self._below(self.achieved(state))

    def reward(self, state: Array, goal: Array) -> Array:
        """Eq. (2) of the state's pose, less the penalty where the die is dropped: (...)."""
        return self.pose_reward(self.achieved(state), goal)

    def env_reward(self, state: Array, goal: Array) -> Array:
        """The same (...): the real hand's environment has no other."""
        return self.reward(state, goal)

    def pose_reward(self, pose: Array, goal: Array) -> Array:
        """-(0.1·‖p - p*‖ + 2·arccos|⟨q, q*⟩|), p in m, and 2 less when dropped: (...) of poses (..., 7)."""
        xp = namespace(pose)
        distance = xp.linalg.vector_norm(pose[..., :3] - goal[..., :3], axis=-1)
        rotation = geometry.angle(pose[..., 3:], goal[..., 3:])
        penalty = xp.where(self._below(pose), self.drop_penalty, 0.0)
        return -(self.position_weight * distance + rotation) - penalty

    def errors(self, state: Array, goal: Array) -> dict[str, Array]:
        """Distance (m), shortest angle (rad), and how far the wanted face leans away (rad), each (...)."""
        xp = namespace(state)
        lean = xp.sum(self._seen_up(self._rotation(state)) * self._seen_up(goal[..., 3:]), axis=-1)
        return {
            "position_m": self._position_error(state, goal),
            "rotation_rad": geometry.angle(self._rotation(state), goal[..., 3:]),
            "lean_rad": xp.acos(xp.clip(lean, -1.0, 1.0)),
        }

    def successes(self, state: Array, goal: Array) -> dict[str, Array]:
        """bool (...) in the hand: the goal's face uppermost (`paper`), and within 0.5 rad of its pose (`env`).

        # Paper: success on the real hand is "faces 4, 5 and 2 upward" (Sec. IV-C) without a threshold.
        """
        held = ~self.dropped(state)
        wanted = self._uppermost(goal[..., 3:])
        return {
            "success_paper": held & (self._uppermost(self._rotation(state)) == wanted),
            "success_env": held & (self.errors(state, goal)["rotation_rad"] < self.paper_threshold_rad),
        }

    def goal(self, face: int) -> NDArray[np.float64]:
        """The paper's single target pose (7,) for a face: where the die starts, turned the short way."""
        rotation = self.die.face_up(face, self.up, self.start_rotation)
        return np.concatenate([self.start_position, rotation])

    def goals(self, face: int, yaws: int = 4) -> NDArray[np.float64]:
        """Target poses (yaws, 7) with the face up, evenly turned about the vertical; the first is `goal`."""
        rotations = self.die.faces_up(face, self.up, self.start_rotation, yaws)
        return np.concatenate([np.broadcast_to(self.start_position, (yaws, 3)), rotations], axis=1)

    def _below(self, pose: Array) -> Array:
        height = sum(axis * pose[..., i] for i, axis in enumerate(self.up))
        return height < self.drop_height_m

    def _seen_up(self, q: Array) -> Array:
        """The world's up (..., 3) in the frame of a die with rotation `q` (..., 4), palm frame."""
        xp = namespace(q)
        up = xp.broadcast_to(xp.asarray(self.up, dtype=q.dtype), (*q.shape[:-1], 3))
        if xp is not np:
            up = up.to(q.device)
        return geometry.rotate(geometry.conjugate(geometry.normalise(q)), up)

    def _uppermost(self, q: Array) -> Array:
        """Index (...) of the face that looks most upwards."""
        seen = self._seen_up(q)
        return namespace(q).argmax(namespace(q).concat([seen, -seen], axis=-1), axis=-1)
