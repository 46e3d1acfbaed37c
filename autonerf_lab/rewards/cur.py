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

SIDE = 42  # pixels a side of what the encoder sees
FAR = 10.0  # metres; depth is cut there
BLOCKS_A_SIDE, BLOCK = 32, 1.0  # of the chart, and metres a side of one
WEIGHT = 100.0  # of the chart: a step that shows new ground surprises several times as much as one that does not
FEATURES = 128  # of the picture, and as many of the chart
HIDDEN = 256
BLOCKS = 4
DISCOUNT = 0.99
RATE = 1e-3
PASSES = 4  # over what was collected: a model that lags behind is surprised by all and tells nothing apart
MEMORY = 2000  # steps; older returns fade from the statistics, which an untrained model would rule for long
KEPT = 8192  # steps that nobody has collected yet


class Curiosity:
    """Surprise of a forward model, standard deviations of its return: ``sum((phi_hat(s, a) - phi(s'))^2)``.

    phi stands for what the robot knows (theirs is the recurrent state of the policy): the picture, colours and depth at
    42 x 42 pixels (where colours are off, depth alone), and the chart, which ground is explored and occupied in blocks
    of 1 m. Of the picture alone whatever is rich in detail is a surprise, however often it was seen. phi is a random
    network that is never trained: a trained one would please the forward model best by seeing the same everywhere, and
    Burda et al. 2018, "Large-Scale Study of Curiosity-Driven Learning", found random features to do about as well as
    the best alternatives. As there, errors are divided by the running standard deviation of their discounted sum over
    all steps, which :meth:`update` keeps; before the first update, by the 100 steps that this sum reaches over. At
    first the model predicts that nothing changes. The first step of an episode, before which nothing was seen, has the
    reward 0.

    An error counts relative to the mean error of the same action. A turn changes more of the picture than a step ahead
    and is harder to predict wherever the robot stands: without this, turning on the spot is the most curious thing.

    Args:
        seed: of the networks and of the order of the samples.

    Example:
        >>> import numpy as np
        >>> from autonerf_lab.rewards.conformance import play, random_walk
        >>> first, second = play(Curiosity(), random_walk(np.random.default_rng(0), 2))
        >>> first, second > 0
        (0.0, True)
    """

    def __init__(self, seed: int = 0) -> None:
        self._networks = seeded(_Networks, seed)
        self._learner = Learner(self._networks, RATE, seed)
        self._usual = np.zeros((len(Action), 2))  # error of each action: of how many steps, and their mean
        self._return = np.zeros(4)  # the discounted sum of errors; how many such sums, their mean and variance
        self._previous: np.ndarray | None = None
        self._seen: deque[tuple[np.ndarray, int, np.ndarray]] = deque(maxlen=KEPT)

    def reset(self, rng: np.random.Generator) -> None:
        """Forget the last observation."""
        self._previous = None

    def __call__(self, transition: Transition) -> float:
        before, action = self._previous, int(transition.action)
        with torch.inference_mode():
            image, chart = _image(transition.observation), _chart(transition.after)
            self._previous = after = self._networks.features(torch.from_numpy(image), torch.from_numpy(chart)).numpy()
            if before is None:
                return 0.0
            self._seen.append((before, action, after))
            error = self._errors(*(torch.from_numpy(np.array([a])) for a in (before, action, after))).numpy()
        return float(self._relative(error, np.array([action]))[0] / self._scale)

    def collect(self) -> dict[str, np.ndarray]:
        """``before``, ``after`` (N, 256) float32 features, ``action`` (N,) int64."""
        before, action, after = zip(*self._seen, strict=True) if self._seen else ((), (), ())
        self._seen.clear()
        return {
            "before": np.array(before, np.float32).reshape(-1, 2 * FEATURES),
            "action": np.array(action, np.int64),
            "after": np.array(after, np.float32).reshape(-1, 2 * FEATURES),
        }

    def update(self, batch: dict[str, np.ndarray]) -> dict[str, float]:
        """``loss``: the mean error of the first pass, before it is divided."""
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
        """Both networks, the optimiser, and the statistics of errors and returns."""
        return self._learner.state_dict() | {"return": self._return.copy(), "usual": self._usual.copy()}

    def load_state_dict(self, state: State) -> None:
        """Go on from there."""
        check_state(self.state_dict(), state)
        self._learner.load_state_dict(state)
        self._return, self._usual = np.array(state["return"]), np.array(state["usual"])

    def _errors(self, before: torch.Tensor, action: torch.Tensor, after: torch.Tensor) -> torch.Tensor:
        return (self._networks(before, action) - after).square().sum(dim=1)

    def _relative(self, errors: np.ndarray, actions: np.ndarray) -> np.ndarray:
        usual = self._usual[actions, 1]
        return np.divide(errors, usual, out=errors.astype(float), where=usual > 0)

    @property
    def _scale(self) -> float:
        return float(np.sqrt(self._return[3])) or 1 / (1 - DISCOUNT)

    def _count_errors(self, errors: np.ndarray, actions: np.ndarray) -> None:
        for action in np.unique(actions):
            of_it = errors[actions == action]
            count = min(self._usual[action, 0] + len(of_it), max(MEMORY, len(of_it)))
            mean = self._usual[action, 1]
            self._usual[action] = count, mean + (of_it.mean() - mean) * len(of_it) / count

    def _count_returns(self, errors: np.ndarray) -> None:
        total, count, mean, variance = (float(v) for v in self._return)
        if not count:
            total = mean = float(errors.mean()) / (1 - DISCOUNT)  # as if it had always been so
        for error in errors.tolist():  # Welford 1962
            total = DISCOUNT * total + error
            count = min(count + 1, MEMORY)
            step = total - mean
            mean += step / count
            variance += (step * (total - mean) - variance) / count
        self._return = np.array([total, count, mean, variance])


class _Networks(nn.Module):
    """phi, of pictures and charts, which is fixed, and the forward model in its space."""

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
        self.chart = nn.Linear(2 * BLOCKS_A_SIDE**2, FEATURES, bias=False).requires_grad_(False)
        nn.init.orthogonal_(self.chart.weight, WEIGHT)
        self.first = nn.Linear(2 * FEATURES + len(Action), HIDDEN)
        self.blocks = nn.ModuleList(
            nn.Sequential(nn.Linear(HIDDEN, HIDDEN), nn.LeakyReLU(), nn.Linear(HIDDEN, HIDDEN)) for _ in range(BLOCKS)
        )
        self.last = nn.Linear(HIDDEN, 2 * FEATURES)
        nn.init.zeros_(self.last.weight)
        nn.init.zeros_(self.last.bias)

    def features(self, image: torch.Tensor, chart: torch.Tensor) -> torch.Tensor:
        """(4, 42, 42) and (2, 32, 32) -> (256,): of the picture, then of the chart."""
        return torch.cat([self.phi(image[None])[0], self.chart(chart.flatten())])

    def forward(self, before: torch.Tensor, action: torch.Tensor) -> torch.Tensor:
        """Features (N, 256) and actions (N,) -> features one step later (N, 256)."""
        x = leaky_relu(self.first(torch.cat([before, one_hot(action, len(Action))], dim=1)))
        for block in self.blocks:
            x = x + block(x)
        return before + self.last(x)


def _chart(map: MapState) -> np.ndarray:
    """(2, 32, 32) float32: which share of each block around the middle of the map is occupied, and explored."""
    side = max(1, round(BLOCK / map.cell))
    half, first = BLOCKS_A_SIDE * side // 2, len(map.explored) // 2
    known = np.pad(np.stack([map.occupied, map.explored]), ((0, 0), (half, half), (half, half)))
    return block_shares(known[:, first : first + 2 * half, first : first + 2 * half], side)


def _image(observation: Observation) -> np.ndarray:
    """(4, 42, 42) float32, colours and depth from 0 to 1."""
    rgb = Image.fromarray(observation.rgb).resize((SIDE, SIDE), Image.Resampling.BOX)
    depth = Image.fromarray(np.minimum(observation.depth, np.float32(FAR)))
    channels = [np.asarray(rgb, np.float32) / 255, np.asarray(depth.resize((SIDE, SIDE), Image.Resampling.BOX)) / FAR]
    return np.ascontiguousarray(np.dstack(channels).transpose(2, 0, 1))
