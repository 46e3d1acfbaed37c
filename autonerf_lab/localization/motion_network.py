"""Network that weighs the residuals between two successive depth images, and the motion that follows from them.

The network sees the residuals of :mod:`.residual_image` and predicts a weight and a robust width for each pixel. The
correction of the measured motion is the weighted least-squares solution with the odometry as prior, so that the
gradient of the likelihood of the true motion trains the weights (Ranftl and Koltun 2018, for fundamental matrices).
"""

import torch
from torch import Tensor, nn
from torch.nn import functional

from autonerf_lab.localization.scan import INVERSE_DEPTH_SIGMA

PIXELS = 4096  # of the images of the training: more pixels of one image do not add information
_INPUTS = 9  # the residual image, products of residual and derivatives, and the size of the residual
_FEATURES = 16
_SCALE = 5.0  # standard deviations, of the residuals as input
_FIRST_WEIGHT = -5.0  # logarithm of the weight before the training


class MotionNetwork(nn.Module):
    """Convolutions on a grid of every second pixel, with a receptive field of 29 pixels; 6,000 parameters.

    Example:
        >>> network = MotionNetwork()
        >>> image = torch.zeros(1, 5, 32, 32)  # nothing is seen
        >>> correction, information = network(image, 4 * torch.eye(3)[None])
        >>> correction.detach().numpy().round(3) + 0, information.detach().numpy()[0, 0]
        (array([[0., 0., 0.]], dtype=float32), array([4., 0., 0.], dtype=float32))
    """

    def __init__(self) -> None:
        super().__init__()
        n = _FEATURES
        self.layers = nn.Sequential(
            nn.Conv2d(_INPUTS, n, 3, 2, 1), nn.SiLU(),
            nn.Conv2d(n, n, 3, 1, 2, 2), nn.SiLU(),
            nn.Conv2d(n, n, 3, 1, 4, 4), nn.SiLU(),
            nn.Conv2d(n, 2, 1),
        )  # fmt: skip

    def forward(self, images: Tensor, prior: Tensor) -> tuple[Tensor, Tensor]:
        """Return the corrections of motions and their information.

        Args:
            images: (B, 5, R, C) residual images.
            prior: (B, 3, 3) information of the odometry.

        Returns:
            (B, 3) corrections that are added to the measured motions, metres and radians; (B, 3, 3) information of the
            corrected motions.
        """
        residual, derivatives, known = images[:, 0], images[:, 1:4], images[:, 4]
        scaled = images[:, :1] / _SCALE
        found = self.layers(torch.cat([scaled, images[:, 1:], scaled * derivatives, scaled.abs()], dim=1))
        weight, width = functional.interpolate(found, images.shape[2:]).unbind(dim=1)
        weight = torch.exp((weight + _FIRST_WEIGHT).clamp(-15, 3)) * known
        squared = (_SCALE * torch.exp(width.clamp(-3, 3))).square()
        weight = weight * (squared / (squared + residual.square())).square()
        weight = weight * min(1.0, PIXELS / residual[0].numel())
        jacobian = derivatives / INVERSE_DEPTH_SIGMA
        weighted = jacobian * weight[:, None]
        information = prior + torch.einsum("biuv,bjuv->bij", weighted, jacobian)
        gradient = torch.einsum("biuv,buv->bi", weighted, residual)
        return -torch.linalg.solve(information, gradient), information
