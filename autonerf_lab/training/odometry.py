"""Train learned odometry: ``train_odometry("runs/odometry")``.

The depth images of each training apartment are rendered once and kept in the folder, see :mod:`.odometry_pairs`. The
loss is the negative logarithm of the likelihood of the true motion. A checkpoint is written every minute; after an
interruption, the same call continues with the same batches.

The folder contains the pairs, the checkpoint and the weights, ``odometry.safetensors`` and ``odometry.json``.
"""

import math
import time
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor, nn
from tqdm import tqdm

from autonerf_lab.errors import TrainingError
from autonerf_lab.localization.learned import save_network
from autonerf_lab.localization.motion_network import MotionNetwork
from autonerf_lab.scenes import scene_names
from autonerf_lab.training.checkpoint import CHECKPOINT, SupervisedHeader, resume_supervised, save_supervised
from autonerf_lab.training.odometry_pairs import Pairs, sample_batch, training_pairs
from autonerf_lab.version import __version__

SAVE_EVERY = 60.0  # seconds between two checkpoints
_LARGEST_LOSS = 50.0  # of a pair, so that a pair of images without a common surface does not count more
_RISE = 100  # steps until the learning rate is largest


@dataclass(frozen=True)
class OdometrySettings:
    """Settings of the training of learned odometry."""

    steps: int = 800
    seed: int = 0
    scenes: int = 25  # the first ones of train-*
    runs: int = 150  # start poses per apartment
    batch: int = 8  # runs
    lr: float = 3e-3
    weight_decay: float = 1e-3
    measure_every: int = 100  # steps


def train_odometry(
    folder: str | Path, settings: OdometrySettings | None = None, progress: bool = True, command: str | None = None
) -> Path:
    """Train the network of learned odometry, or resume its training from the checkpoint in the folder.

    Args:
        folder: folder of the training.
        settings: settings of the training.
        progress: show progress bars.
        command: command line that the file beside the weights names.

    Returns:
        Path of the weights without suffix.

    Raises:
        RunFolderError: the folder contains another training.
        DataError: a file is damaged or cannot be written.
        TrainingError: the loss is not finite; the last checkpoint is kept.
    """
    folder, settings = Path(folder), settings or OdometrySettings()
    started = time.process_time()
    names = scene_names("train")[: settings.scenes]
    parts = [
        training_pairs(folder / "pairs", name, settings.runs, settings.seed)
        for name in tqdm(names, "render", unit="apartment", disable=not progress)
    ]
    pairs = Pairs(*(np.concatenate([getattr(part, key) for part in parts]) for key in ("depth", "motions", "actions")))
    training = _Training(folder, settings, pairs, started)
    training.run(progress)
    meta = {
        "command": command,
        "step": training.step,
        "pairs": int(pairs.actions.size),
        "cpu_minutes": round(training.seconds / 60, 2),
        "settings": asdict(settings),
        "curve": training.curve,
    }
    save_network(folder / "odometry", training.network, meta)
    return folder / "odometry"


def likelihood_loss(correction: Tensor, information: Tensor, wanted: Tensor) -> Tensor:
    """Return the negative logarithm of normal densities (B,), without its constant.

    Example:
        >>> wanted = torch.tensor([[1.0, 0.0, 0.0]])
        >>> likelihood_loss(torch.zeros(1, 3), 4 * torch.eye(3)[None], wanted).round(decimals=4)  # 4 / 2 - log(64) / 2
        tensor([-0.0794])
    """
    error = correction - wanted
    distance = torch.einsum("bi,bij,bj->b", error, information, error)
    return distance / 2 - torch.logdet(information) / 2


class _Training:
    """State of a training: network, optimiser and curve."""

    def __init__(self, folder: Path, settings: OdometrySettings, pairs: Pairs, started: float) -> None:
        self.folder, self.settings, self.pairs = folder, settings, pairs
        torch.manual_seed(settings.seed)
        self.network = MotionNetwork()
        self.optimizer = torch.optim.AdamW(self.network.parameters(), settings.lr, weight_decay=settings.weight_decay)
        self.curve: list[dict[str, float]] = []
        self.step, self.seconds, self._started = 0, 0.0, started  # seconds of the processor
        self._losses: list[float] = []
        self._fingerprint = {"version": __version__, **asdict(settings)}
        self._resume()

    def run(self, progress: bool) -> None:
        """Train up to the last step and write the last checkpoint."""
        saved = time.perf_counter()
        steps, every = self.settings.steps, self.settings.measure_every
        with tqdm(total=steps, initial=self.step, desc="train", unit="step", disable=not progress) as bar:
            while self.step < steps:
                self._losses.append(self._update())
                bar.update()
                if self.step % every == 0 or self.step == steps:
                    self.curve.append({"step": self.step, "loss": round(float(np.mean(self._losses)), 4)})
                    bar.set_postfix_str(f"loss {self.curve[-1]['loss']:.3f}")
                    self._losses = []
                    if time.perf_counter() - saved > SAVE_EVERY or self.step == steps:
                        self._save()
                        saved = time.perf_counter()

    def _update(self) -> float:
        settings = self.settings
        rng = np.random.default_rng([settings.seed, self.step])
        images, prior, wanted = (torch.from_numpy(a).float() for a in sample_batch(self.pairs, settings.batch, rng))
        rate = min(1.0, (self.step + 1) / _RISE) * (1 + math.cos(math.pi * self.step / settings.steps)) / 2
        for group in self.optimizer.param_groups:
            group["lr"] = settings.lr * rate
        correction, information = self.network(images, prior)
        losses = likelihood_loss(correction, information, wanted)
        loss = losses.clamp(max=_LARGEST_LOSS).mean()
        self.optimizer.zero_grad()
        loss.backward()
        nn.utils.clip_grad_norm_(self.network.parameters(), 1.0)
        value = float(losses.detach().mean())
        if not math.isfinite(value):
            raise TrainingError(
                f"the loss is not finite at step {self.step}; {self.folder / CHECKPOINT} is the last good state"
            )
        self.optimizer.step()
        self.step += 1
        return value

    def _save(self) -> None:
        now = time.process_time()
        self.seconds, self._started = self.seconds + now - self._started, now
        header = SupervisedHeader(self._fingerprint, self.curve, self.step, self.seconds)
        save_supervised(self.folder / CHECKPOINT, header, {"network": self.network}, self.optimizer)

    def _resume(self) -> None:
        path, networks = self.folder / CHECKPOINT, {"network": self.network}
        if header := resume_supervised(path, self._fingerprint, networks, self.optimizer):
            self.curve, self.step, self.seconds = header.curve, header.step, header.seconds
