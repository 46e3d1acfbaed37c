"""Tessellation of the solids of a specification into surface patches, and of patches into triangles.

A patch is a grid of (n + 1) x (m + 1) points: a flat face has one cell, the side of a vase many. Patch coordinates
(a, b) run over [0, 1] squared; the normal is dP/da x dP/db and points to the free side. Each patch has a rectangle
of the texture atlas, with a margin of one texel on every side, so that bilinear look-ups never read a neighbour.

Solids (metres and radians; ``at`` is the centre of the underside unless stated otherwise; ``tilt`` rotates about the
local x axis first, then ``yaw`` about z):

* ``box`` [sx, sy, sz]; ``omit`` lists omitted faces: ``x`` and ``X`` are the sides at -x and +x, and so on.
* ``lathe`` [[radius, z], ...]: surface of revolution of a profile about z; ``n`` segments; ``scale`` [x, y]; ``power``
  of the superellipse (2 round, 5 a rounded square); ``arc`` [start, end] of the revolution.
* ``quad`` [[ux, uy, uz], [vx, vy, vz]]: parallelogram; ``at`` is its corner.
* ``ribbon`` [[x, y], ...] and ``height``: vertical surface over a polyline, such as a curtain.
* ``leaf`` [length, width, droop]: leaf that extends along +y from ``at``.
"""

from dataclasses import dataclass

import numpy as np

MARGIN = 1  # texels around the atlas rectangle of each patch
TEXEL_STRUCTURE = 0.016  # metres per texel on walls, floor and ceiling
TEXEL_FURNITURE = 0.013  # metres per texel on furniture
TEXEL_SMALL = 0.006  # metres per texel on solids below SMALL: books, cups, bottles
SMALL = 0.3  # metres
ATLAS_WIDTH = 2048  # texels

# corner, first edge and second edge of each face of the unit box standing on the origin
_BOX_FACES = {
    "x": ((-0.5, 0.5, 0), (0, -1, 0), (0, 0, 1)),
    "X": ((0.5, -0.5, 0), (0, 1, 0), (0, 0, 1)),
    "y": ((-0.5, -0.5, 0), (1, 0, 0), (0, 0, 1)),
    "Y": ((0.5, 0.5, 0), (-1, 0, 0), (0, 0, 1)),
    "z": ((-0.5, 0.5, 0), (1, 0, 0), (0, -1, 0)),
    "Z": ((-0.5, -0.5, 1), (1, 0, 0), (0, 1, 0)),
}
_BOX = np.array(list(_BOX_FACES.values()), dtype=np.float64)  # (6, 3, 3)


@dataclass(frozen=True)
class SurfaceTessellation:
    """Surface patches of a scene as flat arrays: P patches, N points."""

    points: np.ndarray  # (N, 3) float64, world frame, metres
    start: np.ndarray  # (P,) int64, first point of each patch; point (i, j) is start + i * (m + 1) + j
    cells: np.ndarray  # (P, 2) int64, n and m
    length: np.ndarray  # (P, 2) float64, metres along a and along b
    shift: np.ndarray  # (P, 2) float64, metres: texture offset; makes patterns continue across the pieces of a wall
    material: np.ndarray  # (P,) int64, index into the specification's materials
    object: np.ndarray  # (P,) int64, index into the specification's objects
    rect: np.ndarray  # (P, 4) int64: left, top, width, height in the atlas without margin, texels
    atlas: tuple[int, int]  # rows, columns of the atlas, texels


def rotation(yaw: float, tilt: float = 0.0) -> np.ndarray:
    """Return the (3, 3) matrix that rotates by ``tilt`` about x, then by ``yaw`` about z (radians).

    Example:
        >>> (rotation(np.pi / 2) @ [1, 0, 0]).round(6) + 0
        array([0., 1., 0.])
    """
    c, s, ct, st = np.cos(yaw), np.sin(yaw), np.cos(tilt), np.sin(tilt)
    return np.array([[c, -s * ct, s * st], [s, c * ct, -c * st], [0, st, ct]])


def _lathe(part: dict) -> np.ndarray:
    """Return the (n + 1, m + 1, 3) points of a surface of revolution."""
    profile = np.asarray(part["lathe"], dtype=np.float64)
    low, high = part.get("arc", (0.0, 2 * np.pi))
    angle = np.linspace(low, high, part.get("n", 12) + 1)
    exponent = 2 / part.get("power", 2)
    ring = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    ring[np.abs(ring) < 1e-9] = 0.0
    ring = np.sign(ring) * np.abs(ring) ** exponent * np.asarray(part.get("scale", (1.0, 1.0)))
    return np.concatenate(
        [ring[:, None, :] * profile[None, :, :1], np.broadcast_to(profile[:, 1:], (len(ring), len(profile), 1))], axis=2
    )


def _quad(part: dict) -> np.ndarray:
    u, v = np.asarray(part["quad"], dtype=np.float64)
    return np.array([[0 * u, v], [u, u + v]])


def _ribbon(part: dict) -> np.ndarray:
    line = np.asarray(part["ribbon"], dtype=np.float64)
    foot = np.concatenate([line, np.zeros((len(line), 1))], axis=1)
    return np.stack([foot, foot + np.array([0, 0, part["height"]])], axis=1)


def _leaf(part: dict) -> np.ndarray:
    length, width, droop = part["leaf"]
    middle = [length * 0.45, droop * 0.25]
    tip = [0.0, length, -droop]
    side = [
        [x, middle[0], -middle[1] + lift] for x, lift in ((-width / 2, 0.15 * width), (0, 0), (width / 2, 0.15 * width))
    ]
    return np.array([[[0.0, 0, 0], s, tip] for s in side])


SHAPES = {"lathe": _lathe, "quad": _quad, "ribbon": _ribbon, "leaf": _leaf}


def _placed_parts(
    spec: dict, names: dict[str, int]
) -> tuple[list[dict], np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return all parts with their rotations, translations, material indices and object indices."""
    parts, rotations, translations, materials, owners = [], [], [], [], []
    for index, entry in enumerate(spec["objects"]):
        outer = rotation(entry.get("yaw", 0.0))
        base = np.asarray(entry.get("at", (0, 0, 0)), dtype=np.float64)
        for part in entry["parts"]:
            yaw, tilt = part.get("yaw", 0.0), part.get("tilt", 0.0)
            parts.append(part)
            rotations.append(outer @ rotation(yaw, tilt) if yaw or tilt else outer)
            translations.append(base + outer @ part.get("at", (0, 0, 0)))
            materials.append(names[part["m"]])
            owners.append(index)
    return parts, np.array(rotations), np.array(translations), np.array(materials), np.array(owners)


def tessellate(spec: dict) -> SurfaceTessellation:
    """Tessellate the solids of a valid specification into surface patches and pack them into a texture atlas.

    Example:
        >>> table = {"id": 1, "parts": [{"box": [2, 1, 0.7], "m": "oak", "omit": "z"}]}
        >>> surface = tessellate({"objects": [table], "materials": {"oak": {}}})
        >>> len(surface.start), surface.length[-1].tolist()
        (5, [2.0, 1.0])
    """
    names = {name: k for k, name in enumerate(spec["materials"])}
    parts, rotations, translations, materials, owners = _placed_parts(spec, names)
    is_box = np.array(["box" in part for part in parts])
    boxes = np.flatnonzero(is_box)
    size = np.array([parts[k]["box"] for k in boxes], dtype=np.float64).reshape(-1, 3)
    keep = np.array([[c not in parts[k].get("omit", "") for c in _BOX_FACES] for k in boxes], dtype=bool).reshape(-1, 6)
    local = _BOX[None] * size[:, None, None, :]  # (B, 6, corner/u/v, 3)
    corner, u, v = local[:, :, 0], local[:, :, 1], local[:, :, 2]
    grid = np.stack([corner, corner + v, corner + u, corner + u + v], axis=2)  # points (0,0) (0,1) (1,0) (1,1)
    grid = np.einsum("bij,bfkj->bfki", rotations[boxes], grid) + translations[boxes][:, None, None]
    points = [grid[keep].reshape(-1, 3)]
    owner = [np.repeat(boxes, keep.sum(axis=1))]
    count = int(keep.sum())
    cells = [np.ones((count, 2), dtype=np.int64)]
    stretch = [np.ones((count, 2))]
    length = [np.stack([np.linalg.norm(u, axis=2)[keep], np.linalg.norm(v, axis=2)[keep]], axis=1)]
    # objects get different texture offsets; the building (object 0) keeps world coordinates
    offset = np.stack([translations[boxes] @ [0.7, 0.4, 0.3], translations[boxes] @ [0.3, 0.8, 0.6]], axis=1)[
        :, None
    ] * np.ones((1, 6, 1))
    shift = [offset[keep]]
    for k in np.flatnonzero(~is_box):
        part = parts[k]
        shape = next(SHAPES[key](part) for key in SHAPES if key in part)
        n, m = shape.shape[0] - 1, shape.shape[1] - 1
        cell_a = np.linalg.norm(np.diff(shape, axis=0), axis=2)
        cell_b = np.linalg.norm(np.diff(shape, axis=1), axis=2)
        along, across = cell_a.sum(axis=0).max(), cell_b.sum(axis=1).max()
        # all cells of a patch get the same number of texels: that of the longest one
        stretch.append(np.minimum([[n * cell_a.max() / along, m * cell_b.max() / across]], 1.6))
        world = shape.reshape(-1, 3) @ rotations[k].T + translations[k]
        points.append(world)
        owner.append(np.array([k]))
        cells.append(np.array([[n, m]]))
        length.append(np.array([[along, across]]))
        first, a_end, b_end = world[0], world[-(m + 1)], world[m]
        a_axis = (a_end - first) / max(float(np.linalg.norm(a_end - first)), 1e-9)
        b_axis = (b_end - first) / max(float(np.linalg.norm(b_end - first)), 1e-9)
        shift.append(np.array([[first @ a_axis, first @ b_axis]]))
    cell = np.concatenate(cells)
    per_patch = np.prod(cell + 1, axis=1)
    part_of = np.concatenate(owner)
    metres = np.concatenate(length)
    small = np.array([_extent(part) < SMALL for part in parts])
    structure = np.array([spec["objects"][o]["id"] == 0 for o in owners])
    texel = np.where(structure, TEXEL_STRUCTURE, np.where(small, TEXEL_SMALL, TEXEL_FURNITURE))[part_of]
    rect, atlas = pack(np.maximum(np.ceil(metres * np.concatenate(stretch) / texel[:, None]), 2).astype(np.int64))
    return SurfaceTessellation(
        np.concatenate(points),
        np.concatenate([[0], np.cumsum(per_patch)[:-1]]),
        cell,
        metres,
        np.concatenate(shift),
        materials[part_of],
        owners[part_of],
        rect,
        atlas,
    )


def _extent(part: dict) -> float:
    """Return the largest dimension of a part, metres."""
    if "box" in part:
        return max(part["box"])
    if "lathe" in part:
        return max(2 * max(r for r, _ in part["lathe"]), abs(part["lathe"][-1][1] - part["lathe"][0][1]))
    return max(part["leaf"][:2]) if "leaf" in part else 1.0


def pack(sizes: np.ndarray) -> tuple[np.ndarray, tuple[int, int]]:
    """Pack rectangles into an atlas of fixed width (shelf packing, tallest first).

    Args:
        sizes: (P, 2) int, width and height of each rectangle without margin, texels.

    Returns:
        (P, 4) int64 left, top, width, height, and the (rows, columns) of the atlas, texels.

    Example:
        >>> pack(np.array([[4, 2], [3, 5]]))[0].tolist()
        [[6, 1, 4, 2], [1, 1, 3, 5]]
    """
    sizes = np.minimum(sizes, ATLAS_WIDTH - 2 * MARGIN)
    rect = np.empty((len(sizes), 4), dtype=np.int64)
    x = y = shelf = 0
    for k in np.lexsort((sizes[:, 0], -sizes[:, 1])).tolist():
        w, h = int(sizes[k, 0]), int(sizes[k, 1])
        if x + w + 2 * MARGIN > ATLAS_WIDTH:
            x, y, shelf = 0, y + shelf, 0
        rect[k] = x + MARGIN, y + MARGIN, w, h
        x += w + 2 * MARGIN
        shelf = max(shelf, h + 2 * MARGIN)
    return rect, (y + shelf, ATLAS_WIDTH)


def triangulate(surface: SurfaceTessellation) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Split every cell into two triangles and drop triangles without area (at poles and tips).

    Returns:
        vertices (V, 3) float32, faces (F, 3) int32, uv (F, 3, 2) float32 (v down), patch (F,) int64.
    """
    n, m = surface.cells[:, 0], surface.cells[:, 1]
    total = n * m
    patch = np.repeat(np.arange(len(n)), total)
    inner = np.arange(len(patch)) - np.repeat(np.concatenate([[0], np.cumsum(total)[:-1]]), total)
    i, j = inner // m[patch], inner % m[patch]
    stride = m[patch] + 1
    first = surface.start[patch] + i * stride + j
    p00, p01, p10, p11 = first, first + 1, first + stride, first + stride + 1
    faces = np.stack([np.stack([p00, p10, p11], 1), np.stack([p00, p11, p01], 1)], axis=1).reshape(-1, 3)
    di, dj = np.array([[0, 1, 1], [0, 1, 0]]), np.array([[0, 0, 1], [0, 1, 1]])
    a = ((i[:, None, None] + di) / n[patch][:, None, None]).reshape(-1, 3)
    b = ((j[:, None, None] + dj) / m[patch][:, None, None]).reshape(-1, 3)
    patch = np.repeat(patch, 2)
    left, top, width, height = (column[:, None] for column in surface.rect[patch].T)
    uv = np.stack([(left + a * width) / surface.atlas[1], (top + (1 - b) * height) / surface.atlas[0]], axis=2)
    vertices = surface.points.astype(np.float32)
    corner = vertices[faces].astype(np.float64)
    area = np.linalg.norm(np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]), axis=1) / 2
    real = area > 1e-8
    return vertices, faces[real].astype(np.int32), uv[real].astype(np.float32), patch[real]
