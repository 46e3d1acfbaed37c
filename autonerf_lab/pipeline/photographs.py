"""Training and evaluation on photographs with poses: ``autonerf-lab fit PHOTOGRAPHS --out DIR``.

::

    DIR/
      nerf/                        radiance field (safetensors and JSON)
      scores.json                  scores on the held-out photographs
      baselines/nearest_view.json  scores of the nearest training photograph
      colmap/                      poses by COLMAP (--poses colmap)
"""

from pathlib import Path
from typing import TYPE_CHECKING

from autonerf_lab import presets
from autonerf_lab.data.dataset import load_dataset
from autonerf_lab.data.readers import find_format
from autonerf_lab.errors import RunFolderError, UnknownNameError
from autonerf_lab.pipeline import outputs
from autonerf_lab.pipeline.colmap_poses import estimate_poses
from autonerf_lab.pipeline.run_folder import is_empty_except, locked

if TYPE_CHECKING:
    from autonerf_lab.evaluators import Scores
    from autonerf_lab.evaluators.lpips import Lpips

OUTPUTS = (
    *("colmap/database.db", "colmap/all/*", "colmap/all/*/*", "colmap/sparse/0/*.bin", "colmap/photographs.json"),
    "scores.json",
    "baselines/nearest_view.json",
    "nerf/nerf.json",
    "nerf/nerf.safetensors",
)


def is_photograph_folder(folder: str | Path) -> bool:
    """Return True if a folder holds photographs with poses and no run."""
    folder = Path(folder)
    return (folder.suffix == ".json" and folder.is_file()) or (
        folder.is_dir() and find_format(folder) is not None and not (folder / "run.json").exists()
    )


def fit_photographs(
    folder: str | Path,
    out: str | Path,
    model: str = "semantic-nerfacto",
    preset: str | None = None,
    seed: int = 0,
    *,
    overwrite: bool = False,
    lpips: "Lpips | None" = None,
    poses: str | None = None,
    device: str | None = None,
) -> "Scores":
    """Train a radiance field on the training photographs and evaluate it on the held-out ones.

    An interrupted training continues from its last checkpoint.

    Args:
        folder: Photographs, see :func:`autonerf_lab.data.dataset.load_dataset`.
        out: Output folder.
        model: Name of a model, see :mod:`autonerf_lab.nerf.models`.
        preset: Preset with the hyper-parameters and the number of training steps.
        seed: Random seed.
        overwrite: Replace a finished field in ``out``.
        lpips: LPIPS network; None: LPIPS is not computed.
        poses: ``"colmap"`` estimates the poses, see :func:`~autonerf_lab.pipeline.colmap_poses.estimate_poses`; None:
            those of the folder.
        device: Torch device of the field; None: compiled kernels on the CPU.

    Returns:
        PSNR, SSIM and FLIP on the held-out photographs, and those of the baseline ``nearest_view``.

    Raises:
        UnknownNameError: The model or preset does not exist.
        DataError: The photographs are invalid, see :func:`autonerf_lab.data.dataset.load_dataset`.
        RunFolderError: ``out`` holds other files or a finished field.
        TrainingError: A loss is not finite, or memory is exhausted.
    """
    from autonerf_lab.evaluators import evaluate
    from autonerf_lab.nerf import fit, model_spec

    out = Path(out)
    model_spec(model)
    presets.preset(preset)
    if poses not in (None, "colmap"):
        raise UnknownNameError("source of poses", poses, ["colmap"])
    data = None if poses else load_dataset(folder)
    with locked(out):
        _prepare_folder(out, overwrite)
        data = data or load_dataset(folder, colmap=estimate_poses(folder, out / "colmap"))
        train, held_out = data.split()
        print(f"{len(train)} training photographs, {len(held_out)} held-out photographs", flush=True)
        nerf = fit(train, model, preset, seed=seed, device=device, checkpoint=out / "nerf")
        scores = evaluate(nerf, held_out, trajectory=train, lpips_weights=lpips)
        scores.baselines["nearest_view"].save(out / "baselines/nearest_view.json")
        scores.save(out / "scores.json")
        nerf.save(out / "nerf")  # last: marks the result as complete and removes the checkpoint
        outputs.record(out, "fit", OUTPUTS)
    return scores


def _prepare_folder(out: Path, overwrite: bool) -> None:
    """Check that the output folder may be used, and remove the outputs that will be replaced."""
    if (out / "run.json").exists():
        raise RunFolderError(f"{out} holds a run; choose another --out for the photographs")
    if not any((out / name).exists() for name in ("nerf", "colmap")) and not is_empty_except(out, "nerf"):
        raise RunFolderError(f"{out} holds files but no field; choose another --out")
    if not overwrite and (out / "nerf/nerf.json").exists():
        raise RunFolderError(f"{out} holds a finished field; choose another --out, or replace it with --overwrite")
    if overwrite:
        outputs.check_unchanged(out, ["fit"])
        outputs.remove(out, ["fit"])
