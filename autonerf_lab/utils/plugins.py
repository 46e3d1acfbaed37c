"""Plug-ins: entry points of installed packages. A broken plug-in does not affect the others."""

import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from importlib.metadata import entry_points
from typing import Any, TypeVar

from autonerf_lab.errors import AutoNerfError, WrongTypeError

T = TypeVar("T")


class PluginWarning(AutoNerfError, UserWarning):  # noqa: N818 - a warning, unless strict() makes it an error
    """Warning that a plug-in was skipped, with its name and the reason. An error under :func:`strict`."""


@contextmanager
def strict() -> Iterator[None]:
    """Context manager that raises each :class:`PluginWarning` as an error.

    Example:
        >>> with strict():
        ...     found = load_plugins("nothing", {"a": 1}, int)
    """
    with warnings.catch_warnings():
        warnings.simplefilter("error", PluginWarning)
        yield


@contextmanager
def named_errors(
    name: str, place: str, kind: type[AutoNerfError], passed: type[AutoNerfError] = AutoNerfError
) -> Iterator[None]:
    """Context manager that names the plug-in that runs in it, in its errors and when Ctrl-C interrupts it.

    Args:
        name: the plug-in, such as ``policy 'frontier'``.
        place: where it runs, such as ``at step 3``.
        kind: class of the error that replaces others.
        passed: class of the errors that stay as they are.

    Example:
        >>> with named_errors("reward 'cov'", "in reset", AutoNerfError):
        ...     1 / 0
        Traceback (most recent call last):
        autonerf_lab.errors.AutoNerfError: reward 'cov' failed in reset: ZeroDivisionError: division by zero
    """
    try:
        yield
    except passed:
        raise
    except KeyboardInterrupt as error:
        raise KeyboardInterrupt(f"{name} was interrupted {place}") from error
    except Exception as error:
        raise kind(f"{name} failed {place}: {type(error).__name__}: {error}") from error


def require(condition: bool, requirement: str) -> None:
    """Raise an error if a requirement of a conformance check is not met.

    Raises:
        AssertionError: the condition is false. Not by an assert statement, which ``python -O`` removes.

    Example:
        >>> require(1 > 2, "a reward must be finite")
        Traceback (most recent call last):
        AssertionError: a reward must be finite
    """
    if not condition:
        raise AssertionError(requirement)


def with_members(made: T, name: str, kind: str, check: Callable[[T], Any]) -> T:
    """Return an object that has the members of a plug-in.

    Args:
        made: the object.
        name: how errors name it.
        kind: what it should be, such as ``policy``.
        check: raises an AssertionError that names a missing member.

    Raises:
        WrongTypeError: the object has not all members.
    """
    try:
        check(made)
    except AssertionError as error:
        raise WrongTypeError(f"{name} is not a {kind}: {error}") from error
    return made


def load_plugins(
    group: str, builtin: Mapping[str, T], kind: type[Any], check: Callable[[T], Any] | None = None
) -> dict[str, T]:
    """Return the built-in entries and the plug-ins registered under ``autonerf_lab.<group>``, by name.

    A plug-in is skipped with a :class:`PluginWarning` if its import fails, its type is wrong, its check fails or its
    name is taken. Loading a plug-in runs its code; there is no sandbox.

    Args:
        group: Last part of the name of the entry-point group, such as ``"rewards"``.
        builtin: Entries that ship with this package.
        kind: Required type of an entry.
        check: Function that raises an exception if an entry is invalid.

    Example:
        >>> sorted(load_plugins("nothing", {"a": 1}, int))
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
        except KeyboardInterrupt:
            raise
        except BaseException as error:  # third-party code may raise anything on import
            reason = f"{type(error).__name__}: {error}"
            warnings.warn(f"plug-in {point.name!r} ({point.value}) was skipped: {reason}", PluginWarning, stacklevel=2)
    return found


def package_name_of(group: str, name: str) -> str | None:
    """Return the installed package that registers ``name`` under ``autonerf_lab.<group>``, or None.

    Example:
        >>> package_name_of("models", "missing-model") is None
        True
    """
    packages = [point.dist.name for point in entry_points(group=f"autonerf_lab.{group}", name=name) if point.dist]
    return min(packages, default=None)
