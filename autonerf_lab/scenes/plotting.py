"""Top view of a scene: orthographic image from above without the ceiling, and its matplotlib plot."""

from typing import TYPE_CHECKING

import numpy as np
from embreex import rtcore_scene
from embreex.mesh_construction import TriangleMesh

from autonerf_lab.scenes.scene import Scene

if TYPE_CHECKING:
    from matplotlib.axes import Axes

WALL_GREY = 58  # grey level of the cut surfaces inside walls
MAX_SIDE = 8192  # pixels


def top_view(scene: Scene, pixels_per_metre: float = 40.0, cut: float = 2.0) -> tuple[np.ndarray, np.ndarray]:
    """Render an orthographic image of a scene from above.

    Args:
        scene: Scene to draw.
        pixels_per_metre: Resolution of the image.
        cut: Height, metres; surfaces above it are left out.

    Returns:
        (H, W, 3) uint8 image, white where there is no surface, row 0 at the largest y (+y points up), and the (2,)
        world x, y of its lower left corner, metres.

    Raises:
        ValueError: The image would have more than MAX_SIDE pixels on a side.

    Example:
        >>> from autonerf_lab.scenes import generate_apartment
        >>> image, corner = top_view(generate_apartment(7), 10)
        >>> image.shape[2], corner.shape
        (3, (2,))
    """
    low, high = scene.bounds
    origin = low[:2] - 0.1
    width, height = np.ceil((high[:2] + 0.1 - origin) * pixels_per_metre).astype(int).tolist()
    if max(width, height) > MAX_SIDE:
        raise ValueError(
            f"the top view of scene {scene.name!r} would have {width} x {height} pixels (at most {MAX_SIDE} a side);"
            " pass a smaller pixels_per_metre"
        )
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

    # Rays that start inside a wall hit nothing: fill such gaps, up to the thickness of a wall.
    seen = found.reshape(height, width)
    padded = np.pad(seen, (reach := max(1, int(0.16 * pixels_per_metre))))
    square = np.ones((reach + 1, reach + 1), dtype=bool)
    closed = binary_closing(padded, square)[reach:-reach, reach:-reach]
    image[closed & ~seen] = WALL_GREY
    return image, origin


def plot_scale(scene: Scene) -> float:
    """Return the pixels per metre of plots: 60, or fewer for a scene that would exceed MAX_SIDE."""
    extent = float((scene.bounds[1] - scene.bounds[0])[:2].max()) + 0.2
    return min(60.0, (MAX_SIDE - 1) / extent)


def plot_scene(scene: Scene, ax: "Axes | None" = None) -> "Axes":
    """Plot the top view of a scene on axes in metres; create the axes if none are given."""
    import matplotlib.pyplot as plt

    if ax is None:
        _, ax = plt.subplots(figsize=(7, 7))
    scale = plot_scale(scene)
    image, origin = top_view(scene, scale)
    extent = (origin[0], origin[0] + image.shape[1] / scale, origin[1], origin[1] + image.shape[0] / scale)
    ax.imshow(image, extent=extent)
    ax.set(xlabel="x (m)", ylabel="y (m)", title=scene.name, aspect="equal")
    return ax
