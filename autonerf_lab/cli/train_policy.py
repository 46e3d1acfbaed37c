"""``autonerf-lab train-policy``."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from autonerf_lab.cli.options import option
from autonerf_lab.errors import DataError


def whole_number(text: str, smallest: int = 1) -> int:
    """Parse a whole number: 2000000, 2e6 or 2_000_000.

    Raises:
        DataError: not a whole number, or smaller than ``smallest``.

    Example:
        >>> whole_number("2e6")
        2000000
    """
    try:
        value = float(text)
    except ValueError:
        value = -1.0
    if not smallest <= value <= 2**53 or value != round(value):
        raise DataError(f"{text!r} is not a whole number from {smallest} on, such as 1000000 or 1e6")
    return round(value)


@dataclass(frozen=True)
class TrainPolicyCommand:
    """Train a policy in the training scenes, by imitation and PPO.

    After an interruption, the same command continues.
    """

    policy: Annotated[
        str,
        option(
            help="modular-REWARD, paper-REWARD (with the paper's network) or e2e-REWARD, for example modular-obs; or "
            "pointgoal."
        ),
    ] = "modular-obs"
    frames: Annotated[
        str | None,
        option(
            metavar="N",
            help="Number of robot actions of PPO, rounded up to whole rollouts; 0: imitation only. The actual number "
            "is smaller if waypoints are reached early.",
            default="1e6; pointgoal: 2e6",
        ),
    ] = None
    start: Annotated[
        str | None,
        option(
            metavar="POLICY", help="Initial weights instead of imitation: a built-in policy or a .safetensors file."
        ),
    ] = None
    demonstrations: Annotated[
        str | None,
        option(
            metavar="N",
            help="Number of episodes of the teacher that are imitated before PPO; 0: PPO from scratch.",
            default="60; e2e: 0; pointgoal: 1e4",
        ),
    ] = None
    workers: Annotated[int, option(help="Number of worker processes.")] = 2
    seed: Annotated[int, option(help="Random seed.")] = 0
    out: Annotated[Path | None, option(metavar="PATH", help="Output folder.", default="runs/policies/POLICY")] = None
    device: Annotated[str, option(metavar="NAME", help="Torch device of the network, such as cuda.")] = "cpu"

    def run(self) -> None:
        """Train the policy, save the learning curve and print the path of the weights."""
        import io

        from autonerf_lab.policies.weights import read_meta
        from autonerf_lab.training.settings import settings_of
        from autonerf_lab.training.train import train_policy
        from autonerf_lab.utils.storage import write_bytes
        from autonerf_lab.viz.figures.training import learning_curve

        if self.start is not None and self.demonstrations is not None:
            raise DataError("--start replaces the imitation of --demonstrations: give one of them")
        given = {"frames": self.frames, "demonstrations": self.demonstrations}
        chosen: dict[str, Any] = {name: whole_number(text, 0) for name, text in given.items() if text is not None}
        settings = settings_of(self.policy, seed=self.seed, **chosen)
        out = self.out or Path("runs/policies") / self.policy
        weights = train_policy(self.policy, out, settings, workers=self.workers, start=self.start, device=self.device)
        if curve := read_meta(weights)["curve"]:  # empty after imitation only
            image = io.BytesIO()
            learning_curve(curve, self.policy).savefig(image, format="png", dpi=110)
            write_bytes(out / "curve.png", image.getvalue())
        print(f"weights: {weights}.safetensors")
