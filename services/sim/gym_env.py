"""`DexHandDie-v0`: the digital twin with the die as a goal-conditioned Gymnasium environment.

`gymnasium.make("services.sim.gym_env:DexHandDie-v0")` registers and makes it; `faces` names the faces that
episodes ask for. It renders with MuJoCo, which needs `MUJOCO_GL=egl`
or `osmesa` where there is no screen.
"""

from __future__ import annotations

import os
from typing import Any, ClassVar

import gymnasium
import mujoco as compiled_mujoco
import numpy as np
from gymnasium import spaces
from numpy.typing import ArrayLike, NDArray

from common.die import FACES
from common.task.die import GOAL_FACES, DieTask
from services.sim.dexhand_twin import DexHandTwin

mujoco: Any = compiled_mujoco  # its names come from compiled modules without type stubs

ENV_ID = "DexHandDie-v0"
EPISODE_STEPS = 50
RATE_HZ = 3
SEEDS = 2**31
# From above the wrist and the thumb, metres and degrees, world frame.
_LOOK_AT = (0.15, 0.0, 0.2)
_DISTANCE, _AZIMUTH, _ELEVATION = 0.42, 35.0, -35.0

Observation = dict[str, NDArray[np.float64]]


class DexHandDieEnv(gymnasium.Env[Any, NDArray[np.float32]]):
    """State (24,), achieved and desired pose (7,); action (12,) in [-1, 1] at 3 Hz; reward as in Eq. (2).

    An episode ends when the die is dropped, with 2 less, or is cut off after 50 steps.
    """

    metadata: ClassVar[dict[str, Any]] = {"render_modes": ["rgb_array"], "render_fps": RATE_HZ}  # pyright: ignore[reportIncompatibleVariableOverride]

    def __init__(
        self,
        render_mode: str | None = None,
        faces: tuple[int, ...] = GOAL_FACES,
        hand: str = "right",
        size: tuple[int, int] = (480, 480),
    ) -> None:
        """`faces` are those that goals ask for; `size` is the picture's height and width."""
        if render_mode not in (None, *self.metadata["render_modes"]):
            raise ValueError(f"no render mode {render_mode!r}; there is rgb_array")
        if not faces or not set(faces) <= set(range(1, FACES + 1)):
            raise ValueError(f"faces must be some of 1 to {FACES}, got {faces}")
        self.render_mode = render_mode
        self._faces = faces
        self._twin = DexHandTwin(hand, rate_hz=RATE_HZ)
        self._size = size
        self._renderer: Any = None
        self.action_space = spaces.Box(-1.0, 1.0, (self._twin.task.action_dim,), np.float32)
        self.observation_space = _observation_space(self._twin.task)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Begin an episode; `options` may hold a `face`, 1 to 6, or a `goal` (7,)."""
        super().reset(seed=seed)
        wishes = options or {}
        face = wishes.get("face", self.np_random.choice(self._faces))
        goal = wishes.get("goal", self._twin.task.goal(int(face)))
        self._twin.reset(int(self.np_random.integers(SEEDS)), goal)
        return self._observation(), self._info()

    def step(self, action: NDArray[np.float32]) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """One control step of a third of a second."""
        self._twin.step(action)
        observation = self._observation()
        reward = self.compute_reward(observation["achieved_goal"], observation["desired_goal"], {})
        return observation, float(reward), not self._twin.holding, False, self._info()

    def compute_reward(
        self, achieved_goal: ArrayLike, desired_goal: ArrayLike, info: Any
    ) -> NDArray[np.float64]:
        """Eq. (2) of poses (..., 7), for learners that pretend another goal; `info` is not looked at."""
        del info
        achieved, desired = np.asarray(achieved_goal), np.asarray(desired_goal)
        return np.asarray(self._twin.task.compute_reward(achieved, desired))

    def render(self) -> NDArray[np.uint8] | None:  # pyright: ignore[reportIncompatibleMethodOverride]
        """A picture (H, W, 3) of hand and die."""
        if self.render_mode is None:
            return None
        if self._renderer is None:
            self._renderer = _renderer(self._twin.model, self._size)
        camera = mujoco.MjvCamera()
        camera.lookat[:] = _LOOK_AT
        camera.distance, camera.azimuth, camera.elevation = _DISTANCE, _AZIMUTH, _ELEVATION
        self._renderer.update_scene(self._twin.data, camera)
        return self._renderer.render()

    def close(self) -> None:
        """Give the renderer back."""
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None

    def _observation(self) -> Observation:
        state = self._twin.state
        return {
            "observation": state,
            "achieved_goal": self._twin.task.achieved(state).copy(),
            "desired_goal": self._twin.goal,
        }

    def _info(self) -> dict[str, Any]:
        state, goal, task = self._twin.state, self._twin.goal, self._twin.task
        numbers = {name: float(value) for name, value in task.errors(state, goal).items()}
        verdicts = {name: bool(value) for name, value in task.successes(state, goal).items()}
        return {**numbers, **verdicts, "is_success": verdicts["success_paper"]}


def _observation_space(task: DieTask) -> spaces.Dict:
    """Bounds of every part, those within which a state is plausible."""
    ends = [
        (-1.0, 1.0) if group.kind == "quaternion" else (group.low, group.high)
        for group in task.groups
        for _ in range(group.start, group.stop)
    ]
    low, high = np.array(ends).T
    state = spaces.Box(low, high, dtype=np.float64)
    pose = spaces.Box(low[-task.goal_dim :], high[-task.goal_dim :], dtype=np.float64)
    return spaces.Dict({"observation": state, "achieved_goal": pose, "desired_goal": pose})


def _renderer(model: Any, size: tuple[int, int]) -> Any:
    """MuJoCo's renderer. Raises RuntimeError, in one line, where there is no OpenGL."""
    try:
        return mujoco.Renderer(model, *size)
    except Exception as error:  # each of MuJoCo's back ends has its own
        chosen = os.environ.get("MUJOCO_GL", "none")
        raise RuntimeError(
            f"no OpenGL to render with (MUJOCO_GL is {chosen}; try egl or osmesa): {error}"
        ) from None


gymnasium.register(ENV_ID, entry_point=f"{__name__}:DexHandDieEnv", max_episode_steps=EPISODE_STEPS)
