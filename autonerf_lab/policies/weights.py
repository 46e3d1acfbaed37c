"""Trained policies on disk: half-precision safetensors, and a JSON that says how they were made."""

from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import nn

from autonerf_lab.errors import DataError
from autonerf_lab.utils.storage import read_arrays, read_json, write_arrays, write_json

VERSION = 1


def save_weights(path: str | Path, network: nn.Module, meta: dict[str, Any]) -> None:
    """Write ``path``.safetensors and ``path``.json; ``meta`` holds at least the ``kind`` of the policy."""
    path = Path(path)
    arrays = {name: value.detach().cpu().numpy().astype(np.float16) for name, value in network.state_dict().items()}
    write_arrays(path.with_suffix(".safetensors"), arrays)
    write_json(path.with_suffix(".json"), {"version": VERSION, **meta})


def read_meta(path: str | Path) -> dict[str, Any]:
    """What the JSON beside the weights says.

    Raises:
        DataError: there is none, or it is that of a newer version.
    """
    meta = read_json(Path(path).with_suffix(".json"))
    if meta.get("version") != VERSION:
        raise DataError(f"{path}: made by another version ({meta.get('version')}, this one reads {VERSION})")
    return meta


def load_weights(path: str | Path, network: nn.Module) -> None:
    """Read weights into a network of the same architecture.

    Raises:
        DataError: the file is missing, damaged, or belongs to another network; it names the difference.
    """
    path = Path(path).with_suffix(".safetensors")
    arrays, _ = read_arrays(path)
    wanted = {name: tuple(value.shape) for name, value in network.state_dict().items()}
    found = {name: array.shape for name, array in arrays.items()}
    if found != wanted:
        name = min(name for name in {*found, *wanted} if found.get(name) != wanted.get(name))
        raise DataError(
            f"{path} belongs to another policy: {name} is {found.get(name, 'absent')}, not "
            f"{wanted.get(name, 'absent')}; was it trained with other channels?"
        )
    if not all(np.isfinite(array).all() for array in arrays.values()):
        raise DataError(f"{path} holds values that are not finite; train the policy again")
    network.load_state_dict({name: torch.from_numpy(array.astype(np.float32)) for name, array in arrays.items()})
