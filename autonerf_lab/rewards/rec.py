"""Reconstruction, the ``rec.`` of Ramakrishnan et al. 2021, "An Exploration of Embodied Visual Exploration"."""

from collections import deque

import numpy as np
import torch
from torch import nn

from autonerf_lab.rewards.learner import Learner, State, check_state, seeded
from autonerf_lab.rewards.visual_concepts import DESCRIPTOR, Concepts, describe
from autonerf_lab.types import Observation, Transition

EVERY = 5  # steps between two rewards
NEAREST = 8  # views that predict a reference
AHEAD = 2.0  # metres; two views are close if the robots and the points this far ahead of them are close
KEY = 6  # numbers that describe a view relative to a reference
SAMPLES = 4  # training samples per reward
HIDDEN = 32
FIRST_SLOPE = 3.0  # initial decrease of the attention score per metre
RATE = 3e-3
MAX_SAMPLES = 1024  # samples that are kept until the next collect


class Reconstruction:
    """Improvement in predicting reference views from the robot's views, nats: decrease of a mean KL divergence.

    At the start of an episode the reward gets reference observations of the scene. Every 5 steps it predicts the visual
    concepts of each reference (50 clusters of descriptors, :mod:`~autonerf_lab.rewards.visual_concepts`) by attention
    over the 8 nearest views of the robot; the keys are their relative pose and median depth. The remaining weight goes
    to the frequency of each concept. The reward is the decrease of ``KL(true | predicted)``, mean over the references;
    it is 0 at all other steps and until 50 concepts are known.

    Differences from the paper: the descriptors are hand-crafted instead of ImageNet features; the concepts are
    clustered during the training of the policy instead of before it; the predictor is one attention over near views
    instead of a transformer over all views, and learns from the divergence that is the reward.

    Args:
        seed: random seed of the concepts, of the predictor and of the order of the samples.

    Example:
        >>> from autonerf_lab.rewards.conformance import blank_transition
        >>> reward, step = Reconstruction(), blank_transition()
        >>> reward.set_references([step.observation] * reward.references)
        >>> reward(step)
        0.0
    """

    references = 20

    def __init__(self, seed: int = 0) -> None:
        self._concepts = Concepts(seed)
        self._attention = seeded(_Attention, seed)
        self._learner = Learner(self._attention, RATE, seed)
        self._samples: deque[tuple[np.ndarray, ...]] = deque(maxlen=MAX_SAMPLES)
        self._clear()

    def reset(self, rng: np.random.Generator) -> None:
        """Clear the views and the references."""
        self._clear()

    def set_references(self, observations: list[Observation]) -> None:
        """Set the observations from random poses in the scene that the predictor must recognise in this episode."""
        self._references = np.array([_pose(o) for o in observations])
        self._truth = np.array([describe(o) for o in observations])

    def __call__(self, transition: Transition) -> float:
        """Return the decrease of the divergence at every fifth step, else 0."""
        self._poses.append(_pose(transition.observation))
        self._views.append(describe(transition.observation))
        steps = len(self._poses)
        if steps % EVERY or not len(self._references):
            return 0.0
        context = self._context(steps)
        for k in (steps // EVERY * SAMPLES + np.arange(SAMPLES)) % len(self._references):
            self._samples.append((self._truth[k], *(a[k].copy() for a in context)))
        if not self._concepts.known:
            return 0.0
        with torch.inference_mode():
            before = self._divergence(self._truth, *self._context(steps - EVERY))
            return float((before - self._divergence(self._truth, *context)).item())

    def collect(self) -> dict[str, np.ndarray]:
        """Return ``reference`` (N, 192) and ``views`` (N, 8, 192) descriptors, ``keys`` (N, 8, 6), ``valid`` (N, 8)."""
        columns = [np.array(c) for c in zip(*self._samples, strict=True)] or [
            np.zeros((0, *shape), kind) for shape, kind in _SAMPLE.values()
        ]
        self._samples.clear()
        return dict(zip(_SAMPLE, columns, strict=True))

    def update(self, batch: dict[str, np.ndarray]) -> dict[str, float]:
        """Update the concepts, train the predictor; return ``loss``, the mean divergence in nats."""
        if not len(batch["reference"]):
            return {}
        self._concepts.learn(batch["reference"])
        columns = [batch[k] for k in _SAMPLE]
        loss = self._learner.learn(len(columns[0]), lambda rows: self._divergence(*(c[rows] for c in columns)))
        return {"loss": loss}

    def state_dict(self) -> State:
        """Return the concepts, the predictor and its optimiser."""
        return self._learner.state_dict() | {f"concepts.{k}": v for k, v in self._concepts.state_dict().items()}

    def load_state_dict(self, state: State) -> None:
        """Load a state of :meth:`state_dict`."""
        check_state(self.state_dict(), state)
        self._learner.load_state_dict(state)
        self._concepts.load_state_dict({k: state[f"concepts.{k}"] for k in self._concepts.state_dict()})

    def _clear(self) -> None:
        self._references, self._truth = np.zeros((0, 5)), np.zeros((0, DESCRIPTOR), np.float32)
        self._poses: list[np.ndarray] = []
        self._views: list[np.ndarray] = []

    def _context(self, steps: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the nearest of the first views for R references: (R, 8, 192), keys (R, 8, 6), valid (R, 8)."""
        shape = (len(self._references), NEAREST)
        views, keys = np.zeros((*shape, DESCRIPTOR), np.float32), np.zeros((*shape, KEY), np.float32)
        count = min(steps, NEAREST)
        if count:
            poses = np.array(self._poses[:steps])
            distances = _distances(self._references, poses)
            order = np.argsort(distances, axis=1, kind="stable")[:, :count]
            views[:, :count] = np.array(self._views[:steps])[order]
            keys[:, :count, 0] = np.take_along_axis(distances, order, axis=1)
            keys[:, :count, 1:] = _keys(self._references[:, None], poses[order])
        return views, keys, np.tile(np.arange(NEAREST) < count, (len(self._references), 1))

    def _divergence(
        self, reference: np.ndarray, views: np.ndarray, keys: np.ndarray, valid: np.ndarray
    ) -> torch.Tensor:
        """Return ``KL(true | predicted)``, mean over N references."""
        truth, values = (torch.from_numpy(self._concepts.probabilities(a)) for a in (reference, views))
        scores = self._attention(torch.from_numpy(keys)).masked_fill(~torch.from_numpy(valid), -torch.inf)
        weights = torch.softmax(torch.cat([torch.zeros(len(scores), 1), scores], dim=1), dim=1)
        prior = torch.from_numpy(self._concepts.prior).expand(len(scores), 1, -1)
        predicted = (weights[..., None] * torch.cat([prior, values], dim=1)).sum(dim=1)
        return (torch.xlogy(truth, truth) - truth * predicted.clamp(min=1e-9).log()).sum(dim=1).mean()


_SAMPLE = {
    "reference": ((DESCRIPTOR,), np.float32),
    "views": ((NEAREST, DESCRIPTOR), np.float32),
    "keys": ((NEAREST, KEY), np.float32),
    "valid": ((NEAREST,), np.bool_),
}


class _Attention(nn.Module):
    """Attention score of a view for a reference, from its key; initially a decreasing function of the distance."""

    def __init__(self) -> None:
        super().__init__()
        self.slope = nn.Parameter(torch.tensor([FIRST_SLOPE]))
        last = nn.Linear(HIDDEN, 1)
        nn.init.zeros_(last.weight)
        nn.init.zeros_(last.bias)
        self.rest = nn.Sequential(nn.Linear(KEY, HIDDEN), nn.ReLU(), nn.Linear(HIDDEN, HIDDEN), nn.ReLU(), last)

    def forward(self, keys: torch.Tensor) -> torch.Tensor:
        """Return the scores, (...), of keys (..., 6)."""
        return self.slope * (1 - keys[..., 0]) + self.rest(keys)[..., 0]


def _pose(observation: Observation) -> np.ndarray:
    """Return (5,): position x, y in metres, viewing direction (2), median depth in metres."""
    heading = -observation.pose[:2, 2]
    return np.array([*observation.pose[:2, 3], *heading, np.median(observation.depth)])


def _distances(references: np.ndarray, poses: np.ndarray) -> np.ndarray:
    """Return distances (R, N): root of the sum of squared distances of the positions and of the points 2 m ahead."""
    a, b = (np.hstack([p[:, :2], p[:, :2] + AHEAD * p[:, 2:4]]) for p in (references, poses))
    return np.asarray(np.linalg.norm(a[:, None] - b, axis=2))


def _keys(references: np.ndarray, poses: np.ndarray) -> np.ndarray:
    """Return poses in the frames of references, (..., 5): metres ahead and left, cosine and sine, median depth."""
    dx, dy = np.moveaxis(poses[..., :2] - references[..., :2], -1, 0)
    c, s = references[..., 2], references[..., 3]
    u, v = poses[..., 2], poses[..., 3]
    return np.stack([c * dx + s * dy, c * dy - s * dx, c * u + s * v, c * v - s * u, poses[..., 4]], axis=-1)
