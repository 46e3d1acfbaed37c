"""A model of your own, in one file: what is at a point is kept in dense grids of voxels, with no network at all.

A model is a *field*, which knows what is at a point, and a *sampler*, which knows where on a ray to ask. Here the field
is new, and the sampler is that of Semantic Nerfacto. Between the corners of its voxels the field interpolates a
density, a colour and the logits of the classes, and adds up what a coarse and a fine grid say: the coarse one carries
what was learned to where no ray has passed. The density begins low, as in DVGO (Sun et al. 2022). Plenoxels
(Fridovich-Keil et al. 2022) have one grid with a smoothness loss, are sparse, and let colours depend on the direction
by spherical harmonics: good exercises, all three.

In a notebook, with this file beside it::

    from tiny_model import SPEC
    nerf = lab.fit(trajectory, SPEC, preset="smoke")

From a package of yours, which makes ``dense-grid`` a name for every command and every notebook::

    [project.entry-points."autonerf_lab.models"]
    dense-grid = "tiny_model:SPEC"

See it: python examples/tiny_model.py --scene train-00 --steps 200 --preset smoke --out dense-grid.png

That is 22.7 dB in the frames of the walk that were held out, and 25.2 dB with --preset fast: things are blurred where
they are smaller than a voxel.
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

THIN_AIR = -3.0  # added to the log density: it begins so thin that cameras do not paint fog in front of themselves


@dataclass(frozen=True)
class GridSettings(ProposalSettings):
    """What the sampler needs is inherited (with sizes of a hash table and its networks, which this field has not)."""

    voxels: tuple[float, ...] = (1.00, 0.20)  # sides of the voxels of each grid, metres
    samples: int = 24
    table_rate: float = 10.0
    semantic_weight: float = 0.1
    view_dependent: bool = False  # there is no place for directions here


SETTINGS = {
    "smoke": GridSettings(steps=150, rays=1024, voxels=(1.00, 0.25), seen_rays=20_000),
    "fast": GridSettings(steps=500, rays=2048, distortion_weight=0.01, seen_rays=100_000),
    "paper": GridSettings(steps=20_000, rays=4096, samples=64, proposal_samples=(256, 96), voxels=(0.80, 0.20, 0.05)),
}


class VoxelGrids(TorchField):
    """Values at the corners of cubic voxels, trilinear in between.

    The base class renders, trains by autograd and answers queries: a field of your own is its parameters and
    ``forward``.

    Args:
        settings: size of the voxels, loss weights.
        box: where the scene is; the grids cover its cube, in which the rest of the world is squeezed into a shell.
        classes: number of classes, 0 for a field without semantics.
        device: a torch device.
    """

    def __init__(self, settings: GridSettings, box: SceneBox, classes: int, device: str) -> None:
        self.box = box
        self.cells = [np.ceil(box.size / side).astype(np.int64) for side in settings.voxels]  # (3,) along each axis
        values = 1 + 3 + classes  # at each corner: log density, colour, logits
        # names that end in "table" learn ``table_rate`` times faster: few rays pass a voxel
        tables = {
            f"grid_{k}_table": np.zeros((np.prod(cells + 1), values), np.float32) for k, cells in enumerate(self.cells)
        }
        super().__init__(settings, tables, device)

    def forward(
        self, points: torch.Tensor, directions: torch.Tensor, frames: torch.Tensor | None
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """Points (R, S, 3), directions (R, 3) -> raw density (R, S), colour (R, S, 3), logits (R, S, C)."""
        x = self.box.contract_tensor(points).flatten(0, 1)
        found = [interpolate(x, self.parameters[f"grid_{k}_table"], cells) for k, cells in enumerate(self.cells)]
        values = torch.stack(found).sum(dim=0).unflatten(0, points.shape[:2])
        return values[..., 0] + THIN_AIR, torch.sigmoid(values[..., 1:4]), values[..., 4:]


def interpolate(x: torch.Tensor, table: torch.Tensor, cells: np.ndarray) -> torch.Tensor:
    """Trilinear interpolation.

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
    """The field in torch; the sampler is a numba kernel. What passes between them is numpy, so any two fit together."""
    return Model(
        settings, box, VoxelGrids(settings, box, classes, device or "cpu"), ProposalSampler(settings, box, rng), frames
    )


SPEC = ModelSpec(SETTINGS, build, "dense-grid")


def main() -> None:
    """Explore, train on seven frames of eight, and put four of the others beside what the field shows there."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scene", default="train-00")
    parser.add_argument("--steps", type=int, default=200, help="of the walk")
    parser.add_argument("--preset", default="smoke", choices=SETTINGS)
    parser.add_argument("--out", default="dense-grid.png")
    arguments = parser.parse_args()
    sim = lab.Simulator(lab.load_scene(arguments.scene), Intrinsics.from_fov(96, 96))
    walk = lab.explore(sim, "frontier", steps=arguments.steps, seed=0)
    kept, held_out = np.arange(len(walk)) % 8 != 4, np.arange(4, len(walk), 8)
    train = replace(walk, poses=walk.poses[kept], rgb=walk.rgb[kept], semantics=walk.semantics[kept], depth=None)
    nerf = lab.fit(train, SPEC, preset=arguments.preset)
    truth = walk.rgb[held_out] / 255
    shown = np.stack([nerf.render(pose).rgb for pose in walk.poses[held_out]])
    print(f"{nerf}: {-10 * np.log10(np.mean((truth - shown) ** 2)):.1f} dB in {len(held_out)} frames held out")
    four = np.linspace(0, len(held_out) - 1, 4).astype(int)
    picture = np.vstack([np.hstack([truth[k], shown[k]]) for k in four])
    Image.fromarray(np.uint8(255 * picture.clip(0, 1))).save(arguments.out)
    print(f"truth on the left, the field on the right: {arguments.out}")


if __name__ == "__main__":
    main()
