"""What installed packages add: entry points, loaded one by one, so that a broken one breaks only itself."""

import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from importlib.metadata import entry_points
from typing import Any, TypeVar

from autonerf_lab.errors import AutoNerfError

T = TypeVar("T")


class PluginWarning(AutoNerfError, UserWarning):  # noqa: N818 - a warning, unless strict() makes it an error
    """An installed plug-in was left out; the message names it and says why. Under :func:`strict` it is raised."""


@contextmanager
def strict() -> Iterator[None]:
    """Inside, a broken plug-in is not left out: its :class:`PluginWarning` is raised.

    Example:
        >>> with strict():
        ...     found = installed("nothing", {"a": 1}, int)
    """
    with warnings.catch_warnings():
        warnings.simplefilter("error", PluginWarning)
        yield


def installed(
    group: str, builtin: Mapping[str, T], kind: type[Any], check: Callable[[T], Any] | None = None
) -> dict[str, T]:
    """Built-in entries and those registered under ``autonerf_lab.<group>``.

    A plug-in that does not import, is not a ``kind``, does not pass the ``check`` (which raises) or takes a built-in
    name is left out with a :class:`PluginWarning`; the others are not disturbed. This is not a sandbox: loading a
    plug-in runs its code.

    Example:
        >>> sorted(installed("nothing", {"a": 1}, int))
        ['a']
    """
    found = dict(builtin)
    for point in sorted(entry_points(group=f"autonerf_lab.{group}"), key=lambda point: (point.name, point.value)):
        try:
            if point.name in found:
                raise ValueError(f"the name {point.name!r} is taken")
            value = point.load()
            if not isinstance(value, kind):
                raise TypeError(f"it is a {type(value).__name__}, not a {kind.__name__}")
            if check is not None:
                check(value)
            found[point.name] = value
        except (Exception, SystemExit) as error:  # whatever a stranger's module raises when it is imported
            reason = f"{type(error).__name__}: {error}"
            warnings.warn(f"plug-in {point.name!r} ({point.value}) is left out: {reason}", PluginWarning, stacklevel=2)
    return found


def package_of(group: str, name: str) -> str | None:
    """The installed package that registers ``name`` under ``autonerf_lab.<group>``; None where none does.

    Example:
        >>> package_of("models", "nobody-registers-this") is None
        True
    """
    packages = [point.dist.name for point in entry_points(group=f"autonerf_lab.{group}", name=name) if point.dist]
    return min(packages, default=None)
