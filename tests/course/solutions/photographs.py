"""Notebook 13: right answers in other styles, wrong ones with the start of the hint that they get."""

import cmath
import math

import numpy as np
import torch
from scipy.spatial.transform import RigidTransform, Rotation

FLIP = np.diag([1.0, -1, -1])
QUARTER = Rotation.from_euler("x", 90, degrees=True)


def upright_loop(point):
    matrix = [[1, 0, 0], [0, 0, -1], [0, 1, 0]]
    return [sum(a * b for a, b in zip(row, point, strict=True)) for row in matrix]


def matrix_of(rotation, translation):
    return np.vstack([np.c_[rotation, translation], [0, 0, 0, 1]])


def pose_torch(rotation, translation):
    r, t = (
        torch.tensor(rotation, dtype=torch.float32, requires_grad=True),
        torch.tensor(translation, dtype=torch.float32),
    )
    top = torch.cat([r.T * torch.tensor([1.0, -1, -1]), (-r.T @ t)[:, None]], 1)
    return torch.cat([top, torch.tensor([[0.0, 0, 0, 1]])])


def pose_loop(rotation, translation):
    rows = [[(1, -1, -1)[j] * rotation[j, i] for j in range(3)] for i in range(3)]
    position = [-sum(rotation[j, i] * translation[j] for j in range(3)) for i in range(3)]
    return [[*row, p] for row, p in zip(rows, position, strict=True)] + [[0, 0, 0, 1]]


def seen_complex(x, y, k1, k2):
    z = complex(x, y)
    z += z * (k1 * abs(z) ** 2 + k2 * abs(z) ** 4)
    return [z.real, z.imag]


def seen_polar(x, y, k1, k2):
    r, angle = cmath.polar(x + 1j * y)
    r = r + k1 * r**3 + k2 * r**5
    return r * math.cos(angle), r * math.sin(angle)


RIGHT = {
    "13-upright": (
        upright_loop,
        QUARTER.apply,
        lambda p: (p[0], -p[2], p[1]),
        lambda p: torch.tensor(p, requires_grad=True)[[0, 2, 1]] * torch.tensor([1, -1, 1]),
        lambda p: np.float32([[1, 0, 0], [0, 0, -1], [0, 1, 0]]) @ np.float32(p),
        lambda p: np.add(np.cross([1, 0, 0], p), [p[0], 0, 0]),
    ),
    "13-camera-to-world": (
        pose_torch,
        pose_loop,
        lambda r, t: np.linalg.inv(np.diag([1, -1, -1, 1]) @ matrix_of(r, t)),
        lambda r, t: RigidTransform.from_components(t, Rotation.from_matrix(r)).inv().as_matrix() * [1, -1, -1, 1],
        lambda r, t: np.float32(matrix_of(np.linalg.solve(r, FLIP), np.linalg.solve(r, -t))),
    ),
    "13-seen-at": (
        seen_complex,
        seen_polar,
        lambda x, y, k1, k2: (
            torch.tensor([x, y], requires_grad=True) * (1 + k1 * (x**2 + y**2) + k2 * (x**2 + y**2) ** 2)
        ),
        lambda x, y, k1, k2: np.float32([x, y]) * np.polyval([k2, k1, 1], np.float32(x * x + y * y)),
        lambda x, y, k1, k2: [v * (1 + k1 * math.hypot(x, y) ** 2 + k2 * math.hypot(x, y) ** 4) for v in (x, y)],
    ),
}
WRONG = {
    "13-upright": (
        ("The room is mirrored:", lambda p: [p[0], p[2], p[1]]),
        ("The room is upside down", lambda p: QUARTER.inv().apply(p)),
        ("The room is mirrored and", lambda p: torch.tensor([p[0], -p[2], -p[1]])),
        ("The point is unchanged", lambda p: p),
        ("The axes are permuted", lambda p: np.roll(p, 1)),
    ),
    "13-camera-to-world": (
        ("These are OpenCV axes", lambda r, t: np.linalg.inv(matrix_of(r, t))),
        ("This is still world-to-camera", lambda r, t: matrix_of(r, t) @ np.diag([1, -1, -1, 1])),
        ("The translation t is not", lambda r, t: matrix_of(r.T @ FLIP, t)),
        ("The sign of the position", lambda r, t: matrix_of(r.T @ FLIP, r.T @ t)),
        ("The position is -R", lambda r, t: torch.tensor(matrix_of(r.T @ FLIP, -t))),
        ("got shape (3, 4)", lambda r, t: pose_loop(r, t)[:3]),
    ),
    "13-seen-at": (
        (
            "The powers are wrong",
            lambda x, y, k1, k2: [v * (1 + k1 * math.hypot(x, y) + k2 * (x * x + y * y)) for v in (x, y)],
        ),
        ("This is only the displacement", lambda x, y, k1, k2: np.subtract(seen_polar(x, y, k1, k2), (x, y))),
        ("Radial distortion", lambda x, y, k1, k2: [v + k1 * v**3 + k2 * v**5 for v in (x, y)]),
        ("The term with k2", lambda x, y, k1, k2: torch.tensor(seen_complex(x, y, k1, 0))),
    ),
}
