"""Features extractor for the stock policies of Stable-Baselines3."""

import gymnasium
import numpy as np
import pytest
import torch
from stable_baselines3 import PPO
from toy_scene import to_scene, two_rooms

import autonerf_lab  # noqa: F401 - registers the environments
from autonerf_lab.training.feature_extractor import MapFeaturesExtractor

OPTIONS = {"features_extractor_class": MapFeaturesExtractor}


def parameters(ppo: PPO) -> int:
    return sum(parameter.numel() for parameter in ppo.policy.parameters())


def test_parameters_of_the_default_environment():
    env = gymnasium.make("AutoNeRF/Explore-v0", scene=to_scene(two_rooms()))
    ppo = PPO("MultiInputPolicy", env, n_steps=64, policy_kwargs=OPTIONS, device="cpu")
    assert parameters(ppo) < 2_000_000
    default = PPO("MultiInputPolicy", env, n_steps=64, device="cpu")
    assert parameters(default) > 10_000_000


@pytest.mark.parametrize("name", ["Explore", "Waypoint", "Egocentric", "PointGoal"])
def test_64_steps_of_learning(name):
    sizes = {"max_steps": 20} | ({"window": 60} if name == "Explore" else {})
    env = gymnasium.make(f"AutoNeRF/{name}-v0", scene=to_scene(two_rooms()), size=16, rgb=False, **sizes)
    ppo = PPO(
        "MultiInputPolicy", env, n_steps=64, batch_size=32, n_epochs=1, policy_kwargs=OPTIONS, device="cpu", seed=0
    )
    before = [parameter.detach().clone() for parameter in ppo.policy.parameters()]
    ppo.learn(64)
    after = list(ppo.policy.parameters())
    assert all(torch.isfinite(parameter).all() for parameter in after)
    assert any(not torch.equal(a, b) for a, b in zip(before, after, strict=True))
    assert parameters(ppo) < 2_000_000
    obs, _ = env.reset(seed=0)
    assert np.asarray(ppo.predict(obs)[0]).shape == env.action_space.shape
