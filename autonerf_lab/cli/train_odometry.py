"""``autonerf-lab train-odometry``."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from autonerf_lab.cli.options import option
from autonerf_lab.cli.train_policy import whole_number


@dataclass(frozen=True)
class TrainOdometryCommand:
    """Train the network of the pose estimator `learned` on depth images of the training apartments.

    After an interruption, the same command continues. The weights of the package were made by this command.
    """

    steps: Annotated[str | None, option(metavar="N", help="Number of batches.", default="800")] = None
    seed: Annotated[int, option(help="Random seed.")] = 0
    out: Annotated[Path, option(help="Output folder.")] = Path("runs/odometry")

    def run(self) -> None:
        """Train and print the path of the weights."""
        from autonerf_lab.training.odometry import OdometrySettings, train_odometry

        given = {} if self.steps is None else {"steps": whole_number(self.steps)}
        options = "".join(f" --{name} {value}" for name, value in given.items())
        weights = train_odometry(
            self.out,
            OdometrySettings(seed=self.seed, **given),
            command=f"autonerf-lab train-odometry --seed {self.seed}{options}",
        )
        print(f"weights: {weights}.safetensors")
