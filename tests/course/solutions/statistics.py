"""Notebook 12: right answers in other styles, wrong ones with the start of the hint that they get."""

import math
import statistics
from itertools import chain

import numpy as np
import torch
from scipy import stats

FACTORS = {2: 12.7062, 3: 4.30265}  # of a table, for n = 2 and 3


def means(runs):
    return [sum(starts) / len(starts) for starts in runs]


def half_interval(runs):
    if np.ptp(means(runs)) == 0:
        return 0.0
    low, high = stats.t.interval(0.95, len(runs) - 1, loc=np.mean(means(runs)), scale=stats.sem(means(runs)))
    return (high - low) / 2


def half_plain(runs):
    return FACTORS[len(runs)] * statistics.stdev(means(runs)) / math.sqrt(len(runs))


def half_torch(runs):
    return FACTORS[len(runs)] * torch.tensor(means(runs), requires_grad=True).std() / len(runs) ** 0.5


def half_loop(runs, ddof=1, factor=FACTORS):
    n, m = len(runs), means(runs)
    variance = sum((value - sum(m) / n) ** 2 for value in m) / (n - ddof)
    return factor[n] * math.sqrt(variance / n)


def subtract(first, second):
    return [[b - a for a, b in zip(one, two, strict=True)] for one, two in zip(first, second, strict=True)]


def flat(runs):
    return np.array(list(chain(*runs)))


def paired_scenes(first, second):
    differences = np.subtract(means(second), means(first))
    return differences.mean(), stats.t.ppf(0.975, len(first) - 1) * stats.sem(differences)


def r_loop(x, y):
    mx, my = sum(x) / len(x), sum(y) / len(y)
    both = sum((a - mx) * (b - my) for a, b in zip(x, y, strict=True))
    return both / math.sqrt(sum((a - mx) ** 2 for a in x) * sum((b - my) ** 2 for b in y))


RIGHT = {
    "12-half-width": (
        half_interval,
        half_plain,
        half_torch,
        half_loop,
        lambda runs: np.float32(stats.t.isf(0.025, len(runs) - 1) * stats.sem(means(runs))),
    ),
    "12-paired": (
        paired_scenes,
        lambda a, b: [np.mean(means(subtract(a, b))), half_loop(subtract(a, b))],
        lambda a, b: np.array([statistics.fmean(means(subtract(a, b))), half_plain(subtract(a, b))]),
        lambda a, b: torch.stack([torch.tensor(means(subtract(a, b))).mean(), half_torch(subtract(a, b))]),
        lambda a, b: np.float32(paired_scenes(a, b)),
    ),
    "12-correlation": (
        r_loop,
        lambda x, y: np.corrcoef(x, y)[0, 1],
        lambda x, y: stats.pearsonr(x, y).statistic,
        lambda x, y: torch.corrcoef(torch.tensor([x, y], requires_grad=True))[0, 1],
        statistics.correlation,
        lambda x, y: np.mean(stats.zscore(x) * stats.zscore(np.float32(y))),
    ),
}
WRONG = {
    "12-half-width": (
        ("All starts are treated", lambda runs: stats.t.ppf(0.975, len(flat(runs)) - 1) * stats.sem(flat(runs))),
        ("1.96 applies", lambda runs: half_loop(runs, factor={2: 1.96, 3: 1.96})),
        ("Use the sample standard", lambda runs: half_loop(runs, ddof=0)),
        ("This is the spread", lambda runs: half_torch(runs) * len(runs) ** 0.5),
        ("This is the full width", lambda runs: 2 * half_interval(runs)),
    ),
    "12-paired": (
        ("The sign is wrong", lambda a, b: [-paired_scenes(a, b)[0], half_loop(subtract(a, b))]),
        ("The intervals of both", lambda a, b: (paired_scenes(a, b)[0], half_loop(a) + half_loop(b))),
        ("The root of the sum", lambda a, b: (paired_scenes(a, b)[0], math.hypot(half_plain(a), half_plain(b)))),
        (
            "All pairs are treated",
            lambda a, b: (
                np.mean(flat(b) - flat(a)),
                stats.t.ppf(0.975, len(flat(a)) - 1) * stats.sem(flat(b) - flat(a)),
            ),
        ),
        ("expected an array of shape (2,), got a number", lambda a, b: paired_scenes(a, b)[0]),
    ),
    "12-correlation": (
        ("Subtract the means", lambda x, y: torch.cosine_similarity(torch.tensor(x), torch.tensor(y), dim=0)),
        ("This is the covariance", lambda x, y: np.mean(np.subtract(x, np.mean(x)) * np.subtract(y, np.mean(y)))),
        ("This is r squared", lambda x, y: stats.linregress(x, y).rvalue ** 2),
        ("This is the rank", lambda x, y: stats.spearmanr(x, y).statistic),
        ("This is the slope", lambda x, y: stats.linregress(x, y).slope),
        ("expected a number", np.corrcoef),
    ),
}
