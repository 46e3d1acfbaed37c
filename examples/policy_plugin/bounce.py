"""Exploration policy that moves straight ahead and turns by a random angle after a collision."""

from autonerf_lab.types import Action


class Bounce:
    """Move forward; after a collision turn left or right by 30 to 180 degrees."""

    waypoint = None

    def reset(self, rng):
        """Begin an episode."""
        self.rng, self.turns, self.action = rng, 0, Action.TURN_LEFT

    def act(self, map, observation):
        """Return the next action."""
        if observation.collided and not self.turns:
            self.turns = int(self.rng.integers(1, 7))
            self.action = (Action.TURN_LEFT, Action.TURN_RIGHT)[self.rng.integers(2)]
        if self.turns:
            self.turns -= 1
            return self.action
        return Action.FORWARD
