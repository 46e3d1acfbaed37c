"""Scene box: full resolution around the training positions, the rest of the world contracted into a shell."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    import torch


@dataclass(frozen=True)
class SceneBox:
    """Map from the whole world to the unit cube, separate for each axis and continuously differentiable.

    Inside the box the map is linear, so that cells are cubes of a known size in metres. Outside, with u the distance
    from the centre in half sizes, u > 1 becomes 1 + s - s^2 / (u - 1 + s): the contraction of Barron et al. 2022 for a
    shell of thickness s (s = 1 in their paper).
    """

    center: np.ndarray  # (3,) float32 metres, coordinates of the field
    half: np.ndarray  # (3,) float32 half size, metres
    shell: float  # thickness of the shell, half sizes

    @classmethod
    def around(cls, positions: np.ndarray, margin: float, shell: float) -> "SceneBox":
        """Return the box that extends ``margin`` metres beyond all (N, 3) positions."""
        low, high = positions.min(axis=0) - margin, positions.max(axis=0) + margin
        return cls(((low + high) / 2).astype(np.float32), ((high - low) / 2).astype(np.float32), shell)

    @property
    def size(self) -> np.ndarray:
        """(3,) float64 size of the unit cube in metres, by the scale inside the box."""
        return 2 * self.half.astype(np.float64) * (1 + self.shell)

    def contract(self, points: np.ndarray) -> np.ndarray:
        """Map (N, 3) points to (N, 3) float32 in the unit cube.

        Example:
            >>> box = SceneBox(np.zeros(3, np.float32), np.ones(3, np.float32), 1.0)
            >>> box.contract(np.array([[0.0, 1.0, 1e9]]))
            array([[0.5 , 0.75, 1.  ]], dtype=float32)
        """
        u = (np.asarray(points, np.float32) - self.center) / self.half
        beyond = np.maximum(np.abs(u) - 1, 0)
        contracted = np.sign(u) * (1 + self.shell - self.shell**2 / (beyond + self.shell))
        return ((np.where(beyond > 0, contracted, u) / (1 + self.shell) + 1) / 2).astype(np.float32)

    def contract_tensor(self, points: "torch.Tensor") -> "torch.Tensor":
        """Map (..., 3) tensors on any device as :meth:`contract` does; differentiable."""
        u = (points - points.new_tensor(self.center)) / points.new_tensor(self.half)
        beyond = u.abs() - 1
        contracted = u.sign() * (1 + self.shell - self.shell**2 / (beyond.clamp(min=0) + self.shell))
        return (contracted.where(beyond > 0, u) / (1 + self.shell) + 1) / 2

    def expand(self, x: np.ndarray) -> np.ndarray:
        """Map (N, 3) points of the open unit cube to (N, 3) float32 points; inverse of :meth:`contract`.

        Example:
            >>> box = SceneBox(np.zeros(3, np.float32), np.ones(3, np.float32), 1.0)
            >>> box.expand(np.array([[0.5, 0.75, 0.875]])).tolist()
            [[0.0, 1.0, 2.0]]
        """
        u = (2 * np.asarray(x, np.float64) - 1) * (1 + self.shell)
        beyond = self.shell**2 / np.maximum(1 + self.shell - np.abs(u), 1e-6) - self.shell
        return (np.where(np.abs(u) > 1, np.sign(u) * (1 + beyond), u) * self.half + self.center).astype(np.float32)
