"""What passes between fields, samplers and models: rays, bins on them, what they should show and what they show."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch

NO_LABEL = -1
NO_DEPTH = 0.0

Array = np.ndarray | torch.Tensor
Arrays = dict[str, Any]  # name -> Array


@dataclass(frozen=True)
class Rays:
    """R rays, world frame; R is a multiple of 16 wherever fields and samplers see them."""

    origins: np.ndarray  # (R, 3) float32, metres
    directions: np.ndarray  # (R, 3) float32, unit
    frames: np.ndarray | None = None  # (R,) int64, the training image of each; None: of no image

    def __len__(self) -> int:
        return len(self.origins)


@dataclass(frozen=True)
class Targets:
    """What the rays should show."""

    color: np.ndarray  # (R, 3) float32 in [0, 1]
    labels: np.ndarray  # (R,) int64, NO_LABEL where there is none
    depth: np.ndarray  # (R,) float32, metres along the ray, NO_DEPTH where there is none


@dataclass(frozen=True)
class Samples:
    """Bins on each ray, in order and without overlap. Between two of them there is nothing."""

    starts: np.ndarray  # (R, S) float32, metres along the ray
    ends: np.ndarray  # (R, S)
    record: Any = None  # what the sampler wants to remember until it learns

    @property
    def middles(self) -> np.ndarray:
        """(R, S), where the field is asked."""
        return np.float32(0.5) * (self.starts + self.ends)

    @classmethod
    def between(cls, edges: np.ndarray, record: Any = None) -> "Samples":
        """The S bins between (R, S + 1) increasing distances."""
        return cls(np.ascontiguousarray(edges[:, :-1]), np.ascontiguousarray(edges[:, 1:]), record)


@dataclass(frozen=True)
class Learned:
    """What a training step of a field yields."""

    gradients: Arrays  # by parameter name
    losses: dict[str, float]
    weights: np.ndarray  # (R, S) of the samples
    d_origins: np.ndarray | None = None  # (R, 3) gradient of the rays, where it was asked for
    d_directions: np.ndarray | None = None


@dataclass(frozen=True)
class Rendered:
    """What R rays show."""

    color: np.ndarray  # (R, 3) float32; light that nothing stopped is black
    logits: np.ndarray  # (R, C) float32
    depth: np.ndarray  # (R,) float32, metres along the ray where half of the light is collected
    weights: np.ndarray  # (R, S) float32


def to_numpy(value: Array) -> np.ndarray:
    """The values of an array or tensor."""
    return value.detach().cpu().numpy() if isinstance(value, torch.Tensor) else value


def assign(target: Array, value: np.ndarray) -> None:
    """Overwrite in place.

    Raises:
        ValueError: the shapes differ.
    """
    if tuple(target.shape) != value.shape:
        raise ValueError(f"shape {value.shape}, not {tuple(target.shape)}")
    if isinstance(target, torch.Tensor):
        with torch.no_grad():
            target.copy_(torch.from_numpy(value))
    else:
        target[...] = value
