"""Learned odometry: the motion of a step from two successive depth images and the measured motion.

The role is that of the pose estimator of Active Neural SLAM (Chaplot et al. 2020), which regresses the correction from
two egocentric maps with cells of 5 cm, the earlier one warped by the measured motion. Here the images themselves are
compared, whose residuals resolve millimetres, and the network weighs them (:mod:`.motion_network`). Errors of single
steps shrink; without a map they still add up.

``odometry.json`` beside the weights names the command of the training, its settings, the learning curve and the digest
of the code on which the inputs depend.
"""

from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import nn

from autonerf_lab.errors import DataError
from autonerf_lab.localization import motion_network, residual_image, scan
from autonerf_lab.localization.motion_network import MotionNetwork
from autonerf_lab.localization.scan import Scan
from autonerf_lab.utils.network_weights import code_sha256, load_weights, save_weights, weights_file
from autonerf_lab.utils.storage import read_json

WEIGHTS = Path(__file__).parent / "weights" / "odometry"
VERSION = 1


class LearnedOdometry:
    """Correction of measured motions by a trained network.

    Args:
        path: weights, ``.safetensors`` with a ``.json`` beside it; default: those of the package.

    Raises:
        DataError: a file is missing, damaged or belongs to another network.
    """

    def __init__(self, path: str | Path = WEIGHTS) -> None:
        self._network = load_network(path)

    def correct(
        self, current: Scan, previous: Scan, motion: np.ndarray, covariance: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the corrected motion (3,) between two scans and its covariance (3, 3).

        Args:
            current: scan after the motion.
            previous: scan before it.
            motion: (3,) measured, without its mean error; metres and radians in the frame of the previous scan.
            covariance: (3, 3) of its error.
        """
        image = residual_image.residual_image(current, previous, motion)
        with torch.inference_mode():
            prior = torch.from_numpy(np.linalg.inv(covariance)).float()
            correction, information = self._network(torch.from_numpy(image)[None], prior[None])
        return motion + correction[0].double().numpy(), np.linalg.inv(information[0].double().numpy())


def save_network(path: str | Path, network: nn.Module, meta: dict[str, Any]) -> None:
    """Write ``path``.safetensors, in half precision, and ``path``.json with the training."""
    save_weights(path, network, {"version": VERSION, "inputs_sha256": inputs_sha256(), **meta})


def load_network(path: str | Path) -> nn.Module:
    """Return the network for inference.

    Raises:
        DataError: a file is missing, damaged or belongs to another network.
    """
    file = weights_file(path, ".json")
    if read_json(file, dict[str, Any]).get("version") != VERSION:
        raise DataError(f"{file} needs version {VERSION}; train the weights again")
    network = MotionNetwork().eval()
    load_weights(path, network)
    return network


def inputs_sha256() -> str:
    """Return the SHA-256 of the code on which the inputs of the network depend."""
    return code_sha256(scan, residual_image, motion_network)
