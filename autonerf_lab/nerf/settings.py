"""Hyper-parameters of the models; :mod:`autonerf_lab.nerf.models` has their values for each preset."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Settings:
    """Settings that all models share: losses, schedule, sampling range. Lengths in metres."""

    steps: int = 2800
    rays: int = 1536  # per step; multiples of 16 need no padding
    near: float = 0.05  # start of a ray
    far: float = 16.0  # end of a ray
    turn: float = (
        4.0  # half of the bins lie before this distance with equal lengths, the others grow (d_s of the paper)
    )
    margin: float = 1.5  # distance from the training positions to the faces of the scene box
    shell: float = 0.25  # thickness of the shell that holds the rest of the world, half sizes of the box
    view_dependent: bool = True  # colours depend on the viewing direction
    semantic_weight: float = 0.02  # of the cross entropy; the colour loss has weight 1
    rays_by_class: float = 0.2  # share of rays sampled by class, so that small objects are seen often enough
    distortion_weight: float = 0.002
    depth_weight: float = 0.0  # of the absolute depth error, per metre; depth images are used if above 0
    refine_cameras: bool = False  # learn a correction of each training pose, a 6-vector
    learning_rate: float = 1e-2
    final_learning_rate: float = 2e-3
    warmup: float = 0.01  # share of the training in which the learning rate rises
    seen_rays: int = 400_000  # rays that carve the visibility grid after the training


@dataclass(frozen=True)
class HashSettings(Settings):
    """Settings of a field on a multi-resolution hash table (section 3.2)."""

    samples: int = 16  # bins per ray at which the field is evaluated
    min_weight: float = 1e-3  # samples of less weight are skipped: no colour, no gradient
    levels: int = 10  # of the hash grid; even
    log2_entries: int = 18  # largest table of a level
    coarse: float = 0.8  # side of the largest cells
    fine: float = 0.02  # side of the smallest cells
    hidden: int = 64  # units of a hidden layer; a multiple of 4
    appearance: int = 0  # size of the learned embedding of each training image; a multiple of 4
    table_rate: float = 3.0  # learning rate of hash tables as a multiple: few batches update an entry

    def __post_init__(self) -> None:
        for name in ("hidden", "appearance"):
            if getattr(self, name) % 4:
                raise ValueError(f"{name} must be a multiple of 4, not {getattr(self, name)}")
        if self.levels % 2:
            raise ValueError(f"levels must be even, not {self.levels}")


@dataclass(frozen=True)
class ProposalSettings(HashSettings):
    """Settings of Semantic Nerfacto: the hash field and its proposal sampler."""

    proposal_samples: tuple[int, ...] = (32,)  # bins of each proposal round
    proposal_every: int = 2  # steps between two updates of the proposals, after the first tenth of the training
    proposal_levels: int = 4  # even
    proposal_log2_entries: int = 15  # largest table of a level
    proposal_fine: float = 0.06  # side of the smallest cells
    proposal_hidden: int = 16  # units of the hidden layer; a multiple of 4
    padding: float = 0.01  # total weight added to the bins in resampling, so that every bin can be sampled
    interlevel_weight: float = 1.0

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.proposal_hidden % 4:
            raise ValueError(f"proposal_hidden must be a multiple of 4, not {self.proposal_hidden}")
        if self.proposal_levels % 2:
            raise ValueError(f"proposal_levels must be even, not {self.proposal_levels}")


@dataclass(frozen=True)
class OccupancySettings(HashSettings):
    """Settings of Instant-NGP: the hash field and its occupancy sampler."""

    distortion_weight: float = 0.02  # the only loss that removes low density in front of the cameras
    samples: int = 24
    candidates: int = 256  # steps per ray that query the grid
    cell: float = 0.10  # side of a cell of the occupancy grid
    update_every: int = 16  # steps between two updates of the grid
    decay: float = 0.8  # factor of the densities at each update; 0.95 would keep the initial density for 1000 steps
    occupied: float = 0.1  # smallest density of an occupied cell, per metre
    reach: float = 1.0  # length of occupied space that a ray crosses before it may stop


@dataclass(frozen=True)
class SemanticNerfSettings(Settings):
    """Settings of Semantic NeRF: the same network twice, coarse and fine."""

    semantic_weight: float = 0.04
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
