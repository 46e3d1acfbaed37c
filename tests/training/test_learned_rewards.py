"""Learned rewards in training: every environment has a copy of the same one."""

import os

import numpy as np
import pandas as pd
import pytest
from safetensors.numpy import load_file

from autonerf_lab.training.checkpoint import CHECKPOINT
from autonerf_lab.training.settings import PolicySettings
from autonerf_lab.training.train import train_policy


class RandomStart:
    """A constant reward that every process draws for itself, unless it gets the state of another."""

    def __init__(self):
        self.value = np.frombuffer(os.urandom(2), np.uint16).astype(np.float64)

    def __call__(self, transition):
        return float(self.value[0])

    def collect(self):
        return {"nothing": np.zeros(1)}

    def update(self, batch):
        return {}

    def state_dict(self):
        return {"value": self.value.copy()}

    def load_state_dict(self, state):
        self.value = state["value"]


def test_all_environments_begin_with_the_same_learned_reward(tmp_path):
    """The first checkpoint holds it, so that an interrupted training resumes with the same one."""
    settings = PolicySettings(
        frames=48, demonstrations=0, environments=2, episode=2, rollout=2, epochs=1, batch=4, sensor=16
    )
    train_policy("modular-random", tmp_path, settings, RandomStart, workers=2, progress=False)
    value = load_file(tmp_path / CHECKPOINT)["reward/value"][0]
    curve = pd.read_csv(tmp_path / "curve.csv")
    assert curve["reward"][0] == pytest.approx(value * curve["frames"][0] / settings.environments, rel=1e-6)
