"""Compare policies by explored area, in the same apartments and from the same start poses.

python examples/compare_policies.py                        # frontier against random, two apartments
python examples/compare_policies.py --scenes dev-0 --steps 300
"""

import argparse

import autonerf_lab as lab
from autonerf_lab.geometry import Intrinsics


def explored_area(scene: str, policy: str, steps: int, seed: int) -> float:
    """Return the explored area at the end of an episode, m²."""
    camera = Intrinsics.from_fov(64, 64)  # small and fast, sufficient for the map
    sim = lab.Simulator(lab.load_scene(scene), camera, rgb=False)
    return lab.explore(sim, policy, steps=steps, seed=seed, progress=False).meta["explored_m2"][-1]


def main() -> None:
    """Print a table with a row per scene and a column per policy."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenes", default="dev-0,dev-1", help="Names, separated by commas.")
    parser.add_argument("--policies", default="random,frontier", help="Names, separated by commas.")
    parser.add_argument("--steps", type=int, default=500, help="Actions per episode.")
    parser.add_argument("--seed", type=int, default=0, help="Random seed.")
    arguments = parser.parse_args()
    policies = arguments.policies.split(",")
    print(f"{'m² after ' + str(arguments.steps) + ' steps':<24}" + "".join(f"{name:>18}" for name in policies))
    for scene in arguments.scenes.split(","):
        areas = [explored_area(scene, policy, arguments.steps, arguments.seed) for policy in policies]
        print(f"{scene:<24}" + "".join(f"{area:18.1f}" for area in areas))


if __name__ == "__main__":
    main()
