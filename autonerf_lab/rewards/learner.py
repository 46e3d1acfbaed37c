"""Network with optimiser, shared by the learned rewards; its state is a dict of arrays."""

import math
from collections.abc import Callable, Mapping
from typing import TypeVar

import numpy as np
import torch

from autonerf_lab.errors import DataError, TrainingError

BATCH = 64
_MOMENTS = ("exp_avg", "exp_avg_sq")

State = dict[str, np.ndarray]
Network = TypeVar("Network", bound=torch.nn.Module)


def seeded(make: Callable[[], Network], seed: int) -> Network:
    """Make a network with seeded initial parameters; the state of torch's global generator is restored.

    One thread makes them: orthogonal matrices are rounded differently by another number of threads.
    """
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(seed)
            return make()
    finally:
        torch.set_num_threads(threads)


class Learner:
    """Network with its optimiser (Adam) and a counter of passes.

    Args:
        network: trained network.
        rate: learning rate.
        seed: random seed of the order of the samples.
    """

    def __init__(self, network: torch.nn.Module, rate: float, seed: int) -> None:
        self._network = network
        self._trainable = {k: p for k, p in network.named_parameters() if p.requires_grad}
        self._optimizer = torch.optim.Adam(self._trainable.values(), rate)
        self._seed, self._passes = seed, 0

    def learn(self, samples: int, loss: Callable[[torch.Tensor], torch.Tensor]) -> float:
        """Train for one pass.

        Args:
            samples: number of samples.
            loss: returns the mean loss of the samples with the given indices.

        Returns:
            The mean loss of the pass.

        Raises:
            TrainingError: the loss is not finite.
        """
        order = np.random.default_rng((self._seed, self._passes)).permutation(samples)
        self._passes += 1
        total = 0.0
        for rows in torch.from_numpy(order).split(BATCH):
            value = loss(rows)
            if not math.isfinite(value.item()):
                raise TrainingError(f"the loss of a learned reward is {value.item()} in pass {self._passes}")
            self._optimizer.zero_grad()
            value.backward()
            self._optimizer.step()
            total += value.item() * len(rows)
        return total / samples

    def state_dict(self) -> State:
        """Return parameters, their moments and number of steps, the seed and the number of passes."""
        state = {f"network.{k}": v.numpy().copy() for k, v in self._network.state_dict().items()}
        for name, parameter in self._trainable.items():
            moments = self._optimizer.state.get(parameter, {})
            state[f"steps.{name}"] = np.array(float(moments.get("step", 0)), np.float32)
            for moment in _MOMENTS:
                state[f"{moment}.{name}"] = moments.get(moment, torch.zeros_like(parameter)).detach().numpy().copy()
        return state | {"passes": np.array([self._seed, self._passes], np.int64)}

    def load_state_dict(self, state: Mapping[str, np.ndarray]) -> None:
        """Load a state that :func:`check_state` accepts."""
        tensors = {k: torch.from_numpy(np.array(v)) for k, v in state.items()}
        self._network.load_state_dict({k: tensors[f"network.{k}"] for k in self._network.state_dict()})
        for name, parameter in self._trainable.items():
            moments = {moment: tensors[f"{moment}.{name}"] for moment in _MOMENTS}
            self._optimizer.state[parameter] = {"step": tensors[f"steps.{name}"]} | moments
        self._seed, self._passes = (int(v) for v in state["passes"])


def check_state(expected: Mapping[str, np.ndarray], state: Mapping[str, np.ndarray]) -> None:
    """Check that a state has the names, shapes and types of the expected one, and finite values.

    Raises:
        DataError: names the first array that differs, or whose values are not finite.
    """
    for name in sorted({*expected, *state}):
        kinds = [f"{a.dtype} {a.shape}" if (a := d.get(name)) is not None else "missing" for d in (expected, state)]
        if kinds[0] != kinds[1]:
            raise DataError(f"the state belongs to another reward: {name!r} is {kinds[1]}, not {kinds[0]}")
        if not np.isfinite(state[name]).all():
            raise DataError(f"the state of the reward is damaged: {name!r} has values that are not finite")
