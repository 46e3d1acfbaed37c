"""Data augmentation: each episode is transformed by a random symmetry of the square."""

from typing import Any

import gymnasium

from autonerf_lab.policies.symmetry import SquareSymmetry


class SymmetryAugmentation(gymnasium.Wrapper):
    """Wrapper that transforms compact observations by a symmetry and inverts it for the actions.

    The symmetry is sampled at every reset from the environment's random numbers.
    """

    def __init__(self, env: gymnasium.Env) -> None:
        super().__init__(env)
        self.symmetry = SquareSymmetry()

    def reset(self, **options: Any) -> tuple[Any, dict[str, Any]]:
        """Begin an episode with a new symmetry."""
        obs, info = self.env.reset(**options)
        self.symmetry = SquareSymmetry.sample(self.unwrapped.np_random)
        return self.symmetry.transform_observation(obs), info

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Apply an action of the transformed frame."""
        obs, reward, terminated, truncated, info = self.env.step(self.symmetry.invert_action(int(action)))
        return self.symmetry.transform_observation(obs), float(reward), terminated, truncated, info
