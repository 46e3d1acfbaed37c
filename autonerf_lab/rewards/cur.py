"""Curiosity, the ``cur.`` of Ramakrishnan et al. 2021, "An Exploration of Embodied Visual Exploration"."""

from collections import deque

import numpy as np
import torch
from PIL import Image
from torch import nn
from torch.nn.functional import leaky_relu, one_hot

from autonerf_lab.geometry import block_shares
from autonerf_lab.rewards.learner import Learner, State, check_state, seeded
from autonerf_lab.types import Action, MapState, Observation, Transition

SIDE = 42  # pixels a side of the input of the encoder
FAR = 10.0  # metres; larger depths are clipped
BLOCKS_A_SIDE, BLOCK = 32, 1.0  # size of the coarse map; side of a block, metres
WEIGHT = 100.0  # of the coarse map: new ground gives a prediction error several times that of a step without
FEATURES = 128  # of the image, and as many of the coarse map
HIDDEN = 256
BLOCKS = 4
DISCOUNT = 0.99
RATE = 1e-3
PASSES = 4  # over the samples of an update; with fewer passes all prediction errors stay large and alike
MEMORY = 2000  # steps, window of the running statistics: errors of the untrained model must fade from them
MAX_SAMPLES = 8192  # steps that are kept until the next collect


class Curiosity:
    """Prediction error of a forward model, standard deviations of its return: ``sum((phi_hat(s, a) - phi(s'))^2)``.

    Two things differ from the paper. First, phi is not the recurrent state of the policy. It encodes the color and
    depth image at 42 x 42 pixels (depth alone if colors are off), and a coarse map, the explored and occupied share of
    blocks of 1 m, which says what is new ground. phi is a fixed random network: a trained encoder could minimise the
    error by mapping all states to the same features, and Burda et al. 2018, "Large-Scale Study of Curiosity-Driven
    Learning", found random features about as good as the best alternatives. Second, each error is divided by the mean
    error of the same action: a turn changes the image more than a step forward. Errors are divided by the running
    standard deviation of their discounted sum, as by Burda et al., which :meth:`update` maintains; before the first
    update, by 100 steps, the horizon of the sum. Initially the model predicts no change. The reward of the first step
    of an episode is 0.

    Args:
        seed: random seed of the networks and of the order of the samples.

    Example:
        >>> import numpy as np
        >>> from autonerf_lab.rewards.conformance import random_transitions, run_episode
        >>> first, second = run_episode(Curiosity(), random_transitions(np.random.default_rng(0), 2))
        >>> first, second > 0
        (0.0, True)
    """

    def __init__(self, seed: int = 0) -> None:
        self._networks = seeded(_Networks, seed)
        self._learner = Learner(self._networks, RATE, seed)
        self._action_errors = np.zeros((len(Action), 2))  # count and mean of the errors of each action
        self._return = np.zeros(4)  # discounted sum of errors; count, mean and variance of these sums
        self._previous: np.ndarray | None = None
        self._samples: deque[tuple[np.ndarray, int, np.ndarray]] = deque(maxlen=MAX_SAMPLES)

    def reset(self, rng: np.random.Generator) -> None:
        """Clear the last observation."""
        self._previous = None

    def __call__(self, transition: Transition) -> float:
        """Return the normalised prediction error of one step."""
        before, action = self._previous, int(transition.action)
        with torch.inference_mode():
            image, coarse_map = _image(transition.observation), _coarse_map(transition.after)
            self._previous = after = self._networks.features(
                torch.from_numpy(image), torch.from_numpy(coarse_map)
            ).numpy()
            if before is None:
                return 0.0
            self._samples.append((before, action, after))
            error = self._errors(*(torch.from_numpy(np.array([a])) for a in (before, action, after))).numpy()
        return float(self._relative(error, np.array([action]))[0] / self._scale)

    def collect(self) -> dict[str, np.ndarray]:
        """Return ``before`` and ``after``, (N, 256) float32 features, and ``action``, (N,) int64."""
        before, action, after = zip(*self._samples, strict=True) if self._samples else ((), (), ())
        self._samples.clear()
        return {
            "before": np.array(before, np.float32).reshape(-1, 2 * FEATURES),
            "action": np.array(action, np.int64),
            "after": np.array(after, np.float32).reshape(-1, 2 * FEATURES),
        }

    def update(self, batch: dict[str, np.ndarray]) -> dict[str, float]:
        """Train the forward model; return ``loss``, the mean unnormalised error of the first pass."""
        columns = [torch.from_numpy(batch[k]) for k in ("before", "action", "after")]
        samples = len(columns[0])
        if not samples:
            return {}
        with torch.inference_mode():
            errors = self._errors(*columns).numpy()
        self._count_errors(errors, batch["action"])
        self._count_returns(self._relative(errors, batch["action"]))
        losses = [
            self._learner.learn(samples, lambda rows: self._errors(*(c[rows] for c in columns)).mean())
            for _ in range(PASSES)
        ]
        return {"loss": losses[0]}

    def state_dict(self) -> State:
        """Return both networks, the optimiser, and the statistics of errors and returns."""
        return self._learner.state_dict() | {"return": self._return.copy(), "action_errors": self._action_errors.copy()}

    def load_state_dict(self, state: State) -> None:
        """Load a state of :meth:`state_dict`."""
        check_state(self.state_dict(), state)
        self._learner.load_state_dict(state)
        self._return, self._action_errors = np.array(state["return"]), np.array(state["action_errors"])

    def _errors(self, before: torch.Tensor, action: torch.Tensor, after: torch.Tensor) -> torch.Tensor:
        return (self._networks(before, action) - after).square().sum(dim=1)

    def _relative(self, errors: np.ndarray, actions: np.ndarray) -> np.ndarray:
        mean = self._action_errors[actions, 1]
        return np.divide(errors, mean, out=errors.astype(float), where=mean > 0)

    @property
    def _scale(self) -> float:
        return float(np.sqrt(self._return[3])) or 1 / (1 - DISCOUNT)

    def _count_errors(self, errors: np.ndarray, actions: np.ndarray) -> None:
        for action in np.unique(actions):
            selected = errors[actions == action]
            count = min(self._action_errors[action, 0] + len(selected), max(MEMORY, len(selected)))
            mean = self._action_errors[action, 1]
            self._action_errors[action] = count, mean + (selected.mean() - mean) * len(selected) / count

    def _count_returns(self, errors: np.ndarray) -> None:
        total, count, mean, variance = (float(v) for v in self._return)
        if not count:
            total = mean = float(errors.mean()) / (1 - DISCOUNT)  # as after a long time with this mean
        for error in errors.tolist():  # Welford 1962
            total = DISCOUNT * total + error
            count = min(count + 1, MEMORY)
            step = total - mean
            mean += step / count
            variance += (step * (total - mean) - variance) / count
        self._return = np.array([total, count, mean, variance])


class _Networks(nn.Module):
    """Fixed encoders phi of images and coarse maps, and the forward model over their features."""

    def __init__(self) -> None:
        super().__init__()
        sizes = ((4, 16), (16, 32), (32, 32))
        convolutions = [layer for i, o in sizes for layer in (nn.Conv2d(i, o, 4, stride=2, bias=False), nn.LeakyReLU())]
        self.phi = nn.Sequential(
            *convolutions, nn.Flatten(), nn.Linear(32 * 3 * 3, FEATURES, bias=False), nn.LayerNorm(FEATURES)
        )
        for parameter in self.phi.parameters():
            if parameter.ndim > 1:
                nn.init.orthogonal_(parameter, np.sqrt(2))
            parameter.requires_grad_(False)
        self.coarse_map = nn.Linear(2 * BLOCKS_A_SIDE**2, FEATURES, bias=False).requires_grad_(False)
        nn.init.orthogonal_(self.coarse_map.weight, WEIGHT)
        self.unit: torch.Tensor
        self.first = nn.Linear(2 * FEATURES + len(Action), HIDDEN)
        self.blocks = nn.ModuleList(
            nn.Sequential(nn.Linear(HIDDEN, HIDDEN), nn.LeakyReLU(), nn.Linear(HIDDEN, HIDDEN)) for _ in range(BLOCKS)
        )
        self.last = nn.Linear(HIDDEN, 2 * FEATURES)
        # The model computes with features of about unit size; with larger ones, it sometimes diverged.
        self.register_buffer("unit", torch.tensor([1.0, WEIGHT]).repeat_interleave(FEATURES), persistent=False)
        nn.init.zeros_(self.last.weight)
        nn.init.zeros_(self.last.bias)

    def features(self, image: torch.Tensor, coarse_map: torch.Tensor) -> torch.Tensor:
        """Encode an image (4, 42, 42) and a coarse map (2, 32, 32) to (256,) features, in this order."""
        return torch.cat([self.phi(image[None])[0], self.coarse_map(coarse_map.flatten())])

    def forward(self, before: torch.Tensor, action: torch.Tensor) -> torch.Tensor:
        """Predict the next features, (N, 256), from features (N, 256) and actions (N,)."""
        x = leaky_relu(self.first(torch.cat([before / self.unit, one_hot(action, len(Action))], dim=1)))
        for block in self.blocks:
            x = x + block(x)
        return before + self.unit * self.last(x)


def _coarse_map(map: MapState) -> np.ndarray:
    """Return the occupied and the explored share of each block around the map's centre, (2, 32, 32) float32."""
    side = max(1, round(BLOCK / map.cell))
    half, first = BLOCKS_A_SIDE * side // 2, len(map.explored) // 2
    known = np.pad(np.stack([map.occupied, map.explored]), ((0, 0), (half, half), (half, half)))
    return block_shares(known[:, first : first + 2 * half, first : first + 2 * half], side)


def _image(observation: Observation) -> np.ndarray:
    """Return color and depth, (4, 42, 42) float32 in [0, 1]."""
    rgb = Image.fromarray(observation.rgb).resize((SIDE, SIDE), Image.Resampling.BOX)
    depth = Image.fromarray(np.minimum(observation.depth, np.float32(FAR)))
    channels = [np.asarray(rgb, np.float32) / 255, np.asarray(depth.resize((SIDE, SIDE), Image.Resampling.BOX)) / FAR]
    return np.ascontiguousarray(np.dstack(channels).transpose(2, 0, 1))
