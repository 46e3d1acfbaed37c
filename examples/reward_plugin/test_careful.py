from dataclasses import replace

import pytest
from careful import Careful

from autonerf_lab.rewards.conformance import blank_transition, check_reward


def test_conformance():
    check_reward(Careful)


def test_the_second_collision_costs_twice_as_much():
    step = blank_transition(cell=0.5)
    step.after.explored[0, :2] = True  # two cells of 0.25 m²
    collision = replace(step, observation=replace(step.observation, collided=True))
    reward = Careful(penalty=0.1)
    assert [reward(s) for s in (step, collision, step, collision)] == pytest.approx([0.5, 0.4, 0.5, 0.3])
