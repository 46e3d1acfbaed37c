"""The whole chain in one file: a policy learns where to look, it walks, and a field of its walk is scored.

python examples/whole_chain.py                              # with a policy that ships: minutes
python examples/whole_chain.py --frames 200000 --reward cov # trains one first, by PPO (the extra `training`)
"""

import argparse
from pathlib import Path

import autonerf_lab as lab
from autonerf_lab.geometry import Intrinsics
from autonerf_lab.viz.figures.evaluation import map_overlay

TINY = {"environments": 2, "episode": 2, "rollout": 2, "batch": 4, "sensor": 16}  # of a training that proves nothing


def trained(reward: str, frames: int, out: Path, preset: str) -> Path:
    """Train a modular policy for a reward, in the training apartments and without a teacher; its weights."""
    from autonerf_lab.training.settings import settings_of
    from autonerf_lab.training.train import train_policy

    size = TINY if preset == "smoke" else {}
    settings = settings_of(f"modular-{reward}", frames=frames, demonstrations=0, **size)
    return train_policy(f"modular-{reward}", out / "policy", settings).with_suffix(".safetensors")


def main() -> None:
    """Train if asked to, explore, fit, evaluate; print the table and draw the map."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scene", default="val-0")
    parser.add_argument("--reward", default="obs", help="what the policy is paid for: a name, such as cov or view")
    parser.add_argument("--frames", type=int, default=0, help="steps of the training; 0: the policy that ships")
    parser.add_argument("--steps", type=int, default=500, help="of the walk")
    parser.add_argument("--preset", default="fast", help="of the field and its scores")
    parser.add_argument("--out", type=Path, default=Path("whole-chain"))
    arguments = parser.parse_args()
    out, size = arguments.out, lab.preset(arguments.preset)
    out.mkdir(parents=True, exist_ok=True)
    policy = f"modular-{arguments.reward}"
    if arguments.frames:
        policy = str(trained(arguments.reward, arguments.frames, out, arguments.preset))
    sim = lab.Simulator(lab.load_scene(arguments.scene), Intrinsics.from_fov(size.width, size.height))
    walk = lab.explore(sim, policy, steps=arguments.steps, seed=0)
    nerf = lab.fit(walk, "semantic-nerfacto", preset=size)
    scores = lab.evaluate(nerf, sim.scene, size, trajectory=walk)
    map_overlay(scores.artifacts["maps"]).savefig(out / "maps.png")
    print(scores.table())
    print(f"{policy}; the field's map beside the true one: {out / 'maps.png'}")


if __name__ == "__main__":
    main()
