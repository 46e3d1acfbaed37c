"""``autonerf-lab train-policy``."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

from tyro.conf import arg

from autonerf_lab.errors import DataError

# Heavy imports wait inside the commands: `--help` answers at once.


def whole(text: str) -> int:
    """A number of things: 2000000, 2e6 or 2_000_000.

    Raises:
        DataError: it is not a positive whole number.

    Example:
        >>> whole("2e6")
        2000000
    """
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if value < 1 or value != round(value):
        raise DataError(f"{text!r} is not a positive whole number, such as 1000000 or 1e6")
    return round(value)


@dataclass(frozen=True)
class TrainPolicy:
    """Train a policy on the training apartments, by a teacher and PPO. Interrupted, the same command goes on."""

    policy: Annotated[str, arg(help="modular-REWARD or e2e-REWARD, such as modular-obs; or pointgoal.")] = "modular-obs"
    frames: Annotated[
        str | None, arg(help="Actions of the robots at most; without, 1.5e6, for e2e 5e5, for pointgoal 2e6.")
    ] = None
    start: Annotated[
        str | None, arg(help="Begin with the weights of a policy that ships, or of a .safetensors, not with a teacher.")
    ] = None
    workers: Annotated[int, arg(help="Processes that walk.")] = 2
    seed: Annotated[int, arg(help="Of everything.")] = 0
    out: Annotated[Path | None, arg(help="Folder of the run; runs/policies/POLICY without it.")] = None
    network: Annotated[
        Literal["compact", "paper"], arg(help="Of a modular policy: what it sees and how large it is.")
    ] = "compact"

    def run(self) -> None:
        """Train, draw the curve, say where the weights are."""
        from autonerf_lab.policies.weights import read_meta
        from autonerf_lab.training.settings import settings_of
        from autonerf_lab.training.train import train_policy
        from autonerf_lab.viz.figures.training import learning_curve

        chosen: dict[str, Any] = {} if self.frames is None else {"frames": whole(self.frames)}
        if self.network == "paper":
            chosen["network"] = {"kind": "paper", "viewpoints": self.policy.endswith("-view")}
        settings = settings_of(self.policy, seed=self.seed, **chosen)
        out = self.out or Path("runs/policies") / self.policy
        weights = train_policy(self.policy, out, settings, workers=self.workers, start=self.start)
        learning_curve(read_meta(weights)["curve"], self.policy).savefig(out / "curve.png", dpi=110)
        print(f"weights: {weights}.safetensors")
