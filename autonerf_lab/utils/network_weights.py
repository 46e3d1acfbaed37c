"""Weights of trained networks: half-precision safetensors, and a JSON file with the training beside them."""

import ast
import hashlib
import inspect
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import torch
from torch import nn

from autonerf_lab.errors import DataError
from autonerf_lab.utils.storage import read_arrays, write_arrays, write_json


def save_weights(path: str | Path, network: nn.Module, meta: dict[str, Any]) -> None:
    """Write ``path``.safetensors, without counters, and ``path``.json.

    Args:
        path: File; its suffix is replaced.
        network: Network on any device.
        meta: Content of the JSON file.
    """
    arrays = {name: value.detach().cpu().numpy().astype(np.float16) for name, value in _state(network).items()}
    write_arrays(weights_file(path, ".safetensors"), arrays)
    write_json(weights_file(path, ".json"), meta)


def weights_file(path: str | Path, suffix: str) -> Path:
    """Return the file of weights with a suffix; ``path`` has none, or that of one of the two files.

    Example:
        >>> [weights_file(path, ".json").name for path in ("policy", "policy.safetensors", "policy.v2")]
        ['policy.json', 'policy.json', 'policy.v2.json']
    """
    path = Path(path)
    stem = path.with_suffix("") if path.suffix in (".json", ".safetensors") else path
    return stem.with_name(stem.name + suffix)


def load_weights(path: str | Path, network: nn.Module, way_out: str = "train the weights again") -> None:
    """Read ``path``.safetensors into a network of the same architecture.

    Args:
        path: File; its suffix is replaced.
        network: Network whose parameters are overwritten.
        way_out: What the user can do about weights of another network.

    Raises:
        DataError: The file is missing, damaged, or belongs to another network; names the difference.
    """
    path = weights_file(path, ".safetensors")
    arrays, _ = read_arrays(path, dict[str, Any])
    wanted = {name: tuple(value.shape) for name, value in _state(network).items()}
    found = {name: array.shape for name, array in arrays.items()}
    if found != wanted:
        name = min(name for name in {*found, *wanted} if found.get(name) != wanted.get(name))
        raise DataError(
            f"{path} belongs to another network: {name} is {found.get(name, 'absent')}, not "
            f"{wanted.get(name, 'absent')}; {way_out}"
        )
    if not all(np.isfinite(array).all() for array in arrays.values()):
        raise DataError(f"{path} contains values that are not finite; train the weights again")
    values = {name: torch.from_numpy(array.astype(np.float32)) for name, array in arrays.items()}
    network.load_state_dict(values, strict=False)  # counters are not stored; all other names were compared


def code_sha256(*modules: ModuleType) -> str:
    """Return the SHA-256 of the code of modules, without comments and docstrings.

    Example:
        >>> from autonerf_lab import classes, geometry
        >>> code_sha256(classes) == code_sha256(classes), code_sha256(classes) == code_sha256(geometry)
        (True, False)
    """
    digest = hashlib.sha256()
    for module in modules:
        tree = ast.parse(inspect.getsource(module))
        for node in ast.walk(tree):
            if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef) and ast.get_docstring(node) is not None:
                node.body = node.body[1:]
        digest.update(ast.unparse(tree).encode())
    return digest.hexdigest()


def _state(network: nn.Module) -> dict[str, torch.Tensor]:
    """Return the state without the counters of batch normalisation, which are whole numbers."""
    return {name: value for name, value in network.state_dict().items() if value.dtype.is_floating_point}
