"""Pose graph in SE(2): nodes are poses, edges are measured motions between them (Grisetti et al. 2010).

Each edge is a quadratic function of the deviation from its motion, see
:class:`~autonerf_lab.localization.scan_matching.ScanFactor`. Gauss-Newton steps on the sparse normal equations minimise
their sum. The first pose is fixed.
"""

import numpy as np
from scipy.sparse import csc_matrix
from scipy.sparse.linalg import splu

from autonerf_lab.localization.se2 import between

_FIRST = 1e12  # information of the first pose
_REGULAR = 1.0  # 1/m2, added to the information of edges that do not fix all of the pose
_KERNEL = 12.0  # squared Mahalanobis distance from which an edge loses weight (Agarwal et al. 2013)


class PoseGraph:
    """Pose graph.

    Args:
        start: (3,) first pose: x, y, heading.

    Example:
        >>> graph = PoseGraph(np.zeros(3))
        >>> for x in (1.1, 2.2):
        ...     _ = graph.add_pose(np.array([x, 0.0, 0.0]))
        >>> for i, j, x, weight in ((0, 1, 1.1, 1.0), (1, 2, 1.1, 1.0), (0, 2, 2.0, 100.0)):
        ...     graph.add_edge(i, j, np.array([x, 0.0, 0.0]), weight * np.eye(3))
        >>> covariance = graph.optimize()
        >>> graph.poses[:, 0].round(3)
        array([0.   , 1.   , 2.001])
    """

    def __init__(self, start: np.ndarray) -> None:
        self._poses = np.empty((64, 3))
        self._poses[0] = start
        self._count = 1
        self._edges: list[tuple[int, int]] = []
        self._motions: list[np.ndarray] = []
        self._information: list[np.ndarray] = []
        self._gradients: list[np.ndarray] = []
        self._minima: list[np.ndarray] = []  # deviations at which the edges are smallest

    @property
    def poses(self) -> np.ndarray:
        """(N, 3) current estimates."""
        return self._poses[: self._count]

    def add_pose(self, pose: np.ndarray) -> int:
        """Add a node with an initial estimate (3,), and return its index."""
        if self._count == len(self._poses):
            self._poses = np.concatenate([self._poses, np.empty_like(self._poses)])
        self._poses[self._count] = pose
        self._count += 1
        return self._count - 1

    def add_edge(
        self, i: int, j: int, motion: np.ndarray, information: np.ndarray, gradient: np.ndarray | None = None
    ) -> None:
        """Add a measured motion (3,) from node i to node j, with its (3, 3) information in the frame of node i."""
        self._edges.append((i, j))
        self._motions.append(motion)
        self._information.append(information)
        self._gradients.append(np.zeros(3) if gradient is None else gradient)
        regular = information + _REGULAR * np.eye(3)
        self._minima.append(np.zeros(3) if gradient is None else -np.linalg.solve(regular, gradient))

    def optimize(self, iterations: int = 2, tolerance: float = 1e-5) -> np.ndarray:
        """Move the poses to the minimum; stop if no number changes by more than ``tolerance``.

        Returns:
            (3, 3) covariance of the last pose, world frame.
        """
        last = np.zeros((3 * self._count, 3))
        last[-3:] = np.eye(3)
        for _ in range(iterations):
            matrix, gradient = self._normal_equations()
            factors = splu(matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0)
            step = factors.solve(-gradient).reshape(-1, 3)
            self.poses[:] += step
            if np.abs(step).max() < tolerance:
                break
        return factors.solve(last)[-3:]

    def _normal_equations(self) -> tuple[csc_matrix, np.ndarray]:
        n = self._count
        diagonal, gradient = np.zeros((n, 3, 3)), np.zeros((n, 3))
        diagonal[0] = _FIRST * np.eye(3)
        if not self._edges:
            return csc_matrix(_FIRST * np.eye(3)), gradient.ravel()
        edges = np.array(self._edges)
        i, j = edges.T
        h, b = np.array(self._information), np.array(self._gradients)
        motion = between(self.poses[i], self.poses[j])
        deviation = motion - np.array(self._motions)
        deviation[:, 2] = (deviation[:, 2] + np.pi) % (2 * np.pi) - np.pi
        c, s = np.cos(self.poses[i, 2]), np.sin(self.poses[i, 2])
        to_j = np.zeros((len(i), 3, 3))  # derivative of the motion by pose j
        to_j[:, 0, 0], to_j[:, 0, 1], to_j[:, 1, 0], to_j[:, 1, 1], to_j[:, 2, 2] = c, s, -s, c, 1
        to_i = -to_j
        to_i[:, 0, 2], to_i[:, 1, 2] = motion[:, 1], -motion[:, 0]
        apart = deviation - np.array(self._minima)
        distance = np.einsum("ei,eij,ej->e", apart, h, apart)
        weight = np.minimum(1.0, 2 * _KERNEL / (_KERNEL + distance)) ** 2
        h, b = weight[:, None, None] * h, weight[:, None] * b
        slope = np.einsum("eij,ej->ei", h, deviation) + b
        np.add.at(gradient, i, np.einsum("eji,ej->ei", to_i, slope))
        np.add.at(gradient, j, np.einsum("eji,ej->ei", to_j, slope))
        hi, hj = h @ to_i, h @ to_j
        ti, tj = to_i.transpose(0, 2, 1), to_j.transpose(0, 2, 1)
        np.add.at(diagonal, i, ti @ hi)
        np.add.at(diagonal, j, tj @ hj)
        cross = ti @ hj
        nodes = np.arange(n)
        rows = np.concatenate([nodes, i, j])
        cols = np.concatenate([nodes, j, i])
        blocks = np.concatenate([diagonal, cross, cross.transpose(0, 2, 1)])
        offset = np.arange(3)
        shape = blocks.shape
        r = np.broadcast_to(3 * rows[:, None, None] + offset[:, None], shape).ravel()
        k = np.broadcast_to(3 * cols[:, None, None] + offset, shape).ravel()
        return csc_matrix((blocks.ravel(), (r, k)), shape=(3 * n, 3 * n)), gradient.ravel()
