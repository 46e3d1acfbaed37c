"""Every episode in one of the eight symmetries of the square: an apartment and its mirror images make eight."""

from typing import Any

import gymnasium
import numpy as np

from autonerf_lab.policies.views import CompactView


class Symmetry(gymnasium.Wrapper):
    """Turns and mirrors what a :class:`~autonerf_lab.policies.views.CompactView` shows, and its actions back.

    The symmetry is drawn from the episode's seed.
    """

    def __init__(self, env: gymnasium.Env) -> None:
        super().__init__(env)
        self._swap = self._flip_x = self._flip_y = False

    def reset(self, **options: Any) -> tuple[Any, dict[str, Any]]:
        """Begin an episode in another symmetry."""
        seen, info = self.env.reset(**options)
        self._swap, self._flip_x, self._flip_y = (bool(bit) for bit in self.unwrapped.np_random.integers(2, size=3))
        return self._turned(seen), info

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Act in the turned frame."""
        row, col = divmod(int(action), CompactView.GRID)
        if self._flip_y:
            row = CompactView.GRID - 1 - row
        if self._flip_x:
            col = CompactView.GRID - 1 - col
        if self._swap:
            row, col = col, row
        seen, reward, terminated, truncated, info = self.env.step(row * CompactView.GRID + col)
        return self._turned(seen), float(reward), terminated, truncated, info

    def _turned(self, seen: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        x, y = seen["heading"]
        images = [seen["map"], seen["reach"]]
        if self._swap:
            images, (x, y) = [image.swapaxes(1, 2) for image in images], (y, x)
        if self._flip_x:
            images, x = [image[:, :, ::-1] for image in images], -x
        if self._flip_y:
            images, y = [image[:, ::-1] for image in images], -y
        turned = [np.ascontiguousarray(image) for image in images]
        return {"map": turned[0], "reach": turned[1], "heading": np.array([x, y], np.float32)}
