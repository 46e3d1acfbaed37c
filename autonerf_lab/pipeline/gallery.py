"""The pictures of a run: files in ``figures/`` and, beside them, what a reader needs to be told about each."""

import io
import sys
from collections.abc import Callable, Collection
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from autonerf_lab.errors import DataError
from autonerf_lab.utils import storage

_DPI = 110


@dataclass(frozen=True)
class Picture:
    """One picture and its words. All text is plain: whoever shows it escapes it."""

    section: str  # of the report: walk, rendering, geometry, maps, planning, pose_refinement, mesh
    file: str  # relative to ``figures/``
    title: str
    caption: str
    alt: str  # what a reader who cannot see it should know
    still: str = ""  # for an animation: a picture that says the same on paper


class Gallery:
    """Collects the pictures of one stage; :meth:`close` makes them known to the report.

    Args:
        folder: of the pictures.
        stage: begins the name of each file.
        only: names of those to draw; all without.

    Example:
        >>> import tempfile
        >>> folder = Path(tempfile.mkdtemp())
        >>> gallery = Gallery(folder, "explore")
        >>> red = np.full((4, 4, 3), (255, 0, 0), np.uint8)
        >>> gallery.add("walk", "red", lambda: red, title="Red", caption="All of it.", alt="A red square")
        >>> gallery.close()
        >>> [picture.file for picture in read_gallery(folder, "explore")]
        ['explore_red.png']
    """

    def __init__(self, folder: Path, stage: str, only: Collection[str] | None = None) -> None:
        self.folder, self.stage, self.only = folder, stage, only
        self.pictures: list[Picture] = []

    def add(self, section: str, name: str, draw: Callable[[], Any], *, title: str, caption: str, alt: str) -> None:
        """Draw and keep a picture, if it is wanted.

        Args:
            section: the part of the report it belongs to.
            name: of the file, without the ending.
            draw: returns a matplotlib figure (closed afterwards), an (H, W, 3) uint8 array, or a list of such arrays or
                of Pillow images: the frames of an animation, whose last one is also kept as a still; no frames, no
                picture.
            title: a few words.
            caption: one or two sentences: what to look at.
            alt: for readers who cannot see it.
        """
        if self.only is not None and name not in self.only:
            return
        stem, still, image = f"{self.stage}_{name}", "", draw()
        if isinstance(image, list):
            if not image:
                return
            frames = [f if isinstance(f, Image.Image) else Image.fromarray(f) for f in image]
            still = f"{stem}_still.png"
            storage.write_bytes(self.folder / still, _png(frames[-1]))
            # the last frame stays for a moment, so that a reader sees where it ended
            durations = [150] * (len(frames) - 1) + [2500]
            file, data = f"{stem}.webp", io.BytesIO()
            frames[0].save(
                data, "WEBP", save_all=True, append_images=frames[1:], duration=durations, loop=0, quality=85
            )
            storage.write_bytes(self.folder / file, data.getvalue())
        else:
            file = f"{stem}.png"
            storage.write_bytes(self.folder / file, _png(image))
        self.pictures.append(Picture(section, file, title, caption, alt, still))

    def close(self) -> None:
        """Write the list of pictures."""
        storage.write_json(
            self.folder / f"{self.stage}.json", {"version": 1, "pictures": [asdict(p) for p in self.pictures]}
        )


def read_gallery(folder: Path, stage: str) -> list[Picture]:
    """The pictures of a stage; none when it drew none.

    Raises:
        DataError: the list is damaged, or names a file outside the folder.
    """
    path = folder / f"{stage}.json"
    if not path.exists():
        return []
    try:
        pictures = [Picture(**row) for row in storage.read_json(path)["pictures"]]
    except (KeyError, TypeError) as error:
        raise DataError(f"{path} is not a list of pictures: {error!r}; run the stage again") from error
    for picture in pictures:
        if not all(isinstance(v, str) for v in asdict(picture).values()):
            raise DataError(f"{path} is not a list of pictures; run the stage again")
        for name in filter(None, (picture.file, picture.still)):
            if Path(name).name != name or Path(name).suffix not in (".png", ".webp"):
                raise DataError(f"{path} names {name[:80]!r}, which is no picture of this folder")
    return pictures


def _png(image: Any) -> bytes:
    data = io.BytesIO()
    if isinstance(image, np.ndarray):
        image = Image.fromarray(image)
    if isinstance(image, Image.Image):
        image.convert("RGB").save(data, "PNG", optimize=True)
        return data.getvalue()
    image.savefig(data, format="png", dpi=_DPI, bbox_inches="tight", facecolor="white")
    if "matplotlib.pyplot" in sys.modules:  # a figure made through pyplot is kept alive by it
        sys.modules["matplotlib.pyplot"].close(image)
    return data.getvalue()
