"""Exercises of notebook 00: opacity of a bin and colour of a ray.

Students read the solutions. They compute for one ray what ``nerf.rendering`` computes for a batch.
"""

import numpy as np

from autonerf_lab.course.checker import Case, Exercise, Mistake

_HALF = np.log(2.0)  # optical depth at which half of the light passes


def opacity(sigma: float, delta: float) -> float:
    """Return the opacity of a bin from its density (1/m) and width (m)."""
    return float(1 - np.exp(-sigma * delta))  # exp(-sigma * delta) is the fraction that passes


def colour(alphas: np.ndarray, colors: np.ndarray) -> np.ndarray:
    """Return the colour of a ray, (3,), from opacities (S,) and colours (S, 3) of its bins."""
    transmittance, total = 1.0, np.zeros(3)
    for alpha, color in zip(alphas, colors, strict=True):
        total += transmittance * alpha * color  # weight of the bin times its colour
        transmittance *= 1 - alpha
    return total


def _weighted_sum(weights: np.ndarray, colors: np.ndarray) -> np.ndarray:
    return np.asarray(weights @ colors)


def _transmittance(alphas: np.ndarray) -> np.ndarray:
    return np.cumprod(np.concatenate([[1.0], 1 - alphas[:-1]]))


def _normalised(values: np.ndarray) -> np.ndarray:
    return values / values.sum()


OPACITY = Exercise(
    "00-opacity",
    "Return the opacity, 0 to 1, of a bin with density sigma (per metre) and width delta (metres).",
    (
        Case("half a metre of air (density 0)", (0.0, 0.5), 0.0),
        Case("2 m of a medium in which half of the light passes each metre", (_HALF, 2.0), 0.75),
        Case("half a metre of a medium in which half of the light passes that distance", (2 * _HALF, 0.5), 0.5),
        Case("5 cm of a wall through which one sixteenth of the light passes", (80 * _HALF, 0.05), 0.9375),
    ),
    opacity,
    (
        Mistake("This is the fraction that passes. Opacity is 1 minus this fraction.", lambda s, d: np.exp(-s * d)),
        Mistake(
            "The product can exceed 1, but opacity cannot. The light decays exponentially with sigma * delta.",
            lambda s, d: s * d,
        ),
        Mistake("The width is missing: a wider bin absorbs more light.", lambda s, d: 1 - np.exp(-s)),
        Mistake("Density is per metre: multiply it by the width, do not divide.", lambda s, d: 1 - np.exp(-s / d)),
        Mistake("The minus sign of the exponent is missing.", lambda s, d: 1 - np.exp(s * d)),
    ),
)

COLOUR = Exercise(
    "00-colour",
    "Return the colour of a ray, (3,), from the opacities, (S,), and colours, (S, 3), of its bins, nearest first.",
    (
        Case(
            "a red bin of opacity 0.5 in front of an opaque green one",
            (np.array([0.5, 1.0]), np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])),
            np.array([0.5, 0.5, 0.0]),
        ),
        Case(
            "red, green and blue bins of opacity 0.5",
            (np.full(3, 0.5), np.eye(3)),
            np.array([0.5, 0.25, 0.125]),
        ),
        Case(
            "an empty bin, then one of opacity 0.25",
            (np.array([0.0, 0.25]), np.array([[1.0, 1.0, 1.0], [0.4, 0.8, 0.0]])),
            np.array([0.1, 0.2, 0.0]),
        ),
    ),
    colour,
    (
        Mistake(
            "Light from the second bin must pass the first one: multiply by the transmittance of the bins in front.",
            _weighted_sum,
        ),
        Mistake(
            "A bin does not attenuate its own colour: the product is over j < i, not j <= i.",
            lambda a, c: _weighted_sum(_transmittance(a) * a * (1 - a), c),
        ),
        Mistake(
            "These weights sum to 1. They should not: light that no bin absorbs contributes nothing.",
            lambda a, c: _weighted_sum(_normalised(_transmittance(a) * a), c),
        ),
        Mistake(
            "This is the transmittance of each bin. Multiply it by the opacity of the bin.",
            lambda a, c: _weighted_sum(_transmittance(a), c),
        ),
        Mistake(
            "The order is reversed: the first bin is the nearest to the camera.", lambda a, c: colour(a[::-1], c[::-1])
        ),
    ),
)

EXERCISES = (OPACITY, COLOUR)
