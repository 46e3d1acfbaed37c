"""Every episode in one of the eight symmetries of the square: an apartment and its mirror images make eight."""

from dataclasses import dataclass
from typing import Any

import gymnasium
import numpy as np

from autonerf_lab.policies.views import CompactView


@dataclass(frozen=True)
class Turn:
    """A symmetry of the square: rows and columns change places, or not; then columns run backwards, or rows do.

    Example:
        >>> turn = Turn.drawn(np.random.default_rng(0))
        >>> turn.back(turn.action(77))
        77
    """

    swap: bool = False
    flip_x: bool = False
    flip_y: bool = False

    @classmethod
    def drawn(cls, rng: np.random.Generator) -> "Turn":
        """One of the eight."""
        return cls(*(bool(bit) for bit in rng.integers(2, size=3)))

    def seen(self, seen: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        """What a :class:`~autonerf_lab.policies.views.CompactView` shows, or a batch of it, turned."""
        x, y = seen["heading"][..., 0], seen["heading"][..., 1]
        images = [seen["map"], seen["reach"]]
        if self.swap:
            images, (x, y) = [image.swapaxes(-1, -2) for image in images], (y, x)
        if self.flip_x:
            images, x = [image[..., ::-1] for image in images], -x
        if self.flip_y:
            images, y = [image[..., ::-1, :] for image in images], -y
        turned = [np.ascontiguousarray(image) for image in images]
        return {"map": turned[0], "reach": turned[1], "heading": np.stack([x, y], axis=-1).astype(np.float32)}

    def action(self, action: Any) -> Any:
        """The block, or the blocks, where they are in the turned frame."""
        row, col = divmod(action, CompactView.GRID)
        if self.swap:
            row, col = col, row
        return self._flipped(row, col)

    def back(self, action: Any) -> Any:
        """The block of the turned frame, where it is in the original one."""
        row, col = divmod(self._flipped(*divmod(action, CompactView.GRID)), CompactView.GRID)
        if self.swap:
            row, col = col, row
        return row * CompactView.GRID + col

    def _flipped(self, row: Any, col: Any) -> Any:
        last = CompactView.GRID - 1
        return (last - row if self.flip_y else row) * CompactView.GRID + (last - col if self.flip_x else col)


class Symmetry(gymnasium.Wrapper):
    """Turns what a :class:`~autonerf_lab.policies.views.CompactView` shows, and its actions back.

    The symmetry is drawn from the episode's seed.
    """

    def __init__(self, env: gymnasium.Env) -> None:
        super().__init__(env)
        self.turn = Turn()

    def reset(self, **options: Any) -> tuple[Any, dict[str, Any]]:
        """Begin an episode in another symmetry."""
        seen, info = self.env.reset(**options)
        self.turn = Turn.drawn(self.unwrapped.np_random)
        return self.turn.seen(seen), info

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Act in the turned frame."""
        seen, reward, terminated, truncated, info = self.env.step(self.turn.back(int(action)))
        return self.turn.seen(seen), float(reward), terminated, truncated, info
