"""Reconstruction, the ``rec.`` of Ramakrishnan et al. 2021, "An Exploration of Embodied Visual Exploration"."""

from collections import deque

import numpy as np
import torch
from torch import nn

from autonerf_lab.rewards.learner import Learner, State, check_state, seeded
from autonerf_lab.rewards.visual_concepts import DESCRIPTOR, Concepts, describe
from autonerf_lab.types import Observation, Transition

EVERY = 5  # steps between two rewards
NEAREST = 8  # views that tell about a place
AHEAD = 2.0  # metres; two views are near where the robot and the point so far ahead of it are
KEY = 6
SAMPLES = 4  # to learn from, at each reward
HIDDEN = 32
FIRST_SLOPE = 3.0  # a metre
RATE = 3e-3
KEPT = 1024  # samples that nobody has collected yet


class Reconstruction:
    """How much better places never shown can be told from what was seen, nats: the decrease of a mean KL divergence.

    At the start of an episode the reward is shown places of the scene. Every 5 steps it predicts which visual concepts
    (50 clusters of descriptors, :mod:`~autonerf_lab.rewards.visual_concepts`) are seen from each: attention over
    the 8 nearest views of the robot, by their pose relative to the place and how far they look; what attends to none
    of them falls back on how frequent each concept is. The reward is by how much ``KL(true | predicted)`` fell, in the
    mean over the places, and 0 at all other steps and before 50 concepts are known. As in the paper the predictor and
    the concepts are learned; unlike there the descriptors are made by hand instead of by ImageNet.

    Args:
        seed: of the concepts, of the predictor and of the order of the samples.

    Example:
        >>> from autonerf_lab.rewards.conformance import blank_transition
        >>> reward, step = Reconstruction(), blank_transition()
        >>> reward.show([step.observation] * reward.references)
        >>> reward(step)
        0.0
    """

    references = 20

    def __init__(self, seed: int = 0) -> None:
        self._concepts = Concepts(seed)
        self._attention = seeded(_Attention, seed)
        self._learner = Learner(self._attention, RATE, seed)
        self._samples: deque[tuple[np.ndarray, ...]] = deque(maxlen=KEPT)
        self._forget()

    def reset(self, rng: np.random.Generator) -> None:
        """Forget what was seen, and the places."""
        self._forget()

    def show(self, observations: list[Observation]) -> None:
        """The places that are to be told."""
        self._places = np.array([_pose(o) for o in observations])
        self._truth = np.array([describe(o) for o in observations])

    def __call__(self, transition: Transition) -> float:
        self._poses.append(_pose(transition.observation))
        self._views.append(describe(transition.observation))
        steps = len(self._poses)
        if steps % EVERY or not len(self._places):
            return 0.0
        context = self._context(steps)
        for k in (steps // EVERY * SAMPLES + np.arange(SAMPLES)) % len(self._places):
            self._samples.append((self._truth[k], *(a[k].copy() for a in context)))
        if not self._concepts.known:
            return 0.0
        with torch.inference_mode():
            before = self._divergence(self._truth, *self._context(steps - EVERY))
            return float((before - self._divergence(self._truth, *context)).item())

    def collect(self) -> dict[str, np.ndarray]:
        """``place`` (N, 192) and ``views`` (N, 8, 192) descriptors, ``keys`` (N, 8, 6), ``seen`` (N, 8) bool."""
        columns = [np.array(c) for c in zip(*self._samples, strict=True)] or [
            np.zeros((0, *shape), kind) for shape, kind in _SAMPLE.values()
        ]
        self._samples.clear()
        return dict(zip(_SAMPLE, columns, strict=True))

    def update(self, batch: dict[str, np.ndarray]) -> dict[str, float]:
        """``loss``: the mean divergence, nats."""
        if not len(batch["place"]):
            return {}
        self._concepts.learn(batch["place"])
        columns = [batch[k] for k in _SAMPLE]
        loss = self._learner.learn(len(columns[0]), lambda rows: self._divergence(*(c[rows] for c in columns)))
        return {"loss": loss}

    def state_dict(self) -> State:
        """Concepts, predictor and its optimiser."""
        return self._learner.state_dict() | {f"concepts.{k}": v for k, v in self._concepts.state_dict().items()}

    def load_state_dict(self, state: State) -> None:
        """Go on from there."""
        check_state(self.state_dict(), state)
        self._learner.load_state_dict(state)
        self._concepts.load_state_dict({k: state[f"concepts.{k}"] for k in self._concepts.state_dict()})

    def _forget(self) -> None:
        self._places, self._truth = np.zeros((0, 5)), np.zeros((0, DESCRIPTOR), np.float32)
        self._poses: list[np.ndarray] = []
        self._views: list[np.ndarray] = []

    def _context(self, steps: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The nearest of the first views, for each of R places: (R, 8, 192), keys (R, 8, 6), which there are."""
        shape = (len(self._places), NEAREST)
        views, keys = np.zeros((*shape, DESCRIPTOR), np.float32), np.zeros((*shape, KEY), np.float32)
        count = min(steps, NEAREST)
        if count:
            poses = np.array(self._poses[:steps])
            distances = _distances(self._places, poses)
            order = np.argsort(distances, axis=1, kind="stable")[:, :count]
            views[:, :count] = np.array(self._views[:steps])[order]
            keys[:, :count, 0] = np.take_along_axis(distances, order, axis=1)
            keys[:, :count, 1:] = _keys(self._places[:, None], poses[order])
        return views, keys, np.tile(np.arange(NEAREST) < count, (len(self._places), 1))

    def _divergence(self, place: np.ndarray, views: np.ndarray, keys: np.ndarray, seen: np.ndarray) -> torch.Tensor:
        """Mean over N places of ``KL(true | predicted)``."""
        truth, values = (torch.from_numpy(self._concepts.of(a)) for a in (place, views))
        scores = self._attention(torch.from_numpy(keys)).masked_fill(~torch.from_numpy(seen), -torch.inf)
        weights = torch.softmax(torch.cat([torch.zeros(len(scores), 1), scores], dim=1), dim=1)
        prior = torch.from_numpy(self._concepts.prior).expand(len(scores), 1, -1)
        predicted = (weights[..., None] * torch.cat([prior, values], dim=1)).sum(dim=1)
        return (torch.xlogy(truth, truth) - truth * predicted.clamp(min=1e-9).log()).sum(dim=1).mean()


_SAMPLE = {
    "place": ((DESCRIPTOR,), np.float32),
    "views": ((NEAREST, DESCRIPTOR), np.float32),
    "keys": ((NEAREST, KEY), np.float32),
    "seen": ((NEAREST,), np.bool_),
}


class _Attention(nn.Module):
    """How much a view, by its key, has to say about a place. At first, all the more the nearer it is."""

    def __init__(self) -> None:
        super().__init__()
        self.slope = nn.Parameter(torch.tensor([FIRST_SLOPE]))
        last = nn.Linear(HIDDEN, 1)
        nn.init.zeros_(last.weight)
        nn.init.zeros_(last.bias)
        self.rest = nn.Sequential(nn.Linear(KEY, HIDDEN), nn.ReLU(), nn.Linear(HIDDEN, HIDDEN), nn.ReLU(), last)

    def forward(self, keys: torch.Tensor) -> torch.Tensor:
        """(..., 6) -> (...)."""
        return self.slope * (1 - keys[..., 0]) + self.rest(keys)[..., 0]


def _pose(observation: Observation) -> np.ndarray:
    """(5,) x, y, direction of view (2), and how far is what is seen, all in metres."""
    heading = -observation.pose[:2, 2]
    return np.array([*observation.pose[:2, 3], *heading, np.median(observation.depth)])


def _distances(places: np.ndarray, poses: np.ndarray) -> np.ndarray:
    """(R, N) of places (R, 5) to poses (N, 5): of the robot's, and of the points 2 m ahead, root of summed squares."""
    a, b = (np.hstack([p[:, :2], p[:, :2] + AHEAD * p[:, 2:4]]) for p in (places, poses))
    return np.asarray(np.linalg.norm(a[:, None] - b, axis=2))


def _keys(places: np.ndarray, poses: np.ndarray) -> np.ndarray:
    """Poses in the frames of places, both (..., 5): metres ahead and left, cosine and sine of the turn, metres seen."""
    dx, dy = np.moveaxis(poses[..., :2] - places[..., :2], -1, 0)
    c, s = places[..., 2], places[..., 3]
    u, v = poses[..., 2], poses[..., 3]
    return np.stack([c * dx + s * dy, c * dy - s * dx, c * u + s * v, c * v - s * u, poses[..., 4]], axis=-1)
