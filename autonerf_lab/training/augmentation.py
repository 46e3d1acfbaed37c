"""Every episode in one of the eight symmetries of the square: an apartment and its mirror images make eight."""

from typing import Any

import gymnasium

from autonerf_lab.policies.symmetry import Turn


class Symmetry(gymnasium.Wrapper):
    """Turns what a :class:`~autonerf_lab.policies.interfaces.CompactView` shows, and its actions back.

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
