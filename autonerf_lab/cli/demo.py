"""``autonerf-lab demo``."""

from dataclasses import dataclass
from pathlib import Path

from autonerf_lab.cli.options import (
    NO_LPIPS,
    NO_OVERRIDES,
    Device,
    ExplorationOptions,
    LpipsOptions,
    ModelName,
    OutFolder,
    Overwrite,
    PolicyName,
    PresetName,
    SceneName,
    Seed,
)


@dataclass(frozen=True)
class DemoCommand:
    """Run all stages: explore a scene, train a radiance field, evaluate it and write the report.

    After an interruption, the same command continues after the last finished stage.
    """

    scene: SceneName = "val-0"
    policy: PolicyName = "frontier"
    model: ModelName = "semantic-nerfacto"
    preset: PresetName = None
    seed: Seed = 0
    out: OutFolder = Path("runs/demo")
    overwrite: Overwrite = False
    device: Device = None
    exploration: ExplorationOptions = NO_OVERRIDES
    lpips: LpipsOptions = NO_LPIPS

    def run(self) -> None:
        """Run all stages and print the scores and the path of the report."""
        from autonerf_lab import pipeline

        pipeline.run_pipeline(
            self.out, self.scene, self.policy, self.preset, self.seed, self.model, overwrite=self.overwrite,
            options=pipeline.StageOptions(self.lpips.load(), self.device), **self.exploration.overrides(),
        )  # fmt: skip
        print(f"\n{pipeline.score_table(self.out)}\n\nreport: {self.out / 'report.html'}")
