"""Symmetry group of the square, for :class:`~autonerf_lab.policies.interfaces.CompactInterface`.

Rotations and reflections of an apartment are equally likely and equally good to explore. Training samples one of the
eight symmetries per episode (:mod:`autonerf_lab.training.augmentation`); a rollout averages the network over all eight.
"""

import itertools
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn
from torch.distributions import Categorical, Distribution

from autonerf_lab.policies.interfaces import CompactInterface


@dataclass(frozen=True)
class SquareSymmetry:
    """Symmetry of the square: an optional transposition, then optional reflections of x and of y.

    Example:
        >>> symmetry = SquareSymmetry.sample(np.random.default_rng(0))
        >>> symmetry.invert_action(symmetry.transform_action(77))
        77
    """

    swap: bool = False  # exchange rows and columns
    flip_x: bool = False  # reverse the columns
    flip_y: bool = False  # reverse the rows

    @classmethod
    def sample(cls, rng: np.random.Generator) -> "SquareSymmetry":
        """Sample one of the eight symmetries."""
        return cls(*(bool(bit) for bit in rng.integers(2, size=3)))

    def transform_observation(self, obs: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        """Transform an observation, or a batch of observations."""
        x, y = obs["heading"][..., 0], obs["heading"][..., 1]
        images = [obs["map"], obs["reach"]]
        if self.swap:
            images, (x, y) = [image.swapaxes(-1, -2) for image in images], (y, x)
        if self.flip_x:
            images, x = [image[..., ::-1] for image in images], -x
        if self.flip_y:
            images, y = [image[..., ::-1, :] for image in images], -y
        maps, reach = (np.ascontiguousarray(image) for image in images)
        return {"map": maps, "reach": reach, "heading": np.stack([x, y], axis=-1).astype(np.float32)}

    def transform_action(self, action: Any) -> Any:
        """Return the index of a block, or of an array of blocks, in the transformed frame."""
        row, col = divmod(action, CompactInterface.GRID)
        if self.swap:
            row, col = col, row
        return self._flipped(row, col)

    def invert_action(self, action: Any) -> Any:
        """Return the index in the original frame of a block of the transformed frame."""
        row, col = divmod(self._flipped(*divmod(action, CompactInterface.GRID)), CompactInterface.GRID)
        if self.swap:
            row, col = col, row
        return row * CompactInterface.GRID + col

    def _flipped(self, row: Any, col: Any) -> Any:
        last = CompactInterface.GRID - 1
        return (last - row if self.flip_y else row) * CompactInterface.GRID + (last - col if self.flip_x else col)


SYMMETRIES = tuple(SquareSymmetry(*bits) for bits in itertools.product((False, True), repeat=3))


class SymmetryAveraged(nn.Module):
    """Network whose logits and value are the mean over the eight symmetries of an observation.

    A network trained with all symmetries is only approximately equivariant; the mean is exactly equivariant and less
    noisy. On the development scenes it adds at least 0.5 % to every area under the coverage curve.

    Args:
        network: trained network, such as :class:`~autonerf_lab.policies.networks.CompactNetwork`.

    Example:
        >>> from autonerf_lab.policies import make_policy
        >>> from autonerf_lab.policies.networks import batched
        >>> rng = np.random.default_rng(0)
        >>> spaces = CompactInterface().observation_space
        >>> obs = {name: rng.random(space.shape, np.float32) for name, space in spaces.items()}
        >>> network, symmetry = make_policy("modular-cov").network, SYMMETRIES[5]
        >>> images = obs, symmetry.transform_observation(obs)
        >>> plain, transformed = (network(batched([image]))[0].probs[0] for image in images)
        >>> blocks = symmetry.transform_action(np.arange(1024))
        >>> plain.std() > 1e-4, torch.allclose(plain, transformed[blocks], atol=1e-6)
        (tensor(True), True)
    """

    def __init__(self, network: nn.Module) -> None:
        super().__init__()
        self.network = network
        blocks = np.arange(CompactInterface.GRID**2)
        self._blocks = [torch.from_numpy(symmetry.transform_action(blocks)) for symmetry in SYMMETRIES]

    def forward(self, obs: dict[str, Tensor]) -> tuple[Distribution, Tensor]:
        """Return a Categorical over 1024 blocks, batch shape (B,), and the values, (B,)."""
        plain = {name: value.numpy() for name, value in obs.items()}
        images = [symmetry.transform_observation(plain) for symmetry in SYMMETRIES]
        distribution, value = self.network(
            {name: torch.from_numpy(np.concatenate([image[name] for image in images])) for name in plain}
        )
        logits = distribution.logits.unflatten(0, (len(SYMMETRIES), -1))
        mean = torch.stack([logits[k][:, blocks] for k, blocks in enumerate(self._blocks)]).mean(dim=0)
        return Categorical(logits=mean, validate_args=False), value.unflatten(0, (len(SYMMETRIES), -1)).mean(dim=0)
