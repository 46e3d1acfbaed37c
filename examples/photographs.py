"""Train a field on photographs, evaluate it on held-out photographs, and save renderings and a point cloud.

The folder contains images and a `transforms.json`, as written by nerfstudio's `ns-process-data` and many phone apps.

python examples/photographs.py FOLDER                              # a minute
python examples/photographs.py FOLDER --preset smoke --steps 100   # seconds, to check the poses
"""

import argparse
from pathlib import Path

import numpy as np
from PIL import Image

import autonerf_lab as lab
from autonerf_lab.viz.point_cloud import point_cloud


def main() -> None:
    """Print the scores; write photographs beside renderings, and the points in the coordinates of the folder."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, help="Folder of transforms.json.")
    parser.add_argument("--preset", default="fast", help="Preset of the model.")
    parser.add_argument("--steps", type=int, default=None, help="Training steps. Default: of the preset.")
    parser.add_argument("--points", type=int, default=50_000, help="Number of points.")
    parser.add_argument("--out", type=Path, default=Path("photographs-field"), help="Output folder.")
    arguments = parser.parse_args()
    train, held_out = lab.load_dataset(arguments.folder).split()  # every eighth, or the lists of the file
    nerf = lab.fit(train, preset=arguments.preset, steps=arguments.steps)
    scores = lab.evaluate(nerf, held_out, trajectory=train)  # with the baseline of the nearest training photograph
    arguments.out.mkdir(parents=True, exist_ok=True)
    for k in np.linspace(0, len(held_out) - 1, min(4, len(held_out))).astype(int):
        rendered = nerf.render(held_out.poses[k], held_out.intrinsics[k]).rgb
        pair = np.hstack([held_out.images[k], np.uint8(255 * np.clip(rendered, 0, 1))])
        Image.fromarray(pair).save(arguments.out / f"held-out-{Path(held_out.names[k]).stem}.png")
    point_cloud(nerf, arguments.points).save(arguments.out / "points.ply")
    print(scores.table())
    print(f"photographs beside renderings, and points: {arguments.out}")


if __name__ == "__main__":
    main()
