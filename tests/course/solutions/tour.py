"""Notebook 00: right answers in other styles, wrong ones with the start of the hint that they get."""

import math

import numpy as np
import torch


def opacity_steps(sigma, delta):
    passes = 1.0
    for _ in range(1000):  # a thousand thin layers
        passes *= math.exp(-sigma * delta / 1000)
    return 1 - passes


def colour_torch(alphas, colors):
    a, c = torch.tensor(alphas, requires_grad=True), torch.tensor(colors)
    passes = torch.cat([torch.ones(1), torch.cumprod(1 - a, 0)[:-1]])
    return ((passes * a)[:, None] * c).sum(0)


def colour_recursive(alphas, colors):
    if len(alphas) == 0:
        return np.zeros(3)
    return alphas[0] * colors[0] + (1 - alphas[0]) * colour_recursive(alphas[1:], colors[1:])


def colour_lists(alphas, colors):
    passes, total = 1.0, [0.0, 0.0, 0.0]
    for alpha, color in zip(alphas.tolist(), colors.tolist(), strict=True):
        total = [t + passes * alpha * c for t, c in zip(total, color, strict=True)]
        passes *= 1 - alpha
    return total


def transmittance(alphas):
    return np.array([np.prod(1 - alphas[:i]) for i in range(len(alphas))])


RIGHT = {
    "00-opacity": (
        lambda s, d: -math.expm1(-s * d),
        lambda s, d: np.float32(1) - np.exp(np.float32(-s * d)),
        lambda s, d: 1 - torch.exp(-torch.tensor(s * d, requires_grad=True)),
        lambda s, d: 1 - math.e ** -(s * d),
        opacity_steps,
    ),
    "00-colour": (
        colour_torch,
        colour_recursive,
        colour_lists,
        lambda a, c: np.einsum("s,sc->c", transmittance(a) * a, c).astype(np.float32),
        lambda a, c: tuple((transmittance(a) * a) @ c),
        lambda a, c: np.sum([np.prod(1 - a[:i]) * a[i] * c[i] for i in range(len(a))], axis=0),
    ),
}
WRONG = {
    "00-opacity": (
        ("This is the fraction that passes", lambda s, d: torch.exp(torch.tensor(-s * d))),
        ("The product can exceed 1", lambda s, d: np.float32(s) * np.float32(d)),
        ("The width is missing", lambda s, d: -math.expm1(-s)),
        ("The minus sign", lambda s, d: 1 - math.e ** (s * d)),
        ("of type `str`", lambda s, d: str(1 - math.exp(-s * d))),
        ("expected a number, got an array of shape (1,)", lambda s, d: [1 - math.exp(-s * d)]),
    ),
    "00-colour": (
        ("Light from the second bin", lambda a, c: list(a @ c)),
        ("A bin does not attenuate", lambda a, c: torch.tensor((np.cumprod(1 - a) * a) @ c)),
        ("These weights sum to 1", lambda a, c: (w := transmittance(a) * a) @ c / sum(w)),
        ("This is the transmittance", lambda a, c: (transmittance(a)[:, None] * c).sum(axis=0)),
        ("The order is reversed", lambda a, c: colour_recursive(np.flip(a), np.flip(c, axis=0))),
    ),
}
