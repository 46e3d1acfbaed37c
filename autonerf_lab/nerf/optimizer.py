"""Adam over named arrays and tensors, with its state open to checkpoints."""

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from autonerf_lab.nerf.kernels.adam import MAX_GRADIENT, adam
from autonerf_lab.nerf.ray_batch import Array, Arrays

if TYPE_CHECKING:
    import torch

BETA_1, BETA_2, EPSILON = 0.9, 0.99, 1e-15  # values of Nerfacto


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


def _zeros_like(value: Array) -> Array:
    return np.zeros_like(value) if isinstance(value, np.ndarray) else value.new_zeros(value.shape)


def _update_array(p: np.ndarray, g: np.ndarray, m: np.ndarray, v: np.ndarray, rate: float, step: int) -> None:
    first, second, epsilon = np.float32(BETA_1), np.float32(BETA_2), np.float32(EPSILON)
    p, g, m, v = (array.reshape(-1) for array in (p, g, m, v))
    adam(p, g, m, v, np.float32(rate), first, second, epsilon, step)


def _update_tensor(
    p: "torch.Tensor", g: "torch.Tensor", m: "torch.Tensor", v: "torch.Tensor", rate: float, step: int
) -> None:
    touched = (g != 0).to(g.dtype)
    g = g.clamp(-float(MAX_GRADIENT), float(MAX_GRADIENT))
    m.lerp_(g, touched * (1 - BETA_1))
    v.lerp_(g * g, touched * (1 - BETA_2))
    direction = (m / (1 - BETA_1**step)) / ((v / (1 - BETA_2**step)).sqrt() + EPSILON)
    p.data.sub_(rate * touched * direction)
