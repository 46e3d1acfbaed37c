"""Train nerfstudio's Nerfacto on a trajectory folder, on the CPU; run by ``peers.py`` in nerfstudio's environment.

It is the method ``nerfacto`` as its authors registered it, with the layers in torch, because tiny-cuda-nn needs CUDA.
At each mark, seconds of training, the views of a second folder are rendered into ``views-MARK.npz``: ``rgb`` (N, H, W,
3) and ``depth`` (N, H, W), metres along the optical axis. The last line is a JSON object with the versions and, for
each mark, the seconds and the steps.
"""

import argparse
import copy
import json
import time
from importlib.metadata import version
from pathlib import Path

import numpy as np
import torch
from nerfstudio.cameras.cameras import Cameras
from nerfstudio.configs.method_configs import method_configs
from nerfstudio.engine.callbacks import TrainingCallbackLocation
from nerfstudio.engine.trainer import Trainer
from torchmetrics.image import lpip


def make_trainer(options: argparse.Namespace) -> Trainer:
    """Return nerfstudio's trainer of the method, which uses all images of the folder."""
    config = copy.deepcopy(method_configs["nerfacto"])
    config.machine.device_type, config.machine.seed = "cpu", 0
    config.vis, config.output_dir, config.data = "tensorboard", options.out / "nerfstudio", options.train
    config.logging.local_writer.enable = False
    manager, model = config.pipeline.datamanager, config.pipeline.model
    manager.data = manager.dataparser.data = options.train
    manager.dataparser.eval_mode = "all"
    model.implementation = "torch"
    model.eval_num_rays_per_chunk = 1024  # renders in a third of the time on the CPU
    if options.few_steps:  # as registered, it starts transparent and has no geometry after 400 steps
        manager.train_num_rays_per_batch = 512
        model.average_init_density, model.use_appearance_embedding = 1.0, False
        model.camera_optimizer.mode = "off"
        del config.optimizers["camera_opt"]
    # LPIPS, of nerfstudio's own evaluation, would download weights
    lpip.LearnedPerceptualImagePatchSimilarity = lambda **_: torch.nn.Identity()  # type: ignore[misc, assignment]
    config.set_timestamp()
    trainer = config.setup(local_rank=0, world_size=1)
    trainer.setup()
    return trainer


def train_step(trainer: Trainer, step: int) -> None:
    """Run one iteration of nerfstudio's training loop, with its callbacks."""
    trainer.step = step
    trainer.pipeline.train()
    for callback in trainer.callbacks:
        callback.run_callback_at_location(step, location=TrainingCallbackLocation.BEFORE_TRAIN_ITERATION)
    trainer.train_iteration(step)
    for callback in trainer.callbacks:
        callback.run_callback_at_location(step, location=TrainingCallbackLocation.AFTER_TRAIN_ITERATION)


def render_views(trainer: Trainer, folder: Path, path: Path) -> None:
    """Render the views of a trajectory folder and write colours and depth."""
    meta = json.loads((folder / "transforms.json").read_text())
    parsed = trainer.pipeline.datamanager.train_dataparser_outputs
    frames = sorted(meta["frames"], key=lambda frame: frame["file_path"])
    poses = torch.tensor([frame["transform_matrix"] for frame in frames], dtype=torch.float32)
    transform = torch.eye(4)
    transform[:3] = parsed.dataparser_transform[:3]
    poses = (transform @ poses)[:, :3]
    poses[:, :, 3] *= parsed.dataparser_scale
    size = {"width": meta["w"], "height": meta["h"]}
    cameras = Cameras(poses, *(float(meta[key]) for key in ("fl_x", "fl_y", "cx", "cy")), **size)
    trainer.pipeline.eval()
    rgb, depth = [], []
    with torch.no_grad():
        for k in range(len(poses)):
            rays = cameras.generate_rays(camera_indices=k)
            found = trainer.pipeline.model.get_outputs_for_camera_ray_bundle(rays)
            along_axis = found["depth"] / rays.metadata["directions_norm"] / parsed.dataparser_scale
            rgb.append(found["rgb"].numpy().astype(np.float16))
            depth.append(along_axis[..., 0].numpy().astype(np.float32))
    np.savez(path, rgb=np.stack(rgb), depth=np.stack(depth))


def main() -> None:
    """Train until the last mark; the clock stands still while views are rendered."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--train", type=Path, required=True, help="Trajectory folder of the training views.")
    parser.add_argument("--test", type=Path, required=True, help="Trajectory folder of the test views.")
    parser.add_argument("--out", type=Path, required=True, help="Output folder.")
    parser.add_argument("--marks", type=float, nargs="+", required=True, help="Increasing, seconds.")
    parser.add_argument("--few-steps", action="store_true", help="Settings that suit few steps and exact poses.")
    parser.add_argument("--threads", type=int, default=2, help="Number of threads.")
    options = parser.parse_args()
    torch.set_num_threads(options.threads)
    trainer = make_trainer(options)
    train_step(trainer, 0)  # starts the processes that load images, as kernels are compiled before our clock starts
    rows, step, seconds = [], 1, 0.0
    for mark in options.marks:
        started = time.perf_counter() - seconds
        while seconds < mark:
            train_step(trainer, step)
            step += 1
            seconds = time.perf_counter() - started
        render_views(trainer, options.test, options.out / f"views-{mark:g}.npz")
        rows.append({"mark_s": mark, "seconds": seconds, "step": step})
        print(f"{mark:g} s: {step} steps", flush=True)
    print(json.dumps({"versions": {name: version(name) for name in ("nerfstudio", "torch")}, "rows": rows}))


if __name__ == "__main__":
    main()
