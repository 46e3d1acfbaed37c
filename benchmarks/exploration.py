"""How fast the robot explores: an episode as it is recorded, and the steps of an environment as policies train on it.

Prints a table, and as its last line one JSON object. ``--quick`` for a look.
"""

import argparse
import json
import time
from collections.abc import Callable

import numpy as np

from autonerf_lab.exploration import explore
from autonerf_lab.geometry import Intrinsics
from autonerf_lab.mapping import empty_map, update
from autonerf_lab.policies import make_policy
from autonerf_lab.scenes import load_scene
from autonerf_lab.simulator import Simulator


def milliseconds(work: Callable[[], object], repeats: int) -> float:
    """Mean time of one call."""
    work()
    start = time.perf_counter()
    for _ in range(repeats):
        work()
    return (time.perf_counter() - start) / repeats * 1000


def environment_steps_per_second(sim: Simulator, cells: int, steps: int) -> float:
    """Move, look (depth and classes), map; no learning."""
    rng = np.random.default_rng(0)
    observation = sim.reset(seed=0)
    known = empty_map(observation.pose, cells, 24.0 / cells)
    start = time.perf_counter()
    for action in rng.choice(3, size=steps, p=[0.6, 0.2, 0.2]):
        known = update(known, observation, sim.intrinsics)
        observation = sim.step(int(action))
    return steps / (time.perf_counter() - start)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="a shorter episode")
    quick = parser.parse_args().quick
    scene = load_scene("dev-0")
    bake = time.perf_counter()
    _ = scene.texture
    bake = time.perf_counter() - bake
    sim = Simulator(scene)  # 128x128, 2x2 supersampled
    sensor = Simulator(scene, Intrinsics.from_fov(64, 64), rgb=False)
    explore(sim, "frontier", steps=40, progress=False)  # compiled kernels are not what is measured
    steps = 200 if quick else 1500
    start = time.perf_counter()
    walk = explore(sim, "frontier", steps=steps, progress=False)
    episode = (time.perf_counter() - start) * 1500 / steps

    observation = sim.reset(seed=0)
    known = update(empty_map(observation.pose), observation, sim.intrinsics)
    policy = make_policy("frontier")
    policy.reset(np.random.default_rng(0))
    figures = {
        "episode_s": episode,
        "texture_s": bake,
        "render_ms": milliseconds(sim.observe, 50),
        "map_ms": milliseconds(lambda: update(known, observation, sim.intrinsics), 50),
        "policy_ms": milliseconds(lambda: policy.act(known, observation), 50),
        "environment_steps_per_s_480": environment_steps_per_second(sensor, 480, steps),
        "environment_steps_per_s_240": environment_steps_per_second(sensor, 240, steps),
        "explored_m2": walk.meta["explored_m2"][-1],
    }
    for name, value in figures.items():
        print(f"{name:<32}{value:>10.2f}")
    print(json.dumps({k: round(float(v), 3) for k, v in figures.items()}))


if __name__ == "__main__":
    main()
