"""Storage of trained policies: half-precision safetensors, and a JSON file with network and training settings."""

from pathlib import Path
from typing import Any

from torch import nn

from autonerf_lab.errors import DataError
from autonerf_lab.utils import network_weights
from autonerf_lab.utils.storage import read_json

VERSION = 1


def save_weights(path: str | Path, network: nn.Module, meta: dict[str, Any]) -> None:
    """Write ``path``.safetensors and ``path``.json; ``meta`` must contain ``network``, the kind and its options."""
    network_weights.save_weights(path, network, {"version": VERSION, **meta})


def read_meta(path: str | Path) -> dict[str, Any]:
    """Read the JSON file beside the weights.

    Raises:
        DataError: the file is missing, or has another version.
    """
    path = network_weights.weights_file(path, ".json")
    meta = read_json(path, dict[str, Any])
    if meta.get("version") != VERSION:
        raise DataError(
            f"{path}: file version {str(meta.get('version'))[:20]} is not supported, only version {VERSION}"
        )
    network = meta.get("network")
    if not isinstance(network, dict) or not isinstance(network.get("kind"), str):
        raise DataError(f"{path}: 'network' must hold the kind of the network and its options")
    if not all(
        isinstance(value, str) or (isinstance(value, int | float) and abs(value) <= 4096) for value in network.values()
    ):
        raise DataError(f"{path}: the options of 'network' must be texts, or numbers up to 4096")
    return meta


def load_weights(path: str | Path, network: nn.Module) -> None:
    """Read weights into a network of the same architecture.

    Raises:
        DataError: the file is missing, damaged, or belongs to another network; names the difference.
    """
    network_weights.load_weights(path, network, "check the network settings in the JSON file beside it")
