"""Texture atlas of an imported mesh: its images below each other, then tiles for faces that have colours only."""

from pathlib import Path
from typing import Any

import numpy as np

from autonerf_lab.errors import SceneError

COLOR_WIDTH = 4096  # texels, smallest width of an atlas with color tiles
MAX_TEXELS = 2**28  # texels of an atlas: 800 MB
MAX_TILES = 64  # repetitions of an image across one face
REPEATED_SIDE = 2048  # texels, longest side of a repeated image


def build_atlas(path: Path, parts: list[dict[str, Any]]) -> tuple[np.ndarray, np.ndarray]:
    """Combine the images and colours of all meshes into one texture.

    Args:
        path: Mesh file, for error messages.
        parts: One entry per mesh with either ``image`` (H, W, 3) uint8 and ``uv`` (F, 3, 2), v down and unbounded, or
            ``color`` (F, 3, 3), a colour per corner. Entries with an image are changed in place.

    Returns:
        uv (F, 3, 2) float32 in [0, 1] of all faces, v down, and the atlas (Ht, Wt, 3) uint8.

    Raises:
        SceneError: The atlas would exceed MAX_TEXELS.
    """
    repeats_of: dict[int, np.ndarray] = {}
    for part in parts:
        if "image" in part:
            part["uv"], part["tiles"] = _wrap(part["uv"])
            key = id(part["image"])
            repeats_of[key] = np.maximum(repeats_of.get(key, 1), part["tiles"].max(axis=0))
    blocks: dict[tuple[int, bool], np.ndarray] = {}  # by image: once, and repeated
    for part in parts:
        if "image" in part:
            key, many = id(part["image"]), part["tiles"].max(axis=1) > 1
            if not many.all():
                blocks[key, False] = part["image"]
            if many.any() and (key, True) not in blocks:
                blocks[key, True] = _repeated(part["image"], *repeats_of[key].tolist())
    width = max([3, *(block.shape[1] for block in blocks.values())])
    if any("color" in part for part in parts):
        width = max(width, COLOR_WIDTH)
    row_of = dict(zip(blocks, np.cumsum([0, *(len(b) for b in blocks.values())]).tolist(), strict=False))
    rows = sum(len(block) for block in blocks.values())
    strips: list[np.ndarray] = []
    texels = []
    for part in parts:
        if "image" in part:
            key, many = id(part["image"]), part["tiles"].max(axis=1) > 1
            texel = np.empty_like(part["uv"])
            for chosen, repeats in ((~many, np.ones(2)), (many, repeats_of[key])):
                if chosen.any():
                    block = blocks[key, bool(many[chosen][0])]
                    size = np.array([block.shape[1], len(block)]) / repeats
                    texel[chosen] = part["uv"][chosen] * size + [0, row_of[key, bool(many[chosen][0])]]
        else:
            strip, texel = _color_tiles(part["color"].astype(np.float64), width)
            texel[..., 1] += rows
            strips.append(strip)
            rows += len(strip)
        texels.append(texel)
    if rows * width > MAX_TEXELS:
        raise SceneError(
            f"{path}: its textures have {rows * width / 1e6:.0f} megapixels; the limit is {MAX_TEXELS / 1e6:.0f}"
        )
    atlas = np.zeros((rows, width, 3), dtype=np.uint8)
    row = 0
    for block in [*blocks.values(), *strips]:
        atlas[row : row + len(block), : block.shape[1]] = block
        row += len(block)
    return (np.concatenate(texels) / np.array([width, rows], dtype=np.float64)).astype(np.float32), atlas


def _color_tiles(color: np.ndarray, width: int) -> tuple[np.ndarray, np.ndarray]:
    """Return 3 x 3 texel tiles for faces with a colour per corner.

    Args:
        color: (F, 3, 3) float64, colour of each corner, 0 to 255.
        width: Width of the atlas, texels.

    Returns:
        Tiles (rows, width, 3) uint8, and the texel positions of the corners (F, 3, 2).
    """
    per_row = width // 3
    k = np.arange(len(color))
    strip = np.zeros((-(-len(color) // per_row) * 3, width, 3), dtype=np.uint8)
    # corners at the centres of texels (0, 0), (2, 0), (0, 2): texel (i, j) is their affine combination
    for i in range(3):
        for j in range(3):
            mixed = color[:, 0] * (1 - i / 2 - j / 2) + color[:, 1] * i / 2 + color[:, 2] * j / 2
            strip[k // per_row * 3 + j, k % per_row * 3 + i] = np.clip(mixed + 0.5, 0, 255)
    base = np.stack([k % per_row * 3, k // per_row * 3], axis=1)[:, None, :]
    return strip, base + np.array([[0.5, 0.5], [2.5, 0.5], [0.5, 2.5]])


def _wrap(uv: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Shift texture coordinates so that each face starts in tile [0, 1].

    A face that spans more than MAX_TILES tiles is scaled down to MAX_TILES.

    Args:
        uv: (F, 3, 2) texture coordinates, unbounded.

    Returns:
        Shifted coordinates (F, 3, 2), and the number of tiles that each face spans, (F, 2) int.
    """
    inner = uv - np.floor(uv.min(axis=1, keepdims=True) + 1e-6)
    reach = inner.max(axis=1)
    inner = inner * (MAX_TILES / np.maximum(reach, MAX_TILES))[:, None]
    tiles = np.clip(np.ceil(reach - 1e-6), 1, MAX_TILES).astype(int)
    return np.clip(inner, 0, tiles[:, None]), tiles


def _repeated(image: np.ndarray, across: int, down: int) -> np.ndarray:
    """Return an image repeated ``across`` x ``down`` times, shrunk so that no side exceeds REPEATED_SIDE."""
    from PIL import Image

    height, width = image.shape[:2]
    shrink = min(1.0, REPEATED_SIDE / (width * across), REPEATED_SIDE / (height * down))
    if shrink < 1:
        size = max(1, round(width * shrink)), max(1, round(height * shrink))
        image = np.asarray(Image.fromarray(image).resize(size, Image.Resampling.BOX))
    return np.tile(image, (down, across, 1))
