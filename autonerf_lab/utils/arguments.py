"""Checks of arguments."""

from pathlib import Path
from typing import Any

from autonerf_lab.errors import WrongTypeError


def refuse_name(value: Any, what: str, load: str) -> None:
    """Raise an error if a name or a path was passed instead of the loaded object.

    Args:
        value: the argument.
        what: what the argument is, for the message.
        load: call that loads it, with a pair of braces for the name.

    Raises:
        WrongTypeError: the argument is a name or a path.

    Example:
        >>> refuse_name("dev-0", "the scene", "lab.load_scene({})")
        Traceback (most recent call last):
        autonerf_lab.errors.WrongTypeError: the scene must be loaded first; pass lab.load_scene('dev-0')
    """
    if isinstance(value, str | Path):
        raise WrongTypeError(f"{what} must be loaded first; pass {load.format(repr(str(value)))}")
