"""Exercises of notebook 05: discounted returns, advantages, the clipped objective.

The solutions are read by students: they say for one episode what Stable-Baselines3 does for many at once.
"""

import numpy as np

from autonerf_lab.course.checker import Case, Exercise, Mistake


def returns(rewards: np.ndarray, gamma: float) -> np.ndarray:
    found, following = np.zeros(len(rewards)), 0.0
    for t in reversed(range(len(rewards))):  # from the end: what follows is known already
        following = rewards[t] + gamma * following
        found[t] = following
    return found


def advantages(
    rewards: np.ndarray, values: np.ndarray, ends: np.ndarray, last_value: float, gamma: float, lam: float
) -> np.ndarray:
    found, following, next_value = np.zeros(len(rewards)), 0.0, last_value
    for t in reversed(range(len(rewards))):
        goes_on = 0.0 if ends[t] else 1.0  # nothing flows back from the next episode
        delta = rewards[t] + gamma * goes_on * next_value - values[t]
        following = delta + gamma * lam * goes_on * following
        found[t], next_value = following, values[t]
    return found


def clipped(ratio: float, advantage: float, epsilon: float) -> float:
    held = min(max(ratio, 1 - epsilon), 1 + epsilon)
    return min(ratio * advantage, held * advantage)  # the smaller: never more optimistic than either


def _forwards(rewards: np.ndarray, gamma: float) -> np.ndarray:
    return np.array([sum(gamma ** (t - k) * rewards[k] for k in range(t + 1)) for t in range(len(rewards))])


def _not_shifted(rewards: np.ndarray, gamma: float) -> np.ndarray:
    return np.cumsum((rewards * gamma ** np.arange(len(rewards)))[::-1])[::-1]


RETURNS = Exercise(
    "05-returns",
    "What each decision of an episode brings from there to its end, (T,): later rewards are discounted.",
    (
        Case("a reward of 3 at the end of one decision, gamma = 0.5", (np.array([3.0]), 0.5), np.array([3.0])),
        Case("the rewards 1, 0, 2 and gamma = 0.5", (np.array([1.0, 0.0, 2.0]), 0.5), np.array([1.5, 1.0, 2.0])),
        Case("the rewards 0, 0, 1 and gamma = 0.9", (np.array([0.0, 0.0, 1.0]), 0.9), np.array([0.81, 0.9, 1.0])),
    ),
    returns,
    (
        Mistake("That looks back: a decision is worth what comes after it, not what came before.", _forwards),
        Mistake(
            "The discount begins at the start of the episode here. It should begin anew at each decision.",
            _not_shifted,
        ),
        Mistake(
            "Nothing is discounted: a reward after k decisions counts gamma to the power of k.",
            lambda r, gamma: np.cumsum(r[::-1])[::-1],
        ),
        Mistake(
            "The decision's own reward is discounted too. It counts in full, the next one gamma times.",
            lambda r, gamma: gamma * returns(r, gamma),
        ),
        Mistake(
            "This is one number for the whole episode; each decision has its own.",
            lambda r, gamma: returns(r, gamma)[0],
        ),
    ),
)

_NOT_AT_ALL = np.array([False, False, False])
_IN_BETWEEN = np.array([False, True, False])
_PAID, _EXPECTED = np.array([1.0, 0.0, 2.0]), np.array([1.0, 2.0, 1.0])

ADVANTAGES = Exercise(
    "05-advantages",
    "Generalised advantages, (T,), of decisions in a row; after a decision that ends[t], another episode begins.",
    (
        Case(
            "one decision, reward 1, value 2, then a value of 4; gamma = lambda = 0.5",
            (np.array([1.0]), np.array([2.0]), np.array([False]), 4.0, 0.5, 0.5),
            np.array([1.0]),
        ),
        Case(
            "rewards 1, 0, 2, values 1, 2, 1, then 2; gamma = lambda = 0.5",
            (_PAID, _EXPECTED, _NOT_AT_ALL, 2.0, 0.5, 0.5),
            np.array([0.75, -1.0, 2.0]),
        ),
        Case(
            "the same, but the episode ends with the second decision",
            (_PAID, _EXPECTED, _IN_BETWEEN, 2.0, 0.5, 0.5),
            np.array([0.5, -2.0, 2.0]),
        ),
        Case(
            "the same, with lambda = 0.8",
            (_PAID, _EXPECTED, _IN_BETWEEN, 2.0, 0.5, 0.8),
            np.array([0.2, -2.0, 2.0]),
        ),
    ),
    advantages,
    (
        Mistake(
            "An episode flows into the next one: where ends[t], neither the next value nor the next advantage counts.",
            lambda r, v, e, last, gamma, lam: advantages(r, v, np.zeros_like(e), last, gamma, lam),
        ),
        Mistake(
            "These are the one-step errors, delta. Each advantage also holds gamma * lambda times the next one.",
            lambda r, v, e, last, gamma, lam: advantages(r, v, e, last, gamma, 0.0),
        ),
        Mistake(
            "lambda is missing: the next advantage counts gamma * lambda times.",
            lambda r, v, e, last, gamma, lam: advantages(r, v, e, last, gamma, 1.0),
        ),
        Mistake(
            "The next advantage counts lambda times here. It should be gamma * lambda.",
            lambda r, v, e, last, gamma, lam: advantages(r, v, e, last, gamma, lam / gamma),
        ),
        Mistake(
            "These are returns: what was expected, values[t], has to be taken away.",
            lambda r, v, e, last, gamma, lam: advantages(r, v, e, last, gamma, lam) + v,
        ),
        Mistake(
            "The last decision forgets what comes after it: there, the next value is last_value.",
            lambda r, v, e, last, gamma, lam: advantages(r, v, e, 0.0, gamma, lam),
        ),
        Mistake(
            "The next value is not discounted: gamma times values[t + 1].",
            lambda r, v, e, last, gamma, lam: advantages(
                r + (1 - gamma) * ~e * np.append(v[1:], last), v, e, last, gamma, lam
            ),
        ),
    ),
)


def _held(ratio: float, epsilon: float) -> float:
    return float(np.clip(ratio, 1 - epsilon, 1 + epsilon))


CLIPPED = Exercise(
    "05-clipped",
    "The clipped objective of one decision, to be made as large as possible.",
    (
        Case("ratio 1, advantage 2, epsilon 0.2", (1.0, 2.0, 0.2), 2.0),
        Case("ratio 1.5, advantage 2, epsilon 0.2", (1.5, 2.0, 0.2), 2.4),
        Case("ratio 0.5, advantage 2, epsilon 0.2", (0.5, 2.0, 0.2), 1.0),
        Case("ratio 1.5, advantage -1, epsilon 0.2", (1.5, -1.0, 0.2), -1.5),
        Case("ratio 0.5, advantage -1, epsilon 0.2", (0.5, -1.0, 0.2), -0.8),
    ),
    clipped,
    (
        Mistake("Nothing is clipped: this rewards steps of any size.", lambda rho, a, eps: rho * a),
        Mistake(
            "It is clipped always, so that a decision which has become worse is not drawn back. Take the minimum of "
            "both.",
            lambda rho, a, eps: _held(rho, eps) * a,
        ),
        Mistake(
            "The larger of the two is the optimistic one. Take the smaller.",
            lambda rho, a, eps: max(rho * a, _held(rho, eps) * a),
        ),
        Mistake(
            "The sign of a loss: this is what an optimiser makes small. Here the objective itself is asked for.",
            lambda rho, a, eps: -clipped(rho, a, eps),
        ),
        Mistake(
            "The ratio is clipped, and then multiplied with the advantage; not their product.",
            lambda rho, a, eps: min(rho * a, _held(rho * a, eps)),
        ),
    ),
)

EXERCISES = (RETURNS, ADVANTAGES, CLIPPED)
