"""Exercises of notebook 00: what a bin stops, and what a ray collects.

The solutions are read by students: they say for one ray what ``nerf.rendering`` does for a bundle of them.
"""

import numpy as np

from autonerf_lab.course.checker import Case, Exercise, Mistake

_HALF = np.log(2.0)  # an optical depth that lets half of the light pass


def opacity(sigma: float, delta: float) -> float:
    return float(1 - np.exp(-sigma * delta))  # exp(-sigma * delta) is what passes


def colour(alphas: np.ndarray, colors: np.ndarray) -> np.ndarray:
    light, total = 1.0, np.zeros(3)
    for alpha, color in zip(alphas, colors, strict=True):
        total += light * alpha * color  # of the light that arrives, the share that is stopped
        light *= 1 - alpha
    return total


def _summed(weights: np.ndarray, colors: np.ndarray) -> np.ndarray:
    return np.asarray(weights @ colors)


def _arriving(alphas: np.ndarray) -> np.ndarray:
    return np.cumprod(np.concatenate([[1.0], 1 - alphas[:-1]]))


def _unit(values: np.ndarray) -> np.ndarray:
    return values / values.sum()


OPACITY = Exercise(
    "00-opacity",
    "The share of light, 0 to 1, that a bin of width delta (metres) with density sigma (per metre) stops.",
    (
        Case("half a metre of air", (0.0, 0.5), 0.0),
        Case("2 m of what lets half of the light pass each metre", (_HALF, 2.0), 0.75),
        Case("half a metre of what lets half of it pass there", (2 * _HALF, 0.5), 0.5),
        Case("5 cm of a wall that lets a sixteenth pass there", (80 * _HALF, 0.05), 0.9375),
    ),
    opacity,
    (
        Mistake("This is the share that passes. What is stopped is the rest of 1.", lambda s, d: np.exp(-s * d)),
        Mistake(
            "A product grows without end, and a share is never above 1. Where less light is left, less is stopped: "
            "that is the exponential.",
            lambda s, d: s * d,
        ),
        Mistake("The width is missing: a bin of twice the width stops more.", lambda s, d: 1 - np.exp(-s)),
        Mistake("Density is per metre: multiply it by the width.", lambda s, d: 1 - np.exp(-s / d)),
        Mistake("The exponent lost its minus sign.", lambda s, d: 1 - np.exp(s * d)),
    ),
)

COLOUR = Exercise(
    "00-colour",
    "The colour of a ray, (3,), from the shares that its bins stop, (S,), and their colours, (S, 3), nearest first.",
    (
        Case(
            "red that stops half, before a green wall",
            (np.array([0.5, 1.0]), np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])),
            np.array([0.5, 0.5, 0.0]),
        ),
        Case(
            "red, green and blue that stop half each",
            (np.full(3, 0.5), np.eye(3)),
            np.array([0.5, 0.25, 0.125]),
        ),
        Case(
            "air, and then a thin veil",
            (np.array([0.0, 0.25]), np.array([[1.0, 1.0, 1.0], [0.4, 0.8, 0.0]])),
            np.array([0.1, 0.2, 0.0]),
        ),
    ),
    colour,
    (
        Mistake(
            "Light of the second bin has to pass the first one: multiply by what the bins before let pass.", _summed
        ),
        Mistake(
            "A bin stands in front of those behind it, and not of itself: the product is over j < i.",
            lambda a, c: _summed(_arriving(a) * a * (1 - a), c),
        ),
        Mistake(
            "The weights sum to 1 now. They should not: what no bin stops is missing: a veil before nothing is dark.",
            lambda a, c: _summed(_unit(_arriving(a) * a), c),
        ),
        Mistake(
            "This is the light that arrives in each bin. Which share of it is stopped there?",
            lambda a, c: _summed(_arriving(a), c),
        ),
        Mistake("The camera is at the other end: the first bin is the nearest.", lambda a, c: colour(a[::-1], c[::-1])),
    ),
)

EXERCISES = (OPACITY, COLOUR)
