"""Arguments that have to be real numbers, whoever passes whatever: refusals name the argument."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from math import inf, isfinite
from typing import Any, get_args

import numpy as np
from numpy.typing import NDArray

from pbrfit._core import InputError
from pbrfit.values.arrays import Array
from pbrfit.values.quoting import quoted

REAL = "buif"
"""Kinds of numpy's types that hold real numbers."""

Shape = tuple[int, ...] | None
"""Which an array has to have; None = any."""


def any_array(name: str, values: Any, shape: Shape = None) -> NDArray[Any]:
    """As an array of whatever it holds; InputError where it is masked or its rows differ."""
    if np.ma.is_masked(values):  # what the mask leaves out would count as numbers
        raise InputError(f"{name}: expected an array without a mask, found a masked one")
    try:
        array = np.asarray(values)
    except ValueError as error:
        raise InputError(f"{name}: expected an array, found {error}") from None
    if shape not in (None, array.shape):
        raise InputError(f"{name}: expected shape {shape}, found {array.shape}")
    return array


def reals(name: str, values: Any, shape: Shape = None) -> NDArray[Any]:
    """As an array of real numbers of the type that they have."""
    array = any_array(name, values, shape)
    if array.dtype.kind not in REAL:
        raise InputError(f"{name}: expected real numbers, found {array.dtype}")
    return array


def real_array(name: str, values: Any, shape: Shape = None) -> Array:
    """As a float64 array of real numbers."""
    with np.errstate(over="ignore"):  # of long doubles; they are infinite then
        return reals(name, values, shape).astype(np.float64, copy=False)


def real_number(name: str, value: Any, expected: str = "a number") -> float:
    """As a float, which may be NaN or infinite."""
    other = isinstance(value, (bool, str, bytes))
    if isinstance(value, (np.ndarray, np.generic)):
        other = value.ndim > 0 or value.dtype.kind not in REAL
    with suppress(TypeError, ValueError, OverflowError):
        if not other:
            return float(value)
    raise InputError(f"{name}: expected {expected}, found {of_what(value)}")


def finite(
    name: str, value: Any, expected: str = "a finite number", least: float = -inf, most: float = inf
) -> float:
    """As a finite float from `least` to `most`; `expected` is that in words."""
    found = real_number(name, value, expected)
    if isfinite(found) and least <= found <= most:
        return found
    raise InputError(f"{name}: expected {expected}, found {of_what(value)}")


def one_of(name: str, value: Any, known: Any) -> None:
    """Refuse what is none of some values: a sequence of them, or a `Literal`."""
    values = get_args(known) or tuple(known)
    if not isinstance(value, (str, int)) or value not in values:
        expected = ", ".join(map(str, values))
        raise InputError(f"{name}: expected one of {expected}, found {of_what(value)}")


def of_what(value: Any) -> str:
    """What a refused value is, in one short line."""
    if isinstance(value, np.ndarray) and value.size > 4:
        return f"an array of {value.dtype} of shape {value.shape}"
    return quoted(value)


@contextmanager
def errors_about(path: object) -> Iterator[None]:
    """Let an InputError in the block begin with the file or folder that it is about."""
    try:
        yield
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
