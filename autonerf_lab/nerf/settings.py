"""Hyper-parameters of the models; :mod:`autonerf_lab.nerf.models` has their values for each preset."""

import math
from dataclasses import dataclass, fields, replace
from typing import Any, get_args, get_origin

from autonerf_lab.errors import DataError

MAX_COUNT = 1 << 24  # upper limit of every whole number, and of the entries of all hash levels together
MAY_BE_ZERO = {
    *("near", "semantic_weight", "rays_by_class", "distortion_weight", "depth_weight", "floor_weight"),
    *("rays_by_contrast", "rays_on_planes", "warmup", "averaged", "min_weight", "label_distance"),
    *("appearance", "interlevel_weight", "skip"),
}
APARTMENT = 160.0  # m² of explored area, above that of every apartment: settings for larger homes grow with the area
FINEST, LONGEST = 1e-3, 20.0  # of fused distances, metres: they are stored in int16 millimetres
SHARES = {  # at most 1
    *("rays_by_class", "rays_by_contrast", "rays_on_planes", "warmup", "averaged", "min_weight", "decay"),
}


@dataclass(frozen=True)
class Settings:
    """Settings that all models share: losses, schedule, sampling range. Lengths in metres."""

    steps: int = 2800
    rays: int = 1536  # per step; multiples of 16 need no padding
    near: float = 0.05  # start of a ray
    far: float = 16.0  # end of a ray
    turn: float = 4.0  # bins before this distance have equal lengths, and grow behind it (d_s of the paper)
    margin: float = 1.5  # distance from the training positions to the faces of the scene box
    shell: float = 0.25  # thickness of the shell that holds the rest of the world, half sizes of the box
    view_dependent: bool = True  # colours depend on the viewing direction
    semantic_weight: float = 0.02  # of the cross entropy; the colour loss has weight 1
    label_distance: float = 0.0  # metres; predicted labels beyond it count less, by the inverse square; 0: equally
    rays_by_class: float = 0.2  # share of rays sampled by class, so that small objects are seen often enough
    rays_by_contrast: float = 0.0  # share of rays sampled by contrast, with importance weights
    distortion_weight: float = 0.002
    # Of the squared error of signed distances, per m²; depth images and ``label_distance`` are used if above 0.
    depth_weight: float = 0.0
    floor_weight: float = 2.25  # of this error where the floor that the robot drove over is seen, if depth is not used
    rays_on_planes: float = 0.0  # share of rays on planes of the half-trained field, with the loss of driven floors
    surface_density: float = 67.0  # per metre, at a measured surface
    sharpness: float = 120.0  # growth of the log density through a measured surface, per metre
    free_density: float = 0.0015  # largest density in measured free space, per metre (see ``min_weight``)
    behind: float = 0.04  # distance behind a measured surface in which densities are compared
    refine_cameras: bool = False  # learn a correction of each training pose, a 6-vector
    refine_planar: bool | None = None  # corrected in x, y and heading only; None: if the poses differ in nothing else
    learning_rate: float = 1e-2
    final_learning_rate: float = 2e-3
    warmup: float = 0.01  # share of the training in which the learning rate rises
    averaged: float = 0.0  # share of the training, at its end, over whose parameters the field averages
    seen_rays: int = 400_000  # rays that carve the visibility grid after the training

    def __post_init__(self) -> None:
        """Check types and ranges.

        Raises:
            DataError: a value has the wrong type or is out of range; names it.
        """
        for entry in fields(self):
            _check_value(entry.name, getattr(self, entry.name), entry.type)
        if not self.near < self.far:
            raise DataError(f"settings: near must be less than far, not {self.near} and {self.far}")
        if (shares := self.rays_by_class + self.rays_by_contrast + self.rays_on_planes) > 1:
            raise DataError(f"settings: rays_by_class + rays_by_contrast + rays_on_planes exceed 1: {shares:g}")

    @property
    def distance_weight(self) -> float:
        """Weight of the error of signed distances, from measured depth or from the floor that the robot drove over."""
        return self.depth_weight or self.floor_weight

    def _check_length(self, name: str, least: float, most: float | str) -> None:
        """Check the range of a length; ``most`` may name the setting that is the upper limit."""
        value, limit = getattr(self, name), getattr(self, most) if isinstance(most, str) else most
        if not least <= value <= limit:
            shown = f"{most}={limit}" if isinstance(most, str) else f"{most:g}"
            raise DataError(f"settings: {name} must be from {least:g} to {shown}, not {value}")

    def _check_sizes(self, hidden: tuple[str, ...], levels: str, log2_entries: str) -> None:
        """Check the sizes of a hash field: layers are multiples of 4, and the tables fit into memory."""
        for name in hidden:
            if getattr(self, name) % 4 or getattr(self, name) > 1024:
                raise DataError(f"settings: {name} must be a multiple of 4 up to 1024, not {getattr(self, name)}")
        count, exponent = getattr(self, levels), getattr(self, log2_entries)
        if count > 32:
            raise DataError(f"settings: {levels} must be at most 32, not {count}")
        if exponent > 24 or count << exponent > MAX_COUNT:
            raise DataError(
                f"settings: {levels}={count} with {log2_entries}={exponent} exceed {MAX_COUNT} entries; lower one"
            )


@dataclass(frozen=True)
class HashSettings(Settings):
    """Settings of a field on a multi-resolution hash table (section 3.2)."""

    samples: int = 24  # bins per ray at which the field is evaluated
    min_weight: float = 1e-3  # samples of less weight have no colour, and a gradient only near measured surfaces
    levels: int = 10  # of the hash grid
    log2_entries: int = 18  # largest table of a level
    coarse: float = 0.8  # side of the largest cells
    fine: float = 0.02  # side of the smallest cells
    hidden: int = 64  # units of a hidden layer; a multiple of 4
    semantic_layers: int = 1  # hidden layers of the semantic network, 1 or 2
    appearance: int = 0  # size of the learned embedding of each training image; a multiple of 4
    density_gain: float = 1.0  # factor of the density network's output; large for sharp surfaces and small features
    table_rate: float = 3.0  # learning rate of hash tables as a multiple: few batches update an entry

    def __post_init__(self) -> None:
        """Check types, ranges and sizes, as :meth:`Settings.__post_init__`."""
        super().__post_init__()
        self._check_sizes(("hidden", "appearance"), "levels", "log2_entries")
        if self.semantic_layers not in (1, 2):
            raise DataError(f"settings: semantic_layers must be 1 or 2, not {self.semantic_layers}")
        self._check_length("fine", 1e-4, "coarse")


@dataclass(frozen=True)
class ProposalSettings(HashSettings):
    """Settings of Semantic Nerfacto: the hash field and its proposal sampler."""

    proposal_samples: tuple[int, ...] = (32,)  # bins of each proposal round
    proposal_every: int = 2  # steps between two updates of the proposals, after the first tenth of the training
    proposal_levels: int = 4
    proposal_log2_entries: int = 15  # largest table of a level
    proposal_fine: float = 0.06  # side of the smallest cells, in the last round
    proposal_ratio: float = 1.0  # of the smallest cells of a round to those of the next
    proposal_hidden: int = 16  # units of the hidden layer; a multiple of 4
    histogram_padding: float = 0.01 / 32  # weight added to every bin in resampling, so that every bin can be sampled
    interlevel_weight: float = 1.0

    def __post_init__(self) -> None:
        """Check types, ranges and sizes, as :meth:`Settings.__post_init__`."""
        super().__post_init__()
        self._check_sizes(("proposal_hidden",), "proposal_levels", "proposal_log2_entries")
        self._check_length("proposal_fine", 1e-4, "coarse")


@dataclass(frozen=True)
class SurfaceSettings(HashSettings):
    """Settings of a hash field trained on RGB-D images, with samples around the measured surfaces."""

    depth_weight: float = 2.25
    density_gain: float = 8.0
    samples: int = 12  # in training
    evaluation_samples: int = 24
    before: float = 0.05  # distance in front of a surface that the samples cover; ``behind`` on the other side
    band: float = 0.06  # voxels of the distance grid closer than this count as near a surface
    voxel: float = 0.03  # side of a voxel of the distance grid
    truncation: float = 0.09  # largest distance that is fused
    fused_rays: int = 6_000_000  # largest number of pixels that are fused
    label_distance: float = 1.0

    def __post_init__(self) -> None:
        """Check types, ranges and sizes, as :meth:`Settings.__post_init__`."""
        super().__post_init__()
        self._check_length("truncation", FINEST, LONGEST)
        self._check_length("voxel", FINEST, "truncation")


@dataclass(frozen=True)
class OccupancySettings(HashSettings):
    """Settings of Instant-NGP: the hash field and its occupancy sampler."""

    distortion_weight: float = 0.02  # the only loss that removes low density in front of the cameras
    candidates: int = 256  # steps per ray that query the grid
    cell: float = 0.10  # side of a cell of the occupancy grid
    update_every: int = 16  # steps between two updates of the grid
    grid_warmup: int = 64  # first steps, whose updates query the whole grid; later ones query an eighth
    decay: float = 0.8  # factor of the densities at each update; 0.95 would keep the initial density for 1000 steps
    occupied: float = 0.1  # smallest density of an occupied cell, per metre
    reach: float = 2.0  # length of occupied space that a ray crosses before the grid may end it
    marched: int = 32  # bins per ray in which the density of the field tells where the ray is dark

    def __post_init__(self) -> None:
        """Check types, ranges and sizes, as :meth:`Settings.__post_init__`."""
        super().__post_init__()
        if self.depth_weight:  # depth is fused with this truncation, and voxels of half of it
            self._check_length("cell", 2 * FINEST, LONGEST)


@dataclass(frozen=True)
class SemanticNerfSettings(Settings):
    """Settings of Semantic NeRF: the same network twice, coarse and fine."""

    semantic_weight: float = 0.04
    floor_weight: float = 0.0
    far: float = 10.0
    turn: float = 10.0
    layers: int = 8  # of the trunk
    width: int = 256  # units of a layer
    skip: int = 4  # the encoded position is an input again after this layer
    position_frequencies: int = 10  # octaves of the encoding
    direction_frequencies: int = 4
    coarse_samples: int = 64  # bins of the coarse field
    fine_samples: int = 128  # additional bins of the fine field
    distortion_weight: float = 0.0
    seen_rays: int = 20_000


def scaled_to_area(settings: Settings, area: float) -> Settings:
    """Return settings for a trajectory that explored an area, m²: those of an apartment up to :data:`APARTMENT`.

    Beyond, with g = 2 area / APARTMENT - 1: steps and rays that carve the visibility grid grow by the factor g, the
    largest distance along a ray by sqrt(g), and hash tables in proportion to the area, to the nearest power of two, up
    to the largest that the settings allow. Models that train on depth need fewer steps; theirs grow in proportion to
    the area.

    Example:
        >>> small, large = (scaled_to_area(HashSettings(), area) for area in (60, 300))
        >>> (small.steps, small.log2_entries, small.far), (large.steps, large.log2_entries, round(large.far))
        ((2800, 18, 16.0), (7700, 19, 27))
    """
    if area <= APARTMENT:
        return settings
    growth = 2 * area / APARTMENT - 1
    steps = settings.steps * (area / APARTMENT if settings.depth_weight else growth)
    seen_rays = min(round(settings.seen_rays * growth), MAX_COUNT)
    changes: dict[str, Any] = {"steps": round(steps), "seen_rays": seen_rays, "far": settings.far * math.sqrt(growth)}
    for prefix in ("", "proposal_"):
        if hasattr(settings, name := f"{prefix}log2_entries"):
            largest = (MAX_COUNT // getattr(settings, f"{prefix}levels")).bit_length() - 1
            changes[name] = min(getattr(settings, name) + round(math.log2(area / APARTMENT)), largest)
    return replace(settings, **changes)


def _check_value(name: str, value: Any, kind: Any) -> None:
    """Check the type and the range of one setting."""
    if kind in (bool, bool | None):
        valid, wanted = isinstance(value, kind), "True or False" if kind is bool else "True, False or None"
    elif kind is int:
        least = 0 if name in MAY_BE_ZERO else 1
        valid = isinstance(value, int) and not isinstance(value, bool) and least <= value <= MAX_COUNT
        wanted = f"a whole number from {least} to {MAX_COUNT}"
    elif kind is float:
        most = 1.0 if name in SHARES else 1e6
        valid = isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
        valid = valid and (value >= 0 if name in MAY_BE_ZERO else value > 0) and value <= most
        wanted = f"a number {'from' if name in MAY_BE_ZERO else 'above'} 0 to {most:g}"
    elif get_origin(kind) is tuple:
        number = get_args(kind)[0]
        valid = isinstance(value, tuple) and len(value) > 0
        valid = valid and all(isinstance(v, int | number) and not isinstance(v, bool) and 0 < v <= 4096 for v in value)
        wanted = f"a tuple of {'whole ' if number is int else ''}numbers above 0 to 4096"
    else:  # a type of a model of one's own, which checks it itself
        return
    if not valid:
        raise DataError(f"settings: {name} must be {wanted}, not {value!r}")
