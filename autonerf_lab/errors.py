"""Everything this package raises on purpose: one family, so that ``except AutoNerfError`` is enough.

Each message names the thing that is wrong and the way out.
"""

from collections.abc import Iterable


class AutoNerfError(Exception):
    """Base of all errors raised on purpose."""


class UnknownNameError(AutoNerfError, ValueError):
    """A scene, policy, model, preset or reward that does not exist.

    Example:
        >>> raise UnknownNameError("policy", "frontire", ["frontier", "random"])
        Traceback (most recent call last):
        autonerf_lab.errors.UnknownNameError: unknown policy 'frontire'; valid names: frontier, random
    """

    def __init__(self, kind: str, name: str, valid: Iterable[str]) -> None:
        self._said = (kind, name, sorted(valid))
        super().__init__(f"unknown {kind} {name!r}; valid names: {', '.join(self._said[2])}")

    def __reduce__(self) -> tuple[type, tuple[str, str, list[str]]]:
        """How it leaves a worker process."""
        return type(self), self._said


class WrongTypeError(AutoNerfError, TypeError):
    """An argument of another type than the one that is asked for."""


class DataError(AutoNerfError, ValueError):
    """A file or folder that is missing, damaged, or not what the caller says it is."""


class SceneError(DataError):
    """A scene that cannot be built, loaded or walked in."""


class TrainingError(AutoNerfError, RuntimeError):
    """Training met a value that is not finite, or data that cannot be learned from."""


class RewardError(AutoNerfError, ValueError):
    """A reward that failed or is not a finite number, or a sum of rewards that cannot be read."""


class RunFolderError(AutoNerfError, RuntimeError):
    """A run folder that holds something else than the command asked for."""


class MissingPackageError(AutoNerfError, ImportError):
    """A package of an extra that is not installed."""
