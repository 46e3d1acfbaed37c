"""The scene from above: rays straight down through an apartment without its ceiling."""

from typing import TYPE_CHECKING

import numpy as np
from embreex import rtcore_scene
from embreex.mesh_construction import TriangleMesh

from autonerf_lab.scenes.scene import Scene

if TYPE_CHECKING:
    from matplotlib.axes import Axes

VOID = 58  # grey of what is cut: the inside of walls
MAX_SIDE = 8192  # pixels


def top_view(scene: Scene, pixels_per_metre: float = 40.0, cut: float = 2.0) -> tuple[np.ndarray, np.ndarray]:
    """Orthographic picture from above, everything over ``cut`` metres removed.

    Returns:
        (H, W, 3) uint8 with north (+y) up, and the world x, y of the picture's lower left corner, metres.

    Raises:
        ValueError: the picture would be larger than MAX_SIDE pixels a side.
    """
    low, high = scene.bounds
    origin = low[:2] - 0.1
    width, height = np.ceil((high[:2] + 0.1 - origin) * pixels_per_metre).astype(int).tolist()
    if max(width, height) > MAX_SIDE:
        raise ValueError(f"a picture of {width} x {height} pixels is too large; use fewer pixels per metre")
    x = origin[0] + (np.arange(width) + 0.5) / pixels_per_metre
    y = origin[1] + (np.arange(height)[::-1] + 0.5) / pixels_per_metre
    xx, yy = np.meshgrid(x, y)
    start = np.stack([xx, yy, np.full_like(xx, cut)], axis=-1).reshape(-1, 3).astype(np.float32)
    down = np.broadcast_to(np.array([0, 0, -1], dtype=np.float32), start.shape).copy()
    embree = rtcore_scene.EmbreeScene()
    mesh = TriangleMesh(embree, scene.vertices, scene.faces)
    hit = embree.run(start, down, output=True)
    del mesh
    face = hit["primID"]
    found = face >= 0
    u, v = hit["u"][found, None], hit["v"][found, None]
    corner = scene.uv[face[found]]
    uv = corner[:, 0] * (1 - u - v) + corner[:, 1] * u + corner[:, 2] * v
    rows, cols = scene.texture.shape[:2]
    row = np.clip((uv[:, 1] * rows).astype(int), 0, rows - 1)
    col = np.clip((uv[:, 0] * cols).astype(int), 0, cols - 1)
    image = np.full((height * width, 3), 255, dtype=np.uint8)
    image[found] = scene.texture[row, col]
    image = image.reshape(height, width, 3)
    from scipy.ndimage import binary_closing

    seen = found.reshape(height, width)
    padded = np.pad(seen, (reach := max(1, int(0.16 * pixels_per_metre))))
    square = np.ones((reach + 1, reach + 1), dtype=bool)
    closed = binary_closing(padded, square)[reach:-reach, reach:-reach]
    image[closed & ~seen] = VOID
    return image, origin


def plot(scene: Scene, ax: "Axes | None" = None) -> "Axes":
    """Draw the scene from above on a matplotlib axis in metres."""
    import matplotlib.pyplot as plt

    if ax is None:
        _, ax = plt.subplots(figsize=(7, 7))
    image, origin = scene.top_view(60.0)
    extent = (origin[0], origin[0] + image.shape[1] / 60, origin[1], origin[1] + image.shape[0] / 60)
    ax.imshow(image, extent=extent)
    ax.set(xlabel="x (m)", ylabel="y (m)", title=scene.name, aspect="equal")
    return ax
