"""Notebook 09: right answers in other styles, wrong ones with the start of the hint that they get."""

import math

import numpy as np
import torch
from scipy import ndimage
from scipy.spatial import KDTree
from scipy.spatial.distance import cdist


def tolerant_cdist(predicted, true, cell, tolerance, metric="euclidean"):
    near = cdist(np.argwhere(predicted) * cell, np.argwhere(true) * cell, metric) <= tolerance
    return 100 * np.array([near.any(axis=1).mean(), near.any(axis=0).mean()])


def tolerant_tree(predicted, true, cell, tolerance):
    a, b = cell * np.argwhere(predicted), cell * np.argwhere(true)
    return 100 * np.mean(KDTree(b).query(a)[0] <= tolerance), 100 * np.mean(KDTree(a).query(b)[0] <= tolerance)


def tolerant_transform(predicted, true, cell, tolerance):
    to_true = ndimage.distance_transform_edt(~true, sampling=cell)
    to_predicted = ndimage.distance_transform_edt(~predicted, sampling=cell)
    return [100 * (to_true[predicted] <= tolerance).mean(), 100 * (to_predicted[true] <= tolerance).mean()]


def tolerant_loops(predicted, true, cell, tolerance):
    def share(of, others):
        found = [any(cell * math.dist(p, q) <= tolerance for q in others) for p in of]
        return 100 * sum(found) / len(found)

    a, b = np.argwhere(predicted).tolist(), np.argwhere(true).tolist()
    return share(a, b), share(b, a)


def tolerant_torch(predicted, true, cell, tolerance):
    a, b = (torch.tensor(np.argwhere(mask)).float() * cell for mask in (predicted, true))
    near = torch.cdist(a, b) <= tolerance
    return 100 * torch.stack([near.any(1).float().mean(), near.any(0).float().mean()])


def spl_loop(success, length, shortest, limit=True, count=None):
    total = 0.0
    for s, p, b in zip(success, length, shortest, strict=True):
        if s:
            total += b / (max(p, b) if limit else p)
    return 100 * total / (count(success) if count else len(success))


RIGHT = {
    "09-alpha": (
        lambda s, d: -math.expm1(-s * d),
        lambda s, d: 1 - torch.exp(-torch.tensor(s, requires_grad=True) * d),
        lambda s, d: 1 - np.exp(np.float32(-s) * np.float32(d)),
        lambda s, d: 1 - 2 ** (-s * d / math.log(2)),
        lambda s, d: 1 - 1 / np.exp(d * s),
    ),
    "09-tolerant": (tolerant_cdist, tolerant_tree, tolerant_transform, tolerant_loops, tolerant_torch),
    "09-spl": (
        spl_loop,
        lambda s, p, b: 100 * (s @ np.minimum(1, b / p)) / len(s),
        lambda s, p, b: (torch.tensor(s) * torch.tensor(b) / torch.tensor(p).clamp(min=torch.tensor(b))).mean() * 100,
        lambda s, p, b: 100 * np.average([x * min(1.0, z / y) for x, y, z in zip(s, p, b, strict=True)]),
        lambda s, p, b: np.float32(100) * np.where(s > 0, b / np.fmax(p, b), 0).mean(dtype=np.float32),
    ),
}
WRONG = {
    "09-alpha": (
        ("The product can exceed", lambda s, d: torch.tensor(s) * d),
        ("This is the fraction", lambda s, d: math.exp(-s * d)),
        ("The length is missing", lambda s, d: -np.expm1(-s)),
        ("Multiply by the length", lambda s, d: -np.expm1(-s / d)),
        ("The minus sign", lambda s, d: -math.expm1(s * d)),
    ),
    "09-tolerant": (
        ("Only identical", lambda p, t, c, tol: tolerant_tree(p, t, c, 0)),
        ("Precision and recall", lambda p, t, c, tol: tolerant_tree(t, p, c, tol)),
        ("Use the Euclidean", lambda p, t, c, tol: tolerant_cdist(p, t, c, tol, "chebyshev")),
        ("Use the straight line", lambda p, t, c, tol: tolerant_cdist(p, t, c, tol, "cityblock")),
        ("The distance is in cells", lambda p, t, c, tol: tolerant_loops(p, t, 1, tol)),
        ("The result is a fraction", lambda p, t, c, tol: tolerant_torch(p, t, c, tol) / 100),
    ),
    "09-spl": (
        ("Divide by the number of all", lambda s, p, b: spl_loop(s, p, b, count=sum)),
        ("Failures must count", lambda s, p, b: 100 * np.minimum(1, b / p).mean()),
        ("A path may be", lambda s, p, b: spl_loop(s, p, b, limit=False)),
        ("This is the success rate", lambda s, p, b: 100 * sum(s) / len(s)),
        ("The result is a fraction", lambda s, p, b: torch.tensor(spl_loop(s, p, b) / 100)),
    ),
}
