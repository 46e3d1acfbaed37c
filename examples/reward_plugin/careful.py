"""Reward with state: explored area with a penalty for collisions."""

from autonerf_lab.rewards import cov


class Careful:
    """Newly explored area minus a collision penalty, square metres: the penalty grows with each collision."""

    def __init__(self, penalty=0.1):
        self.penalty, self.collisions = penalty, 0

    def reset(self, rng):
        """Begin an episode."""
        self.collisions = 0

    def __call__(self, transition):
        """Return the reward of one step."""
        self.collisions += transition.observation.collided
        return cov(transition) - self.penalty * self.collisions * transition.observation.collided
