"""JSON files of users, and values in them that are what they should be.

The functions that take a value return it, or raise ValueError in words; they are for content that
somebody may have edited, or a disk damaged.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NoReturn

from pbrfit._core import InputError
from pbrfit.io.quoting import quoted, shown

UNFIT = (ValueError, KeyError, TypeError, AttributeError, OverflowError, RecursionError)
"""What it may come to when content is taken for what it is not."""

MOST = 2**53
"""Whole numbers up to here are the same as floats."""


def read_json(path: Path, expected: str, *, finite: bool = True) -> Any:
    """Content of a JSON file.

    Raises InputError if it is not UTF-8 or not JSON, or nested beyond reason; OSError if it cannot
    be read.

    Parameters
    ----------
    path
        The file.
    expected
        What it should hold, for the message.
    finite
        Whether NaN and infinities are refused, which are no JSON but often written.
    """
    refuse = _refuse if finite else None
    try:
        return json.loads(path.read_text(encoding="utf-8"), parse_constant=refuse)
    except (ValueError, RecursionError) as error:
        raise unfit(path, expected, error) from None


def unfit(path: Path, expected: str, error: Exception) -> InputError:
    """Say that a file does not hold what was expected; `error` is one of `UNFIT`."""
    return InputError(f"{path}: expected {expected}, found {type(error).__name__}: {shown(error)}")


def number(value: Any) -> float:
    """Check a finite number."""
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise ValueError(f"{quoted(value)} in place of a number")
    if not math.isfinite(value):
        raise ValueError(f"{value} in place of a finite number")
    return float(value)


def whole(value: Any, least: int = 0) -> int:
    """Check a whole number, `least` or more."""
    if isinstance(value, bool) or not isinstance(value, int) or not least <= value <= MOST:
        raise ValueError(f"{quoted(value)} in place of a whole number from {least} on")
    return value


def seed(value: Any) -> int:
    """Check a whole number of either sign."""
    if isinstance(value, bool) or not isinstance(value, int):
        raise ValueError(f"{quoted(value)} in place of a whole number")
    return value


def flag(value: Any) -> bool:
    """Check true or false."""
    if not isinstance(value, bool):
        raise ValueError(f"{quoted(value)} in place of true or false")
    return value


def path_text(value: Any) -> str:
    """Check a text that can be the path of a file; bytes that are no UTF-8 are as `os` has them."""
    if not isinstance(value, str):
        raise ValueError(f"{quoted(value)} in place of a path")
    value.encode("utf-8", "surrogateescape")
    if "\0" in value:
        raise ValueError(f"{quoted(value)} in place of a path")
    return value


def text(value: Any) -> str:
    """Check a text that can be written to a file in UTF-8."""
    if not isinstance(value, str):
        raise ValueError(f"{quoted(value)} in place of a text")
    value.encode("utf-8")
    return value


def texts(value: Any) -> tuple[str, ...]:
    """Check a list of texts."""
    if not isinstance(value, list):
        raise ValueError(f"{quoted(value)} in place of a list")
    return tuple(text(one) for one in value)


def table(value: Any) -> dict[str, Any]:
    """Check an object; its keys are texts that can be written to a file."""
    if not isinstance(value, Mapping):
        raise ValueError(f"{quoted(value)} in place of an object")
    return {text(key): entry for key, entry in value.items()}


def _refuse(constant: str) -> NoReturn:
    raise ValueError(f"{constant} in place of a finite number")
