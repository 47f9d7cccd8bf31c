"""One axis for all control steps: episodes behind each other, without gaps between them."""

from __future__ import annotations

from deploy.viewer.drawing import When


class StepCounter:
    """Numbers the steps of all episodes in the order in which the episodes were first heard of."""

    def __init__(self) -> None:
        self._plant: tuple[int, int] | None = None  # boot and episode
        self._base = 0
        self._newest = 0
        self._episode = 0

    def step(self, boot_id: int, episode: int, k: int) -> int | None:
        """Number of step k of a plant's episode; None for an episode that has been left behind."""
        if self._plant != (boot_id, episode):
            if self._plant is not None and self._plant[0] == boot_id and episode < self._plant[1]:
                return None
            self._base = 0 if self._plant is None else self._newest + 1
            self._plant = (boot_id, episode)
            self._episode = episode
        return self._base + k

    def planned(self, boot_id: int, episode: int, k: int) -> int | None:
        """The same for a plan; None also for one made for another plant than the last that was heard."""
        if self._plant is None or self._plant[0] != boot_id:
            return None
        return self.step(boot_id, episode, k)

    def advance(self, step: int) -> None:
        """Note that the plant has reached `step`; what is not tied to a step is drawn there."""
        self._newest = max(self._newest, step)

    def now(self, t_ns: int) -> When:
        """The newest step, at time `t_ns`."""
        return When(self._newest, t_ns, self._episode)
