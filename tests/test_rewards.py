import numpy as np
import pytest

from autonerf_lab.errors import UnknownNameError
from autonerf_lab.rewards import REWARDS, make_reward
from autonerf_lab.rewards.conformance import blank_transition, check_reward

CHANNEL = {"cov": "explored", "obs": "occupied", "sem": "semantics", "view": "viewpoints"}


@pytest.mark.parametrize("name", REWARDS)
def test_every_reward_conforms(name):
    check_reward(REWARDS[name])
    assert REWARDS[name].__doc__ and "square metres" in REWARDS[name].__doc__


@pytest.mark.parametrize("name", REWARDS)
def test_a_reward_is_the_growth_of_its_channel_and_of_no_other(name):
    step = blank_transition(cell=0.05)
    for channel in CHANNEL.values():
        if channel != CHANNEL[name]:
            getattr(step.after, channel)[:] = True
    assert REWARDS[name](step) == 0
    mine = getattr(step.after, CHANNEL[name])
    mine.reshape(-1)[:20] = True
    getattr(step.before, CHANNEL[name]).reshape(-1)[:8] = True
    assert REWARDS[name](step) == pytest.approx(12 * 0.05**2)


def test_conformance_notices_what_is_wrong():
    def changes(step):
        step.after.explored[:] = True
        return 0.0

    class Counts:
        total = 0.0

        def __call__(self, step):
            self.total += 1.0
            return self.total

    for bad, message in (
        (lambda step: 1, "must be a float, not int"),
        (lambda step: np.inf, "finite"),
        (changes, "must not change"),
        (Counts(), "same reward"),
    ):
        with pytest.raises(AssertionError, match=message):
            check_reward(bad)


def test_rewards_are_found_by_name_or_passed():
    assert make_reward("obs") is REWARDS["obs"]
    assert make_reward(len) is len
    with pytest.raises(UnknownNameError, match="valid names: cov, obs, sem, view"):
        make_reward("coverage")
