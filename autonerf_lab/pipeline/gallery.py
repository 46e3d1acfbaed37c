"""Figures of a run: image files in ``figures/``, and a list of them with titles, captions and alternative texts."""

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
class StoredFigure:
    """One figure and its texts. The texts are plain; the report escapes them."""

    section: str  # of the report: "trajectory", or the name of a task
    file: str  # relative to ``figures/``
    title: str
    caption: str
    alt: str  # alternative text, for readers who cannot see the figure
    still: str = ""  # for an animation: a still image for print


@dataclass(frozen=True)
class _FigureList:
    """Content of the list file."""

    figures: list[StoredFigure]


class Gallery:
    """Figures of one stage; :meth:`close` writes the list that the report reads.

    Args:
        folder: folder of the figures.
        stage: prefix of the file names.
        only: names of the figures to draw; default: all.

    Example:
        >>> import tempfile
        >>> folder = Path(tempfile.mkdtemp())
        >>> gallery = Gallery(folder, "explore")
        >>> red = np.full((4, 4, 3), (255, 0, 0), np.uint8)
        >>> gallery.add("trajectory", "red", lambda: red, title="Red", caption="A red square.", alt="Red square")
        >>> gallery.close()
        >>> [figure.file for figure in read_gallery(folder, "explore")]
        ['explore_red.png']
    """

    def __init__(self, folder: Path, stage: str, only: Collection[str] | None = None) -> None:
        self.folder, self.stage, self.only = folder, stage, only
        self.figures: list[StoredFigure] = []

    def add(self, section: str, name: str, draw: Callable[[], Any], *, title: str, caption: str, alt: str) -> None:
        """Draw and save a figure, if ``only`` includes it.

        Args:
            section: section of the report.
            name: of the file, without suffix.
            draw: returns a matplotlib figure (closed afterwards), an (H, W, 3) uint8 array, or a list of arrays or
                Pillow images. A list gives an animation, and its last frame a still image; an empty list, no figure.
            title: a few words.
            caption: one or two sentences that explain the figure.
            alt: alternative text.
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
            # the last frame is shown longer
            durations = [150] * (len(frames) - 1) + [2500]
            file, data = f"{stem}.webp", io.BytesIO()
            frames[0].save(
                data, "WEBP", save_all=True, append_images=frames[1:], duration=durations, loop=0, quality=85
            )
            storage.write_bytes(self.folder / file, data.getvalue())
        else:
            file = f"{stem}.png"
            storage.write_bytes(self.folder / file, _png(image))
        self.figures.append(StoredFigure(section, file, title, caption, alt, still))

    def close(self) -> None:
        """Write the list of figures."""
        storage.write_json(
            self.folder / f"{self.stage}.json", {"version": 1, "figures": [asdict(p) for p in self.figures]}
        )


def read_gallery(folder: Path, stage: str) -> list[StoredFigure]:
    """Read the list of figures of a stage; empty if the stage has drawn none.

    Raises:
        DataError: the list is damaged, or names a file outside the folder.
    """
    path = folder / f"{stage}.json"
    if not path.exists():
        return []
    try:
        figures = storage.read_json(path, _FigureList).figures
    except DataError as error:
        raise DataError(f"{error}; run the stage again") from error
    for figure in figures:
        for name in filter(None, (figure.file, figure.still)):
            if Path(name).name != name or Path(name).suffix not in (".png", ".webp"):
                raise DataError(f"{path} names {name[:80]!r}, which is not an image file of this folder")
    return figures


def _png(image: Any) -> bytes:
    data = io.BytesIO()
    if isinstance(image, np.ndarray):
        image = Image.fromarray(image)
    if isinstance(image, Image.Image):
        image.convert("RGB").save(data, "PNG", optimize=True)
        return data.getvalue()
    image.savefig(data, format="png", dpi=_DPI, bbox_inches="tight", facecolor="white")
    if "matplotlib.pyplot" in sys.modules:  # pyplot keeps a reference to its figures
        sys.modules["matplotlib.pyplot"].close(image)
    return data.getvalue()
