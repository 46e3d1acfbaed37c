"""Results of answers: conversion to arrays, comparison, description, exceptions.

Students write loops, NumPy, torch or plain lists, in float32 or float64. All of these are converted to one NumPy array
before they are compared.
"""

import dis
import inspect
import sysconfig
import traceback
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

# Relative tolerances, of a value and of the largest value of the result. Messages show four to six digits.
VALUE_TOLERANCE, SCALE_TOLERANCE = 1e-4, 1e-5
_PACKAGE = Path(__file__).parents[1]
_STANDARD_LIBRARY = Path(sysconfig.get_paths()["stdlib"])
_OF_EMPTY_BODIES = {"RESUME", "NOP", "LOAD_CONST", "RETURN_CONST", "RETURN_VALUE", "POP_TOP"}


@dataclass(frozen=True)
class Raised:
    """Result of an answer that raised an exception."""

    error: Exception

    def __repr__(self) -> str:
        return f"{type(self.error).__name__}: {self.error}"

    @property
    def line(self) -> str:
        """Line of the answer that raised, with its number; "" if the exception was raised elsewhere."""
        cause: BaseException | None = self.error
        while cause is not None:
            for frame in reversed(traceback.extract_tb(cause.__traceback__)):
                if _is_of_an_answer(frame.filename) and frame.line:
                    return f"line {frame.lineno}: {frame.line.strip()}"
            cause = cause.__cause__
        return ""


def _is_of_an_answer(filename: str) -> bool:
    path = Path(filename)
    library = {"site-packages", "dist-packages"} & set(path.parts)
    return not (library or path.is_relative_to(_PACKAGE) or path.is_relative_to(_STANDARD_LIBRARY))


def to_array(value: Any) -> np.ndarray | None:
    """Convert a number, a nested sequence, an array or a tensor to an array of numbers; None for anything else.

    Tensors are detached. Strings are not numbers.

    Example:
        >>> to_array([1, (2.5)]), to_array("1.0"), to_array([[1, 2], [3]])
        (array([1. , 2.5]), None, None)
    """
    try:
        if isinstance(value, list | tuple):
            parts = [to_array(part) for part in value]
            numbers = [part for part in parts if part is not None]
            if len(numbers) < len(parts):
                return None
            return np.stack(numbers) if numbers else np.zeros(0)
        array = np.asarray(value.detach().cpu() if hasattr(value, "detach") else value)
    except Exception:  # an object of any class, whose conversion may raise anything; or parts of different shapes
        return None
    return array if array.dtype.kind in "biuf" else None


def same(result: Any, expected: Any) -> bool:
    """Compare a result with the expected one: equal shapes, and values within the relative tolerances.

    Two exceptions are the same if their types are.

    Example:
        >>> import torch
        >>> same(torch.tensor([0.5, 0.25], requires_grad=True), np.array([0.5, 0.25])), same("0.5", 0.5)
        (True, False)
    """
    if isinstance(result, Raised) or isinstance(expected, Raised):
        return (
            isinstance(result, Raised) and isinstance(expected, Raised) and type(result.error) is type(expected.error)
        )
    x, y = to_array(result), to_array(expected)
    if x is None or y is None or x.shape != y.shape:
        return False
    x, y = x.astype(np.float64), y.astype(np.float64)
    scale = np.abs(y[np.isfinite(y)]).max(initial=0) or 1.0
    return bool(np.allclose(x, y, rtol=VALUE_TOLERANCE, atol=SCALE_TOLERANCE * scale, equal_nan=True))


def holds_floats(result: Any) -> bool:
    """Tell whether a result consists of floats, which NumPy refuses as indices."""
    array = to_array(result)
    return array is not None and array.size > 0 and array.dtype.kind == "f"


def is_unfinished(answer: Any) -> bool:
    """Tell whether the body of a function, or of ``__call__`` of a class, is empty: ``...``, ``pass``, a docstring.

    Example:
        >>> is_unfinished(lambda x: ...), is_unfinished(lambda x: print(x))
        (True, False)
    """
    function = vars(answer).get("__call__") if inspect.isclass(answer) else answer
    code = getattr(function, "__code__", None)
    return code is not None and {one.opname for one in dis.get_instructions(code)} <= _OF_EMPTY_BODIES


def difference(result: Any, expected: Any) -> str:
    """Describe how a wrong result differs from the expected one, for a message."""
    shown = short(expected)
    if isinstance(result, Raised):
        return f"expected {shown}, but the answer raised {result!r}" + (f"\nin {result.line}" if result.line else ".")
    if result is None or result is ...:
        return f"expected {shown}, but the answer returned {short(result)}. Is a `return` missing?"
    x, y = to_array(result), to_array(expected)
    if x is None or y is None:
        kind = "an array of numbers" if y is not None and y.ndim else "a number"
        return f"expected {shown}, got {short(result)}, an object of type `{type(result).__name__}`, not {kind}."
    if x.ndim != y.ndim or (x.shape != y.shape and max(x.size, y.size) > 6):
        got = f"shape {x.shape}" if y.ndim and x.ndim else _shape(x)
        return f"expected {_shape(y)}, got {got}."
    if x.shape == y.shape and short(x) == short(y):
        apart = np.nanmax(np.abs(x.astype(np.float64) - y), initial=0)
        return f"expected {shown}, got {short(result)}. The largest difference is {apart:.2g}."
    return f"expected {shown}, got {short(result)}."


def _shape(array: np.ndarray) -> str:
    return f"an array of shape {array.shape}" if array.ndim else "a number"


def short(value: Any) -> str:
    """Return a short text of a result: four digits in arrays, six in single numbers."""
    array = to_array(value)
    if array is None:
        text = "..." if value is ... else repr(value)
    elif array.ndim == 0:
        number = array.item()
        text = f"{number:.6g}" if isinstance(number, float) else repr(number)
    else:
        separator = ", " if isinstance(value, list | tuple) else " "
        text = np.array2string(array, precision=4, suppress_small=True, threshold=20, separator=separator)
    return text if len(text) <= 200 else text[:200] + " ..."
