"""Adam over named arrays and tensors, and the mean of its last parameters, with their state open to checkpoints."""

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from autonerf_lab.nerf.kernels.adam import BETA_1, BETA_2, EPSILON, MAX_GRADIENT, adam
from autonerf_lab.nerf.ray_batch import Array, Arrays, assign, to_numpy

if TYPE_CHECKING:
    import torch


class Adam:
    """Adam (Kingma and Ba 2015) for the parameters of one model.

    Entries with zero gradient keep their value and moments, because a batch touches few entries of a hash table.

    Args:
        parameters: arrays or tensors by name, updated in place.

    Attributes:
        steps: number of updates by parameter name.
        first, second: moments by parameter name.
    """

    def __init__(self, parameters: Arrays) -> None:
        self.parameters = parameters
        self.steps = {name: 0 for name in parameters}
        self.first = {name: _zeros_like(value) for name, value in parameters.items()}
        self.second = {name: _zeros_like(value) for name, value in parameters.items()}

    def step(self, gradients: Arrays, rates: dict[str, float]) -> None:
        """Update the parameters that have a gradient, each with its learning rate; numpy gradients are cleared."""
        for name, gradient in gradients.items():
            self.steps[name] += 1
            arrays = self.parameters[name], gradient, self.first[name], self.second[name]
            update: Callable = _update_array if isinstance(gradient, np.ndarray) else _update_tensor
            update(*arrays, rates[name], self.steps[name])


class ParameterAverage:
    """Mean of the parameters over the last steps of a training (Izmailov et al. 2018, "Averaging Weights").

    It takes away the noise of a large learning rate, without which a short training would end too early.

    Args:
        parameters: arrays or tensors by name.

    Attributes:
        sums: sums of the added parameters by name.
        count: number of added parameters.

    Example:
        >>> parameters = {"w": np.array([1.0])}
        >>> average = ParameterAverage(parameters)
        >>> average.add()
        >>> parameters["w"] += 2
        >>> average.add()
        >>> average.apply()
        >>> parameters["w"].tolist()
        [2.0]
    """

    def __init__(self, parameters: Arrays) -> None:
        self.parameters = parameters
        self.sums: Arrays = {name: _zeros_like(value) for name, value in parameters.items()}
        self.count = 0

    def add(self) -> None:
        """Add the present parameters."""
        for name, value in self.parameters.items():
            self.sums[name] += value if isinstance(value, np.ndarray) else value.detach()
        self.count += 1

    def apply(self) -> None:
        """Replace the parameters by their mean, if any were added."""
        if self.count:
            for name, total in self.sums.items():
                assign(self.parameters[name], to_numpy(total / self.count))


def _zeros_like(value: Array) -> Array:
    return np.zeros_like(value) if isinstance(value, np.ndarray) else value.new_zeros(value.shape)


def _update_array(p: np.ndarray, g: np.ndarray, m: np.ndarray, v: np.ndarray, rate: float, step: int) -> None:
    p, g, m, v = (array.reshape(-1) for array in (p, g, m, v))
    adam(p, g, m, v, np.float32(rate), step)


def _update_tensor(
    p: "torch.Tensor", g: "torch.Tensor", m: "torch.Tensor", v: "torch.Tensor", rate: float, step: int
) -> None:
    touched = (g != 0).to(g.dtype)
    g = g.clamp(-float(MAX_GRADIENT), float(MAX_GRADIENT))
    m.lerp_(g, touched * (1 - BETA_1))
    v.lerp_(g * g, touched * (1 - BETA_2))
    direction = (m / (1 - BETA_1**step)) / ((v / (1 - BETA_2**step)).sqrt() + EPSILON)
    p.data.sub_(rate * touched * direction)
