"""Explore, but do not bump into things: a reward that remembers."""

from autonerf_lab.rewards import cov


class Careful:
    """Newly explored area, less the harm of a bump, square metres: each bump of an episode costs more than the last."""

    def __init__(self, price=0.1):
        self.price, self.bumps = price, 0

    def reset(self, rng):
        self.bumps = 0

    def __call__(self, transition):
        self.bumps += transition.observation.collided
        return cov(transition) - self.price * self.bumps * transition.observation.collided
