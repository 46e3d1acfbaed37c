"""Notebook 03: right answers in other styles, wrong ones with the start of the hint that they get."""

import math

import numpy as np
import torch
from scipy import ndimage, signal, special

CROSS = ndimage.generate_binary_structure(2, 1)


def frontier_loops(explored, occupied, moves=((1, 0), (-1, 0), (0, 1), (0, -1)), border=False):
    rows, columns = explored.shape
    result = [[False] * columns for _ in range(rows)]
    for i, j in np.ndindex(rows, columns):
        if explored[i, j] and not occupied[i, j]:
            for di, dj in moves:
                inside = 0 <= i + di < rows and 0 <= j + dj < columns
                result[i][j] |= not explored[i + di, j + dj] if inside else border
    return result


def frontier_torch(explored, occupied):
    unknown = torch.tensor(~explored)[None, None].float()
    kernel = torch.tensor(CROSS)[None, None].float()
    near = torch.nn.functional.conv2d(unknown, kernel, padding=1)[0, 0] > 0
    return torch.tensor(explored & ~occupied) & near


def softmax_loops(scores, reachable):
    highest = max(s for s, r in zip(scores.flat, reachable.flat, strict=True) if r)
    weights = [math.exp(s - highest) if r else 0.0 for s, r in zip(scores.flat, reachable.flat, strict=True)]
    return np.reshape([w / sum(weights) for w in weights], scores.shape)


def softmax_float32(scores, reachable):
    z = np.where(reachable, scores, -np.inf).astype(np.float32)
    return special.softmax(z)


def softmax_torch(scores, reachable):
    z = torch.tensor(scores, requires_grad=True).masked_fill(torch.tensor(~reachable), -torch.inf)
    return torch.softmax(z.flatten(), 0).reshape(z.shape)


def torch_axis(axis):
    return lambda s, t: torch.softmax(torch.tensor(np.where(t, s, -np.inf)), axis)


RIGHT = {
    "03-frontier": (
        frontier_loops,
        frontier_torch,
        lambda e, o: e & ~o & ndimage.binary_dilation(~e, CROSS),
        lambda e, o: (e & ~o & (signal.convolve2d(1 * ~e, CROSS, "same") > 0)).astype(int),
        lambda e, o: e * ~o * (ndimage.maximum_filter(~e, footprint=CROSS, mode="constant") > 0),
    ),
    "03-utility": (
        lambda g, d, r: g / (4 * d + 6 * abs(r) / math.pi + 4),
        lambda g, d, r: torch.tensor(g) / (d / 0.25 + torch.tensor(r).abs() / math.radians(30) + 4),
        lambda g, d, r: np.float32(g) / np.float32(d / 0.25 + math.hypot(r) / (math.pi / 6) + 4),
        lambda g, d, r: g / sum((d / 0.25, abs(math.degrees(r)) / 30, 4)),
        lambda g, d, r: np.divide(g, d / 0.25 + max(r, -r) / np.radians(30) + 4),
    ),
    "03-chances": (
        softmax_loops,
        softmax_float32,
        softmax_torch,
        lambda s, t: special.softmax(np.where(t, s, -np.inf)),
        lambda s, t: np.exp(np.where(t, s, -np.inf) - special.logsumexp(s[t])),
        lambda s, t: softmax_loops(s, t).tolist(),
    ),
}
WRONG = {
    "03-frontier": (
        ("These are the unknown", lambda e, o: ~e & ndimage.binary_dilation(e & ~o, CROSS)),
        ("Occupied cells", lambda e, o: e & ndimage.binary_dilation(~e, CROSS)),
        ("Diagonal", lambda e, o: e & ~o & ndimage.binary_dilation(~e, np.ones((3, 3)))),
        ("The border", lambda e, o: frontier_loops(e, o, border=True)),
        ("np.roll", lambda e, o: e & ~o & (ndimage.convolve(1 * ~e, 1 * CROSS, mode="wrap") > 0)),
    ),
    "03-utility": (
        ("The distance is in metres", lambda g, d, r: g / (d + 6 * abs(r) / math.pi + 4)),
        ("A rotation to the right", lambda g, d, r: g / (4 * d + 6 * r / math.pi + 4)),
        ("The rotation is in radians", lambda g, d, r: np.float32(g / (4 * d + abs(r) + 4))),
        ("The steps for the rotation", lambda g, d, r: torch.tensor(g / (4 * d + 4))),
        ("The fraction is inverted", lambda g, d, r: (4 * d + 6 * abs(r) / math.pi + 4) / g),
    ),
    "03-chances": (
        ("The blocks of a map have two axes", torch_axis(-1)),
        ("This normalises each column", torch_axis(0)),
        ("An unreachable block may", lambda s, t: (w := np.where(t, np.exp(s - np.max(s)), 0)) / w.sum()),
        ("Unreachable blocks must", lambda s, t: torch.softmax(torch.tensor(s).flatten(), 0).reshape(s.shape)),
        ("exp(1000) overflows", lambda s, t: (w := np.where(t, np.exp(s), 0)) / w.sum()),
        ("The probabilities do not sum", lambda s, t: special.softmax(s) * t),
        ("This is argmax", lambda s, t: (s == s[t].max()).astype(np.float32)),
    ),
}
