"""Exercises of notebook 15: weighted cross-entropy, calibration error, Bayesian fusion of labels."""

import numpy as np

from autonerf_lab.course.checker import Case, Exercise, Mistake


def cross_entropy(logits: np.ndarray, labels: np.ndarray, trust: np.ndarray) -> float:
    """Return the weighted mean of the negative logarithms of the probabilities of the labels."""
    logits = logits - logits.max(axis=1, keepdims=True)  # the same probabilities, without overflow
    log_probability = logits - np.log(np.exp(logits).sum(axis=1, keepdims=True))
    return float(-(trust * log_probability[np.arange(len(labels)), labels]).sum() / trust.sum())


def calibration_error(confidence: np.ndarray, right: np.ndarray) -> float:
    """Return the expected calibration error with ten bins."""
    tenth = np.minimum((confidence * 10).astype(int), 9)  # a confidence of 1 belongs to the last bin
    total = 0.0
    for k in np.unique(tenth):
        inside = tenth == k
        total += inside.sum() * abs(confidence[inside].mean() - right[inside].mean())
    return float(total / len(confidence))


def fused(labels: np.ndarray, confidence: np.ndarray, classes: int) -> np.ndarray:
    """Return the probability of each class after independent observations of one point."""
    log_probability = np.zeros(classes)
    for label, c in zip(labels, confidence, strict=True):
        likelihood = np.full(classes, (1 - c) / (classes - 1))
        likelihood[label] = c
        log_probability += np.log(likelihood)
    probability = np.exp(log_probability - log_probability.max())  # the largest is 1: no underflow
    return probability / probability.sum()


def _softmax(logits: np.ndarray, axis: int) -> np.ndarray:
    e = np.exp(logits - logits.max(axis=axis, keepdims=True))
    return np.asarray(e / e.sum(axis=axis, keepdims=True))


def _of_label(probability: np.ndarray, labels: np.ndarray) -> np.ndarray:
    return np.asarray(probability[np.arange(len(labels)), labels])


_LOGITS = np.array([[2.0, 0.0, 0.0], [0.0, 1.0, 0.0], [1.0, 0.0, 3.0]])
_LABELS, _TRUST = np.array([0, 1, 0]), np.array([1.0, 0.5, 0.1])

CROSS_ENTROPY = Exercise(
    "15-cross-entropy",
    "Return the mean of -log(probability of the label), weighted by trust: logits (N, K), labels (N,), trust (N,).",
    (
        Case(
            "three pixels of equal trust",
            (_LOGITS, _LABELS, np.ones(3)),
            cross_entropy(_LOGITS, _LABELS, np.ones(3)),
        ),
        Case("trust 1, 0.5 and 0.1", (_LOGITS, _LABELS, _TRUST), cross_entropy(_LOGITS, _LABELS, _TRUST)),
        Case(
            "logits of 1000 and 998",
            (np.array([[1000.0, 998.0]]), np.array([1]), np.array([0.5])),
            2.126928,
        ),
    ),
    cross_entropy,
    (
        Mistake(
            "exp(1000) is infinite. Subtract the largest logit of the pixel first: the probabilities stay the same.",
            lambda logits, labels, trust: float(
                -(trust * np.log(_of_label(np.exp(logits) / np.exp(logits).sum(axis=1, keepdims=True), labels))).sum()
                / trust.sum()
            ),
        ),
        Mistake(
            "The trust is missing: each pixel counts as much as its label is trusted.",
            lambda logits, labels, trust: cross_entropy(logits, labels, np.ones_like(trust)),
        ),
        Mistake(
            "Divide by the sum of the trust, not by the number of pixels, so that equal trust changes nothing.",
            lambda logits, labels, trust: cross_entropy(logits, labels, trust) * trust.sum() / len(trust),
        ),
        Mistake("The sign is wrong: a loss is small for good predictions.", lambda *args: -cross_entropy(*args)),
        Mistake(
            "The softmax runs over the pixels. The probabilities of the classes of one pixel sum to 1: axis=1.",
            lambda logits, labels, trust: float(
                -(trust * np.log(_of_label(_softmax(logits, 0), labels))).sum() / trust.sum()
            ),
        ),
        Mistake(
            "The logarithm is missing.",
            lambda logits, labels, trust: float(-(trust * _of_label(_softmax(logits, 1), labels)).sum() / trust.sum()),
        ),
    ),
)

_CONFIDENCE = np.array([0.95, 0.95, 0.95, 0.95, 0.55, 0.55])
_RIGHT = np.array([True, True, False, False, True, False])


def _binned(confidence: np.ndarray, right: np.ndarray) -> list[tuple[int, float]]:
    """Return the pixels and the signed difference of confidence and accuracy of each bin with pixels."""
    tenth = np.minimum((confidence * 10).astype(int), 9)
    masks = [tenth == k for k in np.unique(tenth)]
    return [(int(m.sum()), float(confidence[m].mean() - right[m].mean())) for m in masks]


CALIBRATION = Exercise(
    "15-calibration",
    "Return the expected calibration error, 0 to 1, with ten bins, from confidences (N,) and right (N,), booleans.",
    (
        Case("0.95 four times, half right; 0.55 twice, half right", (_CONFIDENCE, _RIGHT), 0.316667),
        Case("0.75, right in three of four", (np.full(4, 0.75), np.array([True, True, True, False])), 0.0),
        Case(
            "0.91 twice, half right; 0.51 twice, both right; 1 once, wrong",
            (np.array([0.91, 0.91, 0.51, 0.51, 1.0]), np.array([True, False, True, True, False])),
            0.56,
        ),
    ),
    calibration_error,
    (
        Mistake(
            "Weight each bin by its number of pixels. Here a bin with two pixels counts as much as one with thousands.",
            lambda c, right: float(np.mean([abs(d) for _, d in _binned(c, right)])),
        ),
        Mistake(
            "Take the absolute value of each bin: too certain and too careful must not cancel.",
            lambda c, right: float(abs(c.mean() - right.mean())),
        ),
        Mistake(
            "A single label is right or wrong, never 90 % right. Compare the means of a bin.",
            lambda c, right: float(np.abs(c - right).mean()),
        ),
        Mistake(
            "This is the sum over the pixels. Divide by their number.",
            lambda c, right: float(sum(n * abs(d) for n, d in _binned(c, right))),
        ),
        Mistake(
            "A confidence of 1 has no bin: it belongs to the last one.",
            lambda c, right: float(sum(n * abs(d) for n, d in _binned(c[c < 1], right[c < 1])) / len(c)),
        ),
        Mistake(
            "This is the largest error of a bin. The expected error is the mean, weighted by pixels.",
            lambda c, right: max(abs(d) for _, d in _binned(c, right)),
        ),
    ),
)


def _votes(labels: np.ndarray, confidence: np.ndarray, classes: int) -> np.ndarray:
    votes = np.bincount(labels, confidence, minlength=classes)
    return np.asarray(votes / votes.sum())


def _likelihoods(labels: np.ndarray, confidence: np.ndarray, classes: int) -> np.ndarray:
    rest = (1 - confidence) / (classes - 1)
    return np.where(np.arange(classes) == labels[:, None], confidence[:, None], rest[:, None])


def _normalised(values: np.ndarray) -> np.ndarray:
    return np.asarray(values / values.sum())


def _product(likelihoods: np.ndarray) -> np.ndarray:
    """Return the normalised product over the observations."""
    return _softmax(np.log(likelihoods).sum(axis=0)[None], 1)[0]


_THREE = np.array([0, 1, 1])
_MANY = np.repeat([2, 3], [700, 400])

FUSED = Exercise(
    "15-fused",
    "Return the probabilities (K,) of the classes of a point after labels (N,) with confidences (N,).",
    (
        Case("one label 0 of confidence 0.7, three classes", (np.array([0]), np.array([0.7]), 3), [0.7, 0.15, 0.15]),
        Case(
            "label 0 of confidence 0.9, and twice label 1 of confidence 0.6, three classes",
            (_THREE, np.array([0.9, 0.6, 0.6]), 3),
            fused(_THREE, np.array([0.9, 0.6, 0.6]), 3),
        ),
        Case(
            "1100 labels of confidence 0.5, 16 classes: 700 times class 2, 400 times class 3",
            (_MANY, np.full(1100, 0.5), 16),
            np.eye(16)[2],
        ),
    ),
    fused,
    (
        Mistake(
            "The product of a thousand small numbers is 0 in a computer. Add logarithms, and subtract the largest sum "
            "before exp(): the ratios stay the same.",
            lambda labels, c, k: _normalised(_likelihoods(labels, c, k).prod(axis=0)),
        ),
        Mistake(
            "This is a vote: it adds confidences. Independent probabilities are multiplied, so add their logarithms.",
            _votes,
        ),
        Mistake(
            "This is the mean of the probabilities. It never becomes more certain than a single frame. Multiply them.",
            lambda labels, c, k: _likelihoods(labels, c, k).mean(axis=0),
        ),
        Mistake(
            "The rest of the probability, 1 - c, is shared by the other classes: divide it by K - 1.",
            lambda labels, c, k: _product(np.where(np.arange(k) == labels[:, None], c[:, None], 1 - c[:, None])),
        ),
        Mistake(
            "The other classes are K - 1, not K.",
            lambda labels, c, k: _product(np.where(np.arange(k) == labels[:, None], c[:, None], (1 - c[:, None]) / k)),
        ),
        Mistake(
            "Labels with a low confidence also speak for the other classes: add log((1 - c) / (K - 1)) to these.",
            lambda labels, c, k: _product(np.where(np.arange(k) == labels[:, None], c[:, None], 1.0)),
        ),
        Mistake(
            "These are the sums of logarithms. Take exp() and divide by the sum.",
            lambda labels, c, k: np.log(_likelihoods(labels, c, k)).sum(axis=0),
        ),
        Mistake(
            "The probabilities do not sum to 1: divide by their sum.",
            lambda labels, c, k: fused(labels, c, k) / fused(labels, c, k).max(),
        ),
    ),
)

EXERCISES = (CROSS_ENTROPY, CALIBRATION, FUSED)
