"""The header of Radiance HDR files: what it says of the samples behind it."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

from pbrfit.io.color import CIE_XYZ, REC709, Primaries

# The first axis is the slower one; EXIF 2.32 numbers the same eight ways to scan a picture.
_ORIENTATIONS = {
    (b"-Y", b"+X"): 1, (b"-Y", b"-X"): 2, (b"+Y", b"-X"): 3, (b"+Y", b"+X"): 4,
    (b"+X", b"-Y"): 5, (b"-X", b"-Y"): 6, (b"-X", b"+Y"): 7, (b"+X", b"+Y"): 8,
}  # fmt: skip

_HEAD = re.compile(rb"(#\?.*?\n)\n([-+][XY]) (\d+) ([-+][XY]) (\d+)\n", re.DOTALL)


@dataclass(frozen=True)
class Header:
    """Of one file."""

    plain: bytes
    """The file as RGBE from top to bottom, whatever it is."""
    orientation: int
    """As EXIF numbers it."""
    primaries: Primaries
    factors: tuple[float, ...]
    """What the values of red, green and blue were multiplied by: EXPOSURE times COLORCORR."""


def read(data: bytes) -> Header | None:
    """Read the header of a file; None = not one that is understood.

    All lines of EXPOSURE and COLORCORR count, and the last of PRIMARIES; damaged ones do not.
    """
    head = _HEAD.match(data)
    if head is None or (head[2], head[4]) not in _ORIENTATIONS:
        return None
    lines, factors, primaries = head[1], [1.0, 1.0, 1.0], REC709
    for line in lines.splitlines():
        name, _, values = line.partition(b"=")
        try:
            numbers = [float(value) for value in values.split()]
        except ValueError:
            continue
        wanted = {b"EXPOSURE": 1, b"COLORCORR": 3, b"PRIMARIES": 8}.get(name.strip())
        if wanted != len(numbers) or not all(map(math.isfinite, numbers)):
            continue
        if wanted == 8 and numbers[7] > 0:  # eight zeros are in files that know none
            primaries = Primaries(*zip(numbers[::2], numbers[1::2], strict=True))
        elif wanted != 8 and min(numbers) > 0:
            factors = [old * new for old, new in zip(factors, 3 * numbers, strict=False)]
    xyz = b"FORMAT=32-bit_rle_xyze\n"
    if xyz in lines:
        lines, primaries = lines.replace(xyz, b"FORMAT=32-bit_rle_rgbe\n"), CIE_XYZ
    plain = b"%s\n-Y %s +X %s\n%s" % (lines, head[3], head[5], data[head.end() :])
    return Header(plain, _ORIENTATIONS[head[2], head[4]], primaries, tuple(factors))
