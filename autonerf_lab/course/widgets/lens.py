"""Interactive view of radial lens distortion."""

from dataclasses import replace
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from scipy.ndimage import map_coordinates

from autonerf_lab.course.widgets.live import LiveFigure
from autonerf_lab.geometry import Intrinsics
from autonerf_lab.viz.figures.style import GREEN


def through_lens(image: np.ndarray, camera: Intrinsics, lens: Intrinsics) -> np.ndarray:
    """Resample an image as another camera at the same pose would record it.

    Args:
        image: (H, W, 3) uint8 with a field of view at least that of ``lens``; missing pixels become black.
        camera: camera model of ``image``.
        lens: camera model of the result.

    Returns:
        (lens.height, lens.width, 3) uint8.

    Example:
        >>> image = np.arange(12, dtype=np.uint8).reshape(2, 2, 3)
        >>> camera = Intrinsics.from_fov(2, 2)
        >>> bool((through_lens(image, camera, camera) == image).all())
        True
    """
    u, v = camera.project(lens.directions().reshape(-1, 3)).T
    at = np.stack([v, u]).reshape(2, lens.height, lens.width) - 0.5  # pixel centres lie at halves
    layers = [map_coordinates(image[..., k].astype(float), at, order=1, mode="constant") for k in range(3)]
    return np.stack(layers, axis=-1).round().astype(np.uint8)


class Lens(LiveFigure):
    """Distorted image with two sliders for the radial distortion of the lens.

    Args:
        image: (H, W, 3) uint8 of a pinhole camera with a wider field of view than ``lens``.
        camera: camera model of ``image``.
        lens: camera model with the initial distortion.

    Example:
        >>> lens = Lens(np.zeros((8, 8, 3), np.uint8), Intrinsics.from_fov(8, 8, 120), Intrinsics.from_fov(6, 6))
        >>> lens.sliders["k1"].value = -0.1
        >>> lens.camera.k1, lens.camera.k2
        (-0.1, 0.0)
    """

    def __init__(self, image: np.ndarray, camera: Intrinsics, lens: Intrinsics) -> None:
        super().__init__()
        self._image, self._wide, self._lens = image, camera, lens
        self.sliders = {
            name: self.slider(name, -limit, limit, getattr(lens, name), step=0.01)
            for name, limit in (("k1", 0.15), ("k2", 0.05))
        }
        self.refresh()

    @property
    def camera(self) -> Intrinsics:
        """Camera model with the distortion set by the sliders."""
        return replace(self._lens, **{name: slider.value for name, slider in self.sliders.items()})

    def controls(self) -> list[Any]:
        """Return the sliders."""
        return [self.widgets.HBox(list(self.sliders.values()))]

    def figure(self) -> Figure:
        """Draw the pinhole image, the distorted image, and the image radius over the angle from the optical axis."""
        pinhole = replace(self._lens, k1=0.0, k2=0.0, k3=0.0, p1=0.0, p2=0.0)
        distorted = self.camera
        figure = Figure(figsize=(12, 3.4), layout="constrained")
        axes = figure.subplots(1, 3)
        # tangents at the edges of the image
        right, down = distorted.width / 2 / distorted.fl_x, distorted.height / 2 / distorted.fl_y
        along = np.linspace(-1.3, 1.3, 60)
        cameras, titles = (pinhole, distorted), ("pinhole camera", "lens with distortion")
        for ax, camera, title in zip(axes, cameras, titles, strict=False):
            ax.imshow(through_lens(self._image, self._wide, camera), extent=(0, distorted.width, distorted.height, 0))
            for k in np.linspace(-1, 1, 7):
                for line in ((along * right, k * down), (k * right, along * down)):
                    x, y, z = np.broadcast_arrays(*line, -1.0)
                    ax.plot(*camera.project(np.stack([x, y, z], axis=1)).T, color=GREEN, linewidth=0.7)
            ax.set(xlim=(0, distorted.width), ylim=(distorted.height, 0), xticks=[], yticks=[], title=title)
        r = np.linspace(0, float(np.hypot(right, down)), 60)
        for camera, style, label in zip(cameras, (":", "-"), titles, strict=True):
            radius = camera.project(np.stack([r, 0 * r, 0 * r - 1], axis=1))[:, 0] - camera.cx
            axes[2].plot(np.degrees(np.arctan(r)), radius, style, color="black", label=label)
        axes[2].set(xlabel="angle from the optical axis (°)", ylabel="distance from the image centre (pixels)")
        axes[2].set_title(f"k1 = {distorted.k1:.2f}, k2 = {distorted.k2:.2f}")
        axes[2].legend(frameon=False)
        return figure
