"""Train on images that push a fit to its numerical limits: every fit must end with finite parameters.

Forty fits: the hostile images below, in the three models; settings are the defaults of the preset. ``--quick`` uses 48
pixels and fewer steps. The last line of the output is JSON.
"""

import argparse
import json
import time

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


def main() -> None:
    """Run the fits and print a table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="Preset smoke instead of fast.")
    parser.add_argument("--models", default=",".join(MODELS), help="Models, separated by commas.")
    parser.add_argument("--views", type=int, default=60, help="Number of training images.")
    parser.add_argument("--steps", type=int, default=None, help="Steps of each fit. Default: those of the preset.")
    arguments = parser.parse_args()
    size, preset = (48, "smoke") if arguments.quick else (96, "fast")
    sim = Simulator(generate_apartment(10001), Intrinsics.from_fov(size, size), supersample=1)
    rng = np.random.default_rng(0)
    poses = np.stack([sim.sample_pose(rng) for _ in range(arguments.views)])
    frames = [sim.render(pose) for pose in poses]
    rgb, depth, semantics = (np.stack([getattr(frame, k) for frame in frames]) for k in ("rgb", "depth", "semantics"))
    rows = []
    for name, images in {"as rendered": rgb, **hostile_images(rgb, rng)}.items():
        data = Trajectory(poses, images, depth, semantics, sim.intrinsics, {"scene": "hostile"})
        for model in arguments.models.split(","):
            started = time.perf_counter()
            field = fit(data, model, preset, steps=arguments.steps, progress=False)
            values = {**field.model.parameters, **field.model.state}
            finite = all(bool(np.isfinite(to_numpy(value)).all()) for value in values.values())
            finite &= bool(np.isfinite(field.render(poses[0]).rgb).all())
            row = {"images": name, "model": model, "finite": finite, "psnr": round(field.meta["train_psnr"], 1)}
            rows.append(row | {"skipped": field.meta["skipped_steps"], "seconds": time.perf_counter() - started})
            print(
                f"{name:22} {model:18} {'finite' if finite else 'NOT FINITE':10} PSNR {row['psnr']:5.1f} "
                f"skipped {rows[-1]['skipped']} {rows[-1]['seconds']:6.1f} s",
                flush=True,
            )
    print(json.dumps({"fits": len(rows), "not_finite": sum(not row["finite"] for row in rows), "rows": rows}))


if __name__ == "__main__":
    main()
