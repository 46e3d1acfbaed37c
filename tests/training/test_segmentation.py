"""Training of a segmenter: it learns, resumes to the same weights, and calibrates its confidences."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from interrupted_training import interrupted
from torch import Tensor, nn

from autonerf_lab.errors import RunFolderError, TrainingError
from autonerf_lab.scenes.generator import generate_spec
from autonerf_lab.segmentation import make_segmenter
from autonerf_lab.training import segmentation
from autonerf_lab.training.segmentation import SegmentationSettings, fit_temperature, train_segmentation
from autonerf_lab.training.segmentation_frames import Frames, randomized_spec, render_frames

TINY = SegmentationSettings(steps=8, apartments=2, frames=8, size=32, batch=4, held_out=1, held_out_frames=4, lr=0.01,
                            measure_every=4)  # fmt: skip


def coloured(folder: object, index: int, count: int, seed: int, size: int = 32) -> Frames:
    """Frames with a red square of class 3 on a grey background."""
    rng = np.random.default_rng([seed, index])
    rgb = rng.integers(90, 130, size=(count, size, size, 3), dtype=np.uint8)
    labels = np.zeros((count, size, size), np.uint8)
    for k, (y, x) in enumerate(rng.integers(size // 2, size=(count, 2))):
        rgb[k, y : y + 12, x : x + 12] = 220, 30, 30
        labels[k, y : y + 12, x : x + 12] = 3
    return Frames(rgb, np.full(labels.shape, 2, np.float16), labels)


@pytest.fixture(autouse=True)
def toy_frames(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(segmentation, "training_frames", coloured)
    monkeypatch.setattr(segmentation, "held_out_frames", coloured)


def test_a_training_learns_and_an_interrupted_one_ends_with_the_same_weights(tmp_path, monkeypatch) -> None:
    whole = train_segmentation(tmp_path / "whole", TINY, progress=False)
    rows = [line.split(",") for line in (tmp_path / "whole" / "curve.csv").read_text().splitlines()[1:]]
    assert [row[0] for row in rows] == ["4", "8"] and float(rows[1][1]) < float(rows[0][1])
    found = make_segmenter(f"{whole}.safetensors")(coloured(None, 9, 4, 0).rgb)
    assert found.labels.shape == (4, 32, 32)

    with interrupted(monkeypatch, segmentation._Training, saved=4, stopped=6):
        train_segmentation(tmp_path / "parts", TINY, progress=False)
    parts = train_segmentation(tmp_path / "parts", TINY, progress=False)
    assert parts.with_suffix(".safetensors").read_bytes() == whole.with_suffix(".safetensors").read_bytes()
    with pytest.raises(RunFolderError, match=r"belongs to another training \(batch differ\)"):
        train_segmentation(tmp_path / "parts", replace(TINY, batch=3), progress=False)
    monkeypatch.setattr(segmentation, "__version__", "0.1.0")
    with pytest.raises(RunFolderError, match=r"another training \(version differ\)"):
        train_segmentation(tmp_path / "parts", TINY, progress=False)


def test_a_loss_that_is_not_finite_is_named(tmp_path) -> None:
    with pytest.raises(TrainingError, match="the loss is not finite at step"):
        train_segmentation(tmp_path, replace(TINY, lr=1e30), progress=False)


def test_the_temperature_makes_confidences_probabilities() -> None:
    """Logits that are three times those of the true probabilities need the temperature 3."""
    rng = np.random.default_rng(0)
    true_logits = rng.normal(size=(2, 16, 64, 64))
    chance = np.exp(true_logits) / np.exp(true_logits).sum(axis=1, keepdims=True)
    labels = (rng.random((2, 1, 64, 64)) > np.cumsum(chance, axis=1)).sum(axis=1).clip(0, 15).astype(np.uint8)

    class Fixed(nn.Module):
        def forward(self, rgb: Tensor, depth: Tensor) -> Tensor:
            return torch.from_numpy(3 * true_logits).float()

    frames = Frames(np.zeros((2, 64, 64, 3), np.uint8), np.ones((2, 64, 64), np.float16), labels)
    assert fit_temperature(Fixed(), frames) == pytest.approx(3, rel=0.1)


def test_frames_of_an_apartment_show_objects_and_only_colours_are_randomized() -> None:
    spec, rng = generate_spec(7), np.random.default_rng(0)
    changed = randomized_spec(spec, rng)
    assert changed["objects"] == spec["objects"] and changed["lights"] != spec["lights"]
    frames = render_frames(changed, 8, rng, size=32)
    assert frames.rgb.shape == (8, 32, 32, 3) and frames.semantics.shape == (8, 32, 32)
    assert len(np.unique(frames.semantics[::2])) > 4, "every second pose looks at an object of a random class"
