"""Hyper-parameters of Semantic Nerfacto, one frozen dataclass a preset."""

from dataclasses import dataclass

from autonerf_lab.config import Preset
from autonerf_lab.nerf.kernels.blocks import BLOCK_RAYS


@dataclass(frozen=True)
class NerfactoSettings:
    """Sizes, losses and schedule. Lengths in metres."""

    steps: int = 1100
    rays: int = 3072  # a step; a multiple of 8
    samples: int = 16  # bins of the last round, where colour and semantics are evaluated
    proposal_samples: tuple[int, ...] = (48,)  # bins of each proposal round before it
    proposal_every: int = 1  # after the warm-up, proposals learn every so many steps
    near: float = 0.05
    far: float = 16.0
    turn: float = 4.0  # half of the first bins lie in front of this distance (d_s of the paper)
    padding: float = 0.01  # share of each bin in the resampling, so that none is impossible
    min_weight: float = 1e-3  # samples of less weight have no colour and no gradient
    levels: int = 8
    log2_entries: int = 17
    coarse: float = 0.8  # cells of the hash grid
    fine: float = 0.02
    hidden: int = 64
    proposal_levels: int = 4
    proposal_log2_entries: int = 15
    proposal_fine: float = 0.06
    proposal_hidden: int = 16
    appearance: int = 0  # values learned for each training image
    semantic_weight: float = 0.1
    distortion_weight: float = 0.002
    interlevel_weight: float = 1.0
    learning_rate: float = 1e-2  # of the networks
    table_rate: float = 10.0  # the hash tables learn this many times faster: an entry is touched by few batches
    final_learning_rate: float = 2e-3
    warmup: float = 0.01  # share of the training in which the rate rises
    margin: float = 1.5  # the box that is not squeezed reaches this far beyond the cameras
    shell: float = 0.25  # thickness of the shell that holds the rest of the world, in half sizes of the box

    def __post_init__(self) -> None:
        if self.rays % BLOCK_RAYS:
            raise ValueError(f"rays must be a multiple of {BLOCK_RAYS}, not {self.rays}")
        for name in ("hidden", "proposal_hidden", "appearance"):
            if getattr(self, name) % 4:
                raise ValueError(f"{name} must be a multiple of 4, not {getattr(self, name)}")
        for name in ("levels", "proposal_levels"):
            if getattr(self, name) % 2:
                raise ValueError(f"{name} must be even, not {getattr(self, name)}")


SETTINGS: dict[str, NerfactoSettings] = {
    "smoke": NerfactoSettings(steps=120, rays=1024, samples=16, proposal_samples=(32,), levels=6, log2_entries=14),
    "fast": NerfactoSettings(),
    "paper": NerfactoSettings(
        steps=30_000,
        rays=4096,
        semantic_weight=0.02,
        table_rate=1.0,
        min_weight=0.0,
        samples=48,
        proposal_samples=(256, 96),
        proposal_every=5,
        levels=16,
        log2_entries=19,
        appearance=32,
        final_learning_rate=1e-4,
    ),
}


def settings_for(preset: Preset) -> NerfactoSettings:
    """The hyper-parameters that go with a preset."""
    return SETTINGS[preset.name]
