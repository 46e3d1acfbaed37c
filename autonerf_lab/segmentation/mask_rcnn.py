"""Segmenter ``mask-rcnn``: Mask R-CNN with a ResNet-50 and a feature pyramid, as in the paper (section 4.1).

The network is torchvision's, trained on COCO, whose categories include the 15 classes. Detections with a score of at
least 0.9 are painted over each other from the lowest to the highest score. The weights are not shipped: see
:func:`load_mask_rcnn` for the file to get.
"""

from pathlib import Path
from typing import Any

import numpy as np
import torch

from autonerf_lab.classes import CLASS_NAMES
from autonerf_lab.errors import DataError, MissingPackageError
from autonerf_lab.segmentation.base import Segmentation
from autonerf_lab.utils.storage import read_arrays

COCO_IDS = {
    "chair": 62, "couch": 63, "potted plant": 64, "bed": 65, "toilet": 70, "tv": 72, "dining table": 67, "oven": 79,
    "sink": 81, "refrigerator": 82, "book": 84, "clock": 85, "vase": 86, "cup": 47, "bottle": 44,
}  # fmt: skip
SCORE = 0.9  # smallest score of a detection
_CLASS_OF = np.zeros(91, np.uint8)
_CLASS_OF[list(COCO_IDS.values())] = [CLASS_NAMES.index(name) for name in COCO_IDS]
_HOW = (
    "needs a file of weights: save the state dict of torchvision's MaskRCNN_ResNet50_FPN_Weights.COCO_V1 as "
    "safetensors and name it, as in mask-rcnn:FILE.safetensors"
)


class MaskRcnn:
    """Mask R-CNN on RGB.

    Args:
        weights: ``.safetensors`` file of the state dict of torchvision's ``maskrcnn_resnet50_fpn``; None is an error
            that says what to get.
        score: smallest score of a detection.

    Raises:
        DataError: the file is missing, damaged or belongs to another network.
        MissingPackageError: torchvision is not installed.
    """

    def __init__(self, weights: str | Path | None = None, score: float = SCORE) -> None:
        if weights is None:
            raise DataError(f"the segmenter 'mask-rcnn' {_HOW}")
        self._network, self._score = load_mask_rcnn(weights), score

    def reset(self, rng: np.random.Generator) -> None:
        """Begin an episode: nothing is remembered between images."""

    def __call__(
        self, rgb: np.ndarray, depth: np.ndarray | None = None, truth: np.ndarray | None = None
    ) -> Segmentation:
        """Segment (H, W, 3) or (B, H, W, 3) uint8 images; depth and truth are not read.

        The confidence is the score of the painted detection, and the smallest score where there is none.
        """
        images = np.asarray(rgb)
        batch = images.reshape(-1, *images.shape[-3:])
        painted = [self._one(image) for image in batch]
        labels, confidence = (np.stack(part).reshape(images.shape[:-1]) for part in zip(*painted, strict=True))
        return Segmentation(labels, confidence)

    def _one(self, image: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        with torch.inference_mode():
            found = self._network([torch.from_numpy(np.ascontiguousarray(image)).permute(2, 0, 1).float() / 255])[0]
        detections = {name: found[name].numpy() for name in ("labels", "scores", "masks")}
        return paint(detections["labels"], detections["scores"], detections["masks"][:, 0], self._score)


def paint(ids: np.ndarray, scores: np.ndarray, masks: np.ndarray, least: float) -> tuple[np.ndarray, np.ndarray]:
    """Paint detections over each other, the highest score on top.

    Args:
        ids: (N,) COCO categories; those of none of the 15 classes are left out.
        scores: (N,) in [0, 1].
        masks: (N, H, W) probabilities; a pixel belongs to a mask from 0.5.
        least: smallest score of a detection.

    Returns:
        (H, W) uint8 labels and (H, W) float32 confidences.

    Example:
        >>> masks = np.array([[[1, 1, 0]], [[0, 1, 0]], [[1, 1, 1]]])
        >>> labels, confidence = paint(np.array([62, 47, 1]), np.array([0.92, 0.95, 0.99]), masks, 0.9)
        >>> labels.tolist(), (100 * confidence).round().tolist()
        ([[1, 14, 0]], [[92.0, 95.0, 90.0]])
    """
    labels = np.zeros(masks.shape[1:], np.uint8)
    confidence = np.full(masks.shape[1:], least, np.float32)
    classes = _CLASS_OF[ids]
    for k in np.argsort(scores, kind="stable"):
        if classes[k] and scores[k] >= least:
            inside = masks[k] >= 0.5
            labels[inside], confidence[inside] = classes[k], scores[k]
    return labels, confidence


def load_mask_rcnn(weights: str | Path) -> Any:
    """Return torchvision's ``maskrcnn_resnet50_fpn`` with the weights of a file, for inference.

    Raises:
        DataError: the file is missing, damaged or belongs to another network.
        MissingPackageError: torchvision is not installed.
    """
    if not Path(weights).is_file():
        raise DataError(f"{weights} does not exist; the segmenter 'mask-rcnn' {_HOW}")
    try:
        from torchvision.models.detection import maskrcnn_resnet50_fpn
    except (ImportError, RuntimeError) as error:  # RuntimeError: a torchvision of another build of torch
        raise MissingPackageError(
            f"the segmenter 'mask-rcnn' needs torchvision of the same build as torch ({error}): "
            'pip install "autonerf-lab[mask-rcnn]"'
        ) from error
    arrays, _ = read_arrays(weights, dict[str, Any])
    network = maskrcnn_resnet50_fpn(weights=None, weights_backbone=None)
    try:
        network.load_state_dict({name: torch.from_numpy(array) for name, array in arrays.items()})
    except RuntimeError as error:
        raise DataError(f"{weights} holds the weights of another network: {str(error)[:200]}") from error
    return network.eval()
