"""Train on images that push a fit to its numerical limits: every fit must end with finite parameters.

Forty fits of each model: the images as rendered, and the thirteen hostile kinds below in each of three apartments. The
depth is as measured in the first apartment, with wrong values in the second, and noise in the third. Settings are the
defaults of the preset; ``--quick`` uses 48 pixels and fewer steps. Seconds are CPU time. The last line of the output is
JSON.
"""

import argparse
import json
import time
from typing import Any

import numpy as np

from autonerf_lab import generate_apartment
from autonerf_lab.data.trajectory import Trajectory
from autonerf_lab.geometry import Intrinsics
from autonerf_lab.nerf import MODELS, fit
from autonerf_lab.nerf.ray_batch import to_numpy
from autonerf_lab.simulator import Simulator


def hostile_images(rgb: np.ndarray, rng: np.random.Generator) -> dict[str, np.ndarray]:
    """Return variants of (T, H, W, 3) uint8 images by name."""
    border = rgb.copy()
    border[:, :8] = border[:, -8:] = 0
    border[:, :, :8] = border[:, :, -8:] = 0
    bright = np.zeros_like(rgb)
    bright[:, rgb.shape[1] // 2, rgb.shape[2] // 2] = 255
    ramp = np.broadcast_to(np.linspace(0, 255, rgb.shape[2]).astype(np.uint8)[:, None], rgb.shape)
    two = rgb[np.arange(len(rgb)) % 16 // 8 * (len(rgb) // 2)]
    return {
        "black": np.zeros_like(rgb),
        "white": np.full_like(rgb, 255),
        "one colour": np.full_like(rgb, (200, 30, 90)),
        "black border": border,
        "white border": np.where(border == 0, 255, border).astype(np.uint8),
        "noise": rng.integers(0, 256, rgb.shape, dtype=np.uint8),
        "one bright pixel": bright,
        "two images": two,
        "grey ramp": np.ascontiguousarray(ramp),
        "night": rgb // 40,
        "overexposed": np.minimum(rgb.astype(np.int32) * 6, 255).astype(np.uint8),
        "black and white": np.where(rgb > 127, 255, 0).astype(np.uint8),
        "inverted every second": np.where((np.arange(len(rgb)) % 2)[:, None, None, None] == 0, rgb, 255 - rgb),
    }


def hostile_depth(depth: np.ndarray, rng: np.random.Generator) -> list[np.ndarray]:
    """Return (T, H, W) depth as measured; with holes, infinite and negative values and outliers; and noise."""
    wrong = depth.copy()
    for value in (0.0, np.inf, np.nan, -1.0, 65.0):
        wrong[rng.random(depth.shape) < 0.05] = value
    return [depth, wrong, rng.uniform(0, 20, depth.shape).astype(np.float32)]


def main() -> None:
    """Run the fits and print a table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="Preset smoke instead of fast.")
    parser.add_argument("--models", default=",".join(MODELS), help="Models, separated by commas.")
    parser.add_argument("--views", type=int, default=60, help="Number of training images.")
    parser.add_argument("--steps", type=int, default=None, help="Steps of each fit. Default: those of the preset.")
    parser.add_argument("--apartments", type=int, default=3, help="Number of apartments.")
    arguments = parser.parse_args()
    size, preset = (48, "smoke") if arguments.quick else (96, "fast")
    rows = []
    for number in range(arguments.apartments):
        sim = Simulator(generate_apartment(10001 + number), Intrinsics.from_fov(size, size), supersample=1)
        rng = np.random.default_rng(number)
        poses = np.stack([sim.sample_pose(rng) for _ in range(arguments.views)])
        frames = [sim.render(pose) for pose in poses]
        rgb, true, semantics = (
            np.stack([getattr(frame, k) for frame in frames]) for k in ("rgb", "depth", "semantics")
        )
        kinds = {"as rendered": rgb} if number == 0 else {}
        depth = hostile_depth(true, rng)[number % 3]
        for name, images in (kinds | hostile_images(rgb, rng)).items():
            data = Trajectory(poses, images, depth, semantics, sim.intrinsics, {"scene": "hostile"})
            for model in arguments.models.split(","):
                row = {"apartment": number, "images": name, "model": model}
                rows.append(row | fit_one(data, model, preset, arguments.steps))
                print(
                    f"{number} {name:22} {model:20} {'finite' if rows[-1]['finite'] else 'NOT FINITE':10} "
                    f"PSNR {rows[-1]['psnr']:5.1f} skipped {rows[-1]['skipped']} {rows[-1]['seconds']:6.1f} s",
                    flush=True,
                )
    fits = {model: sum(row["model"] == model for row in rows) for model in arguments.models.split(",")}
    print(json.dumps({"fits": fits, "not_finite": sum(not row["finite"] for row in rows), "rows": rows}))


def fit_one(data: Trajectory, model: str, preset: str, steps: int | None) -> dict[str, Any]:
    """Fit a model and return True under ``finite`` if all parameters and a rendered image are finite."""
    started = time.process_time()
    field = fit(data, model, preset, steps=steps, progress=False)
    values = {**field.model.parameters, **field.model.state}
    finite = all(bool(np.isfinite(to_numpy(value)).all()) for value in values.values())
    finite &= bool(np.isfinite(field.render(data.poses[0]).rgb).all())
    row = {"finite": finite, "psnr": round(field.meta["train_psnr"], 1), "skipped": field.meta["skipped_steps"]}
    return row | {"seconds": round(time.process_time() - started, 1)}


if __name__ == "__main__":
    main()
