"""LPIPS (Zhang et al. 2018): difference of two images in the features of a network for image classification.

Both images pass through the convolutions of VGG16. After each of its five stages, the features of a pixel are scaled to
unit length. Their squared difference, weighted by a learned factor for each channel, is averaged over the pixels and
summed over the stages:

    d(x, y) = sum_l mean_hw sum_c w_lc (x_lhwc - y_lhwc)**2

**The weights** are neither part of the package nor downloaded by it. They are read from one safetensors file with the
names of torchvision (``features.0.weight`` ...) and of the package lpips (``lin0.model.1.weight`` ...), which
:func:`write_weights` makes where both packages are installed.

The SHA-256 of the file is saved with the scores, and those of the tensors of the backbone and of the heads, which do
not depend on the format of the file.
"""

import hashlib
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import nn

from autonerf_lab.errors import DataError
from autonerf_lab.utils import storage
from autonerf_lab.utils.extras import optional

STAGES = ((64, 64), (128, 128), (256, 256, 256), (512, 512, 512), (512, 512, 512))  # channels of the convolutions
# Normalisation of images in [-1, 1] in the reference implementation, close to the statistics of ImageNet
_SHIFT = torch.tensor([-0.030, -0.088, -0.188])[:, None, None]
_SCALE = torch.tensor([0.458, 0.448, 0.450])[:, None, None]
_EPS = 1e-10
_HEAD = "lin{}.model.1.weight"
HEADS_SHA256 = "09016f6c713efecd87823d0ac57b392f1c5c47de4e54122e04c71f80cc4650a3"  # of version 0.1, ``Lpips.parts``


class Lpips:
    """LPIPS distance of two images, 0 for equal images.

    Args:
        path: file of the weights, see the module docstring.
        sha256: expected SHA-256 of the file, hexadecimal; without, it is not checked.

    Raises:
        DataError: the file is missing, damaged, has another SHA-256, or lacks a weight.

    Example:
        >>> Lpips("/nowhere.safetensors")
        Traceback (most recent call last):
        autonerf_lab.errors.DataError: /nowhere.safetensors does not exist
    """

    min_side = 16  # pixels: four stages halve the image

    def __init__(self, path: str | Path, sha256: str | None = None) -> None:
        arrays, _ = storage.read_arrays(path, dict[str, Any])
        self.sha256 = hashlib.sha256(storage.read_bytes(path)).hexdigest()
        if sha256 is not None and sha256.lower() != self.sha256:
            raise DataError(f"{path} has the SHA-256 {self.sha256}, not {sha256}: the weights differ")
        shapes = {name: tuple(value.shape) for name, value in _vgg16().state_dict().items()}
        shapes |= {_HEAD.format(k): (1, widths[-1], 1, 1) for k, widths in enumerate(STAGES)}
        tensors = {name: _checked(path, name, arrays.get(name), shape) for name, shape in shapes.items()}
        self.parts = {part: _digest(tensors, start) for part, start in (("backbone", "features."), ("heads", "lin"))}
        self._heads = [tensors.pop(_HEAD.format(k))[0] for k in range(len(STAGES))]  # (C, 1, 1) each
        network = _vgg16()
        network.load_state_dict(tensors, assign=True)
        self._stages = _stages(network["features"])

    @torch.no_grad()
    def __call__(self, image: np.ndarray, target: np.ndarray) -> float:
        """Compute the distance of two (H, W, 3) images in [0, 1].

        Raises:
            ValueError: the shapes differ, are not those of colour images, or have a side under 16 pixels.
        """
        shape = np.shape(image)
        if shape != np.shape(target) or len(shape) != 3 or shape[2] != 3 or min(shape[:2]) < self.min_side:
            raise ValueError(
                f"LPIPS compares two (H, W, 3) images of at least {self.min_side} pixels a side, not {shape} with "
                f"{np.shape(target)}"
            )
        both = torch.from_numpy(np.stack([image, target]).astype(np.float32)).permute(0, 3, 1, 2)
        features, distance = (2 * both - 1 - _SHIFT) / _SCALE, 0.0
        for stage, head in zip(self._stages, self._heads, strict=True):
            features = stage(features)
            x, y = features / (features.norm(dim=1, keepdim=True) + _EPS)
            distance += float((head * (x - y) ** 2).sum(dim=0).mean())
        return distance


def write_weights(path: str | Path) -> "Lpips":
    """Write the file of the weights from those of torchvision and of the package lpips (extra ``lpips``).

    torchvision downloads VGG16 (528 MB) and checks its digest. The heads are part of the package lpips; their digest is
    checked here.

    Args:
        path: ``.safetensors`` file.

    Returns:
        The network of the file.

    Raises:
        MissingPackageError: one of the two packages is not installed.
        DataError: the file cannot be written, or the heads are not those of version 0.1.
    """
    torchvision, package = optional("torchvision", "lpips"), optional("lpips", "lpips")
    backbone = torchvision.models.vgg16(weights="IMAGENET1K_V1").state_dict()
    heads = package.LPIPS(net="vgg", version="0.1", pnet_rand=True, verbose=False).state_dict()
    tensors = {name: value for name, value in backbone.items() if name.startswith("features.")}
    tensors |= {_HEAD.format(k): heads[_HEAD.format(k)] for k in range(len(STAGES))}
    if _digest(tensors, "lin") != HEADS_SHA256:
        raise DataError("the heads of the installed package lpips are not those of version 0.1; install lpips 0.1.4")
    storage.write_arrays(path, {name: value.numpy() for name, value in tensors.items()})
    return Lpips(path)


def _digest(tensors: dict[str, torch.Tensor], start: str) -> str:
    """Compute the SHA-256 over names and values (float32, little-endian) of the tensors with a prefix, by name."""
    digest = hashlib.sha256()
    for name in sorted(name for name in tensors if name.startswith(start)):
        digest.update(name.encode() + tensors[name].numpy().astype("<f4").tobytes())
    return digest.hexdigest()


def _checked(path: str | Path, name: str, array: np.ndarray | None, shape: tuple[int, ...]) -> torch.Tensor:
    if array is None or array.shape != shape or not np.issubdtype(array.dtype, np.floating):
        found = "missing" if array is None else f"{array.dtype} of {array.shape}"
        raise DataError(f"{path}: {name} is {found}, not floats of {shape}; write it with `autonerf-lab lpips-weights`")
    if not np.isfinite(array).all():
        raise DataError(f"{path}: {name} holds a value that is not finite")
    return torch.from_numpy(array.astype(np.float32))


def _vgg16() -> nn.ModuleDict:
    """Build the convolutions of VGG16 with the numbering of torchvision, without memory for the weights."""
    layers: list[nn.Module] = []
    channels = 3
    for widths in STAGES:
        for width in widths:
            layers += [nn.Conv2d(channels, width, 3, padding=1, device="meta"), nn.ReLU()]
            channels = width
        layers.append(nn.MaxPool2d(2))
    return nn.ModuleDict({"features": nn.Sequential(*layers)})


def _stages(features: nn.Module) -> list[nn.Sequential]:
    """Split VGG16 before each pooling layer: a stage ends with the features that are compared."""
    stages: list[list[nn.Module]] = [[]]
    for layer in features.children():
        if isinstance(layer, nn.MaxPool2d):
            stages.append([])
        stages[-1].append(layer)
    return [nn.Sequential(*layers) for layers in stages[: len(STAGES)]]
