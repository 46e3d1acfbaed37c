"""``autonerf-lab explore``."""

from dataclasses import dataclass

from autonerf_lab.cli.options import (
    NO_OVERRIDES,
    ExplorationOptions,
    OutFolder,
    Overwrite,
    PolicyName,
    PresetName,
    SceneName,
    Seed,
)


@dataclass(frozen=True)
class ExploreCommand:
    """Explore a scene and save the trajectory as a nerfstudio dataset in OUT/trajectory. Starts a run folder."""

    out: OutFolder
    scene: SceneName = "val-0"
    policy: PolicyName = "frontier"
    preset: PresetName = None
    seed: Seed = 0
    overwrite: Overwrite = False
    exploration: ExplorationOptions = NO_OVERRIDES

    def run(self) -> None:
        """Run the first two stages."""
        from autonerf_lab import pipeline

        pipeline.run_pipeline(
            self.out, self.scene, self.policy, self.preset, self.seed, last="explore", overwrite=self.overwrite,
            **self.exploration.overrides(),
        )  # fmt: skip
        print(f"trajectory: {self.out / 'trajectory'}")
