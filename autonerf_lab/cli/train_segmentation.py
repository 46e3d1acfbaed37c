"""``autonerf-lab train-segmentation``."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from autonerf_lab.cli.options import option
from autonerf_lab.cli.train_policy import whole_number


@dataclass(frozen=True)
class TrainSegmentationCommand:
    """Train the segmenter `compact` on renders of the training apartments and of newly generated ones.

    After an interruption, the same command continues. Use the weights with --semantics OUT/compact.safetensors.
    """

    steps: Annotated[str | None, option(metavar="N", help="Number of batches.", default="16000")] = None
    apartments: Annotated[
        str | None,
        option(
            metavar="N", help="Number of apartments: the training scenes, then newly generated ones.", default="480"
        ),
    ] = None
    seed: Annotated[int, option(help="Random seed.")] = 0
    out: Annotated[Path, option(help="Output folder.")] = Path("runs/segmentation")

    def run(self) -> None:
        """Train, draw the learning curve and print the path of the weights."""
        import io
        import json

        from autonerf_lab.training.segmentation import SegmentationSettings, train_segmentation
        from autonerf_lab.utils.storage import write_bytes
        from autonerf_lab.viz.figures.training import segmentation_curve

        chosen: dict[str, Any] = {"steps": self.steps, "apartments": self.apartments}
        given = {name: whole_number(text) for name, text in chosen.items() if text is not None}
        settings = SegmentationSettings(seed=self.seed, **given)
        options = "".join(f" --{name} {value}" for name, value in given.items())
        weights = train_segmentation(
            self.out, settings, command=f"autonerf-lab train-segmentation --seed {self.seed}{options}"
        )
        image = io.BytesIO()
        curve = json.loads(weights.with_suffix(".json").read_text())["curve"]
        segmentation_curve(curve).savefig(image, format="png", dpi=110)
        write_bytes(self.out / "curve.png", image.getvalue())
        print(f"weights: {weights}.safetensors")
