"""TensorBoard log of a training."""

from pathlib import Path

from autonerf_lab.errors import MissingPackageError
from autonerf_lab.nerf.model import Model


class TensorBoardLog:
    """Callback of :func:`~autonerf_lab.nerf.fit.fit` that writes the losses of each step as TensorBoard scalars.

    ``fit(..., log_dir=folder)`` creates one. Show the curves with ``tensorboard --logdir folder``.

    Args:
        folder: created if it does not exist.
        step: first step to log; later entries of an earlier training in the folder are hidden.

    Raises:
        MissingPackageError: the extra ``training`` is not installed.
    """

    def __init__(self, folder: str | Path, step: int = 0) -> None:
        try:
            from torch.utils.tensorboard import SummaryWriter
        except ImportError as error:
            raise MissingPackageError('log_dir needs TensorBoard: pip install "autonerf-lab[training]"') from error
        self._writer = SummaryWriter(str(folder), purge_step=step)

    def __call__(self, step: int, model: Model) -> None:
        """Write the losses of the last training step."""
        for name, value in model.losses.items():
            self._writer.add_scalar(f"loss/{name}", value, step)

    def close(self) -> None:
        """Write buffered values and close the file."""
        self._writer.close()
