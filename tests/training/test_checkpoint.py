"""Checkpoints of trainings: damaged headers, other settings, and a supervised training that goes on bit for bit."""

import pytest
import torch
from torch import nn

from autonerf_lab.errors import DataError, RunFolderError
from autonerf_lab.training.checkpoint import SupervisedHeader, read_checkpoint, resume_supervised, save_supervised
from autonerf_lab.training.session import CheckpointHeader
from autonerf_lab.utils.storage import read_arrays, write_arrays


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"fingerprint": 3}, "Expected `object`, got `int` - at `\\$.fingerprint`; remove the file"),
        ({"curve": [{"frames": "many"}]}, "Expected `int | float`"),
        ({"episode": -1}, "Expected `int` >= 0"),
        ({"frames": None}, "Expected `int`"),
    ],
)
def test_a_checkpoint_whose_header_is_damaged_is_one_clear_error(change, message, tmp_path):
    header = {"fingerprint": {"a": 1}, "curve": [], "episode": 0, "frames": 0, "seconds": 0.0}
    header |= {"timesteps": 0, "updates": 0}
    write_arrays(tmp_path / "x", {}, header)
    assert read_checkpoint(tmp_path / "x", {"a": 1}, CheckpointHeader) == ({}, CheckpointHeader(**header))
    write_arrays(tmp_path / "x", {}, header | change)
    with pytest.raises(DataError, match=message):
        read_checkpoint(tmp_path / "x", {"a": 1}, CheckpointHeader)


def networks(seed):
    """Return two small networks, of which AdamW optimises the first, and the optimiser."""
    torch.manual_seed(seed)
    made = {"network": nn.Sequential(nn.Linear(3, 4), nn.BatchNorm1d(4), nn.Linear(4, 1)), "average": nn.Linear(3, 1)}
    return made, torch.optim.AdamW(made["network"].parameters(), lr=0.01)


def train(made, optimizer, steps):
    for _ in range(steps):
        optimizer.zero_grad()
        made["network"](torch.arange(12.0).reshape(4, 3)).square().mean().backward()
        optimizer.step()


def values(made):
    return {f"{name}/{k}": v.tolist() for name, network in made.items() for k, v in network.state_dict().items()}


def test_a_supervised_training_continues_bit_for_bit(tmp_path):
    path, header = tmp_path / "checkpoint", SupervisedHeader({"steps": 5}, [{"step": 3.0}], 3, 1.5)
    made, optimizer = networks(0)
    assert resume_supervised(path, {"steps": 5}, made, optimizer) is None
    train(made, optimizer, 3)
    save_supervised(path, header, made, optimizer)
    train(made, optimizer, 2)
    other, its_optimizer = networks(1)
    assert resume_supervised(path, {"steps": 5}, other, its_optimizer) == header
    train(other, its_optimizer, 2)
    assert values(other) == values(made)


def test_a_supervised_checkpoint_without_a_moment_is_damaged(tmp_path):
    path, header = tmp_path / "checkpoint", SupervisedHeader({}, [], 1, 0.0)
    made, optimizer = networks(0)
    train(made, optimizer, 1)
    save_supervised(path, header, made, optimizer)
    arrays, _ = read_arrays(path, SupervisedHeader)
    write_arrays(path, {k: v for k, v in arrays.items() if k != "adam/2.bias/exp_avg_sq"}, {**vars(header)})
    with pytest.raises(DataError, match=r"exp_avg_sq.*remove it to start the training again"):
        resume_supervised(path, {}, made, optimizer)


def test_the_checkpoint_of_another_training_is_refused_by_what_differs(tmp_path):
    path, long = tmp_path / "checkpoint", "z" * 300
    header = SupervisedHeader({"lr": 1, "seed": 0, "gone": 1}, [], 1, 0.0)
    write_arrays(path, {}, {**vars(header)})
    for fingerprint, differ in (
        ({"lr": 2, "seed": 0, "new": 1}, "gone, lr, new"),
        ({"lr": 1, "seed": 0, "gone": 1, long: 1}, long[:200]),
    ):
        with pytest.raises(RunFolderError, match=rf"another training \({differ} differ\); remove it"):
            read_checkpoint(path, fingerprint, SupervisedHeader)
