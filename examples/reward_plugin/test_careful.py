from dataclasses import replace

import pytest
from careful import Careful

from autonerf_lab.rewards.conformance import blank_transition, check_reward


def test_it_conforms():
    check_reward(Careful)


def test_the_second_bump_costs_twice_as_much():
    step = blank_transition(cell=0.5)
    step.after.explored[0, :2] = True  # two cells of a quarter of a square metre
    bump = replace(step, observation=replace(step.observation, collided=True))
    reward = Careful(price=0.1)
    assert [reward(s) for s in (step, bump, step, bump)] == pytest.approx([0.5, 0.4, 0.5, 0.3])
