"""What a walk is rewarded for. One file a reward; this is the table of contents."""

from autonerf_lab.errors import UnknownNameError
from autonerf_lab.rewards.base import Reward
from autonerf_lab.rewards.cov import cov
from autonerf_lab.rewards.obs import obs
from autonerf_lab.rewards.sem import sem
from autonerf_lab.rewards.view import view

REWARDS: dict[str, Reward] = {
    "cov": cov,
    "obs": obs,
    "sem": sem,
    "view": view,
}


def make_reward(reward: str | Reward) -> Reward:
    """A reward by its name; anything that can be called is one already.

    Raises:
        UnknownNameError: lists the valid names.

    Example:
        >>> make_reward("cov") is cov
        True
    """
    if not isinstance(reward, str):
        return reward
    if reward not in REWARDS:
        raise UnknownNameError("reward", reward, REWARDS)
    return REWARDS[reward]


__all__ = ["REWARDS", "Reward", "cov", "make_reward", "obs", "sem", "view"]
