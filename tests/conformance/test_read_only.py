"""Rewards and policies get arrays that cannot be written to, everywhere."""

from dataclasses import fields, is_dataclass

import gymnasium
import numpy as np
import pytest
from toy_scene import to_scene, two_rooms

from autonerf_lab.envs import ENVS
from autonerf_lab.errors import RewardError
from autonerf_lab.exploration import explore
from autonerf_lab.geometry import Intrinsics
from autonerf_lab.policies import RandomActions
from autonerf_lab.simulator import Simulator

MAPPING_ENVS = [name for name in ENVS if "PointGoal" not in name]


def writable(record):
    """Names of the arrays of a record, and of the records in it, that can be written to."""
    found = []
    for field in fields(record):
        value = getattr(record, field.name)
        if is_dataclass(value):
            found += [f"{field.name}.{name}" for name in writable(value)]
        elif isinstance(value, np.ndarray) and value.flags.writeable:
            found.append(field.name)
    return found


@pytest.mark.parametrize("name", MAPPING_ENVS)
def test_rewards_and_their_references(name):
    seen = []

    class Inspector:
        references = 2

        def set_references(self, observations):
            seen.extend(observations)

        def __call__(self, transition):
            seen.append(transition)
            return 0.0

    env = gymnasium.make(name, scene=to_scene(two_rooms()), reward=Inspector(), size=16)
    env.reset(seed=0)
    for _ in range(3):
        env.step(env.action_space.sample())
    assert len(seen) >= 2 + 3
    assert [writable(record) for record in (*seen, env.unwrapped.map)] == [[]] * (len(seen) + 1)


def test_an_attempt_names_the_reward_and_leaves_the_map():
    def eraser(transition):
        transition.after.explored[:] = False
        return 1.0

    env = gymnasium.make("AutoNeRF/Explore-v0", scene=to_scene(two_rooms()), reward=eraser, size=16)
    _, info = env.reset(seed=0)
    with pytest.raises(RewardError, match=r"reward 'eraser' failed at step 1: ValueError: .* read-only"):
        env.step(0)
    assert np.count_nonzero(env.unwrapped.map.explored) * env.unwrapped.map.cell**2 >= info["explored_m2"] > 0


def test_policies():
    seen = []

    class Inspector(RandomActions):
        def act(self, map, observation):
            seen.extend([map, observation])
            return super().act(map, observation)

    explore(Simulator(two_rooms(), Intrinsics.from_fov(16, 16)), Inspector(), steps=4, progress=False)
    assert [writable(record) for record in seen] == [[]] * 2 * 4
