"""Train the ``compact`` segmenter: ``train_segmentation("runs/segmentation")``.

The frames of each apartment are rendered once and kept in the folder, see
:mod:`~autonerf_lab.training.segmentation_frames`. A checkpoint is written every two minutes. After an interruption the
same call continues with the same batches; a call with more steps extends the training. At the end a temperature is
fitted on apartments without training frames, so that confidences are calibrated (Guo et al. 2017).

The folder contains the frames, the checkpoint, the learning curve ``curve.csv`` and the weights,
``compact.safetensors`` and ``compact.json``.
"""

import math
import time
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import pandas as pd
import torch
from torch import Tensor, nn
from torch.nn import functional
from tqdm import tqdm

from autonerf_lab.classes import NUM_CLASSES
from autonerf_lab.errors import TrainingError
from autonerf_lab.segmentation.compact import predict, save_network
from autonerf_lab.segmentation.metrics import class_scores, confusion_matrix
from autonerf_lab.segmentation.network import CompactNetwork
from autonerf_lab.training.checkpoint import CHECKPOINT, SupervisedHeader, resume_supervised, save_supervised
from autonerf_lab.training.segmentation_frames import Frames, held_out_frames, training_frames
from autonerf_lab.utils.storage import write_bytes
from autonerf_lab.version import __version__

SAVE_EVERY = 120.0  # seconds between two checkpoints
_AVERAGE = 0.998  # decay of the moving average of the weights


@dataclass(frozen=True)
class SegmentationSettings:
    """Settings of the training of a segmenter."""

    steps: int = 16_000
    seed: int = 0
    apartments: int = 480  # the 25 training scenes and fresh seeds
    frames: int = 60  # per apartment
    size: int = 128  # pixels a side
    batch: int = 24
    lr: float = 3e-3  # maximum; one cycle
    weight_decay: float = 0.02
    class_balance: float = 0.12  # class weights are shares of pixels to the power of minus this
    held_out: int = 16  # apartments that measure and calibrate
    held_out_frames: int = 24  # per apartment
    measure_every: int = 500  # steps


def train_segmentation(
    folder: str | Path, settings: SegmentationSettings | None = None, progress: bool = True, command: str | None = None
) -> Path:
    """Train the compact network, or resume its training from the checkpoint in the folder.

    Args:
        folder: folder of the training.
        settings: settings of the training.
        progress: show a progress bar.
        command: command line that the file beside the weights names.

    Returns:
        Path of the weights without suffix.

    Raises:
        RunFolderError: the folder contains another training.
        DataError: a file is damaged or cannot be written.
        TrainingError: the loss is not finite; the last checkpoint is kept.
    """
    folder, settings = Path(folder), settings or SegmentationSettings()
    started = time.perf_counter()
    numbers = range(settings.apartments)
    parts = [
        training_frames(folder / "frames", k, settings.frames, settings.seed, settings.size)
        for k in tqdm(numbers, "render", unit="apartment", disable=not progress)
    ]
    frames = Frames.joined(parts)
    del parts
    held_out = held_out_frames(
        folder / "frames", settings.held_out, settings.held_out_frames, settings.seed, settings.size
    )
    training = _Training(folder, settings, frames, held_out, started)
    training.run(progress)
    average = training.average.eval()
    temperature = fit_temperature(average, held_out)
    write_bytes(folder / "curve.csv", pd.DataFrame(training.curve).to_csv(index=False, lineterminator="\n").encode())
    meta = {
        "command": command,
        "step": training.step,
        "frames": len(frames.rgb),
        "hours": round(training.seconds / 3600, 3),
        "settings": asdict(settings),
        "curve": training.curve,
    }
    save_network(folder / "compact", average, temperature, meta)
    return folder / "compact"


class _Training:
    """State of a training: network, moving average, optimiser and curve."""

    def __init__(
        self, folder: Path, settings: SegmentationSettings, frames: Frames, held_out: Frames, started: float
    ) -> None:
        self.folder, self.settings, self.frames, self.held_out = folder, settings, frames, held_out
        torch.manual_seed(settings.seed)
        self.network, self.average = CompactNetwork(), CompactNetwork()
        self._networks = {"network": self.network, "average": self.average}
        self.average.load_state_dict(self.network.state_dict())
        self.optimizer = torch.optim.AdamW(self.network.parameters(), settings.lr, weight_decay=settings.weight_decay)
        shares = np.bincount(frames.semantics.reshape(-1), minlength=NUM_CLASSES) / frames.semantics.size
        weights = np.maximum(shares, 1e-4) ** -settings.class_balance
        self.weights = torch.from_numpy(weights / weights[0]).float()
        self.curve: list[dict[str, float]] = []
        self.step, self.seconds, self._started = 0, 0.0, started
        # bfloat16 saves time where the processor multiplies it in hardware
        self._half = torch.backends.mkldnn.is_available() and torch.ops.mkldnn._is_mkldnn_bf16_supported()
        self.fingerprint = {"version": __version__, **asdict(settings)}
        del self.fingerprint["steps"]  # a training can be extended
        self._resume()

    def run(self, progress: bool) -> None:
        """Train up to the last step and write the last checkpoint."""
        saved = time.perf_counter()
        bar = tqdm(total=self.settings.steps, initial=self.step, desc="train", unit="step", disable=not progress)
        with bar:
            while self.step < self.settings.steps:
                loss = self._update()
                bar.update()
                if self.step % self.settings.measure_every == 0 or self.step == self.settings.steps:
                    depth = self.held_out.depth.astype(np.float32)
                    labels, _ = predict(self.average.eval(), self.held_out.rgb, depth, 1.0)
                    value = class_scores(confusion_matrix(labels, self.held_out.semantics))["miou"] or 0.0
                    self.curve.append({"step": self.step, "loss": loss, "miou": value})
                    bar.set_postfix_str(f"loss {loss:.3f}, mIoU {value:.1f} %")
                if time.perf_counter() - saved > SAVE_EVERY or self.step == self.settings.steps:
                    self._save()
                    saved = time.perf_counter()

    def _update(self) -> float:
        rgb, depth, labels = self._batch()
        self.network.train()
        for group in self.optimizer.param_groups:
            group["lr"] = self.settings.lr * one_cycle(self.step / self.settings.steps)
        with torch.autocast("cpu", torch.bfloat16, enabled=self._half):
            logits = self.network(rgb, depth)
        loss = functional.cross_entropy(logits.float(), labels, self.weights)
        self.optimizer.zero_grad()
        loss.backward()
        nn.utils.clip_grad_norm_(self.network.parameters(), 1.0)
        value = float(loss.detach())
        if not math.isfinite(value):
            raise TrainingError(
                f"the loss is not finite at step {self.step}; {self.folder / CHECKPOINT} is the last good state"
            )
        self.optimizer.step()
        self.step += 1
        decay = min(_AVERAGE, self.step / (self.step + 10))
        with torch.no_grad():
            new = self.network.state_dict()
            for name, averaged in self.average.state_dict().items():
                if averaged.dtype.is_floating_point:
                    averaged.lerp_(new[name], 1 - decay)
        return value

    def _batch(self) -> tuple[Tensor, Tensor, Tensor]:
        """Return the images, depth images and labels of the current step, augmented."""
        rng = np.random.default_rng([self.settings.seed, self.step, 1])
        chosen = rng.integers(len(self.frames.rgb), size=self.settings.batch)
        rgb, labels = self.frames.rgb[chosen], self.frames.semantics[chosen].astype(np.int64)
        depth = self.frames.depth[chosen].astype(np.float32)
        mirrored = rng.random(len(rgb)) < 0.5
        for images in (rgb, depth, labels):
            images[mirrored] = images[mirrored, :, ::-1]
        colours = augmented(torch.from_numpy(rgb).permute(0, 3, 1, 2).float(), rng)
        return colours, torch.from_numpy(measured(depth, rng)), torch.from_numpy(labels)

    def _save(self) -> None:
        now = time.perf_counter()
        self.seconds, self._started = self.seconds + now - self._started, now
        header = SupervisedHeader(self.fingerprint, self.curve, self.step, self.seconds)
        save_supervised(self.folder / CHECKPOINT, header, self._networks, self.optimizer)

    def _resume(self) -> None:
        if header := resume_supervised(self.folder / CHECKPOINT, self.fingerprint, self._networks, self.optimizer):
            self.curve, self.step, self.seconds = header.curve, header.step, header.seconds


def one_cycle(progress: float) -> float:
    """Return the share of the maximum learning rate: a short linear rise, then half a cosine.

    Example:
        >>> [round(one_cycle(p), 3) for p in (0.0, 0.05, 0.525, 1.0)]
        [0.01, 1.0, 0.5, 0.0]
    """
    rise = 0.05
    if progress < rise:
        return 0.01 + 0.99 * progress / rise
    return 0.5 + 0.5 * math.cos(math.pi * (progress - rise) / (1 - rise))


def augmented(rgb: Tensor, rng: np.random.Generator) -> Tensor:
    """Return images as other cameras would take them: exposure, white balance, gamma, blur and noise.

    Args:
        rgb: (B, 3, H, W), 0 to 255.
        rng: random generator.

    Example:
        >>> images = augmented(torch.full((2, 3, 8, 8), 128.0), np.random.default_rng(0))
        >>> images.shape, bool((images >= 0).all() and (images <= 255).all())
        (torch.Size([2, 3, 8, 8]), True)
    """
    count = len(rgb)

    def factors(sigma: float, channels: int = 1) -> Tensor:
        return torch.from_numpy(np.exp(rng.normal(0, sigma, (count, channels, 1, 1)))).float()

    blurred = functional.avg_pool2d(functional.pad(rgb, (1, 1, 1, 1), mode="replicate"), 3, 1)
    share = torch.from_numpy(np.clip(rng.normal(0, 0.25, (count, 1, 1, 1)), 0, 1)).float()
    rgb = rgb + share * (blurred - rgb)
    rgb = 255 * (rgb / 255) ** factors(0.15) * factors(0.12) * factors(0.04, 3)
    sigma = torch.from_numpy(np.clip(rng.normal(0, 5, (count, 1, 1, 1)), 0, None)).float()
    noise = torch.randn(rgb.shape, generator=torch.Generator().manual_seed(int(rng.integers(1 << 62))))
    return (rgb + sigma * noise).clamp(0, 255)


def measured(depth: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Return depth images as sensors would measure them: noise that grows with the square of the depth, holes, or none.

    Args:
        depth: (B, H, W) float32, metres.
        rng: random generator.

    Example:
        >>> images = measured(np.full((64, 8, 8), 2, np.float32), np.random.default_rng(0))
        >>> bool((images == 0).all(axis=(1, 2)).any()), bool((images > 0).any())
        (True, True)
    """
    count, height, width = depth.shape
    noise = rng.normal(0, 0.0028, depth.shape) * rng.integers(2, size=(count, 1, 1))
    depth = depth * (1 + noise * depth).astype(np.float32)
    coarse = rng.random((count, -(-height // 8), -(-width // 8))) < rng.choice([0, 0.03], size=(count, 1, 1))
    holes = coarse.repeat(8, axis=1).repeat(8, axis=2)[:, :height, :width]
    return np.where(holes | (rng.random((count, 1, 1)) < 0.2), np.float32(0), depth)


def fit_temperature(network: nn.Module, frames: Frames) -> float:
    """Return the temperature that minimises the cross-entropy of the labels, by golden-section search.

    Args:
        network: network in evaluation mode.
        frames: labelled frames of apartments on which the network was not trained.
    """
    logits, labels = [], []
    with torch.no_grad():
        for start in range(0, len(frames.rgb), 16):
            rgb = torch.from_numpy(frames.rgb[start : start + 16]).permute(0, 3, 1, 2)
            depth = torch.from_numpy(frames.depth[start : start + 16].astype(np.float32))
            logits.append(network(rgb, depth)[:, :, ::2, ::2])
            labels.append(torch.from_numpy(frames.semantics[start : start + 16, ::2, ::2].astype(np.int64)))
    all_logits, all_labels = torch.cat(logits), torch.cat(labels)

    def loss(log_temperature: float) -> float:
        return float(functional.cross_entropy(all_logits / math.exp(log_temperature), all_labels))

    low, high, ratio = math.log(0.2), math.log(5.0), (math.sqrt(5) - 1) / 2
    while high - low > 1e-3:
        first, second = high - ratio * (high - low), low + ratio * (high - low)
        low, high = (low, second) if loss(first) < loss(second) else (first, high)
    return math.exp((low + high) / 2)
