"""Complete pipeline: train a policy, explore, fit a radiance field, evaluate it.

python examples/whole_chain.py                              # with a built-in policy: minutes
python examples/whole_chain.py --frames 200000 --reward cov # trains a policy first (extra `training`)
"""

import argparse
from pathlib import Path

import autonerf_lab as lab
from autonerf_lab.geometry import Intrinsics
from autonerf_lab.viz.figures.evaluation import map_overlay

TINY = {"environments": 2, "episode": 2, "rollout": 2, "batch": 4, "sensor": 16}  # a minimal training for tests


def trained(reward: str, frames: int, out: Path, preset: str) -> Path:
    """Train a modular policy by PPO without imitation; return the path of its weights."""
    from autonerf_lab.training.settings import settings_of
    from autonerf_lab.training.train import train_policy

    size = TINY if preset == "smoke" else {}
    settings = settings_of(f"modular-{reward}", frames=frames, demonstrations=0, **size)
    return train_policy(f"modular-{reward}", out / "policy", settings).with_suffix(".safetensors")


def main() -> None:
    """Run all stages, print the scores and save the map."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scene", default="val-0", help="Scene.")
    parser.add_argument("--reward", default="obs", help="Reward of the policy, for example cov or view.")
    parser.add_argument("--frames", type=int, default=0, help="Robot actions of the training; 0: built-in policy.")
    parser.add_argument("--steps", type=int, default=500, help="Actions of the episode.")
    parser.add_argument("--preset", default="fast", help="Preset of field and evaluation.")
    parser.add_argument("--out", type=Path, default=Path("whole-chain"), help="Output folder.")
    arguments = parser.parse_args()
    out, size = arguments.out, lab.preset(arguments.preset)
    out.mkdir(parents=True, exist_ok=True)
    policy = f"modular-{arguments.reward}"
    if arguments.frames:
        policy = str(trained(arguments.reward, arguments.frames, out, arguments.preset))
    sim = lab.Simulator(lab.load_scene(arguments.scene), Intrinsics.from_fov(size.width, size.height))
    trajectory = lab.explore(sim, policy, steps=arguments.steps, seed=0)
    nerf = lab.fit(trajectory, "semantic-nerfacto", preset=size)
    scores = lab.evaluate(nerf, sim.scene, size, trajectory=trajectory)
    map_overlay(scores.artifacts["maps"]).savefig(out / "maps.png")
    print(scores.table())
    print(f"{policy}; maps of the field and of the scene: {out / 'maps.png'}")


if __name__ == "__main__":
    main()
