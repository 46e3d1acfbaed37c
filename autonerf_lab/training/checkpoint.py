"""Checkpoints of trainings: found again by a fingerprint of the settings, and refused for another training."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Any, Protocol, TypeVar

import msgspec
import numpy as np
import torch
from torch import Tensor, nn

from autonerf_lab.errors import DataError, RunFolderError
from autonerf_lab.utils.storage import read_arrays, write_arrays

CHECKPOINT = "checkpoint.safetensors"
_ADAM = ("step", "exp_avg", "exp_avg_sq")


class _Header(Protocol):
    @property
    def fingerprint(self) -> dict[str, Any]: ...


H = TypeVar("H", bound=_Header)


@dataclass(frozen=True)
class SupervisedHeader:
    """Header of the checkpoint of a supervised training."""

    fingerprint: dict[str, Any]
    curve: list[dict[str, float]]
    step: Annotated[int, msgspec.Meta(ge=0)]
    seconds: float


def read_checkpoint(path: Path, fingerprint: dict[str, Any], header: type[H]) -> tuple[dict[str, np.ndarray], H] | None:
    """Read the arrays and the header of a checkpoint; None if there is no checkpoint.

    Args:
        path: file of the checkpoint.
        fingerprint: settings and inputs of the training, as JSON holds them, to recognise its checkpoint.
        header: type of the header.

    Raises:
        RunFolderError: the checkpoint belongs to a training with other settings.
        DataError: the checkpoint is damaged.
    """
    if not path.exists():
        return None
    try:
        arrays, read = read_arrays(path, header)
    except DataError as error:
        raise DataError(f"{error}; remove the file to start the training again") from error
    found = read.fingerprint
    if found != fingerprint:
        differ = sorted(k for k in {*found, *fingerprint} if found.get(k) != fingerprint.get(k))
        raise RunFolderError(
            f"{path} belongs to another training ({', '.join(differ)[:200]} differ); remove it, or use another folder"
        )
    return arrays, read


def save_supervised(
    path: Path, header: SupervisedHeader, networks: Mapping[str, nn.Module], optimizer: torch.optim.Optimizer
) -> None:
    """Write the checkpoint of a supervised training.

    Args:
        path: file of the checkpoint.
        header: its header.
        networks: by name; Adam optimises the first one.
        optimizer: Adam or AdamW, after at least one step.
    """
    arrays = {f"{name}/{k}": v.numpy() for name, network in networks.items() for k, v in network.state_dict().items()}
    for name, parameter in next(iter(networks.values())).named_parameters():
        for key, moment in optimizer.state[parameter].items():
            arrays[f"adam/{name}/{key}"] = torch.as_tensor(moment).numpy()
    write_arrays(path, arrays, asdict(header))


def resume_supervised(
    path: Path, fingerprint: dict[str, Any], networks: Mapping[str, nn.Module], optimizer: torch.optim.Optimizer
) -> SupervisedHeader | None:
    """Load a checkpoint of :func:`save_supervised` into networks and optimiser; None if there is no checkpoint.

    Raises:
        RunFolderError: the checkpoint belongs to a training with other settings.
        DataError: the checkpoint is damaged.
    """
    found = read_checkpoint(path, fingerprint, SupervisedHeader)
    if found is None:
        return None
    arrays, header = found
    try:
        for name, network in networks.items():
            network.load_state_dict({k: torch.from_numpy(arrays[f"{name}/{k}"]) for k in network.state_dict()})
        for name, parameter in next(iter(networks.values())).named_parameters():
            optimizer.state[parameter] = {k: torch.from_numpy(arrays[f"adam/{name}/{k}"]) for k in _ADAM}
    except (KeyError, RuntimeError, TypeError) as error:
        raise DataError(f"{path} is damaged ({error!r}); remove it to start the training again") from error
    return header


def training_state(network: nn.Module, optimizer: torch.optim.Optimizer) -> dict[str, np.ndarray]:
    """Return the parameters of a network and the state of its Adam, as arrays."""
    state = {f"parameter/{name}": value.detach() for name, value in network.named_parameters()}
    for name, value in network.named_parameters():
        moments = optimizer.state.get(value, {})
        state |= {f"adam/{name}/{key}": torch.as_tensor(moment) for key, moment in moments.items()}
    return {name: value.numpy(force=True).copy() for name, value in state.items()}


def load_training_state(network: nn.Module, optimizer: torch.optim.Optimizer, arrays: Mapping[str, np.ndarray]) -> None:
    """Load a state of :func:`training_state`; other arrays are ignored.

    Raises:
        KeyError: an array is missing.
        ValueError: an array has another shape or type, or values that are not finite.
    """

    def load(name: str, like: Tensor) -> Tensor:
        array = arrays[name]
        if array.shape != like.shape or array.dtype != np.float32 or not np.isfinite(array).all():
            raise ValueError(f"{name} is not {tuple(like.shape)} finite numbers of 32 bits")
        return torch.from_numpy(array).to(like.device)

    has_moments = any(name.startswith("adam/") for name in arrays)  # False after imitation, before PPO
    with torch.no_grad():
        for name, value in network.named_parameters():
            value.copy_(load(f"parameter/{name}", value))
            if has_moments:
                like = {"step": torch.zeros(()), "exp_avg": value, "exp_avg_sq": value}
                optimizer.state[value] = {key: load(f"adam/{name}/{key}", shape) for key, shape in like.items()}
