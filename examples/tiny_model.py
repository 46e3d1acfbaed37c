"""Custom model in one file: dense voxel grids of density, colour and class logits, without a network.

A model is a *field*, which predicts density, colour and class at points, and a *sampler*, which places points on rays.
Here the field is new, and the sampler is that of Semantic Nerfacto. The field interpolates values between the corners
of its voxels and adds a coarse and a fine grid; the coarse grid also covers voxels that no ray has passed.
The initial density is low, as in DVGO (Sun et al. 2022). Plenoxels (Fridovich-Keil et al. 2022) use one sparse grid
with a smoothness loss and view-dependent colours by spherical harmonics: three good exercises. For a loss of your own,
override ``VoxelGrids.loss``.

In a notebook in the same folder::

    from tiny_model import SPEC
    nerf = lab.fit(trajectory, SPEC, preset="smoke")

In your own package, which makes ``dense-grid`` a name in all commands and notebooks::

    [project.entry-points."autonerf_lab.models"]
    dense-grid = "tiny_model:SPEC"

Run it: python examples/tiny_model.py --scene train-00 --steps 200 --preset smoke --out dense-grid.png

This gives 22.7 dB in the held-out frames of the trajectory, and 25.2 dB with --preset fast. Objects smaller than a
voxel are blurred.
"""

import argparse
from dataclasses import dataclass, replace

import numpy as np
import torch
from PIL import Image
from torch.nn.functional import embedding_bag

import autonerf_lab as lab
from autonerf_lab.geometry import Intrinsics
from autonerf_lab.nerf.fields.torch_field import TorchField
from autonerf_lab.nerf.model import Model, ModelSpec
from autonerf_lab.nerf.samplers.proposal import ProposalSampler
from autonerf_lab.nerf.scene_box import SceneBox
from autonerf_lab.nerf.settings import ProposalSettings

INITIAL_LOG_DENSITY = -3.0  # added to the log density: low enough that no colours form in front of the cameras


@dataclass(frozen=True)
class GridSettings(ProposalSettings):
    """Settings of the field; those of the sampler are inherited, with unused sizes of a hash table and networks."""

    voxels: tuple[float, ...] = (1.00, 0.20)  # side of the voxels of each grid, metres
    samples: int = 24
    table_rate: float = 10.0
    semantic_weight: float = 0.1
    view_dependent: bool = False  # the field does not use directions


SETTINGS = {
    "smoke": GridSettings(steps=150, rays=1024, voxels=(1.00, 0.25), seen_rays=20_000),
    "fast": GridSettings(steps=500, rays=2048, distortion_weight=0.01, seen_rays=100_000),
    "paper": GridSettings(steps=20_000, rays=4096, samples=64, proposal_samples=(256, 96), voxels=(0.80, 0.20, 0.05)),
}


class VoxelGrids(TorchField):
    """Values at the corners of cubic voxels, interpolated trilinearly.

    The base class renders, trains by autograd and answers queries; a subclass defines parameters and ``forward``.

    Args:
        settings: size of the voxels, loss weights.
        box: region of full resolution; the grids cover its cube, with the rest of the world in the outer shell.
        classes: number of classes, 0 for a field without semantics.
        device: a torch device.
    """

    def __init__(self, settings: GridSettings, box: SceneBox, classes: int, device: str) -> None:
        self.box = box
        self.cells = [np.ceil(box.size / side).astype(np.int64) for side in settings.voxels]  # (3,) along each axis
        values = 1 + 3 + classes  # at each corner: log density, colour, logits
        # Parameters whose names end in "table" have ``table_rate`` times the learning rate: few rays pass a voxel.
        tables = {
            f"grid_{k}_table": np.zeros((np.prod(cells + 1), values), np.float32) for k, cells in enumerate(self.cells)
        }
        super().__init__(settings, tables, device)

    def forward(
        self, points: torch.Tensor, directions: torch.Tensor, frames: torch.Tensor | None
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """Return raw density (R, S), colour (R, S, 3) and logits (R, S, C) at points (R, S, 3)."""
        x = self.box.contract_tensor(points).flatten(0, 1)
        found = [interpolate(x, self.parameters[f"grid_{k}_table"], cells) for k, cells in enumerate(self.cells)]
        values = torch.stack(found).sum(dim=0).unflatten(0, points.shape[:2])
        return values[..., 0] + INITIAL_LOG_DENSITY, torch.sigmoid(values[..., 1:4]), values[..., 4:]


def interpolate(x: torch.Tensor, table: torch.Tensor, cells: np.ndarray) -> torch.Tensor:
    """Interpolate values trilinearly.

    Args:
        x: (N, 3) points in the unit cube.
        table: (corners, V) values.
        cells: (3,) voxels along each axis.

    Returns:
        (N, V), differentiable in the points and in the values.
    """
    count = torch.as_tensor(cells, device=x.device)
    corners = torch.cartesian_prod(*[torch.arange(2, device=x.device)] * 3)  # (8, 3)
    scaled = x * count
    low = torch.minimum(scaled.detach().long().clamp(min=0), count - 1)
    inside = (scaled - low)[:, None]
    weights = torch.where(corners == 1, inside, 1 - inside).prod(dim=2)  # (N, 8)
    i, j, k = (low[:, None] + corners).unbind(dim=2)
    rows = (i * (count[1] + 1) + j) * (count[2] + 1) + k
    return embedding_bag(rows, table, per_sample_weights=weights, mode="sum")


def build(
    settings: GridSettings, box: SceneBox, frames: int, classes: int, rng: np.random.Generator, device: str | None
) -> Model:
    """Combine the torch field with the numba sampler; both exchange numpy arrays, so any two can be combined."""
    return Model(
        settings, box, VoxelGrids(settings, box, classes, device or "cpu"), ProposalSampler(settings, box, rng), frames
    )


SPEC = ModelSpec(SETTINGS, build, "dense-grid")


def main() -> None:
    """Explore, train on seven of eight frames, and show four of the held-out frames beside their renderings."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scene", default="train-00", help="Name of a scene.")
    parser.add_argument("--steps", type=int, default=200, help="Steps of the episode.")
    parser.add_argument("--preset", default="smoke", choices=SETTINGS, help="Preset of the model.")
    parser.add_argument("--out", default="dense-grid.png", help="Output image.")
    arguments = parser.parse_args()
    sim = lab.Simulator(lab.load_scene(arguments.scene), Intrinsics.from_fov(96, 96))
    trajectory = lab.explore(sim, "frontier", steps=arguments.steps, seed=0)
    training, held_out = np.arange(len(trajectory)) % 8 != 4, np.arange(4, len(trajectory), 8)
    train = replace(
        trajectory,
        poses=trajectory.poses[training],
        rgb=trajectory.rgb[training],
        semantics=trajectory.semantics[training],
        depth=None,
    )
    nerf = lab.fit(train, SPEC, preset=arguments.preset)
    truth = trajectory.rgb[held_out] / 255
    rendered = np.stack([nerf.render(pose).rgb for pose in trajectory.poses[held_out]])
    print(f"{nerf}: {-10 * np.log10(np.mean((truth - rendered) ** 2)):.1f} dB in {len(held_out)} held-out frames")
    four = np.linspace(0, len(held_out) - 1, 4).astype(int)
    image = np.vstack([np.hstack([truth[k], rendered[k]]) for k in four])
    Image.fromarray(np.uint8(255 * image.clip(0, 1))).save(arguments.out)
    print(f"ground truth on the left, rendering on the right: {arguments.out}")


if __name__ == "__main__":
    main()
