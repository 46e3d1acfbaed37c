"""Imitation of frontier exploration: which decisions are recorded, how a waypoint is encoded, what is learned."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from safetensors.numpy import load_file

from autonerf_lab.envs.explore import ExploreEnv
from autonerf_lab.policies.interfaces import CompactInterface
from autonerf_lab.policies.spec import make_network
from autonerf_lab.policies.weights import read_meta
from autonerf_lab.training import imitation, train
from autonerf_lab.training.settings import settings_of

SMALL = settings_of("modular-cov", demonstrations=6, environments=2, episode=20, rollout=20, sensor=32)


class Recording(CompactInterface):
    """Interface that records the distances from the robot to the encoded waypoints."""

    def __init__(self):
        super().__init__()
        self.distances = []

    def to_action(self, point, map):
        self.distances.append(np.linalg.norm(map.pose[:2, 3] - point))
        return super().to_action(point, map)


def test_the_teacher_is_not_imitated_while_it_looks_around_at_its_waypoint():
    """It does in a quarter of the decisions of this episode; no action of the interface stands for a turn."""
    interface = Recording()
    decisions = imitation.demonstrate(interface, replace(SMALL, demonstrations=1), "cov")
    assert min(interface.distances) >= interface.arrival and len(decisions) >= 10


def test_demonstrations_are_in_the_scenes_of_the_training(monkeypatch, tmp_path):
    scenes = []

    class Env(ExploreEnv):
        def __init__(self, **options):
            scenes.append(options["scene"])
            super().__init__(**options)

    monkeypatch.setattr(imitation, "ExploreEnv", Env)
    short = replace(SMALL, frames=0, demonstrations=1, environments=1, batch=20)
    train.train_policy("modular-cov", tmp_path, short, workers=1, progress=False, scenes=["dev-0"])
    assert scenes == [["dev-0"]]


def test_imitation_learns_actions_and_values_of_frontier(monkeypatch):
    monkeypatch.setattr(imitation, "EPOCHS", 10)  # for a small number of decisions
    monkeypatch.setattr(imitation, "BATCH", 8)
    interface, network = make_network(SMALL.network)
    decisions = imitation.demonstrate(interface, SMALL, "cov")
    assert decisions.returns[0] > 3 * decisions.returns[-1]  # most is found early in an episode
    seen = {name: torch.from_numpy(values) for name, values in decisions.observations.items()}
    actions = torch.from_numpy(decisions.actions)
    assert (seen["reach"][:, 0].flatten(1).gather(1, actions[:, None]) > 0).all()  # all actions are reachable
    assert not seen["reach"][:, 5].any()

    def judge():
        with torch.no_grad():
            chances, value = network(seen)
        error = ((value - torch.from_numpy(decisions.returns)) ** 2).mean().item()
        return chances.log_prob(actions).mean().item(), error

    chance, error = judge()
    imitation.imitate(network, decisions, SMALL)
    chance_after, error_after = judge()
    assert chance_after > chance + 0.5
    assert error_after < 0.5 * error


@pytest.mark.parametrize("kind", [{"kind": "compact"}, {"kind": "paper", "window": 48}])
def test_encoding_and_decoding_of_a_waypoint(kind):
    interface, _ = make_network(kind)
    env = ExploreEnv(scene="train-00", size=32, rgb=False, max_steps=30, window=round(12 / interface.cell))
    env.reset(seed=1)
    for action in [0, 1] * 15:
        env.step(np.int64(action))
    x, y = env.map.pose[:2, 3]
    point = np.array([x + 0.3, y - 0.2])
    again = interface.to_waypoint(interface.to_action(point, env.map), env.map)
    np.testing.assert_allclose(again, point, atol=0.5)
    np.testing.assert_allclose(interface.to_waypoint(interface.to_action(again, env.map), env.map), again, atol=1e-5)
    if kind["kind"] == "compact":
        assert interface.to_action(np.array([x + 40.0, y]), env.map) is None


def test_imitation_alone_trains_and_has_no_frames(tmp_path):
    settings = replace(SMALL, demonstrations=1, episode=2, rollout=2, batch=4, sensor=16, frames=0)
    path = train.train_policy("modular-cov", tmp_path, settings, workers=1, progress=False)
    meta = read_meta(path)
    assert meta["frames"] == 0 and meta["curve"] == []
    assert load_file(f"{path}.safetensors")["score.weight"].any()  # zero before training
