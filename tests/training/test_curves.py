"""Learning curves, probes and devices of policy trainings."""

from dataclasses import replace

import pytest
import torch

from autonerf_lab import cli
from autonerf_lab.errors import DataError, DeviceError
from autonerf_lab.policies.spec import make_network
from autonerf_lab.policies.weights import load_weights, read_meta
from autonerf_lab.training import train
from autonerf_lab.training.probe import probe
from autonerf_lab.training.settings import PolicySettings, command_of, settings_of

# Two decisions of exactly 12 actions an episode: no waypoint counts as reached.
TINY = PolicySettings(
    frames=48, demonstrations=0, environments=2, episode=2, rollout=2, epochs=1, batch=4, sensor=16, gamma=0.5,
    scale=0.1, network={"kind": "compact", "follow": 12, "arrival": 0},
)  # fmt: skip


def one_per_step(transition):
    """Duration, steps: always one."""
    return 1.0


def test_a_curve_has_the_sum_of_the_rewards_and_the_discounted_return(tmp_path):
    weights = train.train_policy("modular-cov", tmp_path, TINY, reward=one_per_step, workers=1, progress=False)
    (row,) = read_meta(weights)["curve"]
    assert row["frames"] == 48 and row["reward"] == pytest.approx(24)
    assert row["return"] == pytest.approx(12 + 0.5 * 12), "the second decision is discounted once"


def test_short_decisions_are_discounted_less(tmp_path):
    """With arrival anywhere each decision takes one action, a twelfth of the maximum."""
    settings = replace(TINY, network={**TINY.network, "arrival": 100.0})
    weights = train.train_policy("modular-cov", tmp_path, settings, reward=one_per_step, workers=1, progress=False)
    row = read_meta(weights)["curve"][0]
    assert row["frames"] == 4 and row["return"] == pytest.approx(1 + 0.5 ** (1 / 12))


def test_a_probe_is_repeatable_and_differs_for_other_weights_and_other_inputs(tmp_path):
    weights = train.train_policy("modular-cov", tmp_path, TINY, workers=1, progress=False)
    network = make_network(TINY.network)[1]
    load_weights(weights, network)
    stored, found = read_meta(weights)["probe"], probe(network, lambda: train.make_env(TINY, "cov"))
    assert len(stored) == 3 and stored[0] != stored[1]
    for before, after in zip(stored, found, strict=True):
        assert before == pytest.approx(after, abs=2e-3), "half precision"
    torch.nn.init.normal_(network.score.weight)
    other = probe(network, lambda: train.make_env(TINY, "cov"))
    assert other[0]["entropy"] < 0.9 * stored[0]["entropy"]
    finer = probe(network, lambda: train.make_env(replace(TINY, sensor=48), "cov"))
    assert max(abs(finer[0][name] - other[0][name]) for name in other[0] if name.startswith("map")) > 2e-3


def test_nothing_to_train_is_an_error(tmp_path, capsys):
    with pytest.raises(DataError, match="nothing would be trained"):
        train.train_policy("modular-cov", tmp_path, replace(TINY, frames=0), workers=1, progress=False)
    with pytest.raises(DataError, match="nothing would be trained"):
        train.train_policy("modular-cov", tmp_path, replace(TINY, frames=0, demonstrations=1), start="modular-cov")
    words = ["train-policy", "--start", "modular-cov", "--demonstrations", "3", "--out", str(tmp_path)]
    assert cli.main(words) == 1
    assert "give one of them" in capsys.readouterr().err and not list(tmp_path.iterdir())


def test_an_unknown_device_is_an_error(tmp_path):
    with pytest.raises(DeviceError, match="'abacus' is not available"):
        train.train_policy("modular-cov", tmp_path, TINY, device="abacus")
    assert not list(tmp_path.iterdir())
    command = command_of("modular-cov", settings_of("modular-cov"), device="cuda")
    assert command is not None and command.endswith("--device cuda")
