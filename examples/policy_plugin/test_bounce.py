import numpy as np
from bounce import Bounce

from autonerf_lab.policies import check_policy
from autonerf_lab.types import Action, Observation


def test_conformance():
    check_policy(Bounce, steps=60)


def test_it_turns_only_after_a_collision():
    policy = Bounce()
    policy.reset(np.random.default_rng(0))
    image = np.zeros((4, 4))
    free, collided = (Observation(image, image, image, np.eye(4), collided) for collided in (False, True))
    assert policy.act(None, free) == Action.FORWARD
    assert policy.act(None, collided) != Action.FORWARD
