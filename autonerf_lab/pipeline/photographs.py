"""From photographs with poses to a field: what ``autonerf-lab fit PHOTOGRAPHS --out DIR`` does.

::

    DIR/
      nerf/                         the field (safetensors and JSON)
      scores.json                   how it shows the photographs that were held out
      baselines/nearest_view.json  what showing the nearest training photograph instead would score
"""

from pathlib import Path
from typing import TYPE_CHECKING

from autonerf_lab import config
from autonerf_lab.data.dataset import load_dataset
from autonerf_lab.errors import RunFolderError
from autonerf_lab.pipeline.run_folder import locked, nothing_but

if TYPE_CHECKING:
    from autonerf_lab.evaluators import Scores
    from autonerf_lab.evaluators.lpips import Lpips

MADE = ("scores.json", "baselines/nearest_view.json", "nerf/nerf.json", "nerf/nerf.safetensors", "nerf/training.*")


def is_capture(folder: str | Path) -> bool:
    """Whether it looks like photographs with poses, and not like a run."""
    folder = Path(folder)
    return (folder.suffix == ".json" and folder.is_file()) or (
        any(folder.glob("transforms*.json")) and not (folder / "run.json").exists()
    )


def fit_capture(
    folder: str | Path,
    out: str | Path,
    model: str = "semantic-nerfacto",
    preset: str | None = None,
    seed: int = 0,
    *,
    overwrite: bool = False,
    lpips: "Lpips | None" = None,
) -> "Scores":
    """Train a field on all photographs but those held out, keep it, and score it on the others.

    A training that was interrupted goes on where it was.

    Args:
        folder: of the photographs, see :func:`autonerf_lab.data.dataset.load_dataset`.
        out: where the field and the scores go.
        model: a name, see :mod:`autonerf_lab.nerf.models`.
        preset: decides the hyper-parameters and the number of steps.
        seed: of everything random.
        overwrite: replace the field that is there.
        lpips: with its weights, to be scored by it too.

    Returns:
        PSNR, SSIM and FLIP of the held-out photographs, beside those of the nearest training photograph.

    Raises:
        UnknownNameError: no such model or preset.
        DataError: the photographs are not as announced, see :func:`autonerf_lab.data.dataset.load_dataset`.
        RunFolderError: ``out`` holds something else, or a finished field.
        TrainingError: a loss is not finite, or memory is short.
    """
    from autonerf_lab.evaluators import evaluate
    from autonerf_lab.nerf import fit, model_spec

    out = Path(out)
    model_spec(model)
    config.preset(preset)
    train, held_out = load_dataset(folder).split()
    with locked(out):
        _make_room(out, overwrite)
        print(f"{len(train)} photographs to train on, {len(held_out)} held out", flush=True)
        nerf = fit(train, model, preset, seed=seed, checkpoint=out / "nerf")
        scores = evaluate(nerf, held_out, trajectory=train, lpips_weights=lpips)
        scores.baselines["nearest_view"].save(out / "baselines/nearest_view.json")
        scores.save(out / "scores.json")
        nerf.save(out / "nerf")  # last: it says that all is done, and takes the checkpoint away
    return scores


def _make_room(out: Path, overwrite: bool) -> None:
    """Refuse what must not be mixed with a field; remove one that is to be replaced."""
    if (out / "run.json").exists():
        raise RunFolderError(f"{out} holds a run; choose another --out for the photographs")
    if not (out / "nerf").exists() and not nothing_but(out, "nerf"):
        raise RunFolderError(f"{out} holds files but no field; choose another --out")
    if not overwrite and (out / "nerf/nerf.json").exists():
        raise RunFolderError(f"{out} holds a finished field; choose another --out, or replace it with --overwrite")
    if overwrite:
        for file in (file for pattern in MADE for file in out.glob(pattern)):
            file.unlink()
