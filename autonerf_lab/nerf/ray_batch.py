"""Records exchanged by fields, samplers and models. R: rays, S: samples per ray, C: classes.

Lengths are in units of the field, which are metres for trajectories.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

if TYPE_CHECKING:
    import torch

NO_LABEL = -1
NO_DEPTH = 0.0

Array: TypeAlias = "np.ndarray | torch.Tensor"
Arrays = dict[str, Any]  # name -> Array


@dataclass(frozen=True)
class Rays:
    """R rays in the coordinates of the field; any number of them."""

    origins: np.ndarray  # (R, 3) float32
    directions: np.ndarray  # (R, 3) float32, unit
    frames: np.ndarray | None = None  # (R,) int64, index of the training image of each ray; None: not from an image
    depth: np.ndarray | None = None  # (R,) float32, measured along the ray, NO_DEPTH for none; None: new view

    def __len__(self) -> int:
        """Return the number of rays."""
        return len(self.origins)


@dataclass(frozen=True)
class Targets:
    """Ground truth of R rays."""

    color: np.ndarray  # (R, 3) float32 in [0, 1]
    labels: np.ndarray  # (R,) int64 class index, NO_LABEL for none
    depth: np.ndarray  # (R,) float32, along the ray, NO_DEPTH for none
    trust: np.ndarray | None = None  # (R,) float32, weight of the label in the loss, its confidence; None: 1
    importance: np.ndarray | None = None  # (R,) float32, weight of the squared colour error in the loss; None: 1


@dataclass(frozen=True)
class Samples:
    """S bins on each ray, ordered and without overlap. Space between two bins counts as empty."""

    starts: np.ndarray  # (R, S) float32, along the ray
    ends: np.ndarray  # (R, S) float32
    record: Any = None  # data that the sampler stores for its own training step

    @property
    def midpoints(self) -> np.ndarray:
        """(R, S) float32 distances at which the field is queried."""
        return np.float32(0.5) * (self.starts + self.ends)

    @classmethod
    def between(cls, edges: np.ndarray, record: Any = None) -> "Samples":
        """Return the S bins between (R, S + 1) increasing distances."""
        return cls(np.ascontiguousarray(edges[:, :-1]), np.ascontiguousarray(edges[:, 1:]), record)


@dataclass(frozen=True)
class TrainOutput:
    """Result of a field's training step on R rays."""

    gradients: Arrays  # by parameter name
    losses: dict[str, float]
    weights: np.ndarray  # (R, S) float32, volume-rendering weights of the samples
    d_origins: np.ndarray | None = None  # (R, 3) float32, gradient of the origins if requested
    d_directions: np.ndarray | None = None  # (R, 3) float32, gradient of the directions if requested


@dataclass(frozen=True)
class RenderOutput:
    """Rendered values of R rays."""

    color: np.ndarray  # (R, 3) float32; the remaining transmittance shows black
    logits: np.ndarray  # (R, C) float32
    depth: np.ndarray  # (R,) float32, along the ray, median of the weights
    weights: np.ndarray  # (R, S) float32


def to_numpy(value: Array) -> np.ndarray:
    """Return the values of an array or tensor as an array."""
    return value if isinstance(value, np.ndarray) else value.detach().cpu().numpy()


def restore(group: dict[str, Any], name: str, value: np.ndarray) -> None:
    """Overwrite the array or tensor ``name`` of a group in place; an empty array is replaced, its shape was not known.

    Raises:
        ValueError: the shapes, or the types of a replaced array, differ.
    """
    known = group[name]
    if isinstance(known, np.ndarray) and known.size == 0 and known.ndim == value.ndim and known.dtype == value.dtype:
        group[name] = value
    else:
        assign(known, value)


def assign(target: Array, value: np.ndarray) -> None:
    """Overwrite an array or tensor in place.

    Raises:
        ValueError: the shapes differ.
    """
    if tuple(target.shape) != value.shape:
        raise ValueError(f"shape {value.shape}, not {tuple(target.shape)}")
    if isinstance(target, np.ndarray):
        target[...] = value
    else:
        target.data[...] = target.new_tensor(value)
