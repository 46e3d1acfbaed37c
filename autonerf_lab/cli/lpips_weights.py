"""``autonerf-lab lpips-weights``."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional

from autonerf_lab.cli.options import option


@dataclass(frozen=True)
class LpipsWeightsCommand:
    """Write a file with the weights of LPIPS; torchvision downloads 528 MB of it (extra lpips)."""

    file: Annotated[Positional[Path], option(help="Output .safetensors file, for --lpips-weights.")]

    def run(self) -> None:
        """Write the file."""
        from autonerf_lab.evaluators.lpips import write_weights

        print(f"{self.file}: SHA-256 {write_weights(self.file).sha256}")
