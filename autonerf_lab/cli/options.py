"""Options shared by several commands."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from tyro.conf import Positional, arg

from autonerf_lab.errors import DataError

if TYPE_CHECKING:
    from autonerf_lab.evaluators.lpips import Lpips


def option(help: str, default: str | None = None, metavar: str | None = None) -> Any:
    """Describe an option of a command.

    Args:
        help: Help text.
        default: Text of the default; None: the default value, and nothing for False, None and an empty tuple.
        metavar: Placeholder of the value; None: the name of its type.
    """

    def hint(value: str) -> str:
        text = default or ("" if value in ("False", "None", "") else value)
        return text and f"(default: {text})"

    return arg(help=help, metavar=metavar, help_behavior_hint=hint)


SceneName = Annotated[
    str, option(help="Scene: a name of `autonerf-lab scenes list`, or the path of a JSON, GLB, OBJ or PLY file.")
]
PolicyName = Annotated[
    str, option(help="Policy: a name such as frontier or random, a .safetensors file of weights, or module:Class.")
]
ModelName = Annotated[str, option(help="Model of the radiance field, such as semantic-nerfacto or instant-ngp.")]
PresetName = Annotated[
    str | None,
    option(
        metavar="NAME",
        help="Preset: smoke, fast or paper.",
        default="AUTONERF_LAB_PRESET, else fast",
    ),
]
Seed = Annotated[int, option(help="Random seed.")]
OutFolder = Annotated[Path, option(help="Run folder.")]
Device = Annotated[
    str | None,
    option(metavar="NAME", help="Torch device of the radiance field, such as cuda.", default="compiled kernels, CPU"),
]
RunPath = Annotated[Positional[Path], option(help="Run folder.")]
FieldPath = Annotated[Positional[Path], option(help="Run folder, or output folder of `autonerf-lab fit --out`.")]
Overwrite = Annotated[bool, option(help="Replace finished results. Only files written by this package are removed.")]
OptionalTasks = Annotated[
    str | None,
    option(metavar="A,B", help="Optional tasks: navigation (minutes per run), finetuning (an hour per run)."),
]
NoiseName = Annotated[
    str | None, option(metavar="NAME", help="Noise of motion and odometry: ans, locobot, and others.", default="none")
]
NoiseScale = Annotated[float | None, option(metavar="X", help="Factor of this noise.", default="1")]
DepthNoiseName = Annotated[str | None, option(metavar="NAME", help="Noise of depth images: redwood.", default="none")]
PosesName = Annotated[
    str | None,
    option(
        metavar="NAME",
        help="Poses that the policy sees: odometry, estimated or true; refined: estimated, refined after the episode.",
        default="odometry",
    ),
]

SemanticsName = Annotated[
    str | None,
    option(
        metavar="NAME",
        help="Source of the classes: true, predicted, noisy, a .safetensors file, or mask-rcnn:FILE.",
        default="true",
    ),
]


@dataclass(frozen=True)
class ExplorationOptions:
    """Options that override the preset."""

    steps: Annotated[
        int | None,
        option(metavar="N", help="Number of steps of the episode.", default="from the preset"),
    ] = None
    map_size: Annotated[
        int | None,
        option(
            metavar="N",
            help="Initial side length of the map, in cells of 5 cm; it grows with the scene.",
            default="640",
        ),
    ] = None
    width: Annotated[int | None, option(metavar="N", help="Image width in pixels.", default="from the preset")] = None
    height: Annotated[int | None, option(metavar="N", help="Image height in pixels.", default="from the preset")] = None
    fov: Annotated[
        float | None,
        option(metavar="DEGREES", help="Horizontal field of view of the camera.", default="from the preset"),
    ] = None

    noise: NoiseName = None
    noise_scale: NoiseScale = None
    depth_noise: DepthNoiseName = None
    poses: PosesName = None
    semantics: SemanticsName = None

    def overrides(self) -> dict[str, Any]:
        """Return the arguments for :func:`autonerf_lab.pipeline.run_pipeline`."""
        return {
            "steps": self.steps,
            "map_size": self.map_size,
            "width": self.width,
            "height": self.height,
            "hfov_deg": self.fov,
            "noise": self.noise,
            "noise_scale": self.noise_scale,
            "depth_noise": self.depth_noise,
            "poses": self.poses,
            "semantics": self.semantics,
        }


@dataclass(frozen=True)
class LpipsOptions:
    """Weights of LPIPS. Without them, LPIPS is not computed."""

    lpips_weights: Annotated[
        Path | None, option(metavar="FILE", help="LPIPS weights: a file of `autonerf-lab lpips-weights`.")
    ] = None
    lpips_sha256: Annotated[
        str | None, option(metavar="HEX", help="Expected SHA-256 of this file; another file is an error.")
    ] = None

    def load(self) -> "Lpips | None":
        """Load and check the weights.

        Raises:
            DataError: The file is missing, damaged or has another SHA-256.
        """
        if self.lpips_weights is None:
            if self.lpips_sha256 is not None:
                raise DataError("--lpips-sha256 needs a file: give --lpips-weights too")
            return None
        from autonerf_lab.evaluators.lpips import Lpips

        return Lpips(self.lpips_weights, self.lpips_sha256)


NO_OVERRIDES = ExplorationOptions()
NO_LPIPS = LpipsOptions()


def split_names(text: str | None) -> tuple[str, ...] | None:
    """Split a comma-separated list of names.

    Example:
        >>> split_names("a, b"), split_names(None)
        (('a', 'b'), None)
    """
    return None if text is None else tuple(name.strip() for name in text.split(",") if name.strip())
