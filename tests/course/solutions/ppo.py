"""Notebook 05: right answers in other styles, wrong ones with the start of the hint that they get."""

import itertools

import numpy as np
import torch
from scipy import linalg, signal


def returns_double_loop(rewards, gamma):
    return [sum(gamma**k * rewards[t + k] for k in range(len(rewards) - t)) for t in range(len(rewards))]


def returns_torch(rewards, gamma):
    r = torch.tensor(rewards, dtype=torch.float32, requires_grad=True)
    steps = torch.arange(len(r))[None] - torch.arange(len(r))[:, None]
    return (torch.tensor(gamma) ** steps).triu() @ r


def returns_accumulated(rewards, gamma):
    return list(itertools.accumulate(rewards[::-1], lambda later, r: r + gamma * later))[::-1]


def gae_double_loop(r, v, ends, last, gamma, lam, subtract=1.0, stop=True, weight=None):
    following = np.append(v[1:], last)
    weight = gamma * lam if weight is None else weight(gamma, lam)
    result = []
    for t in range(len(r)):
        total, factor = 0.0, 1.0
        for k in range(t, len(r)):
            end = ends[k] and stop
            total += factor * (r[k] + gamma * (0 if end else following[k]) - v[k])
            factor *= weight
            if end:
                break
        result.append(total + (1 - subtract) * v[t])
    return result


def gae_solve(r, v, ends, last, gamma, lam):
    going = 1.0 - ends
    delta = r + gamma * going * np.append(v[1:], last) - v
    return linalg.solve(np.eye(len(r)) - np.diag(gamma * lam * going[:-1], 1), delta)


def gae_torch(r, v, ends, last, gamma, lam):
    r, v, going = torch.tensor(r), torch.tensor(v, requires_grad=True), 1.0 - torch.tensor(ends).double()
    following = torch.cat([v[1:], torch.tensor([last])])
    result, later = [], torch.tensor(0.0)
    for t in range(len(r) - 1, -1, -1):
        later = r[t] - v[t] + going[t] * gamma * (following[t] + lam * later)
        result.insert(0, later)
    return torch.stack(result)


def gae_recursive(r, v, ends, last, gamma, lam):
    if len(r) == 0:
        return ()
    later = gae_recursive(r[1:], v[1:], ends[1:], last, gamma, lam)
    following = v[1] if len(v) > 1 else last
    more = 0 if ends[0] else gamma * (following + lam * (later[0] if later else 0))
    return (r[0] - v[0] + more, *later)


def piecewise(ratio, advantage, epsilon):
    if advantage > 0:
        return min(ratio, 1 + epsilon) * advantage
    return max(ratio, 1 - epsilon) * advantage


def clip(ratio, epsilon):
    return torch.clamp(torch.tensor(ratio), 1 - epsilon, 1 + epsilon)


RIGHT = {
    "05-returns": (
        returns_double_loop,
        returns_torch,
        returns_accumulated,
        lambda r, g: signal.lfilter([1], [1, -g], r[::-1])[::-1],
        lambda r, g: np.triu(g ** np.maximum(np.subtract.outer(range(len(r)), range(len(r))).T, 0.0)) @ r,
        lambda r, g: np.array(returns_double_loop(r, g), np.float32),
    ),
    "05-advantages": (
        gae_double_loop,
        gae_solve,
        gae_torch,
        gae_recursive,
        lambda *args: np.float32(gae_double_loop(*args)),
    ),
    "05-clipped": (
        piecewise,
        lambda p, a, e: min(p * a, (1 + e if a > 0 else 1 - e) * a),
        lambda p, a, e: torch.minimum(torch.tensor(p * a), clip(p, e) * a),
        lambda p, a, e: np.minimum(p * a, np.float32(np.clip(p, 1 - e, 1 + e) * a)),
        lambda p, a, e: sorted((p * a, sorted((1 - e, p, 1 + e))[1] * a))[0],
        lambda p, a, e: p * a - max(0.0, p * a - float(clip(p, e)) * a),
    ),
}
WRONG = {
    "05-returns": (
        ("This sums the past", lambda r, g: signal.lfilter([1], [1, -g], r)),
        ("The discount starts", lambda r, g: [sum(g**k * r[k] for k in range(t, len(r))) for t in range(len(r))]),
        ("Nothing is discounted", lambda r, g: [sum(r[t:]) for t in range(len(r))]),
        ("The reward of the decision", lambda r, g: g * returns_torch(r, g)),
        ("This is one value", lambda r, g: sum(g**k * value for k, value in enumerate(r))),
        ("expected an array of shape (1,), got shape (1, 1)", lambda r, g: [returns_double_loop(r, g)]),
    ),
    "05-advantages": (
        ("Episodes are mixed", lambda *args: gae_double_loop(*args, stop=False)),
        ("These are the one-step", lambda *args: gae_double_loop(*args, weight=lambda g, lam: 0.0)),
        ("lambda is missing", lambda *args: gae_double_loop(*args, weight=lambda g, lam: g)),
        ("The next advantage is multiplied", lambda *args: gae_double_loop(*args, weight=lambda g, lam: lam)),
        ("These are returns", lambda *args: gae_double_loop(*args, subtract=0.0)),
        ("The last decision ignores", lambda r, v, e, last, g, lam: gae_torch(r, v, e, 0.0, g, lam)),
    ),
    "05-clipped": (
        ("Nothing is clipped", lambda p, a, e: torch.tensor(p * a)),
        ("The ratio is always", lambda p, a, e: np.clip(p, 1 - e, 1 + e) * a),
        ("This is the maximum", lambda p, a, e: np.maximum(p * a, np.clip(p, 1 - e, 1 + e) * a)),
        ("The sign is that", lambda p, a, e: -piecewise(p, a, e)),
        ("The product of ratio", lambda p, a, e: np.minimum(p * a, np.clip(p * a, 1 - e, 1 + e))),
    ),
}
