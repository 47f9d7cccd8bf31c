"""The DexHand 021's digital twin: as a plant at the control rate, and as bare physics for a hand on a bus."""

from __future__ import annotations

import logging
from typing import Any

import mujoco as compiled_mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from common import geometry
from common.dexhand021 import angles
from common.dexhand021.config import DexHandConfig
from common.dexhand021.tables import HIGH_RAD, LOW_RAD, MOTORS, Hand
from common.task import DieTask, get_die_task
from common.task.die import OUT_OF_PALM, TASK_OF
from services.sim import dexhand_links as links
from services.sim.dexhand_model import PALM, build_model, mount_of, passive_ratios
from services.sim.dexhand_physics import TwinPhysics
from services.sim.dexhand_world import DIE
from services.sim.interface import Floats, PlantState, Snapshot

mujoco: Any = compiled_mujoco  # its names come from compiled modules without type stubs
log = logging.getLogger(__name__)

# Joints (12,) rad when a person lays the die into the hand: a cup, with room for the die between the fingers.
CUP_RAD = np.array([0.5, 0.4, 0.6, 0.1, 0.6, 0.5, 0.6, 0.5, 0.6, 0.5, 0.6, 0.5])
SETTLE_S = 0.6
# How exactly a person lays the die down: standard deviations of position and of the turn about the vertical.
PLACE_M, PLACE_RAD = 0.001, 0.03
LIFT_M = 0.002
GOAL_OFFSET_M = (0.0, 0.0, 0.13)  # the goal is shown above the die, not within it


class DexHandTwin:
    """One simulated hand with the die: same seed and actions, same states, bit for bit.

    Angles are (12,) rad in the order of common.dexhand021.tables.JOINTS. A state (24,) is what the real hand
    reports: joint angles, fingertip normal forces (N), the die's pose in the palm's frame.
    """

    def __init__(
        self,
        hand: str | Hand = Hand.RIGHT,
        seed: int = 0,
        *,
        rate_hz: float = 3.0,
        assumed: DexHandConfig | None = None,
        physics: TwinPhysics | None = None,
    ) -> None:
        """Build the model and reset it to `seed`; `assumed` tells what is not public about the hand."""
        assumed = (assumed or DexHandConfig()).model_copy(update={"hand": Hand(hand)})
        self.task: DieTask = get_die_task(TASK_OF[assumed.hand], assumed.hand)
        self.physics = physics or TwinPhysics()
        mujoco.set_mju_user_warning(log.warning)  # else they go to a file in the working directory
        self.model: Any = build_model(self.task, assumed, self.physics)
        self.data: Any = mujoco.MjData(self.model)
        self._step_s = 1.0 / rate_hz
        self._addresses = _Addresses(self.model)
        self._ratios = _passive_matrix(assumed)
        self._asked_s = 0.0  # until when time was to pass
        self._goal = np.zeros(self.task.goal_dim)
        self._state: Floats | None = None  # of the present moment, once somebody has asked
        self.reset(seed)

    # --- as a plant -------------------------------------------------------------------------------

    @property
    def goal(self) -> Floats:
        """The current goal (G,): the die's pose in the palm's frame."""
        return self._goal.copy()

    @property
    def state(self) -> Floats:
        """The state (S,) after the last reset, step, advance or restore."""
        if self._state is None:
            self._state = np.concatenate([self.joint_angles_rad, self.fingertip_forces_n, *self.die_pose()])
        return self._state.copy()

    def reset(self, seed: int, goal: ArrayLike | None = None) -> PlantState:
        """Lay the die into the cupped hand and let it rest; pursue a face, or `goal` (G,) if given."""
        own, rng = self._drawn(seed)
        mujoco.mj_resetData(self.model, self.data)
        self._asked_s = 0.0
        self.set_powered(np.ones(MOTORS, np.bool_))
        self.data.qpos[self._addresses.joints] = CUP_RAD
        self.data.qpos[self._addresses.passive] = self._ratios @ CUP_RAD
        self.place_die(*self._laid(rng))
        self.set_targets(CUP_RAD)
        self.advance(SETTLE_S)
        self.data.time = self._asked_s = 0.0
        self.set_goal(own if goal is None else goal)
        return PlantState(self.state, self.goal)

    def step(self, action: ArrayLike) -> Floats:
        """Move towards `action` (A,), clipped to [-1, 1], for one control step; the state (S,) after it.

        Set points go there on a straight way at `set_point_hz`, no faster than `rate_rad_s`, as hand_io
        sends them. Raises ValueError for another shape or non-finite values; nothing has moved then.
        """
        command = np.array(action, dtype=np.float64)
        if command.shape != (MOTORS,) or not np.isfinite(command).all():
            raise ValueError(f"action must be {MOTORS} finite numbers, got {command}")
        begin = self.targets_rad
        reach = self.physics.rate_rad_s * self._step_s
        wanted = angles.to_radians(np.clip(command, -1.0, 1.0))
        end = np.clip(wanted, begin - reach, begin + reach)
        points = max(1, round(self.physics.set_point_hz * self._step_s))
        ends_s = self._step_s * np.arange(points + 1) / points
        substeps = np.diff(np.rint(ends_s / self.physics.timestep_s)).astype(int)
        for number, count in enumerate(substeps, start=1):
            self.set_targets(begin + (end - begin) * (number / points))
            mujoco.mj_step(self.model, self.data, int(count))
        self._asked_s = self.data.time
        self._observe()
        return self.state

    def set_goal(self, goal: ArrayLike) -> None:
        """Pursue `goal` (G,) from now on. Raises ValueError if it has another shape or is not finite."""
        wanted = np.array(goal, dtype=np.float64)
        if wanted.shape != (self.task.goal_dim,) or not np.isfinite(wanted).all():
            raise ValueError(f"goal must be {self.task.goal_dim} finite numbers, got {wanted}")
        self._goal = wanted

    def sample_goal(self, seed: int) -> Floats:
        """The goal (G,) that `reset(seed)` would set; the running episode is not disturbed."""
        return self._drawn(seed)[0]

    def save(self) -> Snapshot:
        """Everything needed to continue exactly from here."""
        physics = np.empty(mujoco.mj_stateSize(self.model, mujoco.mjtState.mjSTATE_INTEGRATION))
        mujoco.mj_getState(self.model, self.data, physics, mujoco.mjtState.mjSTATE_INTEGRATION)
        powered = self.powered.astype(np.float64)
        return Snapshot(np.concatenate([physics, powered]), PlantState(self.state, self.goal))

    def restore(self, snapshot: Snapshot) -> PlantState:
        """Continue exactly from `snapshot`; what was observed then is observed again."""
        physics, powered = snapshot.physics[:-MOTORS], snapshot.physics[-MOTORS:]
        self.set_powered(powered > 0.0)
        mujoco.mj_setState(self.model, self.data, physics, mujoco.mjtState.mjSTATE_INTEGRATION)
        mujoco.mj_forward(self.model, self.data)
        # What mj_forward derives is wanted, but not the solver's warm start that it leaves.
        mujoco.mj_setState(self.model, self.data, physics, mujoco.mjtState.mjSTATE_INTEGRATION)
        self._asked_s = self.data.time
        self._goal = snapshot.observed.goal.copy()
        self._state = snapshot.observed.state.copy()
        return snapshot.observed

    def qpos(self, state: Floats) -> Floats:
        """The model's coordinates (nq,) that a state (24,) describes; passive joints follow their motors."""
        joints = state[self.task.group("qpos").slice]
        qpos = np.zeros(self.model.nq)
        qpos[self._addresses.joints] = joints
        qpos[self._addresses.passive] = self._ratios @ joints
        position, rotation = self._in_world(self.task.achieved(state))
        qpos[self._addresses.die] = np.concatenate([position, rotation])
        return qpos

    def bodies(self) -> tuple[tuple[str, ...], Floats, Floats]:
        """Names (n), positions (n, 3) m, quaternions wxyz (n, 4): links, die and goal, world frame."""
        shown = self._addresses.shown
        position, rotation = self._in_world(self._goal)
        position = position + GOAL_OFFSET_M
        return (
            (*(self.model.body(i).name for i in shown), "goal"),
            np.concatenate([self.data.xpos[shown], position[None]]),
            np.concatenate([self.data.xquat[shown], rotation[None]]),
        )

    # --- as bare physics --------------------------------------------------------------------------

    @property
    def targets_rad(self) -> Floats:
        """The motors' present set points (12,)."""
        return self.data.ctrl.copy()

    def set_targets(self, position_rad: ArrayLike) -> None:
        """Give the motors new set points (12,), cut to their range; NaN leaves a motor's as it is."""
        wanted = np.asarray(position_rad, np.float64)
        self.data.ctrl[:] = np.clip(np.where(np.isnan(wanted), self.data.ctrl, wanted), LOW_RAD, HIGH_RAD)

    @property
    def powered(self) -> NDArray[np.bool_]:
        """Which motors (12,) follow their set points."""
        return (self.model.opt.disableactuator >> np.arange(MOTORS)) & 1 == 0

    def set_powered(self, powered: ArrayLike) -> None:
        """Switch motors (12,) on and off; without power a joint is free but for its friction."""
        off = ~np.asarray(powered, np.bool_)
        self.model.opt.disableactuator = int(np.sum(off << np.arange(MOTORS)))

    def advance(self, seconds: float) -> None:
        """Let time pass under the present set points; what whole physics steps leave over comes next."""
        self._asked_s += seconds
        steps = round((self._asked_s - self.data.time) / self.physics.timestep_s)
        mujoco.mj_step(self.model, self.data, max(steps, 0))
        self._observe()

    @property
    def joint_angles_rad(self) -> Floats:
        """Angles (12,) of the joints that the motors turn; of a finger's coupled pair, the PIP."""
        return self.data.qpos[self._addresses.joints]

    @property
    def joint_velocities_rad_s(self) -> Floats:
        """Their velocities (12,)."""
        return self.data.qvel[self._addresses.velocities]

    @property
    def passive(self) -> Floats:
        """Angles (7,), rad, of `dexhand_links.PASSIVE_JOINTS`: five DIP, ring and little finger's spread."""
        return self.data.qpos[self._addresses.passive]

    @property
    def motor_currents_ma(self) -> Floats:
        """Currents (12,), proportional to the motors' torques."""
        return self.physics.current_ma_nm * self.data.actuator_force

    @property
    def fingertip_forces_n(self) -> Floats:
        """Normal forces (5,) on the pads of thumb, index, middle, ring and little finger."""
        return self.data.sensordata.copy()

    def die_pose(self) -> tuple[Floats, Floats]:
        """Position (3,), m, and rotation (4,), wxyz, of the die in the palm's frame."""
        palm, pose = self._addresses.palm, self.data.qpos[self._addresses.die]
        inverse = geometry.conjugate(self.data.xquat[palm])
        return (
            geometry.rotate(inverse, pose[:3] - self.data.xpos[palm]),
            geometry.multiply(inverse, geometry.normalise(pose[3:])),
        )

    def place_die(self, position_m: ArrayLike, rotation: ArrayLike) -> None:
        """Put the resting die at a pose (3,), (4,) in the palm's frame."""
        position, turned = self._in_world(np.concatenate([position_m, rotation], dtype=np.float64))
        self.data.qpos[self._addresses.die] = np.concatenate([position, turned])
        self.data.qvel[self._addresses.die_velocity] = 0.0
        self._observe()

    @property
    def holding(self) -> bool:
        """Whether the die is still in the hand."""
        return not bool(self.task.dropped(self.state))

    # --- within -----------------------------------------------------------------------------------

    def _observe(self) -> None:
        """Derive all that is read."""
        mujoco.mj_forward(self.model, self.data)
        self._state = None

    def _drawn(self, seed: int) -> tuple[Floats, np.random.Generator]:
        """The goal (G,) of an episode, and the generator for the rest of it."""
        rng = np.random.default_rng(seed)
        return self.task.draw_goal(rng), rng

    def _laid(self, rng: np.random.Generator) -> tuple[Floats, Floats]:
        """A pose near the task's initial one, a little above it: position (3,) and rotation (4,)."""
        offset = np.array([LIFT_M, *rng.normal(0.0, PLACE_M, 2)])
        turn = geometry.from_axis_angle(np.array(OUT_OF_PALM), rng.normal(0.0, PLACE_RAD, 1)[0])
        return self.task.start_position + offset, geometry.multiply(turn, np.array(self.task.start_rotation))

    def _in_world(self, pose: Floats) -> tuple[Floats, Floats]:
        mount = mount_of(self.task)
        height = np.array([0.0, 0.0, self.physics.table_m])
        position = geometry.rotate(mount, pose[:3]) + height
        return position, geometry.multiply(mount, pose[3:])


class _Addresses:
    """Where MuJoCo's arrays hold what the twin reads."""

    def __init__(self, model: Any) -> None:
        motors = [model.joint(name) for name in links.MOTOR_JOINTS]
        die = model.joint(DIE)
        first, first_velocity = int(die.qposadr[0]), int(die.dofadr[0])
        self.joints = np.array([joint.qposadr[0] for joint in motors])
        self.velocities = np.array([joint.dofadr[0] for joint in motors])
        self.passive = np.array([model.joint(name).qposadr[0] for name in links.PASSIVE_JOINTS])
        self.die = slice(first, first + 7)
        self.die_velocity = slice(first_velocity, first_velocity + 6)
        self.palm = int(model.body(PALM).id)
        self.shown = np.arange(1, model.nbody)


def _passive_matrix(assumed: DexHandConfig) -> Floats:
    """Passive angles per motor angle: (7, 12)."""
    matrix = np.zeros((len(links.PASSIVE_JOINTS), MOTORS))
    ratios = passive_ratios(assumed)
    for row, name in enumerate(links.PASSIVE_JOINTS):
        leader, ratio = ratios[name]
        matrix[row, links.MOTOR_JOINTS.index(leader)] = ratio
    return matrix
