"""Cache of the baked textures of frozen scenes: reading a texture takes a tenth of the time of baking it."""

import hashlib
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from io import BytesIO
from pathlib import Path

import numpy as np
from PIL import Image, PngImagePlugin
from platformdirs import user_cache_path

from autonerf_lab.errors import DataError
from autonerf_lab.utils.storage import read_bytes, write_bytes

# A texture depends on the specification and on the code of these modules.
_MODULES = ("procedural_textures", "tessellation", "texture_baking", "value_noise")
_FAST = 1  # level of compression


def texture_folder() -> Path:
    """Return the folder of the textures, in the user's cache folder; there is one file of about 5 MB per scene."""
    return user_cache_path("autonerf-lab", appauthor=False) / "textures"


def cached_texture(name: str, spec_digest: str, bake: Callable[[], np.ndarray]) -> np.ndarray:
    """Read the texture of a frozen scene from the cache, or bake it and write it there.

    A file that is missing, damaged or made from another specification or by other code is replaced. Without a folder
    that can be written, every process bakes.

    Args:
        name: Name of the scene.
        spec_digest: SHA-256 of its specification, hexadecimal.
        bake: Computes the texture, (Ht, Wt, 3) uint8.

    Returns:
        Texture, (Ht, Wt, 3) uint8 sRGB.
    """
    path, source = texture_folder() / f"{name}.png", spec_digest + _code_digest()
    with suppress(DataError, OSError, SyntaxError, ValueError, Image.DecompressionBombError):  # errors of Pillow
        image = Image.open(BytesIO(read_bytes(path)))
        if image.mode == "RGB" and image.info.get("source") == source:
            return np.array(image)
    texture = bake()
    info = PngImagePlugin.PngInfo()
    info.add_text("source", source)
    content = BytesIO()
    Image.fromarray(texture).save(content, "PNG", compress_level=_FAST, pnginfo=info)
    with suppress(DataError):
        write_bytes(path, content.getvalue(), durable=False)
    return texture


@cache
def _code_digest() -> str:
    folder = Path(__file__).parent
    return hashlib.sha256(b"".join((folder / f"{name}.py").read_bytes() for name in _MODULES)).hexdigest()
