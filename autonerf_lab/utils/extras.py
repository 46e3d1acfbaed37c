"""Packages that only some need: they come with an extra, and are imported when they are used."""

from importlib import import_module
from typing import Any

from autonerf_lab.errors import MissingPackageError

OWN_SIZE = {"max_width": "100%", "align_self": "flex-start", "margin": "0"}  # an ipywidgets image, not stretched


def optional(module: str, extra: str) -> Any:
    """Import a package that belongs to an extra.

    Raises:
        MissingPackageError: it is not installed; says how to get it.

    Example:
        >>> optional("nobody_has_this", "viewer")
        Traceback (most recent call last):
        autonerf_lab.errors.MissingPackageError: nobody_has_this is not installed: pip install "autonerf-lab[viewer]"
    """
    try:
        return import_module(module)
    except ModuleNotFoundError as error:
        raise MissingPackageError(f'{module} is not installed: pip install "autonerf-lab[{extra}]"') from error
