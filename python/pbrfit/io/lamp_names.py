"""Which picture each lamp of a file is of: told by names, else by numbers in them, else by order.

By order only where nothing speaks against it, and never without a warning that lists pairs.
"""

from __future__ import annotations

import logging
import re
import unicodedata
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

from pbrfit._core import InputError
from pbrfit.io.quoting import shown

log = logging.getLogger("pbrfit")

QUOTES = "\"'`´“”„‟‘’‚‛«»‹›"
"""Marks that writers of names with spaces put around them."""

LISTED = 3
"""Pairs that a warning lists."""

_EXTENSION = re.compile(r"\.(?=\w*[^\W\d])\w{1,5}$")
"""Up to five letters and digits, not digits alone: those of `scan.001` tell scans apart."""


def matched(path: Path, given: Sequence[str], names: Sequence[str]) -> tuple[list[int], str]:
    """Index of the picture of each lamp, -1 where there is none, and in words what was assumed.

    Names are compared without folder, quotes and surrounding spaces, with or without extension;
    then without case and forms of Unicode; then without any extension: in the first of these ways
    in which every picture has a lamp. Where no name is that of a picture, and there are as many,
    the numbers in them tell, if both count through the same set. Else it is the order, if it is the
    same alphabetically and by numbers on both sides. A warning lists these pairs.

    Parameters
    ----------
    path
        The file, for messages.
    given
        Names in it, empty where a lamp has none.
    names
        Of the pictures, without suffix, in their order.

    Raises
    ------
    InputError
        If some picture has no lamp, or lamps under several names, or nothing tells which is whose.
    """
    best = [-1] * len(given)
    for forms in (_as_written, _folded, _bare):
        places = {forms(name)[0]: i for i, name in enumerate(names)}
        if len(places) < len(names):
            continue  # these names differ in what is left out
        found = [next((places[f] for f in forms(one) if f in places), -1) for one in given]
        if len(set(found) - {-1}) > len(set(best) - {-1}):
            best = found
    if max(best) < 0:
        return _by_sequence(path, given, names)
    spare = [one for one, i in zip(given, best, strict=True) if i < 0]
    without = [name for i, name in enumerate(names) if i not in set(best)]
    if without:
        unknown = f"; no picture is called {shown(spare[0])}{_more(spare)}" if spare else ""
        raise InputError(
            f"{path}: expected a lamp for every picture, found none for {shown(without[0])}"
            f"{_more(without)}{unknown}"
        )
    first: dict[int, str] = {}
    for one, i in zip(given, best, strict=True):
        if i >= 0 and first.setdefault(i, one) != one:  # a name may come again: several lamps
            raise InputError(
                f"{path}: expected one name for picture {shown(names[i])}, found "
                f"{shown(first[i])} and {shown(one)}"
            )
    if not spare:
        return best, ""
    return (
        best,
        f"left out: lamps of no picture here ({shown(spare[0]) or 'no name'}{_more(spare)})",
    )


def _as_written(name: str) -> tuple[str, str]:
    """A name without folder and quotes, with and without its extension."""
    last = re.split(r"[/\\]", name)[-1].strip(QUOTES + " \t\u00a0")
    return last, _EXTENSION.sub("", last)


def _folded(name: str) -> tuple[str, str]:
    full, stem = (
        unicodedata.normalize("NFKC", form).casefold().strip() for form in _as_written(name)
    )
    return full, stem


def _bare(name: str) -> tuple[str]:
    name = _folded(name)[0]
    while (shorter := _EXTENSION.sub("", name)) != name and shorter:
        name = shorter
    return (name,)


def _by_sequence(path: Path, given: Sequence[str], names: Sequence[str]) -> tuple[list[int], str]:
    """As `matched`, where no name is that of a picture."""
    if len(given) != len(names):
        example = f" (such as {shown(given[0])})" if given[0] else ""
        raise InputError(
            f"{path}: expected a lamp for each of the {len(names)} pictures, found "
            f"{len(given)}, none with a picture's name{example}"
        )
    numbers = _numbers(names)
    # Copies of captures keep their numbers. A set of names that differ in one number alone, each
    # with the same numbers as the pictures, is named by them as it would be by words.
    if numbers and sorted(numbers) == sorted(_numbers(given)):
        pictures, how = [numbers.index(one) for one in _numbers(given)], "the numbers in names"
    else:
        for of in (names, [_as_written(one)[0] for one in given]):
            # A program that sorts img10 before img2 may have made either sequence.
            for a, b in (*pairwise(of), *pairwise(sorted(of))):
                if _natural(b) < _natural(a):
                    raise InputError(
                        f"{path}: expected names of pictures, found {shown(given[0]) or 'none'}"
                        f"{_more(given)}; by order they cannot be paired, as {shown(a)} comes "
                        f"before {shown(b)}: rename or pad"
                    )
        pictures, how = list(range(len(names))), "order"
    how = f"matched to the pictures by {how}, as no name in it is that of a picture"
    pairs = [
        f"{shown(one) or f'lamp {k + 1}'} with {shown(names[i])}"
        for k, (one, i) in enumerate(zip(given, pictures, strict=True))
    ]
    more = f" and {len(pairs) - LISTED} more" if len(pairs) > LISTED else ""
    log.warning("%s: lamps are %s: %s%s", path, how, ", ".join(pairs[:LISTED]), more)
    return pictures, how


def _numbers(names: Sequence[str]) -> list[str]:
    """The number in each name without leading zeros; empty unless they differ in one alone."""
    plain = [_bare(name)[0] for name in names]
    if len({re.sub(r"\d+", "0", name) for name in plain}) > 1:
        return []
    columns = zip(*(re.findall(r"\d+", name) for name in plain), strict=True)
    varied = [column for column in columns if len(set(column)) > 1]
    found = [number.lstrip("0") or "0" for number in varied[0]] if len(varied) == 1 else []
    return found if len(set(found)) == len(names) else []


def _natural(name: str) -> tuple[str, str]:
    """By what names are in the order of their numbers, which have at most 20 digits."""
    return re.sub(r"\d+", lambda digits: digits[0].zfill(20), name), name


def _more(names: Sequence[str]) -> str:
    return f" and {len(names) - 1} more" if len(names) > 1 else ""
