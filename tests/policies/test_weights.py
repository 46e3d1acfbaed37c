"""Weights of the package: complete metadata, inputs and outputs as stored beside them, and behaviour."""

import json
from dataclasses import asdict, fields

import numpy as np
import pytest
import torch
from noise import fill_with_noise
from safetensors.numpy import load_file

from autonerf_lab.evaluators.exploration import summed_rewards
from autonerf_lab.evaluators.goal_policy import load_goal_policy, reach_goals
from autonerf_lab.exploration import explore
from autonerf_lab.geometry import Intrinsics
from autonerf_lab.policies import WEIGHTS, load_policy, make_policy, weights_path
from autonerf_lab.policies.end_to_end import EndToEnd
from autonerf_lab.policies.modular import Modular
from autonerf_lab.policies.spec import make_network
from autonerf_lab.policies.weights import load_weights, read_meta
from autonerf_lab.scenes import load_scene
from autonerf_lab.simulator import Simulator
from autonerf_lab.training.probe import Probe, probe
from autonerf_lab.training.settings import PolicySettings, settings_of
from autonerf_lab.training.train import make_env

EXPLORING = sorted(WEIGHTS.glob("*.safetensors"))
ALL = sorted(WEIGHTS.rglob("*.safetensors"))


def new_probe(path, replace_by_noise: bool) -> Probe:
    """Probe the network that today's code makes of stored weights, or of noise of the same size."""
    meta = read_meta(path)
    network = make_network(meta["network"])[1]
    load_weights(path, network)
    if replace_by_noise:
        fill_with_noise(network)
    names = {field.name for field in fields(PolicySettings)}
    settings = PolicySettings(**{name: value for name, value in meta["settings"].items() if name in names})
    return probe(network, lambda: make_env(settings, meta["policy"].partition("-")[2]))


def agree(stored: Probe, found: Probe, outputs: bool) -> bool:
    """Compare the outputs of two probes, or their inputs."""
    pairs = [
        (row[name], other[name])
        for row, other in zip(stored, found, strict=True)
        for name in row
        if (name in ("entropy", "value")) == outputs
    ]
    assert pairs and [*stored[0]] == [*found[0]]
    tolerance = {"rtol": 0.01, "atol": 0.01} if outputs else {"rtol": 0.002, "atol": 2e-4}
    return bool(np.allclose(*zip(*pairs, strict=True), **tolerance))


@pytest.mark.parametrize("path", ALL, ids=lambda path: path.stem)
def test_weights_meet_the_inputs_that_they_were_trained_with_and_noise_in_their_place_is_noticed(path):
    """If a change of maps, interfaces or the simulator is intended, train the weights again."""
    stored, found = read_meta(path)["probe"], new_probe(path, replace_by_noise=False)
    assert agree(stored, found, outputs=False), "code that the inputs of the network depend on has changed"
    assert agree(stored, found, outputs=True), "these are other weights"
    assert not agree(stored, new_probe(path, replace_by_noise=True), outputs=True)


@pytest.mark.parametrize("path", ALL, ids=lambda path: path.stem)
def test_built_in_weights_are_small_and_have_complete_metadata(path):
    assert path.stat().st_size <= 5e6
    meta = read_meta(path)
    assert meta["command"].startswith(f"autonerf-lab train-policy --policy {meta['policy']} --frames ")
    assert meta["frames"] >= 500_000 and meta["hours"] > 0 and meta["seed"] is not None
    assert all(row["frames"] > 0 and np.isfinite(row["reward"]) for row in meta["curve"])
    today = asdict(settings_of(meta["policy"], frames=meta["settings"]["frames"], seed=meta["seed"]))  # as they are now
    assert f" --frames {today['frames']} " in meta["command"] and today["frames"] <= meta["frames"]
    assert json.loads(json.dumps(today)) == {name: meta["settings"][name] for name in today}
    assert any(np.abs(array.astype(np.float32)).max() > 0 for array in load_file(path).values())
    if path in EXPLORING:
        assert meta["policy"] == path.stem
        assert isinstance(make_policy(path.stem), EndToEnd if path.stem.startswith("e2e-") else Modular)


@pytest.mark.parametrize("reward", ["cov", "obs", "sem", "view"])
def test_modular_weights_collect_more_of_their_reward_than_the_untrained_network(reward):
    """Sums of 250 steps from two starts in one apartment are 1.15, 1.21, 1.25 and 1.07 times as large."""
    sim = Simulator(load_scene("dev-0"), Intrinsics.from_fov(84, 84), supersample=1, rgb=False)
    name = f"modular-{reward}"
    torch.manual_seed(0)
    sums = [
        sum(summed_rewards(explore(sim, policy, 250, seed, progress=False))[reward] for seed in range(2))
        for policy in (make_policy(name), load_policy(weights_path(name), trained=False))
    ]
    assert sums[0] > 1.05 * sums[1]


@pytest.mark.parametrize("reward", ["cov", "cur", "nov", "rec"])
def test_end_to_end_weights_explore_more_than_the_untrained_network(reward):
    """Sums of the areas explored in 200 steps from two starts in one apartment: 163, 130, 156, 141; untrained 91 m²."""
    sim = Simulator(load_scene("dev-0"), Intrinsics.from_fov(84, 84), supersample=1)
    name = f"e2e-{reward}"
    torch.manual_seed(0)
    areas = [
        sum(explore(sim, policy, 200, seed, progress=False).meta["explored_m2"][-1] for seed in range(2))
        for policy in (make_policy(name), load_policy(weights_path(name), trained=False))
    ]
    assert areas[0] > 1.4 * areas[1]


def test_pointgoal_weights_reach_their_goals():
    """They reach 20 of 20 goals, a network before its training none."""
    scene = load_scene("dev-0")
    path = WEIGHTS / "pointgoal/pretrained.safetensors"
    untrained = make_network(read_meta(path)["network"])[1]
    reached = [
        sum(end["success"] for end in reach_goals(net, scene, 20)) for net in (load_goal_policy(path), untrained)
    ]
    assert reached[0] >= 18 and reached[1] <= 2
