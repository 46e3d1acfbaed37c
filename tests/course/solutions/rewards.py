"""Notebook 04: right answers in other styles, wrong ones with the start of the hint that they get."""

import math
from collections import Counter, defaultdict

import numpy as np
import torch


def count(mask):
    return sum(bool(value) for value in mask.ravel())


def known(state):
    return {k for k in range(15) if state.semantics[k].any()}


class Listed:
    def reset(self, rng):
        self.seen = []

    def __call__(self, transition):
        square = np.floor(transition.observation.pose[:2, 3]).tolist()
        self.seen.append(square)
        return self.seen.count(square) == 1


class Grown:
    def reset(self, rng):
        self.squares = set()

    def __call__(self, transition):
        before = len(self.squares)
        self.squares |= {tuple(math.floor(v) for v in transition.observation.pose[:2, 3])}
        return len(self.squares) - before


class Counted:
    def __init__(self):
        self.visits = Counter()

    def reset(self, rng):
        self.visits.clear()

    def __call__(self, transition):
        x, y = transition.observation.pose[:2, 3] // 1
        self.visits[x, y] += 1
        return np.float32(self.visits[x, y] == 1)


class Tensors:
    def reset(self, rng):
        self.seen = torch.zeros((2, 200, 200), dtype=torch.bool)

    def __call__(self, transition):
        x, y = torch.tensor(transition.observation.pose[:2, 3]).floor().long() + 100
        new = ~self.seen[0, x, y]
        self.seen[0, x, y] = True
        return new.float()


class Marked:
    def reset(self, rng):
        self.unseen = defaultdict(lambda: 1.0)

    def __call__(self, transition):
        square = tuple(np.floor(transition.observation.pose[:2, 3]))
        reward, self.unseen[square] = self.unseen[square], 0.0
        return reward


class NoReset(Grown):
    squares = None

    def __init__(self):
        self.squares = set()

    def reset(self, rng):
        """Do nothing."""


class Truncated(Listed):
    def __call__(self, transition):
        square = [int(v) for v in transition.observation.pose[:2, 3]]
        self.seen += [square]
        return float(self.seen.count(square) == 1)


class Forgetful(Marked):
    def __call__(self, transition):
        self.reset(None)
        return super().__call__(transition)


class Common(Grown):
    squares = set()  # noqa: RUF012 - the mistake

    def reset(self, rng):
        self.squares.clear()

    def __call__(self, transition):
        square = tuple(math.floor(v) for v in transition.observation.pose[:2, 3])
        new = square not in self.squares
        self.squares.add(square)
        return float(new)


class Rounded(Listed):
    def __call__(self, transition):
        square = transition.observation.pose[:2, 3].round().tolist()
        self.seen += [square]
        return float(self.seen.count(square) == 1)


class Unfinished(Listed):
    def __call__(self, transition):
        self.seen.append(transition.observation.pose[:2, 3].tolist())


RIGHT = {
    "04-obs": (
        lambda t: (count(t.after.occupied) - count(t.before.occupied)) * t.after.cell**2,
        lambda t: np.float32(t.after.occupied.sum() * t.after.cell**2 - t.before.occupied.sum() * t.before.cell**2),
        lambda t: (torch.tensor(t.after.occupied).sum() - torch.tensor(t.before.occupied).sum()) * t.after.cell**2,
        lambda t: np.sum(t.after.occupied.astype(int) - t.before.occupied) * t.after.cell * t.after.cell,
        lambda t: len(np.argwhere(t.after.occupied & ~t.before.occupied)) * t.after.cell**2,
    ),
    "04-new-classes": (
        lambda t: len(known(t.after) - known(t.before)),
        lambda t: sum(t.after.semantics[k].any() and not t.before.semantics[k].any() for k in range(15)),
        lambda t: (
            torch.tensor(t.after.semantics).flatten(1).any(1) > torch.tensor(t.before.semantics).flatten(1).any(1)
        ).sum(),
        lambda t: np.setdiff1d(np.nonzero(t.after.semantics)[0], np.nonzero(t.before.semantics)[0]).size,
        lambda t: np.float32((t.after.semantics.max((1, 2)) ^ t.before.semantics.max((1, 2))).sum()),
    ),
    "04-new-squares": (Listed, Grown, Counted, Tensors, Marked),
}
WRONG = {
    "04-obs": (
        ("NumPy cannot subtract", lambda t: np.sum(t.after.occupied - t.before.occupied) * t.after.cell**2),
        ("This is a number of cells", lambda t: count(t.after.occupied) - count(t.before.occupied)),
        ("Multiply by the square", lambda t: (count(t.after.occupied) - count(t.before.occupied)) * t.after.cell),
        ("This is the whole", lambda t: torch.tensor(t.after.occupied).sum() * t.after.cell**2),
        ("This is `cov`", lambda t: count(t.after.explored & ~t.before.explored) * t.after.cell**2),
        ("The sign is wrong", lambda t: (count(t.before.occupied) - count(t.after.occupied)) * t.after.cell**2),
    ),
    "04-new-classes": (
        ("This counts new cells", lambda t: count(t.after.semantics & ~t.before.semantics)),
        ("This counts all classes", lambda t: len(known(t.after))),
        ("Two new classes", lambda t: bool(known(t.after) - known(t.before))),
        ("This is `sem`", lambda t: count(t.after.semantics & ~t.before.semantics) * t.after.cell**2),
    ),
    "04-new-squares": (
        ("Every step gets", Forgetful),
        ("int() rounds", Truncated),
        ("The second episode", NoReset),
        ("Two environments share", Common),
        ("Is a `return` missing", Unfinished),
        ("round() puts", Rounded),
    ),
}
