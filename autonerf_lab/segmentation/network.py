"""Network of the ``compact`` segmenter: an encoder and a decoder with skip connections, 1.6 million parameters.

The input is the colour image and, where there is one, the depth image: its inverse tells near from far, and depth
times the row of the pixel is the height of the point below a level camera with a horizontal field of view of 90
degrees. It is folded to half resolution before the first convolution (pixel unshuffle), and the logits of four pixels
are unfolded from one cell after the last (Shi et al. 2016). No layer runs at full resolution, where most of the time
of such networks goes, and no pixel is discarded.
"""

import torch
from torch import Tensor, nn
from torch.nn import functional
from torch.nn.utils.fusion import fuse_conv_bn_eval

from autonerf_lab.classes import NUM_CLASSES

STRIDE = 16  # pixels of the image per cell of the coarsest level
WIDTHS = (32, 64, 128, 160)  # channels at 1/2, 1/4, 1/8 and 1/16 of the resolution


def _convolution(inputs: int, outputs: int, kernel: int = 3, stride: int = 1) -> nn.Sequential:
    convolution = nn.Conv2d(inputs, outputs, kernel, stride, kernel // 2, bias=False)
    return nn.Sequential(convolution, nn.BatchNorm2d(outputs))


class _Block(nn.Module):
    """Residual block of two convolutions."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.first, self.second = _convolution(width, width), _convolution(width, width)

    def forward(self, x: Tensor) -> Tensor:
        """Map (B, C, h, w) features to features of the same shape."""
        return functional.relu_(x + self.second(functional.relu_(self.first(x))))


class CompactNetwork(nn.Module):
    """Logits of the classes of every pixel.

    Example:
        >>> network = CompactNetwork().eval()
        >>> network(torch.zeros(1, 3, 48, 40, dtype=torch.uint8), torch.zeros(1, 48, 40)).shape
        torch.Size([1, 16, 48, 40])
        >>> sum(parameter.numel() for parameter in network.parameters()) < 2_000_000
        True
    """

    def __init__(self, classes: int = NUM_CLASSES) -> None:
        super().__init__()
        a, b, c, d = WIDTHS
        self.stem = _convolution(4 * 5, a)
        self.levels = nn.ModuleList(
            [
                nn.Sequential(_convolution(a, a), nn.ReLU(inplace=True)),
                nn.Sequential(_convolution(a, b, stride=2), nn.ReLU(inplace=True), _Block(b)),
                nn.Sequential(_convolution(b, c, stride=2), nn.ReLU(inplace=True), _Block(c), _Block(c)),
                nn.Sequential(_convolution(c, d, stride=2), nn.ReLU(inplace=True), _Block(d)),
            ]
        )
        self.context = nn.Linear(d, d)  # of the mean of the image: the kind of room
        decoded = (48, 64, 96)
        self.skips = nn.ModuleList(_convolution(i, o, 1) for i, o in zip(WIDTHS[:-1], decoded, strict=True))
        self.ups = nn.ModuleList(_convolution(i, o, 1) for i, o in zip((*decoded[1:], d), decoded, strict=True))
        self.decoders = nn.ModuleList(_convolution(o, o) for o in decoded)
        self.head = nn.Conv2d(decoded[0], 4 * classes, 1)

    def forward(self, rgb: Tensor, depth: Tensor) -> Tensor:
        """Compute the logits of a batch of images.

        Args:
            rgb: (B, 3, H, W), 0 to 255, any size and type.
            depth: (B, H, W) float32, metres, 0 where there is no reading.

        Returns:
            (B, classes, H, W) logits, of the type of the weights.
        """
        height, width = rgb.shape[-2:]
        below = (torch.arange(height) + 0.5 - height / 2)[:, None] / (width / 2) * depth  # metres
        near = torch.where(depth > 0, 1 / depth.clamp(min=0.2), 0.0)
        x = torch.cat([rgb.float() / 127.5 - 1, near[:, None], below[:, None]], dim=1)
        x = functional.pad(x, (0, -width % STRIDE, 0, -height % STRIDE), mode="replicate")
        x = functional.pixel_unshuffle(x, 2).to(self.head.weight.dtype, memory_format=torch.channels_last)
        x = functional.relu_(self.stem(x))
        features = []
        for level in self.levels:
            x = level(x)
            features.append(x)
        x = x + self.context(x.mean(dim=(2, 3)))[:, :, None, None]
        for k in reversed(range(len(self.decoders))):
            upper = functional.interpolate(self.ups[k](x), scale_factor=2.0, mode="nearest")
            x = functional.relu_(upper + self.skips[k](features[k]))
            x = x + functional.relu_(self.decoders[k](x))
        logits = functional.pixel_shuffle(self.head(x), 2)
        return logits[..., :height, :width]


def fold_normalization(network: nn.Module) -> nn.Module:
    """Merge each batch normalisation of a network in evaluation mode into the convolution before it, in place.

    Example:
        >>> network, image = CompactNetwork().eval(), torch.full((1, 3, 16, 16), 99)
        >>> with torch.no_grad():
        ...     before = network(image, torch.ones(1, 16, 16))
        ...     after = fold_normalization(network)(image, torch.ones(1, 16, 16))
        >>> bool(torch.allclose(after, before, atol=1e-4))
        True
    """
    for module in list(network.modules()):
        if isinstance(module, nn.Sequential):
            for k in range(len(module) - 1):
                convolution, norm = module[k], module[k + 1]
                if isinstance(convolution, nn.Conv2d) and isinstance(norm, nn.BatchNorm2d):
                    module[k], module[k + 1] = fuse_conv_bn_eval(convolution, norm), nn.Identity()
    return network
