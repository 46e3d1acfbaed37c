"""Notebook 07: right answers in other styles, wrong ones with the start of the hint that they get."""

import functools
import itertools
import math
import operator

import numpy as np
import torch
from scipy import interpolate

PRIMES = (1, 2654435761, 805459861)


def side_loop(level, coarse, fine, levels):
    side = coarse
    for _ in range(level):
        side *= (fine / coarse) ** (1 / (levels - 1))
    return side


def row_bits(i, j, k, log2_entries):
    products = [format(n * p, "064b") for n, p in zip((i, j, k), PRIMES, strict=True)]
    bits = ["1" if column.count("1") % 2 else "0" for column in zip(*products, strict=True)]
    return int("".join(bits[64 - log2_entries :]), 2)


def corners_loop(x, y, z):
    result = []
    for c in range(8):
        bits = c & 1, (c >> 1) & 1, c >> 2
        result.append(math.prod(v if bit else 1 - v for v, bit in zip((x, y, z), bits, strict=True)))
    return result


def corners_torch(x, y, z):
    a, b, c = (torch.stack([1 - v, v]) for v in torch.tensor([x, y, z], requires_grad=True))
    return torch.einsum("i,j,k->kji", a, b, c).flatten()


def corners_interpolated(x, y, z):
    eyes = np.eye(8).reshape(8, 2, 2, 2)  # the function that is 1 at one corner
    axes = [(0.0, 1.0)] * 3
    return [interpolate.interpn(axes, one, (z, y, x)).item() for one in eyes]


RIGHT = {
    "07-cell-side": (
        side_loop,
        lambda k, a, b, n: np.geomspace(a, b, n)[k],
        lambda k, a, b, n: math.exp(np.interp(k, [0, n - 1], np.log([a, b]))),
        lambda k, a, b, n: torch.logspace(math.log10(a), math.log10(b), n)[k],
        lambda k, a, b, n: np.float32(a ** (1 - k / (n - 1)) * b ** (k / (n - 1))),
    ),
    "07-row": (
        row_bits,
        lambda i, j, k, n: (i ^ j * PRIMES[1] ^ k * PRIMES[2]) & ((1 << n) - 1),
        lambda i, j, k, n: np.bitwise_xor.reduce(np.multiply((i, j, k), PRIMES)) % 2**n,
        lambda i, j, k, n: (
            torch.tensor(i) ^ torch.tensor(j * PRIMES[1]) % 2**n ^ torch.tensor(k * PRIMES[2]) % 2**n
            if i < 2**n
            else i % 2**n ^ j * PRIMES[1] % 2**n ^ k * PRIMES[2] % 2**n
        ),
        lambda i, j, k, n: functools.reduce(operator.xor, map(operator.mul, (i, j, k), PRIMES)) % (1 << n),
        lambda i, j, k, n: np.uint64(i ^ j * PRIMES[1] ^ k * PRIMES[2]) & np.uint64(2**n - 1),
    ),
    "07-corner-weights": (
        corners_loop,
        corners_torch,
        corners_interpolated,
        lambda x, y, z: np.kron([1 - z, z], np.kron([1 - y, y], [1 - x, x])).astype(np.float32),
        lambda x, y, z: np.multiply.outer(np.outer([1 - z, z], [1 - y, y]), [1 - x, x]).ravel(),
    ),
}
WRONG = {
    "07-cell-side": (
        ("The cell sizes differ by equal amounts", lambda k, a, b, n: np.linspace(a, b, n)[k]),
        ("The last level", lambda k, a, b, n: np.geomspace(a, b, n + 1)[k]),
        ("Halving", lambda k, a, b, n: torch.tensor(a) * 0.5**k),
        ("The order is reversed", lambda k, a, b, n: np.geomspace(b, a, n)[k]),
    ),
    "07-row": (
        ("Combine the products", lambda i, j, k, n: np.dot((i, j, k), PRIMES) % 2**n),
        ("This is the bitwise or", lambda i, j, k, n: (i | j * PRIMES[1] | k * PRIMES[2]) & (2**n - 1)),
        ("The table has 2", lambda i, j, k, n: (i ^ j * PRIMES[1] ^ k * PRIMES[2]) % n),
        ("The row is outside", lambda i, j, k, n: i ^ j * PRIMES[1] ^ k * PRIMES[2]),
        ("The primes are swapped", lambda i, j, k, n: row_bits(i, k, j, n)),
        ("they are floats", lambda i, j, k, n: float(row_bits(i, j, k, n))),
    ),
    "07-corner-weights": (
        ("The weights are reversed", lambda x, y, z: corners_loop(x, y, z)[::-1]),
        (
            "The order of the corners",
            lambda x, y, z: [a * b * c for a, b, c in itertools.product((1 - x, x), (1 - y, y), (1 - z, z))],
        ),
        (
            "Multiply the three",
            lambda x, y, z: [(a + b + c) / 12 for a, b, c in itertools.product((1 - z, z), (1 - y, y), (1 - x, x))],
        ),
        ("This selects", lambda x, y, z: np.array(corners_loop(round(x), round(y), round(z)))),
        (
            "expected an array of shape (8,), got shape (2, 2, 2)",
            lambda x, y, z: corners_torch(x, y, z).reshape(2, 2, 2),
        ),
    ),
}
