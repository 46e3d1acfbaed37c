"""Options that several commands have."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tyro.conf import arg

from autonerf_lab.errors import DataError

if TYPE_CHECKING:
    from autonerf_lab.evaluators.lpips import Lpips


@dataclass(frozen=True)
class LpipsFile:
    """The weights of LPIPS, which is left out without."""

    lpips_weights: Annotated[Path | None, arg(metavar="FILE", help="VGG16 and heads, safetensors: see the README.")] = (
        None
    )
    lpips_sha256: Annotated[str | None, arg(metavar="HEX", help="What the file must have; else it is refused.")] = None

    def load(self) -> "Lpips | None":
        """Read and check the file, before anything else is done."""
        if self.lpips_weights is None:
            if self.lpips_sha256 is not None:
                raise DataError("--lpips-sha256 is about a file: give --lpips-weights too")
            return None
        from autonerf_lab.evaluators.lpips import Lpips

        return Lpips(self.lpips_weights, self.lpips_sha256)


NO_LPIPS = LpipsFile()


def names_of(text: str | None) -> tuple[str, ...] | None:
    """The names of a comma list.

    Example:
        >>> names_of("a, b"), names_of(None)
        (('a', 'b'), None)
    """
    return None if text is None else tuple(name.strip() for name in text.split(",") if name.strip())
