"""Every built-in reward passes the checks that a plug-in must pass."""

import pytest

from autonerf_lab.rewards import REWARDS, make_reward
from autonerf_lab.rewards.base import unit_of
from autonerf_lab.rewards.conformance import check_learned, check_reward

LEARNED = ("cur", "rec")


@pytest.mark.parametrize("name", REWARDS)
def test_every_reward_conforms(name):
    check_reward(REWARDS[name])
    unit = {"nov": "dimensionless", "cur": "standard deviations of its return", "rec": "nats"}
    assert unit_of(make_reward(name)) == unit.get(name, "square metres")


@pytest.mark.parametrize("name", [*LEARNED, "cov+0.5*cur+rec"])
def test_every_learned_reward_conforms(name):
    check_learned(lambda: make_reward(name))
