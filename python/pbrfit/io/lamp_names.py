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
from pbrfit.io.quoting import quoted, shown

log = logging.getLogger("pbrfit")

QUOTES = "\"'`´“”„‟‘’‚‛«»‹›"
"""Marks that writers of names with spaces put around them."""

_EXTENSION = r"\.(?=\w*[^\W\d])\w{1,5}"
"""Up to five letters and digits, not digits alone: those of `scan.001` tell scans apart."""


def matched(path: Path, given: Sequence[str], names: Sequence[str]) -> tuple[list[int], str]:
    """Index of the picture of each lamp of a file, -1 where there is none, and what was assumed.

    `given` are names in the file, empty where it has none; `names` are those of the pictures. They
    are compared without folder, quotes and surrounding spaces, with or without extension; then
    without case and forms of Unicode; then without up to two extensions. The way counts by which
    most pictures have a lamp. Where no name is a picture's, numbers in names tell, if both sides
    have the same; else order, if alphabet and numbers agree on it on both sides.

    Raises InputError if some picture has no lamp, or lamps of several names, or nothing tells which
    lamp is whose.
    """
    ways = [[-1] * len(given)]
    for forms in (_as_written, _folded, _bare):
        places = {forms(name)[0]: i for i, name in enumerate(names)}
        if len(places) == len(names):  # else names differ in what is left out
            ways.append([next((places[f] for f in forms(one) if f in places), -1) for one in given])
    best = max(ways, key=lambda found: len(set(found) - {-1}))
    if max(best) < 0:
        return _by_sequence(path, given, names)
    spare = [one for one, i in zip(given, best, strict=True) if i < 0]
    others = f"no picture is called {quoted(spare[0])}{_more(spare)}" if spare else ""
    first: dict[int, str] = {}
    for one, i in zip(given, best, strict=True):
        if first.setdefault(i, one) != one and i >= 0:  # a name may come again: several lamps
            found = f"{shown(first[i])} and {shown(one)}"
            raise InputError(
                f"{path}: expected one name for picture {shown(names[i])}, found {found}"
            )
    without = [name for i, name in enumerate(names) if i not in first]
    if without:
        found = f"none for {shown(without[0])}{_more(without)}" + f"; {others}" * bool(others)
        raise InputError(f"{path}: expected a lamp for every picture, found {found}")
    return best, f"some left out: {others}" * bool(others)


def _as_written(name: str) -> tuple[str, ...]:
    """A name without folder and quotes, with and without its extension."""
    last = re.split(r"[/\\]", name)[-1].strip(QUOTES + " \t\u00a0")
    return last, re.sub(f"{_EXTENSION}$", "", last)


def _folded(name: str) -> tuple[str, ...]:
    forms = (unicodedata.normalize("NFKC", form).casefold() for form in _as_written(name))
    return tuple(form.strip() for form in forms)


def _bare(name: str) -> tuple[str, ...]:
    return (re.sub(f"({_EXTENSION}){{1,2}}$", "", _folded(name)[0]),)


def _by_sequence(path: Path, given: Sequence[str], names: Sequence[str]) -> tuple[list[int], str]:
    """As `matched`, where no name is that of a picture; a warning lists the pairs."""
    if len(given) != len(names):
        found = f"{len(given)}, none with a picture's name"
        found += f" (such as {shown(given[0])})" if given[0] else ""
        raise InputError(
            f"{path}: expected a lamp for each of the {len(names)} pictures, found {found}"
        )
    numbers, captured = _numbers(names), _numbers(given)
    # Copies of captures keep their numbers. A set of names that differ in one number alone, each
    # with the same numbers as the pictures, is named by them as it would be by words.
    if numbers and numbers.keys() == captured.keys():
        pictures, how = [numbers[one] for one in captured], "the numbers in names"
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
    pairs = enumerate(zip(given[:3], pictures, strict=False), 1)
    some = ", ".join(f"{shown(one) or f'lamp {k}'} with {shown(names[i])}" for k, (one, i) in pairs)
    some += f" and {len(given) - 3} more" if len(given) > 3 else ""
    log.warning("%s: lamps are %s: %s", path, how, some)
    return pictures, how


def _numbers(names: Sequence[str]) -> dict[str, int]:
    """Indices of names by number, in order; empty unless names differ in one number alone."""
    plain = [_bare(name)[0] for name in names]
    if len({re.sub(r"\d+", "0", name) for name in plain}) > 1:
        return {}
    columns = zip(*(re.findall(r"\d+", name) for name in plain), strict=True)
    varied = [column for column in columns if len(set(column)) > 1]
    found = {number.lstrip("0"): i for i, number in enumerate(varied[0])} if varied else {}
    return found if len(varied) == 1 and len(found) == len(names) else {}


def _natural(name: str) -> tuple[str, str]:
    """By what names are in the order of their numbers, which have at most 20 digits."""
    return re.sub(r"\d+", lambda digits: digits[0].zfill(20), name), name


def _more(names: Sequence[str]) -> str:
    return f" and {len(names) - 1} more" if len(names) > 1 else ""
