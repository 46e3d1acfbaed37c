"""Exercises of notebook 05: discounted returns, advantages, the clipped objective.

Students read the solutions. They compute for one episode what Stable-Baselines3 computes for several environments.
"""

import numpy as np

from autonerf_lab.course.checker import Case, Exercise, Mistake


def returns(rewards: np.ndarray, gamma: float) -> np.ndarray:
    """Return the discounted return of each decision, (T,)."""
    result, next_return = np.zeros(len(rewards)), 0.0
    for t in reversed(range(len(rewards))):  # backwards, so that the next return is known
        next_return = rewards[t] + gamma * next_return
        result[t] = next_return
    return result


def advantages(
    rewards: np.ndarray, values: np.ndarray, ends: np.ndarray, last_value: float, gamma: float, lam: float
) -> np.ndarray:
    """Return the generalised advantage estimate of each decision, (T,)."""
    result, next_advantage, next_value = np.zeros(len(rewards)), 0.0, last_value
    for t in reversed(range(len(rewards))):
        mask = 0.0 if ends[t] else 1.0  # values of the next episode must not enter this one
        delta = rewards[t] + gamma * mask * next_value - values[t]
        next_advantage = delta + gamma * lam * mask * next_advantage
        result[t], next_value = next_advantage, values[t]
    return result


def clipped(ratio: float, advantage: float, epsilon: float) -> float:
    """Return the clipped objective of one decision."""
    clipped_ratio = min(max(ratio, 1 - epsilon), 1 + epsilon)
    return min(ratio * advantage, clipped_ratio * advantage)  # the minimum is the pessimistic bound


def _backward_looking(rewards: np.ndarray, gamma: float) -> np.ndarray:
    return np.array([sum(gamma ** (t - k) * rewards[k] for k in range(t + 1)) for t in range(len(rewards))])


def _discounted_from_the_start(rewards: np.ndarray, gamma: float) -> np.ndarray:
    return np.cumsum((rewards * gamma ** np.arange(len(rewards)))[::-1])[::-1]


RETURNS = Exercise(
    "05-returns",
    "Return the discounted return of each decision of an episode, (T,).",
    (
        Case("one decision with reward 3, gamma = 0.5", (np.array([3.0]), 0.5), np.array([3.0])),
        Case("the rewards 1, 0, 2 and gamma = 0.5", (np.array([1.0, 0.0, 2.0]), 0.5), np.array([1.5, 1.0, 2.0])),
        Case("the rewards 0, 0, 1 and gamma = 0.9", (np.array([0.0, 0.0, 1.0]), 0.9), np.array([0.81, 0.9, 1.0])),
    ),
    returns,
    (
        Mistake(
            "This sums the past rewards. The return of a decision sums the rewards from it to the end.",
            _backward_looking,
        ),
        Mistake(
            "The discount starts at the first decision of the episode. It must start at each decision.",
            _discounted_from_the_start,
        ),
        Mistake(
            "Nothing is discounted: multiply a reward k decisions later by gamma ** k.",
            lambda r, gamma: np.cumsum(r[::-1])[::-1],
        ),
        Mistake(
            "The reward of the decision itself must not be discounted; the next one is multiplied by gamma.",
            lambda r, gamma: gamma * returns(r, gamma),
        ),
        Mistake(
            "This is one value for the whole episode. Return one value per decision.",
            lambda r, gamma: returns(r, gamma)[0],
        ),
    ),
)

_NO_END = np.array([False, False, False])
_END_AT_1 = np.array([False, True, False])
_REWARDS, _VALUES = np.array([1.0, 0.0, 2.0]), np.array([1.0, 2.0, 1.0])

ADVANTAGES = Exercise(
    "05-advantages",
    "Return the generalised advantages, (T,), of consecutive decisions; ends[t]: decision t ends its episode.",
    (
        Case(
            "reward 1, value 2, last value 4; gamma = lambda = 0.5",
            (np.array([1.0]), np.array([2.0]), np.array([False]), 4.0, 0.5, 0.5),
            np.array([1.0]),
        ),
        Case(
            "rewards 1, 0, 2, values 1, 2, 1, last value 2; gamma = lambda = 0.5",
            (_REWARDS, _VALUES, _NO_END, 2.0, 0.5, 0.5),
            np.array([0.75, -1.0, 2.0]),
        ),
        Case(
            "the same, with the end of an episode at the second decision",
            (_REWARDS, _VALUES, _END_AT_1, 2.0, 0.5, 0.5),
            np.array([0.5, -2.0, 2.0]),
        ),
        Case(
            "the same, with lambda = 0.8",
            (_REWARDS, _VALUES, _END_AT_1, 2.0, 0.5, 0.8),
            np.array([0.2, -2.0, 2.0]),
        ),
    ),
    advantages,
    (
        Mistake(
            "Episodes are mixed: if ends[t], use neither the next value nor the next advantage.",
            lambda r, v, e, last, gamma, lam: advantages(r, v, np.zeros_like(e), last, gamma, lam),
        ),
        Mistake(
            "These are the one-step errors delta. Add gamma * lambda times the next advantage.",
            lambda r, v, e, last, gamma, lam: advantages(r, v, e, last, gamma, 0.0),
        ),
        Mistake(
            "lambda is missing: multiply the next advantage by gamma * lambda.",
            lambda r, v, e, last, gamma, lam: advantages(r, v, e, last, gamma, 1.0),
        ),
        Mistake(
            "The next advantage is multiplied by lambda only. Multiply it by gamma * lambda.",
            lambda r, v, e, last, gamma, lam: advantages(r, v, e, last, gamma, lam / gamma),
        ),
        Mistake(
            "These are returns: subtract values[t].",
            lambda r, v, e, last, gamma, lam: advantages(r, v, e, last, gamma, lam) + v,
        ),
        Mistake(
            "The last decision ignores last_value, which is its next value.",
            lambda r, v, e, last, gamma, lam: advantages(r, v, e, 0.0, gamma, lam),
        ),
        Mistake(
            "The next value is not discounted: multiply it by gamma.",
            lambda r, v, e, last, gamma, lam: advantages(
                r + (1 - gamma) * ~e * np.append(v[1:], last), v, e, last, gamma, lam
            ),
        ),
    ),
)


def _clipped_ratio(ratio: float, epsilon: float) -> float:
    return float(np.clip(ratio, 1 - epsilon, 1 + epsilon))


CLIPPED = Exercise(
    "05-clipped",
    "Return the clipped objective of one decision, which is maximised.",
    (
        Case("ratio 1, advantage 2, epsilon 0.2", (1.0, 2.0, 0.2), 2.0),
        Case("ratio 1.5, advantage 2, epsilon 0.2", (1.5, 2.0, 0.2), 2.4),
        Case("ratio 0.5, advantage 2, epsilon 0.2", (0.5, 2.0, 0.2), 1.0),
        Case("ratio 1.5, advantage -1, epsilon 0.2", (1.5, -1.0, 0.2), -1.5),
        Case("ratio 0.5, advantage -1, epsilon 0.2", (0.5, -1.0, 0.2), -0.8),
    ),
    clipped,
    (
        Mistake("Nothing is clipped: large policy updates are still rewarded.", lambda rho, a, eps: rho * a),
        Mistake(
            "The ratio is always clipped, so there is no gradient to undo a harmful update. Take the minimum of the "
            "clipped and the unclipped term.",
            lambda rho, a, eps: _clipped_ratio(rho, eps) * a,
        ),
        Mistake(
            "This is the maximum of the two terms. Take the minimum, which is the pessimistic bound.",
            lambda rho, a, eps: max(rho * a, _clipped_ratio(rho, eps) * a),
        ),
        Mistake(
            "The sign is that of a loss, which is minimised. Return the objective, which is maximised.",
            lambda rho, a, eps: -clipped(rho, a, eps),
        ),
        Mistake(
            "The product of ratio and advantage is clipped. Clip only the ratio, then multiply.",
            lambda rho, a, eps: min(rho * a, _clipped_ratio(rho * a, eps)),
        ),
    ),
)

EXERCISES = (RETURNS, ADVANTAGES, CLIPPED)
