"""JSON and TOML files of users, and values in them that are what they should be.

The functions that take a value return it, or raise ValueError in words: files may be damaged.
"""

from __future__ import annotations

import json
import math
import re
import tomllib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import is_dataclass
from functools import partial
from itertools import repeat
from pathlib import Path
from types import UnionType
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

from pbrfit._core import InputError
from pbrfit.io.input_files import TEXT_BYTES, read_text, unexpected
from pbrfit.values.quoting import listed, quoted, shown

UNFIT = (ValueError, KeyError, TypeError, AttributeError, OverflowError, RecursionError)
"""What it may come to when content is taken for what it is not."""

MOST = 2**53
"""Whole numbers up to here are the same as floats."""

TOML_DOTS_MAX = 64
"""Single dots in a line of TOML: the depth of a key by its square is time and memory of reading."""


def read_json(path: Path, expected: str) -> Any:
    """Content of a JSON file; `expected` says for the message what it should hold.

    Raises InputError if it is not JSON, as NaN is not, or deep beyond reason, or no regular file.
    """
    content = read_text(path, TEXT_BYTES)
    with expecting(path, expected):
        return json.loads(content, parse_constant=lambda name: number(float(name)))


def toml_of(path: Path | str, content: str) -> dict[str, Any]:
    """Content of TOML; InputError if it is none, or deep or large beyond reason."""
    for i, line in enumerate(content.split("\n"), 1):
        if (dots := len(re.findall(r"(?<!\.)\.(?!\.)", line))) > TOML_DOTS_MAX:
            raise unexpected(path, f"at most {TOML_DOTS_MAX} dots a line", f"{dots} in line {i}")
    try:
        found = tomllib.loads(content)
        _check_whole(found)
    except (ValueError, RecursionError) as error:  # numbers beyond reason raise a plain ValueError
        raise unexpected(path, "TOML", shown(error)) from None
    return found


def _check_whole(value: Any) -> None:
    """Check all whole numbers in lists and objects."""
    if isinstance(value, (dict, list)):
        for one in value.values() if isinstance(value, dict) else value:
            _check_whole(one)
    elif isinstance(value, int) and value.bit_length() > 63:  # and a sign, as TOML has it
        raise ValueError(f"a whole number of {value.bit_length()} bits in place of 64")


def unfit(path: Path | str, expected: str, error: Exception) -> InputError:
    """Say that a file does not hold what was expected; `error` is one of `UNFIT`."""
    return unexpected(path, expected, f"{type(error).__name__}: {shown(error)}")


@contextmanager
def expecting(path: Path | str, expected: str) -> Iterator[None]:
    """Where what a file holds is looked at: one of `UNFIT` is raised as `unfit`."""
    try:
        yield
    except UNFIT as error:
        raise unfit(path, expected, error) from None


def number(value: Any) -> float:
    """Check a finite number."""
    found = float(_a(value, (int, float), "a number"))
    if not math.isfinite(found):
        raise ValueError(f"{value} in place of a finite number")
    return found


def whole(value: Any) -> int:
    """Check a whole number, 0 or more."""
    what = "a whole number from 0 on"
    if not 0 <= _a(value, int, what) <= MOST:
        raise ValueError(f"{quoted(value)} in place of {what}")
    return int(value)


def path_text(value: Any) -> str:
    """Check a text that can be the path of a file; bytes that are no UTF-8 are as `os` has them."""
    if "\0" in (path := words(value)):
        raise ValueError(f"{quoted(value)} in place of a path")
    return path


def text(value: Any, errors: str = "strict") -> str:
    """Check a text that can be written to a file in UTF-8; `errors` as of `str.encode`."""
    found = str(_a(value, str, "a text"))
    found.encode("utf-8", errors)
    return found


words = partial(text, errors="surrogateescape")
"""Check a text that need not be UTF-8: names of files are not on every system."""


def table(value: Any) -> dict[str, Any]:
    """Check an object; its keys are texts that can be written to a file."""
    return {text(key): entry for key, entry in _a(value, Mapping, "an object").items()}


def as_json(value: Any) -> Any:
    """What JSON can hold of a value: dataclasses are objects, NaN and infinite numbers null."""
    if isinstance(value, float) and not math.isfinite(value):
        return None
    if is_dataclass(value) or isinstance(value, Mapping):
        named = value if isinstance(value, Mapping) else vars(value)
        return {name: as_json(of) for name, of in named.items()}
    return list(map(as_json, value)) if isinstance(value, (list, tuple)) else value


def read_as(kind: Any, value: Any) -> Any:
    """A value as a type, as annotations name it: undoes `as_json`.

    A dataclass is an object of its fields and no others; null among numbers by name is NaN.
    """
    origin, parts = get_origin(kind), get_args(kind)
    if isinstance(kind, type) and is_dataclass(kind):
        given, fields = table(value), get_type_hints(kind)
        if others := given.keys() ^ fields.keys():
            raise ValueError(f"{kind.__name__} with or without {listed(others)}")
        for name, of in fields.items():
            try:
                given[name] = read_as(of, given[name])
            except ValueError as error:
                raise ValueError(f"{name}: {error}") from None
        return kind(**given)
    if origin in (Union, UnionType):
        return None if value is None else read_as(parts[0], value)
    if origin is Literal:
        if value not in parts:
            raise ValueError(f"{quoted(value)} in place of {', '.join(map(str, parts))}")
        return value
    if origin is tuple:
        entries = _a(value, list, "a list")
        kinds = repeat(parts[0], len(entries)) if parts[-1] is Ellipsis else parts
        return tuple(read_as(of, one) for of, one in zip(kinds, entries, strict=True))
    if origin is Mapping:
        nan = parts[1] is float
        return {
            name: math.nan if nan and entry is None else read_as(parts[1], entry)
            for name, entry in table(value).items()
        }
    if kind is bool:
        return _a(value, bool, "true or false")
    return {str: text, int: whole, float: number}.get(kind, kind)(value)


def _a(value: Any, kind: type | tuple[type, ...], what: str) -> Any:
    """Check the type; true and false are no numbers."""
    if not isinstance(value, kind) or (isinstance(value, bool) and kind is not bool):
        raise ValueError(f"{quoted(value)} in place of {what}")
    return value


def write_json(path: Path, content: object, errors: str = "strict") -> None:
    """Write JSON that people can read; `errors` as of `str.encode`, for what no UTF-8 can hold."""
    written = json.dumps(content, indent=1, ensure_ascii=False, allow_nan=False)
    path.write_text(written + "\n", encoding="utf-8", errors=errors)
