"""Exercises of notebook 06: weights along a ray, positional encoding, importance sampling.

Students read the solutions. They compute for one ray what ``nerf.rendering`` computes for a batch.
"""

import numpy as np

from autonerf_lab.course.checker import Case, Exercise, Mistake

_HALF = np.log(2.0)  # optical depth at which half of the light passes


def weights(sigma: np.ndarray, delta: np.ndarray) -> np.ndarray:
    """Return the rendering weights (S,) from densities (1/m) and bin widths (m)."""
    optical = sigma * delta
    in_front = np.cumsum(optical) - optical  # optical depth of the bins in front
    return np.exp(-in_front) * (1 - np.exp(-optical))


def frequencies(x: float, octaves: int) -> np.ndarray:
    """Return the positional encoding of a number, (1 + 2 octaves,)."""
    angles = np.pi * 2.0 ** np.arange(octaves) * x
    return np.concatenate([[x], np.sin(angles), np.cos(angles)])


def finer(edges: np.ndarray, weights: np.ndarray, u: np.ndarray) -> np.ndarray:
    """Return the distances (K,) at the fractions u of the cumulative weight."""
    cdf = np.concatenate([[0.0], np.cumsum(weights) / np.sum(weights)])  # at each edge, from 0 to 1
    return np.interp(u, cdf, edges)


def _alpha(sigma: np.ndarray, delta: np.ndarray) -> np.ndarray:
    return 1 - np.exp(-sigma * delta)


def _normalised(values: np.ndarray) -> np.ndarray:
    return values / values.sum()


WEIGHTS = Exercise(
    "06-weights",
    "Return the rendering weights of the bins of a ray, (S,), from densities and bin widths.",
    (
        Case(
            "three bins of 1 m, each of which passes half of the light",
            (np.full(3, _HALF), np.ones(3)),
            np.array([0.5, 0.25, 0.125]),
        ),
        Case(
            "1 m of air, 0.5 m of fog that passes 1/2, 0.25 m of fog that passes 1/4",
            (np.array([0.0, 2 * _HALF, 8 * _HALF]), np.array([1.0, 0.5, 0.25])),
            np.array([0.0, 0.5, 0.375]),
        ),
        Case("a wall in front of another wall", (np.array([1e4, 1e4]), np.array([0.1, 0.1])), np.array([1.0, 0.0])),
    ),
    weights,
    (
        Mistake(
            "This is alpha. Light from the second bin must pass the first one: multiply by the transmittance.",
            _alpha,
        ),
        Mistake(
            "The transmittance of a bin includes the bins in front of it, but not the bin itself.",
            lambda s, d: np.exp(-np.cumsum(s * d)) * _alpha(s, d),
        ),
        Mistake(
            "The widths are missing: density is per metre, so a narrower bin absorbs less.",
            lambda s, d: weights(s, np.ones_like(d)),
        ),
        Mistake(
            "These weights sum to 1. They should not: the difference to 1 is the light that passes all bins.",
            lambda s, d: _normalised(weights(s, d)),
        ),
        Mistake(
            "This is the transmittance. Multiply it by alpha, the fraction that the bin absorbs.",
            lambda s, d: np.exp(-(np.cumsum(s * d) - s * d)),
        ),
        Mistake(
            "The order is reversed: the first bin is the nearest to the camera.",
            lambda s, d: weights(s[::-1], d[::-1])[::-1],
        ),
    ),
)

FREQUENCIES = Exercise(
    "06-frequencies",
    "Return x itself, then L sines, then L cosines, (1 + 2 L,).",
    (
        Case("x = 0.5 and 2 octaves", (0.5, 2), np.array([0.5, 1, 0, 0, -1])),
        Case(
            "x = 0.25 and 3 octaves",
            (0.25, 3),
            np.array([0.25, np.sqrt(0.5), 1, 0, np.sqrt(0.5), 0, -1]),
        ),
        Case("x = -1/6 and 1 octave", (-1 / 6, 1), np.array([-1 / 6, -0.5, np.sqrt(0.75)])),
    ),
    frequencies,
    (
        Mistake(
            "The first frequency is pi, with exponent 0: count octaves from zero.",
            lambda x, n: np.r_[
                x, np.sin(np.pi * 2.0 ** np.arange(1, n + 1) * x), np.cos(np.pi * 2.0 ** np.arange(1, n + 1) * x)
            ],
        ),
        Mistake(
            "Each octave doubles the frequency: 1, 2, 4, 8, not 1, 2, 3, 4.",
            lambda x, n: np.r_[x, np.sin(np.pi * np.arange(1, n + 1) * x), np.cos(np.pi * np.arange(1, n + 1) * x)],
        ),
        Mistake(
            "The factor pi is missing: [-1, 1] must be one period of the lowest frequency.",
            lambda x, n: np.r_[x, np.sin(2.0 ** np.arange(n) * x), np.cos(2.0 ** np.arange(n) * x)],
        ),
        Mistake("x itself is missing: it comes first.", lambda x, n: frequencies(x, n)[1:]),
        Mistake(
            "The order is wrong: sines first, then cosines.",
            lambda x, n: np.r_[x, frequencies(x, n)[1 + n :], frequencies(x, n)[1 : 1 + n]],
        ),
        Mistake(
            "Sines and cosines alternate. A network would work as well, but here all sines come first.",
            lambda x, n: np.r_[x, frequencies(x, n)[1:].reshape(2, n).T.ravel()],
        ),
    ),
)

FINER = Exercise(
    "06-finer",
    "Return the distances, (K,), at which the cumulative weight reaches the fractions u; linear within a bin.",
    (
        Case(
            "edges 0, 1, 2, 4 and weights 0.2, 0.2, 0.4",
            (np.array([0.0, 1, 2, 4]), np.array([0.2, 0.2, 0.4]), np.array([0.25, 0.5, 0.75])),
            np.array([1.0, 2.0, 3.0]),
        ),
        Case(
            "edges 0, 1, 3, 4 and weights 0.4, 0.4, 0.2",
            (np.array([0.0, 1, 3, 4]), np.array([0.4, 0.4, 0.2]), np.array([0.2, 0.6, 0.9])),
            np.array([0.5, 2.0, 3.5]),
        ),
    ),
    finer,
    (
        Mistake(
            "The weights of a ray need not sum to 1. Divide by their sum, otherwise large u are never reached.",
            lambda e, w, u: np.interp(u, np.r_[0, np.cumsum(w)], e),
        ),
        Mistake(
            "The cumulative weight at the first edge is 0: there is one more edge than bins.",
            lambda e, w, u: np.interp(u, np.cumsum(_normalised(w)), e[1:]),
        ),
        Mistake(
            "These samples are uniform: they ignore the weights.",
            lambda e, w, u: e[0] + u * (e[-1] - e[0]),
        ),
        Mistake(
            "Every sample is on an edge. Interpolate linearly within the bin.",
            lambda e, w, u: e[np.searchsorted(np.cumsum(_normalised(w)), u)],
        ),
        Mistake(
            "Weights are not densities: do not multiply them by the bin widths.",
            lambda e, w, u: finer(e, w * np.diff(e), u),
        ),
    ),
)

EXERCISES = (WEIGHTS, FREQUENCIES, FINER)
