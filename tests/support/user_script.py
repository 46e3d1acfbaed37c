"""A script as a user writes it, for the type checkers."""

from pathlib import Path

import numpy as np

import autonerf_lab as lab


def novelty(transition: lab.Transition) -> float:
    """Reward one for a collision-free step."""
    return 0.0 if transition.observation.collided else 1.0


def main() -> None:
    """Explore, fit, evaluate."""
    scene = lab.load_scene("val-0")
    sim = lab.Simulator(scene, lab.Intrinsics.from_fov(32, 32))
    trajectory = lab.explore(sim, "frontier", steps=20, seed=0)
    nerf: lab.NeRF = lab.fit(trajectory, "semantic-nerfacto", preset="smoke")
    scores: lab.Scores = lab.evaluate(nerf, scene, preset="smoke")
    print(scores.table(), scores["rendering", "psnr"])
    image: np.ndarray = nerf.render(trajectory.poses[0]).rgb
    print(image.shape)
    lab.export_mesh(lab.extract_mesh(nerf), Path("apartment.glb"))
    print(lab.rewards.available(), lab.policies.make_policy("random"), lab.nerf.model_spec("instant-ngp"))
    player = lab.play(trajectory)
    player.save("trajectory.html")
    lab.train_policy("modular-obs", "runs/modular-obs")


if __name__ == "__main__":
    main()
