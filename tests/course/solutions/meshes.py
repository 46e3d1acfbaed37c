"""Notebook 11: right answers in other styles, wrong ones with the start of the hint that they get."""

import itertools
import math

import numpy as np
import torch
from scipy import ndimage, optimize
from scipy.spatial import KDTree
from scipy.spatial.distance import cdist


def crossed_loops(values, level):
    result = np.zeros(np.subtract(values.shape, 1), bool)
    for i, j, k in np.ndindex(result.shape):
        inside = [values[i + a, j + b, k + c] > level for a, b, c in itertools.product((0, 1), repeat=3)]
        result[i, j, k] = any(inside) and not all(inside)
    return result


def crossed_torch(values, level):
    inside = torch.tensor(values > level)[None, None].float()
    share = torch.nn.functional.avg_pool3d(inside, 2, 1)[0, 0]
    return (share > 0) & (share < 1)


def crossed_differences(values, level):
    inside = values > level
    windows = np.lib.stride_tricks.sliding_window_view(inside, (2, 2, 2)).reshape(*np.subtract(values.shape, 1), 8)
    return np.ptp(windows.astype(int), axis=-1) == 1


def crossed_sum(values, level, low=0, high=8):
    count = (values > level).astype(int)
    for axis in range(3):
        count = np.take(count, range(count.shape[axis] - 1), axis) + np.take(count, range(1, count.shape[axis]), axis)
    return ((count > low) & (count < high)).astype(int)


def distances_loops(found, true):
    to_true = [min(math.dist(p, q) for q in true) for p in found]
    to_found = [min(math.dist(p, q) for p in found) for q in true]
    near = sum(d < 0.05 for d in to_found)
    return sum(to_true) / len(to_true), sum(to_found) / len(to_found), 100 * near / len(to_found)


def distances_tree(found, true):
    a, b = KDTree(true).query(found)[0], KDTree(found).query(true)[0]
    return [a.mean(), b.mean(), 100 * (b <= 0.05).mean()]


def distances_torch(found, true):
    apart = torch.cdist(torch.tensor(found, requires_grad=True), torch.tensor(true))
    a, b = apart.amin(1), apart.amin(0)
    return torch.stack([a.mean(), b.mean(), 100 * (b < 0.05).double().mean()])


RIGHT = {
    "11-crossing": (
        lambda a, b, level: np.interp(level, *zip(*sorted([(a, 0.0), (b, 1.0)]), strict=True)),
        lambda a, b, level: optimize.brentq(lambda t: a + t * (b - a) - level, 0, 1),
        lambda a, b, level: torch.tensor((a - level) / (a - b), requires_grad=True),
        lambda a, b, level: abs(level - a) / abs(b - a),
        lambda a, b, level: np.float32(level - a) / np.float32(b - a),
        lambda a, b, level: 1 - (b - level) / (b - a),
    ),
    "11-crossed": (
        crossed_loops,
        crossed_torch,
        crossed_differences,
        crossed_sum,
        lambda v, level: (
            (ndimage.maximum_filter(v, 2) > level)[1:, 1:, 1:] & (ndimage.minimum_filter(v, 2) < level)[1:, 1:, 1:]
        ),
    ),
    "11-distances": (
        distances_loops,
        distances_tree,
        distances_torch,
        lambda f, t: np.r_[
            cdist(f, t).min(1).mean(), cdist(f, t).min(0).mean(), 100 * np.mean(cdist(f, t).min(0) < 0.05)
        ],
        lambda f, t: np.float32(distances_tree(np.float32(f), np.float32(t))),
    ),
}
WRONG = {
    "11-crossing": (
        ("This is the middle", lambda a, b, level: np.float32(1) / 2),
        ("This is measured from b", lambda a, b, level: 1 - (level - a) / (b - a)),
        ("The value at the first", lambda a, b, level: torch.tensor(level / (b - a))),
        ("This is a difference", lambda a, b, level: -(a - level)),
        ("Do not take the absolute", lambda a, b, level: (level - a) / (max(a, b) - min(a, b))),
    ),
    "11-crossed": (
        ("These cubes have a corner", lambda v, level: crossed_sum(v, level, high=9)),
        ("This tests only two", lambda v, level: (v[1:, 1:, 1:] > level) ^ (v[:-1, :-1, :-1] > level)),
        ("The result is inverted", lambda v, level: ~crossed_loops(v, level)),
        ("These are nodes", lambda v, level: torch.tensor(v > level)),
    ),
    "11-distances": (
        ("Accuracy and completion", lambda f, t: distances_loops(t, f)),
        (
            "Use the distance to the nearest",
            lambda f, t: [cdist(f, t).mean()] * 2 + [100 * (cdist(f, t) < 0.05).mean()],
        ),
        ("The ratio counts", lambda f, t: [*distances_tree(f, t)[:2], distances_tree(t, f)[2]]),
        (
            "These are squared",
            lambda f, t: [
                cdist(f, t, "sqeuclidean").min(1).mean(),
                cdist(f, t, "sqeuclidean").min(0).mean(),
                distances_tree(f, t)[2],
            ],
        ),
        ("The ratio is a fraction", lambda f, t: distances_torch(f, t) * torch.tensor([1, 1, 0.01])),
    ),
}
