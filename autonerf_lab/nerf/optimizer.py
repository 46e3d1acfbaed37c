"""Adam over named arrays, with everything a checkpoint needs."""

import numpy as np

from autonerf_lab.nerf.kernels.adam import adam


class Adam:
    """Kingma and Ba 2015, for the gradients of one model (beta 0.9, 0.99; epsilon 1e-15, as Nerfacto has it).

    Entries of the hash tables that a batch did not touch keep their value and their moments.
    """

    def __init__(self, parameters: dict[str, np.ndarray]) -> None:
        self.parameters = parameters
        self.steps = {name: 0 for name in parameters}
        self.first = {name: np.zeros_like(value) for name, value in parameters.items()}
        self.second = {name: np.zeros_like(value) for name, value in parameters.items()}

    def step(self, gradients: dict[str, np.ndarray], rates: dict[str, float]) -> None:
        """One update of every parameter that has a gradient, each with its rate; gradients are cleared."""
        for name, gradient in gradients.items():
            self.steps[name] += 1
            adam(
                self.parameters[name].reshape(-1),
                gradient.reshape(-1),
                self.first[name].reshape(-1),
                self.second[name].reshape(-1),
                np.float32(rates[name]),
                np.float32(0.9),
                np.float32(0.99),
                np.float32(1e-15),
                self.steps[name],
            )
