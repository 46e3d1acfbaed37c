"""Training of learned odometry: it learns, and an interrupted one ends with the same weights."""

from dataclasses import replace

import numpy as np
import pytest
from interrupted_training import interrupted

from autonerf_lab.errors import RunFolderError, TrainingError
from autonerf_lab.training import odometry
from autonerf_lab.training.odometry import OdometrySettings, train_odometry
from autonerf_lab.training.odometry_pairs import sample_batch, training_pairs

TINY = OdometrySettings(steps=8, scenes=1, runs=2, batch=1, measure_every=2)


@pytest.fixture(scope="module")
def pairs(tmp_path_factory):
    return training_pairs(tmp_path_factory.mktemp("pairs"), "train-00", 2, 0)


@pytest.fixture(autouse=True)
def rendered_once(monkeypatch, pairs):
    monkeypatch.setattr(odometry, "training_pairs", lambda *_: pairs)


def test_a_training_learns_and_an_interrupted_one_ends_with_the_same_weights(tmp_path, monkeypatch):
    whole = train_odometry(tmp_path / "whole", TINY, progress=False)
    with interrupted(monkeypatch, odometry._Training, saved=5, stopped=5):
        train_odometry(tmp_path / "parts", TINY, progress=False)
    parts = train_odometry(tmp_path / "parts", TINY, progress=False)
    assert parts.with_suffix(".safetensors").read_bytes() == whole.with_suffix(".safetensors").read_bytes()
    with pytest.raises(RunFolderError, match=r"belongs to another training \(batch differ\)"):
        train_odometry(tmp_path / "parts", replace(TINY, batch=3), progress=False)
    monkeypatch.setattr(odometry, "__version__", "0.1.0")
    with pytest.raises(RunFolderError, match=r"another training \(version differ\)"):
        train_odometry(tmp_path / "parts", TINY, progress=False)


def test_a_loss_that_is_not_finite_is_named(tmp_path):
    with pytest.raises(TrainingError, match="the loss is not finite at step"):
        train_odometry(tmp_path, replace(TINY, lr=1e30), progress=False)


def test_pairs_are_repeatable_and_their_odometry_has_its_noise(pairs):
    images, priors, wanted = sample_batch(pairs, 40, np.random.default_rng(0))
    again, _, _ = sample_batch(pairs, 40, np.random.default_rng(0))
    assert (images == again).all() and images.shape == (320, 5, 64, 64) and images[:, 4].mean() > 0.1
    distance = np.einsum("bi,bij,bj->b", wanted, priors, wanted) / 3
    assert 0.4 < distance.mean() < 1.6  # errors have the covariance of the prior
