"""Notebook 16: right answers in other styles, wrong ones with the start of the hint that they get."""

import numpy as np
import pandas as pd
import torch
from scipy import stats


def variance_loop(colors):
    members, pixels, _ = colors.shape
    result = []
    for n in range(pixels):
        total = 0.0
        for channel in range(3):
            mean = sum(colors[k, n, channel] for k in range(members)) / members
            total += sum((colors[k, n, channel] - mean) ** 2 for k in range(members)) / members
        result.append(total / 3)
    return result


def variance_of_norms(colors):
    return sum(np.linalg.norm(c - colors.mean(axis=0), axis=-1) ** 2 for c in colors) / (3 * len(colors))


def variance_of_squares(colors):
    return ((colors**2).mean(axis=0) - colors.mean(axis=0) ** 2).mean(axis=-1)


def variance_torch(colors):
    return torch.tensor(colors, requires_grad=True).var(dim=0, correction=0).mean(dim=-1)


def missing_loop(sums):
    found = []
    for pixel in sums.T:
        mean = 0.0
        for member in pixel:
            mean += member / len(pixel)
        found.append((1 - mean) ** 2)
    return tuple(found)


def calibration_lists(uncertainty, error, groups):
    pairs = sorted(zip(uncertainty.tolist(), error.tolist(), strict=True))
    size = len(pairs) // groups
    return [
        [sum(column) / size for column in zip(*pairs[k * size : (k + 1) * size], strict=True)] for k in range(groups)
    ]


def calibration_torch(uncertainty, error, groups):
    both = torch.stack([torch.tensor(uncertainty), torch.tensor(error)], dim=1)
    parts = both[both[:, 0].argsort()].tensor_split(groups)
    return torch.stack([part.mean(dim=0) for part in parts])


def calibration_table(uncertainty, error, groups):
    table = pd.DataFrame({"u": uncertainty, "e": error})
    return table.groupby(pd.qcut(table.u, groups, labels=False)).mean().to_numpy()


def calibration_reshaped(uncertainty, error, groups):
    order = uncertainty.argsort()
    return np.stack([uncertainty[order], error[order]]).reshape(2, groups, -1).mean(axis=2).T


def calibration_ranks(uncertainty, error, groups):
    group = ((stats.rankdata(uncertainty) - 1) * groups / len(error)).astype(int)
    counts = np.bincount(group)
    return np.stack([np.bincount(group, uncertainty) / counts, np.bincount(group, error) / counts], axis=1)


def as_groups(u, e, n):
    return np.array([(a.mean(), b.mean()) for a, b in zip(np.array_split(u, n), np.array_split(e, n), strict=True)])


RIGHT = {
    "16-variance": (
        variance_loop,
        variance_of_norms,
        variance_of_squares,
        variance_torch,
        lambda c: np.var(c, axis=0).mean(axis=1),
        lambda c: np.einsum("knc,knc->n", c - c.mean(axis=0), c - c.mean(axis=0)) / (3 * len(c)),
    ),
    "16-missing": (
        missing_loop,
        lambda s: np.square(1 - np.mean(s, axis=0)),
        lambda s: (torch.tensor(s, requires_grad=True).mean(0) - 1) ** 2,
        lambda s: [(1 - sum(column) / len(s)) ** 2 for column in zip(*s, strict=True)],
        lambda s: np.mean(1 - s, axis=0) ** 2,
        lambda s: ((len(s) - s.sum(axis=0)) / len(s)) ** 2,
    ),
    "16-calibration": (
        calibration_lists,
        calibration_torch,
        calibration_table,
        calibration_reshaped,
        calibration_ranks,
    ),
}
WRONG = {
    "16-variance": (
        ("This divides by K - 1", lambda c: torch.tensor(c).var(dim=0).mean(dim=1)),
        ("This is the standard deviation", lambda c: np.std(c, axis=0).mean(axis=1)),
        ("Average over the three channels", lambda c: ((c - c.mean(axis=0)) ** 2).mean(axis=0).sum(axis=1)),
        ("This mixes channels", lambda c: np.array([np.var(c[:, n]) for n in range(c.shape[1])])),
        ("This is the variance of the brightness", lambda c: np.var(c.sum(axis=2) / 3, axis=0)),
        ("Average over the channels only", lambda c: float(np.var(c, axis=0).mean())),
        ("expected an array of shape", lambda c: c.var(axis=0)),
    ),
    "16-missing": (
        ("Take the mean over the members first", lambda s: [np.mean((1 - pixel) ** 2) for pixel in s.T]),
        ("The square is missing", lambda s: np.mean(1 - s, axis=0)),
        ("This is 1 minus the square", lambda s: 1 - np.mean(s, axis=0) ** 2),
        ("This is the square of the weight that is there", lambda s: torch.tensor(s).mean(0) ** 2),
        ("Average over the members instead", lambda s: (1 - sum(s)) ** 2),
        ("The mean is over the members", lambda s: (1 - s.mean(axis=-1)) ** 2),
        ("For an opaque pixel: expected", lambda s: ((1 - s) ** 2).mean()),
    ),
    "16-calibration": (
        ("This sorts uncertainties and errors separately", lambda u, e, n: as_groups(np.sort(u), np.sort(e), n)),
        ("Sort by uncertainty before", as_groups),
        ("Sort by the uncertainty, not by the error", lambda u, e, n: as_groups(u[e.argsort()], np.sort(e), n)),
        ("The columns are swapped", lambda u, e, n: as_groups(e[u.argsort()], np.sort(u), n)),
        ("The groups are in descending order", lambda u, e, n: as_groups(u[(-u).argsort()], e[(-u).argsort()], n)),
        (
            "These groups have equal widths",
            lambda u, e, n: np.stack([stats.binned_statistic(u, v, "mean", n).statistic for v in (u, e)], axis=1),
        ),
        ("transpose", lambda u, e, n: calibration_reshaped(u, e, n).T),
    ),
}
