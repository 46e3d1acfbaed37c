"""Predicted labels of fields that learn from depth: those of near surfaces outvote the many of far ones."""

from dataclasses import replace
from importlib import import_module

import numpy as np

import autonerf_lab as lab
from autonerf_lab.classes import CLASS_NAMES
from autonerf_lab.geometry import Intrinsics


def test_a_field_learns_the_labels_of_near_views(monkeypatch):
    """Beyond 1 m, where most of the pixels are, the segmenter takes everything for a chair."""
    sim = lab.Simulator(lab.load_scene("dev-4"), Intrinsics.from_fov(32, 32), supersample=1)
    episode = lab.explore(sim, "frontier", steps=250, progress=False)
    far = episode.depth > 1.0
    assert far.mean() > 0.6
    labels = np.where(far, CLASS_NAMES.index("chair"), episode.semantics).astype(np.uint8)
    predicted = replace(episode, semantics=labels, confidence=np.full(far.shape, 255, np.uint8))

    def share_right() -> float:
        field = lab.fit(predicted, "semantic-nerfacto-rgbd", preset="smoke", steps=400, progress=False)
        frames = np.linspace(0, len(episode) - 1, 20).astype(int)
        shown = np.stack([field.render(episode.poses[t]).semantics for t in frames])
        return float((shown == episode.semantics[frames])[~far[frames]].mean())

    weighted = share_right()
    monkeypatch.setattr(import_module("autonerf_lab.nerf.fit"), "trust_near_labels", lambda data: data)
    assert weighted > 0.7 and weighted > share_right() + 0.04


def test_a_model_on_colours_does_not_use_the_depth():
    sim = lab.Simulator(lab.load_scene("dev-4"), Intrinsics.from_fov(16, 16), supersample=1)
    episode = lab.explore(sim, "random", steps=20, progress=False)
    predicted = replace(episode, confidence=np.full(episode.depth.shape, 255, np.uint8))
    farther = replace(predicted, depth=2 * episode.depth)
    fields = [lab.fit(data, "instant-ngp", preset="smoke", steps=5, progress=False) for data in (predicted, farther)]
    first, second = (field.render(episode.poses[0]).rgb for field in fields)
    np.testing.assert_array_equal(first, second)
