"""Notebook 06: right answers in other styles, wrong ones with the start of the hint that they get."""

import math

import numpy as np
import torch
from scipy import interpolate


def weights_loop(sigma, delta):
    passes, result = 1.0, []
    for s, d in zip(sigma, delta, strict=True):
        result.append(passes * (1 - math.exp(-s * d)))
        passes *= math.exp(-s * d)
    return result


def weights_torch(sigma, delta):
    optical = torch.tensor(sigma * delta, dtype=torch.float32, requires_grad=True)
    passes = torch.exp(-torch.cat([torch.zeros(1), optical.cumsum(0)[:-1]]))
    return passes * -torch.expm1(-optical)


def through(sigma, delta):
    return np.exp(-np.r_[0, np.cumsum(sigma * delta)])


def encoding_loop(x, octaves, start=0, base=2.0, factor=math.pi):
    angles = [factor * base**k * x for k in range(start, start + octaves)]
    return [x, *map(math.sin, angles), *map(math.cos, angles)]


def encoding_torch(x, octaves):
    angles = torch.pi * 2 ** torch.arange(octaves) * torch.tensor(x, requires_grad=True)
    return torch.cat([torch.tensor([x]), angles.sin(), angles.cos()])


def encoding_complex(x, octaves):
    turns = np.exp(1j * np.pi * x * 2.0 ** np.arange(octaves))
    return np.r_[x, turns.imag, turns.real]


def finer_loop(edges, weights, u, spread=False):
    shares, result = [w / sum(weights) for w in weights], []
    for fraction in u:
        done, k = 0.0, 0
        while done + shares[k] < fraction:
            done, k = done + shares[k], k + 1
        result.append(edges[k] + (0 if spread else (fraction - done) / shares[k] * (edges[k + 1] - edges[k])))
    return result


def finer_torch(edges, weights, u):
    e, w, u = torch.tensor(edges, requires_grad=True), torch.tensor(weights), torch.tensor(u)
    cdf = torch.cat([torch.zeros(1), torch.cumsum(w / w.sum(), 0)])
    k = torch.searchsorted(cdf, u, right=True).clamp(1, len(w)) - 1
    return e[k] + (u - cdf[k]) / (cdf[k + 1] - cdf[k]) * (e[k + 1] - e[k])


def cdf(weights):
    return np.r_[0, np.cumsum(weights) / np.sum(weights)]


RIGHT = {
    "06-weights": (
        weights_loop,
        weights_torch,
        lambda s, d: -np.diff(through(s, d)),
        lambda s, d: through(s, d)[:-1] - through(s, d)[1:].astype(np.float32),
        lambda s, d: [math.exp(-s[:i] @ d[:i]) * -math.expm1(-s[i] * d[i]) for i in range(len(s))],
    ),
    "06-frequencies": (
        encoding_loop,
        encoding_torch,
        encoding_complex,
        lambda x, n: np.array(encoding_loop(x, n), np.float32),
        lambda x, n: np.hstack([x, *(f(np.pi * x * 2.0 ** np.arange(n)) for f in (np.sin, np.cos))]),
        lambda x, n: np.r_[x, np.sin(np.pi * x * 2.0 ** np.arange(n)), np.sin(np.pi * (x * 2.0 ** np.arange(n) + 0.5))],
    ),
    "06-finer": (
        finer_loop,
        finer_torch,
        lambda e, w, u: interpolate.interp1d(cdf(w), e)(u),
        lambda e, w, u: interpolate.make_interp_spline(cdf(w), e, k=1)(u),
        lambda e, w, u: np.interp(u * w.sum(), np.r_[0, np.cumsum(w)], e).astype(np.float32),
    ),
}
WRONG = {
    "06-weights": (
        ("This is alpha", lambda s, d: [-math.expm1(-a * b) for a, b in zip(s, d, strict=True)]),
        ("The transmittance of a bin", lambda s, d: through(s, d)[1:] * -np.expm1(-s * d)),
        ("The widths are missing", lambda s, d: weights_torch(s, 1 + 0 * d)),
        ("These weights sum", lambda s, d: np.divide(weights_loop(s, d), sum(weights_loop(s, d)))),
        ("This is the transmittance", lambda s, d: through(s, d)[:-1]),
        ("expected an array of shape (3,), got a number", lambda s, d: sum(weights_loop(s, d))),
    ),
    "06-frequencies": (
        ("The first frequency", lambda x, n: encoding_loop(x, n, start=1)),
        ("The factor pi", lambda x, n: encoding_loop(x, n, factor=1.0)),
        ("x itself", lambda x, n: encoding_torch(x, n)[1:]),
        (
            "The order is wrong",
            lambda x, n: np.r_[x, encoding_complex(x, n)[n + 1 :], encoding_complex(x, n)[1 : n + 1]],
        ),
        (
            "Sines and cosines",
            lambda x, n: [x, *(f(math.pi * x * 2**k) for k in range(n) for f in (math.sin, math.cos))],
        ),
    ),
    "06-finer": (
        (
            "The weights of a ray",
            lambda e, w, u: interpolate.interp1d(np.r_[0, np.cumsum(w)], e, bounds_error=False, fill_value=e[-1])(u),
        ),
        ("These samples are uniform", lambda e, w, u: [e[0] + f * (e[-1] - e[0]) for f in u]),
        ("Every sample is on an edge", lambda e, w, u: finer_loop(e, w, u - 1e-9, spread=True)),
        ("Weights are not densities", lambda e, w, u: finer_torch(e, w * np.diff(e), u)),
    ),
}
