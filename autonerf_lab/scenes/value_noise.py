"""Value noise of the procedural textures: smooth, seeded and identical on every machine."""

import numpy as np
from numba import njit, uint32


@njit(cache=True, inline="always")
def hash01(x: int, y: int, z: int, seed: int) -> float:
    """Hash an integer point and a seed to a float in [0, 1)."""
    h = uint32(x) * uint32(374761393) + uint32(y) * uint32(668265263) + uint32(z) * uint32(2147483647) + uint32(seed)
    h = uint32(h) * uint32(2654435769)
    h = uint32(h ^ (h >> uint32(15))) * uint32(2246822519)
    h = uint32(h ^ (h >> uint32(13))) * uint32(3266489917)
    h = uint32(h ^ (h >> uint32(16)))
    return h * 2.3283064365386963e-10


@njit(cache=True)
def noise2(x: float, y: float, seed: int) -> float:
    """Return smooth 2-D value noise in [0, 1) with lattice spacing 1."""
    i, j = int(np.floor(x)), int(np.floor(y))
    u, v = x - i, y - j
    u, v = u * u * (3 - 2 * u), v * v * (3 - 2 * v)
    low = hash01(i, j, 0, seed) * (1 - u) + hash01(i + 1, j, 0, seed) * u
    high = hash01(i, j + 1, 0, seed) * (1 - u) + hash01(i + 1, j + 1, 0, seed) * u
    return low * (1 - v) + high * v


@njit(cache=True)
def noise3(x: float, y: float, z: float, seed: int) -> float:
    """Return smooth 3-D value noise in [0, 1) with lattice spacing 1."""
    i, j, k = int(np.floor(x)), int(np.floor(y)), int(np.floor(z))
    u, v, w = x - i, y - j, z - k
    u, v, w = u * u * (3 - 2 * u), v * v * (3 - 2 * v), w * w * (3 - 2 * w)
    a = hash01(i, j, k, seed) * (1 - u) + hash01(i + 1, j, k, seed) * u
    b = hash01(i, j + 1, k, seed) * (1 - u) + hash01(i + 1, j + 1, k, seed) * u
    c = hash01(i, j, k + 1, seed) * (1 - u) + hash01(i + 1, j, k + 1, seed) * u
    d = hash01(i, j + 1, k + 1, seed) * (1 - u) + hash01(i + 1, j + 1, k + 1, seed) * u
    return (a * (1 - v) + b * v) * (1 - w) + (c * (1 - v) + d * v) * w
