"""Import of optional packages: each belongs to an extra of this package and is imported on first use."""

from importlib import import_module
from typing import Any

from autonerf_lab.errors import MissingPackageError

NATURAL_SIZE = {"max_width": "100%", "align_self": "flex-start", "margin": "0"}  # of an ipywidgets image


def optional(module: str, extra: str) -> Any:
    """Import an optional package.

    Args:
        module: Name of the module.
        extra: Extra of ``autonerf-lab`` that installs it.

    Raises:
        MissingPackageError: The package is not installed. The message contains the command that installs it.

    Example:
        >>> optional("missing_package", "viewer")
        Traceback (most recent call last):
        autonerf_lab.errors.MissingPackageError: missing_package is not installed: pip install "autonerf-lab[viewer]"
    """
    try:
        return import_module(module)
    except ModuleNotFoundError as error:
        raise MissingPackageError(f'{module} is not installed: pip install "autonerf-lab[{extra}]"') from error
