"""Notebook 15: right answers in other styles, wrong ones with the start of the hint that they get."""

import math
from functools import reduce

import numpy as np
import torch
from scipy.special import log_softmax, logsumexp, softmax


def entropy_loop(logits, labels, trust):
    total = 0.0
    for z, label, w in zip(logits, labels, trust, strict=True):
        top = max(z)
        total += w * (top + math.log(sum(math.exp(v - top) for v in z)) - z[label])
    return total / sum(trust)


def entropy_torch(logits, labels, trust):
    logits = torch.tensor(logits, requires_grad=True)
    losses = torch.nn.functional.cross_entropy(logits, torch.tensor(labels), reduction="none")
    return (losses * torch.tensor(trust)).sum() / float(trust.sum())


def entropy_one_hot(logits, labels, trust):
    target = np.eye(logits.shape[1])[labels]
    return -np.sum(trust[:, None] * target * log_softmax(logits, axis=1)) / np.sum(trust)


def right_share(confidence, right):
    """Signed differences and pixels of the bins."""
    tenth = np.clip(np.floor(confidence * 10), 0, 9)
    return [(confidence[tenth == k].mean() - right[tenth == k].mean(), (tenth == k).sum()) for k in np.unique(tenth)]


def calibration_loop(confidence, right):
    bins = {}
    for c, hit in zip(confidence, right, strict=True):
        count, sum_c, hits = bins.get(min(int(10 * c), 9), (0, 0.0, 0))
        bins[min(int(10 * c), 9)] = count + 1, sum_c + c, hits + hit
    return sum(abs(sum_c - hits) for _, sum_c, hits in bins.values()) / len(confidence)


def calibration_bincount(confidence, right):
    tenth = np.clip((10 * confidence).astype(int), 0, 9)
    return np.abs(np.bincount(tenth, confidence) - np.bincount(tenth, right)).sum() / len(right)


def calibration_histogram(confidence, right):
    sums = [np.histogram(confidence, 10, (0, 1), weights=w.astype(float))[0] for w in (confidence, right)]
    return np.abs(sums[0] - sums[1]).sum() / confidence.size


def calibration_torch(confidence, right):
    confidence, right = torch.tensor(confidence), torch.tensor(right).double()
    tenth = (confidence * 10).long().clamp(max=9)
    return torch.zeros(10).double().index_add(0, tenth, confidence - right).abs().sum() / len(right)


def fused_one_by_one(labels, confidence, classes):
    """Bayes' rule, one label after the other."""
    probability = np.full(classes, 1 / classes)
    for label, c in zip(labels, confidence, strict=True):
        likelihood = np.full(classes, (1 - c) / (classes - 1))
        likelihood[label] = c
        probability = probability * likelihood
        probability /= probability.sum()
    return probability


def fused_votes(labels, confidence, classes):
    """Log-likelihood ratios, as in the library."""
    ratio = np.log(confidence * (classes - 1) / (1 - confidence))
    return softmax(np.bincount(labels, ratio, minlength=classes))


def fused_torch(labels, confidence, classes):
    c = torch.tensor(confidence)
    logs = ((1 - c) / (classes - 1)).log()[:, None].repeat(1, classes)
    logs[torch.arange(len(c)), torch.tensor(labels)] = c.log()
    return logs.sum(0).softmax(0)


def likelihoods(labels, confidence, classes, rest=None):
    rest = (1 - confidence) / (classes - 1) if rest is None else rest
    return np.where(np.arange(classes) == labels[:, None], confidence[:, None], np.reshape(rest, (-1, 1)))


def fused_logsumexp(labels, confidence, classes):
    logs = np.log(likelihoods(labels, confidence, classes)).sum(axis=0)
    return np.exp(logs - logsumexp(logs))


def normalised(table):
    product = reduce(np.multiply, table)
    return product / product.sum()


def product_of(rest):
    return lambda labels, c, k: softmax(np.log(likelihoods(labels, c, k, rest(c, k))).sum(axis=0))


RIGHT = {
    "15-cross-entropy": (
        entropy_loop,
        entropy_torch,
        entropy_one_hot,
        lambda z, y, w: np.average(logsumexp(z, axis=1) - z[range(len(y)), y], weights=w),
        lambda z, y, w: -np.average(np.take_along_axis(log_softmax(z, axis=1), y[:, None], 1)[:, 0], weights=w),
    ),
    "15-calibration": (
        calibration_loop,
        calibration_bincount,
        calibration_histogram,
        calibration_torch,
        lambda c, hit: np.dot(*np.abs(right_share(c, hit)).T) / len(c),
    ),
    "15-fused": (
        fused_one_by_one,
        fused_votes,
        fused_torch,
        fused_logsumexp,
        lambda labels, c, k: softmax([np.log(np.where(labels == j, c, (1 - c) / (k - 1))).sum() for j in range(k)]),
    ),
}
WRONG = {
    "15-cross-entropy": (
        ("exp(1000) is infinite", lambda z, y, w: -np.average(np.log(softmax_plain(z)[range(len(y)), y]), weights=w)),
        ("The trust is missing", lambda z, y, w: entropy_loop(z, y, 0 * w + 1)),
        ("Divide by the sum of the trust", lambda z, y, w: entropy_loop(z, y, w) * w.mean()),
        ("The sign is wrong", lambda z, y, w: -entropy_loop(z, y, w)),
        (
            "The softmax runs over the pixels",
            lambda z, y, w: -np.average(log_softmax(z, axis=0)[range(len(y)), y], weights=w),
        ),
        ("The logarithm is missing", lambda z, y, w: -np.average(softmax(z, axis=1)[range(len(y)), y], weights=w)),
        ("expected 0.98", lambda z, y, w: np.average(-log_softmax(z, axis=1).sum(axis=1), weights=w)),
        ("expected 0.98", lambda z, y, w: (z.argmax(axis=1) != y).mean()),
    ),
    "15-calibration": (
        ("Weight each bin", lambda c, hit: np.mean([abs(d) for d, _ in right_share(c, hit)])),
        ("must not cancel", lambda c, hit: abs(np.mean(c) - np.mean(hit))),
        ("never 90 % right", lambda c, hit: np.abs(hit - c).mean()),
        ("Divide by their number", lambda c, hit: sum(abs(d) * n for d, n in right_share(c, hit))),
        ("A confidence of 1 has no bin", lambda c, hit: calibration_bincount(c[c < 1], hit[c < 1]) * np.mean(c < 1)),
        ("This is the largest error", lambda c, hit: np.abs(right_share(c, hit))[:, 0].max()),
        ("expected 0.316667, got 0.5", lambda c, hit: np.mean(hit)),
        ("expected 0.316667, got 0.81", lambda c, hit: np.mean(c)),
    ),
    "15-fused": (
        ("The product of a thousand", lambda labels, c, k: normalised(likelihoods(labels, c, k))),
        ("This is a vote", lambda labels, c, k: np.bincount(labels, c, minlength=k) / c.sum()),
        ("mean of the probabilities", lambda labels, c, k: np.mean(likelihoods(labels, c, k), axis=0)),
        ("divide it by K - 1", product_of(lambda c, k: 1 - c)),
        ("The other classes are K - 1, not K", product_of(lambda c, k: (1 - c) / k)),
        ("also speak for the other classes", product_of(lambda c, k: np.ones_like(c))),
        ("Take exp() and divide", lambda labels, c, k: np.log(likelihoods(labels, c, k)).sum(axis=0)),
        ("divide by their sum", lambda labels, c, k: fused_votes(labels, c, k) / np.max(fused_votes(labels, c, k))),
        ("expected [0.7", lambda labels, c, k: np.eye(k)[np.bincount(labels, c, minlength=k).argmax()]),
    ),
}


def softmax_plain(logits):
    return np.exp(logits) / np.exp(logits).sum(axis=1, keepdims=True)
