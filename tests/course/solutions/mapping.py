"""Notebook 02: right answers in other styles, wrong ones with the start of the hint that they get."""

import math

import numpy as np
import torch
from scipy import optimize


def marked_matrix(right, up, depth, pose, origin, cell):
    if depth < 0.5 or depth > 5:
        return np.zeros(0, int)
    point = pose @ [depth * right, depth * up, -depth, 1]
    cells = np.floor((point[1::-1] - origin[::-1]) / cell)
    return np.append(cells, 0.25 <= point[2] < 0.9).astype(int)


def marked_torch(right, up, depth, pose, origin, cell):
    if not 0.5 <= depth <= 5:
        return torch.zeros(0, dtype=torch.long)
    pose = torch.tensor(pose)
    x, y, z = pose[:3, :3] @ torch.tensor([right, up, -1.0]).double() * depth + pose[:3, 3]
    row, column = ((y - origin[1]) / cell).floor(), ((x - origin[0]) / cell).floor()
    return torch.stack([row, column, ((z >= 0.25) & (z <= 0.88 + 1e-6)).double()]).long()


def marked_plain(right, up, depth, pose, origin, cell, low=0.25, near=0.5, far=5.0, swap=False):
    if not near <= depth <= far:
        return []
    local = (right, up, -1)
    x, y, z = (pose[i, 3] + depth * sum(pose[i, j] * local[j] for j in range(3)) for i in range(3))
    where = [math.floor((y - origin[1]) / cell), math.floor((x - origin[0]) / cell)]
    return (where[::-1] if swap else where) + [low <= z <= pose[2, 3] + 0.01]


def root(a, b):
    if abs(a - b) >= 1:
        return min(a, b) + 1
    return optimize.brentq(lambda t: (t - a) ** 2 + (t - b) ** 2 - 1, max(a, b), max(a, b) + 1)


def bisection(a, b):
    low, high = min(a, b), min(a, b) + 1
    for _ in range(60):
        t = (low + high) / 2
        low, high = (low, t) if max(t - a, 0) ** 2 + max(t - b, 0) ** 2 > 1 else (t, high)
    return t


RIGHT = {
    "02-world-to-cell": (
        lambda x, y, o, c: np.floor((np.array([y, x]) - o[::-1]) / c).astype(int),
        lambda x, y, o, c: (math.floor((y - o[1]) / c), math.floor((x - o[0]) / c)),
        lambda x, y, o, c: [int((y - o[1]) // c), int((x - o[0]) // c)],
        lambda x, y, o, c: torch.floor((torch.tensor([y, x]) - torch.tensor(o[::-1].copy())) / c).long(),
        lambda x, y, o, c: np.floor_divide([y - o[1], x - o[0]], c).astype(np.int32),
    ),
    "02-marked": (
        marked_matrix,
        marked_torch,
        marked_plain,
        lambda *args: tuple(marked_plain(*args)),
        lambda *args: marked_matrix(*args).tolist(),
    ),
    "02-eikonal-update": (
        root,
        bisection,
        lambda a, b: torch.tensor(root(a, b), requires_grad=True),
        lambda a, b: np.float32(root(a, b)),
        lambda a, b: min(a, b) + (1 if abs(a - b) >= 1 else (abs(a - b) + math.sqrt(2 - abs(a - b) ** 2)) / 2),
        lambda a, b: np.roots([2, -2 * (a + b), a * a + b * b - 1]).real.max() if abs(a - b) < 1 else min(a, b) + 1,
    ),
}
WRONG = {
    "02-world-to-cell": (
        ("they are floats", lambda x, y, o, c: [np.floor((y - o[1]) / c), np.floor((x - o[0]) / c)]),
        ("they are floats", lambda x, y, o, c: torch.floor((torch.tensor([y, x]) - torch.tensor(o[::-1].copy())) / c)),
        ("they are floats", lambda x, y, o, c: ((y - o[1]) // c, (x - o[0]) // c)),
        ("Row and column", lambda x, y, o, c: np.floor((np.array([x, y]) - o) / c).astype(int)),
        ("int() rounds", lambda x, y, o, c: ((np.array([y, x]) - o[::-1]) / c).astype(int)),
        ("int() rounds", lambda x, y, o, c: (math.trunc((y - o[1]) / c), math.trunc((x - o[0]) / c))),
        ("Cell [0, 0]", lambda x, y, o, c: [int(y // c), int(x // c)]),
        ("got [4.2, 2.4]", lambda x, y, o, c: [(y - o[1]) / c, (x - o[0]) / c]),
    ),
    "02-marked": (
        ("they are floats", lambda *args: [float(value) for value in marked_plain(*args)]),
        ("The range of the sensor", lambda *args: marked_plain(*args, near=-1, far=99)),
        ("Ignore depths below", lambda *args: marked_plain(*args, near=0)),
        ("Ignore depths above", lambda *args: np.array(marked_plain(*args, far=99), int)),
        ("The floor is not", lambda *args: marked_plain(*args, low=-0.1)),
        ("Row and column", lambda *args: marked_plain(*args, swap=True)),
    ),
    "02-eikonal-update": (
        ("This is Dijkstra", lambda a, b: np.minimum(a, b) + 1),
        ("If |a - b| >= 1, the quadratic", lambda a, b: 0.5 * (a + b + np.sqrt(2 - np.square(a - b)))),
        (
            "Between |a - b| = 1",
            lambda a, b: 0.5 * (a + b + np.sqrt(q)) if (q := 2 - (a - b) ** 2) > 0 else min(a, b) + 1,
        ),
        ("Take the larger", lambda a, b: min(a, b) + 1 if abs(a - b) >= 1 else a + b - root(a, b)),
        ("The division by two", lambda a, b: min(a, b) + 1 if abs(a - b) >= 1 else torch.tensor(2 * root(a, b))),
        ("The cell is reached", lambda a, b: root(a, b) if abs(a - b) < 1 else 1 + max(a, b)),
    ),
}
