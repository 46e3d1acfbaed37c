"""Exercises of notebook 06: weights along a ray, positional encoding, finer samples.

The solutions are read by students: they say for one ray what ``nerf.rendering`` does for a bundle of them.
"""

import numpy as np

from autonerf_lab.course.checker import Case, Exercise, Mistake

_HALF = np.log(2.0)  # an optical depth that lets half of the light pass


def weights(sigma: np.ndarray, delta: np.ndarray) -> np.ndarray:
    optical = sigma * delta
    in_front = np.cumsum(optical) - optical  # what the light has to pass before it is in this bin
    return np.exp(-in_front) * (1 - np.exp(-optical))


def frequencies(x: float, octaves: int) -> np.ndarray:
    angles = np.pi * 2.0 ** np.arange(octaves) * x
    return np.concatenate([[x], np.sin(angles), np.cos(angles)])


def finer(edges: np.ndarray, weights: np.ndarray, u: np.ndarray) -> np.ndarray:
    passed = np.concatenate([[0.0], np.cumsum(weights) / np.sum(weights)])  # at each edge, from 0 to 1
    return np.interp(u, passed, edges)


def _alpha(sigma: np.ndarray, delta: np.ndarray) -> np.ndarray:
    return 1 - np.exp(-sigma * delta)


def _unit(values: np.ndarray) -> np.ndarray:
    return values / values.sum()


WEIGHTS = Exercise(
    "06-weights",
    "The share of a ray's light that each bin sends to the camera, (S,), from densities and bin widths.",
    (
        Case(
            "three bins of 1 m that pass half of the light each",
            (np.full(3, _HALF), np.ones(3)),
            np.array([0.5, 0.25, 0.125]),
        ),
        Case(
            "1 m of air, 0.5 m of fog that passes half, 0.25 m of fog that passes a quarter",
            (np.array([0.0, 2 * _HALF, 8 * _HALF]), np.array([1.0, 0.5, 0.25])),
            np.array([0.0, 0.5, 0.375]),
        ),
        Case("a wall before a wall", (np.array([1e4, 1e4]), np.array([0.1, 0.1])), np.array([1.0, 0.0])),
    ),
    weights,
    (
        Mistake(
            "This is alpha. Light from the second bin has to pass the first one too: multiply by the transmittance.",
            _alpha,
        ),
        Mistake(
            "The transmittance of a bin counts the bins before it, and not the bin itself.",
            lambda s, d: np.exp(-np.cumsum(s * d)) * _alpha(s, d),
        ),
        Mistake(
            "The widths are missing: density is per metre, and a bin of half the width stops less.",
            lambda s, d: weights(s, np.ones_like(d)),
        ),
        Mistake(
            "They sum to 1 now. They should not: what is missing to 1 is light that passes all bins.",
            lambda s, d: _unit(weights(s, d)),
        ),
        Mistake(
            "This is the transmittance, the light that arrives in a bin. Which share of it is stopped there?",
            lambda s, d: np.exp(-(np.cumsum(s * d) - s * d)),
        ),
        Mistake(
            "The camera is at the other end: the first bin is the nearest.",
            lambda s, d: weights(s[::-1], d[::-1])[::-1],
        ),
    ),
)

FREQUENCIES = Exercise(
    "06-frequencies",
    "x itself, then its L sines, then its L cosines, (1 + 2 L,).",
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
            "The first octave is pi x, with 2 to the power of 0: count from zero.",
            lambda x, n: np.r_[
                x, np.sin(np.pi * 2.0 ** np.arange(1, n + 1) * x), np.cos(np.pi * 2.0 ** np.arange(1, n + 1) * x)
            ],
        ),
        Mistake(
            "An octave doubles the frequency: 1, 2, 4, 8, and not 1, 2, 3, 4.",
            lambda x, n: np.r_[x, np.sin(np.pi * np.arange(1, n + 1) * x), np.cos(np.pi * np.arange(1, n + 1) * x)],
        ),
        Mistake(
            "Pi is missing: x in [-1, 1] should be one period of the slowest sine.",
            lambda x, n: np.r_[x, np.sin(2.0 ** np.arange(n) * x), np.cos(2.0 ** np.arange(n) * x)],
        ),
        Mistake("x itself comes first; the network gets it too.", lambda x, n: frequencies(x, n)[1:]),
        Mistake(
            "The sines come first, and then the cosines.",
            lambda x, n: np.r_[x, frequencies(x, n)[1 + n :], frequencies(x, n)[1 : 1 + n]],
        ),
        Mistake(
            "Sines and cosines alternate here. A network would not mind, but the checker wants all sines first.",
            lambda x, n: np.r_[x, frequencies(x, n)[1:].reshape(2, n).T.ravel()],
        ),
    ),
)

FINER = Exercise(
    "06-finer",
    "Distances, (K,), at which the shares u of a ray's weight lie in front; linear inside a bin.",
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
            "The weights of a ray need not sum to 1. Divide by their sum, or the last shares are never reached.",
            lambda e, w, u: np.interp(u, np.r_[0, np.cumsum(w)], e),
        ),
        Mistake(
            "At the first edge nothing has passed: there is one edge more than there are bins, and its sum is 0.",
            lambda e, w, u: np.interp(u, np.cumsum(_unit(w)), e[1:]),
        ),
        Mistake(
            "They are spread evenly: where the weight is makes no difference.",
            lambda e, w, u: e[0] + u * (e[-1] - e[0]),
        ),
        Mistake(
            "Every sample sits on an edge. Inside a bin, go on in proportion to what is missing.",
            lambda e, w, u: e[np.searchsorted(np.cumsum(_unit(w)), u)],
        ),
        Mistake(
            "Weights are summed up, not densities: do not multiply them by the widths of their bins.",
            lambda e, w, u: finer(e, w * np.diff(e), u),
        ),
    ),
)

EXERCISES = (WEIGHTS, FREQUENCIES, FINER)
