"""Errors that the package raises on purpose; ``except AutoNerfError`` catches all of them.

Each message names what is wrong and how to correct it.
"""

from collections.abc import Iterable


class AutoNerfError(Exception):
    """Base class of all errors raised on purpose."""


class UnknownNameError(AutoNerfError, ValueError):
    """A scene, policy, model, preset or reward that does not exist.

    Example:
        >>> raise UnknownNameError("policy", "frontire", ["frontier", "random"])
        Traceback (most recent call last):
        autonerf_lab.errors.UnknownNameError: unknown policy 'frontire'; valid names: frontier, random
    """

    def __init__(self, kind: str, name: str, valid: Iterable[str]) -> None:
        self._arguments = (kind, name, sorted(valid))
        super().__init__(f"unknown {kind} {name!r}; valid names: {', '.join(self._arguments[2])}")

    def __reduce__(self) -> tuple[type, tuple[str, str, list[str]]]:
        """Pickle by the constructor's arguments, so that the error can leave a worker process."""
        return type(self), self._arguments


class WrongTypeError(AutoNerfError, TypeError):
    """An argument of the wrong type."""


class DataError(AutoNerfError, ValueError):
    """A file or folder that is missing, damaged, or of another kind than expected."""


class SceneError(DataError):
    """A scene that cannot be built, loaded or navigated."""


class TrainingError(AutoNerfError, RuntimeError):
    """A training that met non-finite values, ran out of memory, or has unusable data."""


class RewardError(AutoNerfError, ValueError):
    """A reward that raised or is not a finite number, or a weighted sum that cannot be parsed."""


class PolicyError(AutoNerfError, RuntimeError):
    """A policy that raised, or chose no action, during an episode."""


class SegmenterError(AutoNerfError, RuntimeError):
    """A segmenter that raised, or returned no labels, during an episode."""


class RunFolderError(AutoNerfError, RuntimeError):
    """A command that a run folder does not allow: a stage is missing, or it would overwrite results."""


class MissingPackageError(AutoNerfError, ImportError):
    """An optional dependency that is not installed."""


class DeviceError(AutoNerfError, RuntimeError):
    """A compute device that this machine does not have."""
