"""Segmenter ``compact``: a small network on RGB-D, trained on renders of generated apartments.

It also works without a depth image: some of its training images had none.

``compact.json`` beside the weights describes the training: command, number of frames, hours, learning curve, and the
digest of the code that makes the inputs of the network and gives its outputs their meaning. The confidence of a pixel
is the probability of its most probable class. The logits are first divided by a temperature, which was fitted on
apartments that are not in the training data (Guo et al. 2017).
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import nn

from autonerf_lab import classes
from autonerf_lab.errors import DataError
from autonerf_lab.segmentation import network as network_module
from autonerf_lab.segmentation.base import Segmentation
from autonerf_lab.segmentation.network import CompactNetwork, fold_normalization
from autonerf_lab.utils.network_weights import code_sha256, load_weights, save_weights, weights_file
from autonerf_lab.utils.storage import read_json

WEIGHTS = Path(__file__).parent / "weights" / "compact"
VERSION = 2
_BATCH = 16  # images at a time
# Processors that multiply numbers of 16 bits need half of the time, and change the label of one pixel in 400. Older
# versions of torch cannot tell.
_CAPABILITIES: Mapping[str, object] = getattr(torch.cpu, "get_capabilities", dict)()
_HALF = any(_CAPABILITIES.get(name) for name in ("avx512_bf16", "amx_bf16"))


class Compact:
    """Small encoder-decoder on colours and, where it is given, depth.

    Args:
        path: weights, ``.safetensors`` with a ``.json`` beside it; default: those of the package.

    Raises:
        DataError: a file is missing, damaged or belongs to another network.
    """

    def __init__(self, path: str | Path = WEIGHTS) -> None:
        self._network, self._temperature = load_network(path)

    def reset(self, rng: np.random.Generator) -> None:
        """Do nothing: labels of an image do not depend on earlier images."""

    def __call__(
        self, rgb: np.ndarray, depth: np.ndarray | None = None, truth: np.ndarray | None = None
    ) -> Segmentation:
        """Segment (H, W, 3) or (B, H, W, 3) uint8 images; truth is not read."""
        images = np.asarray(rgb)
        batch = images.reshape(-1, *images.shape[-3:])
        metres = np.zeros(batch.shape[:-1], np.float32) if depth is None else np.asarray(depth, np.float32)
        labels, confidence = predict(self._network, batch, metres.reshape(batch.shape[:-1]), self._temperature)
        return Segmentation(labels.reshape(images.shape[:-1]), confidence.reshape(images.shape[:-1]))


def predict(
    network: nn.Module, rgb: np.ndarray, depth: np.ndarray, temperature: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return the most probable labels (B, H, W) uint8 and their probabilities (B, H, W) float32.

    Args:
        network: network in evaluation mode.
        rgb: (B, H, W, 3) uint8.
        depth: (B, H, W) float32, metres, 0 where there is no reading.
        temperature: divisor of the logits.
    """
    labels = np.empty(rgb.shape[:-1], np.uint8)
    confidence = np.empty(rgb.shape[:-1], np.float32)
    with torch.inference_mode():
        for start in range(0, len(rgb), _BATCH):
            part = slice(start, start + _BATCH)
            images = torch.from_numpy(np.ascontiguousarray(rgb[part])).permute(0, 3, 1, 2)
            logits = network(images, torch.from_numpy(np.ascontiguousarray(depth[part])))
            logits = logits.float() / temperature
            best, index = logits.max(dim=1)
            labels[part] = index.numpy()
            confidence[part] = torch.exp(best - torch.logsumexp(logits, dim=1)).numpy()
    return labels, confidence


def save_network(path: str | Path, network: nn.Module, temperature: float, meta: dict[str, Any]) -> None:
    """Write ``path``.safetensors, in half precision, and ``path``.json with the temperature and the training."""
    meta = {"version": VERSION, "temperature": temperature, "inputs_sha256": inputs_sha256(), **meta}
    save_weights(path, network, meta)


def inputs_sha256() -> str:
    """Return the SHA-256 of the code on which inputs and classes of the network depend."""
    return code_sha256(network_module, classes)


def load_network(path: str | Path) -> tuple[nn.Module, float]:
    """Return the network for inference and its temperature.

    Raises:
        DataError: a file is missing, damaged or belongs to another network.
    """
    file = weights_file(path, ".json")
    meta = read_json(file, dict[str, Any])
    temperature = meta.get("temperature")
    if meta.get("version") != VERSION or not isinstance(temperature, int | float) or not 0.01 < temperature < 100:
        raise DataError(f"{file} needs version {VERSION} and a temperature; train the weights again")
    network: nn.Module = CompactNetwork().eval()
    load_weights(path, network)
    network = fold_normalization(network).to(dtype=torch.bfloat16 if _HALF else torch.float32)
    return network.to(memory_format=torch.channels_last), float(temperature)  # type: ignore[call-overload]
