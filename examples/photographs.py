"""From photographs to a field: fit it to most of them, score it on the others, look at those, and keep the points.

The folder holds images and a `transforms.json`, as nerfstudio's `ns-process-data` and many apps on phones write it.

python examples/photographs.py FOLDER                              # a minute
python examples/photographs.py FOLDER --preset smoke --steps 100   # seconds, for a look at whether the poses are right
"""

import argparse
from pathlib import Path

import numpy as np
from PIL import Image

import autonerf_lab as lab
from autonerf_lab.viz.point_cloud import point_cloud


def main() -> None:
    """Print the scores; write photographs beside renderings, and the cloud, in the coordinates of the folder."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--preset", default="fast")
    parser.add_argument("--steps", type=int, default=None, help="of the training; those of the preset without it")
    parser.add_argument("--points", type=int, default=50_000)
    parser.add_argument("--out", type=Path, default=Path("photographs-field"))
    arguments = parser.parse_args()
    train, held_out = lab.load_dataset(arguments.folder).split()  # every eighth, unless the file says which
    nerf = lab.fit(train, preset=arguments.preset, steps=arguments.steps)
    scores = lab.evaluate(nerf, held_out, trajectory=train)  # beside them, the nearest training photograph's
    arguments.out.mkdir(parents=True, exist_ok=True)
    for k in np.linspace(0, len(held_out) - 1, min(4, len(held_out))).astype(int):
        shown = nerf.render(held_out.poses[k], held_out.cameras[k]).rgb
        pair = np.hstack([held_out.images[k], np.uint8(255 * np.clip(shown, 0, 1))])
        Image.fromarray(pair).save(arguments.out / f"held-out-{Path(held_out.names[k]).stem}.png")
    point_cloud(nerf, arguments.points).save(arguments.out / "points.ply")
    print(scores.table())
    print(f"photographs beside what the field shows, and its points: {arguments.out}")


if __name__ == "__main__":
    main()
