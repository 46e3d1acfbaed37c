"""Hyper-parameters that all models share; each model adds its own in :mod:`autonerf_lab.nerf.models`."""

from dataclasses import dataclass

from autonerf_lab.nerf.kernels.tiling import BLOCK_RAYS


@dataclass(frozen=True)
class Settings:
    """Losses, schedule, and where the world is. Lengths in metres."""

    steps: int = 2800
    rays: int = 1536  # a step; a multiple of 16
    near: float = 0.05
    far: float = 16.0
    turn: float = 4.0  # half of the first bins lie in front of this distance (d_s of the paper)
    margin: float = 1.5  # the box that is not squeezed reaches this far beyond the cameras
    shell: float = 0.25  # thickness of the shell that holds the rest of the world, in half sizes of the box
    view_dependent: bool = True  # whether colours depend on the direction they are seen from
    semantic_weight: float = 0.02
    rays_by_class: float = 0.2  # share of a step's rays that are drawn by class, so that small objects are met
    distortion_weight: float = 0.002
    depth_weight: float = 0.0  # of the error of the expected depth, a metre; above 0 the walk's depth is used
    refine_cameras: bool = False  # whether the poses are learned too, a 6-vector a camera
    learning_rate: float = 1e-2
    final_learning_rate: float = 2e-3
    warmup: float = 0.01  # share of the training in which the rate rises
    seen_rays: int = 400_000  # that carve the visibility grid afterwards

    def __post_init__(self) -> None:
        if self.rays % BLOCK_RAYS:
            raise ValueError(f"rays must be a multiple of {BLOCK_RAYS}, not {self.rays}")


@dataclass(frozen=True)
class HashSettings(Settings):
    """Sizes of a field on a multi-resolution hash table (section 3.2)."""

    samples: int = 16  # bins of a ray where the field is asked
    min_weight: float = 1e-3  # samples of less weight have no colour and no gradient
    levels: int = 10
    log2_entries: int = 18
    coarse: float = 0.8  # cells of the hash grid
    fine: float = 0.02
    hidden: int = 64
    appearance: int = 0  # values learned for each training image
    table_rate: float = 3.0  # the hash tables learn this many times faster: an entry is touched by few batches

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("hidden", "appearance"):
            if getattr(self, name) % 4:
                raise ValueError(f"{name} must be a multiple of 4, not {getattr(self, name)}")
        if self.levels % 2:
            raise ValueError(f"levels must be even, not {self.levels}")


@dataclass(frozen=True)
class ProposalSettings(HashSettings):
    """The sampler of Semantic Nerfacto."""

    proposal_samples: tuple[int, ...] = (32,)  # bins of each proposal round before the last one
    proposal_every: int = 2  # after the first tenth of the training, proposals learn every so many steps
    proposal_levels: int = 4
    proposal_log2_entries: int = 15
    proposal_fine: float = 0.06
    proposal_hidden: int = 16
    padding: float = 0.01  # share of each bin in the resampling, so that none is impossible
    interlevel_weight: float = 1.0

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.proposal_hidden % 4:
            raise ValueError(f"proposal_hidden must be a multiple of 4, not {self.proposal_hidden}")
        if self.proposal_levels % 2:
            raise ValueError(f"proposal_levels must be even, not {self.proposal_levels}")


@dataclass(frozen=True)
class OccupancySettings(HashSettings):
    """The sampler of Instant-NGP."""

    distortion_weight: float = 0.02  # nothing else takes the fog in front of the cameras away
    samples: int = 24
    candidates: int = 256  # steps along a ray that ask the grid
    cell: float = 0.10  # of the occupancy grid
    update_every: int = 16  # steps between two updates of the grid
    decay: float = 0.8  # of the grid's densities at each update: 0.95 would remember the first fog for a thousand steps
    occupied: float = 0.1  # density, per metre, from which a cell counts
    reach: float = 1.0  # metres of occupied space a ray goes through before it may stop


@dataclass(frozen=True)
class SemanticNerfSettings(Settings):
    """Sizes of Semantic NeRF: the same network twice, coarse and fine."""

    semantic_weight: float = 0.04
    far: float = 10.0
    turn: float = 10.0
    layers: int = 8
    width: int = 256
    skip: int = 4  # the position enters again after this layer
    position_frequencies: int = 10
    direction_frequencies: int = 4
    coarse_samples: int = 64
    fine_samples: int = 128
    distortion_weight: float = 0.0
    seen_rays: int = 20_000
