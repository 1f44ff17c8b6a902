"""How much memory reading a file may take: the bound that every case is held against.

    bound = CONSTANT + PER_BYTE x size of the file + PER_PIXEL x pixels + PER_SAMPLE x EXR samples

Pixels and samples are what the file's header declares, where `pbrfit` lets the declaration pass;
docs/reliability.md states both. The headers are read here once more, without the package.
"""

from __future__ import annotations

import re
import struct

CONSTANT = 96 << 20
PER_BYTE = 64
PER_PIXEL = 96
PER_MAP_PIXEL = 512
"""The same where normals are made of a map of depth."""
PER_SAMPLE = 24

MOST_PIXELS = 1 << 28


def bound(data: bytes, per_pixel: int) -> int:
    """Bytes of memory that reading a file of this content may take at its peak."""
    pixels, samples = _declared(data)
    if not 0 < pixels <= MOST_PIXELS:
        pixels = samples = 0
    return CONSTANT + PER_BYTE * len(data) + per_pixel * pixels + PER_SAMPLE * samples


def _declared(data: bytes) -> tuple[int, int]:
    """Pixels, and of EXR samples, that the header declares; 0 where the package refuses it."""
    size = len(data)
    if data.startswith(b"\x89PNG") and len(data) > 33:
        # 1032 bytes for each that is deflated, up to 8 pixels in each.
        width, height, depth, color = struct.unpack_from(">IIBB", data, 16)
        bits = depth * {0: 1, 2: 3, 3: 1, 4: 2, 6: 4}.get(color, 1)
        return (width * height if width * height * bits <= 8 * 1032 * size else 0), 0
    if data.startswith(b"\xff\xd8"):
        claims = (
            struct.unpack_from(">HH", data, found.end() + 3)
            for found in re.finditer(rb"\xff[\xc0-\xc3\xc5-\xc7\xc9-\xcb\xcd-\xcf]", data[:-7])
        )
        return max((w * h for h, w in claims if w * h <= 1024 * size), default=0), 0
    if data[:4] in (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+"):
        return _tiff(data), 0
    if data.startswith(b"#?"):
        found = re.search(rb"-Y +(\d+) +\+X +(\d+)", data)
        claim = int(found[1]) * int(found[2]) if found else 0
        return (claim if claim <= 8192 * size else 0), 0
    if data.startswith(b"\x76\x2f\x31\x01"):
        return _exr(data)
    return 0, 0


def _tiff(data: bytes) -> int:
    order, big = "<" if data[:2] == b"II" else ">", data[2:4] in (b"+\0", b"\0+")
    try:
        (at,) = struct.unpack_from(order + ("Q" if big else "I"), data, 8 if big else 4)
        (entries,) = struct.unpack_from(order + ("Q" if big else "H"), data, at)
        sides: dict[int, int] = {}
        for k in range(min(entries, 1000)):
            entry = at + (8 + 20 * k if big else 2 + 12 * k)
            tag, kind = struct.unpack_from(order + "HH", data, entry)
            code = {1: "B", 3: "H", 4: "I", 13: "I", 16: "Q"}.get(kind, "H")
            (value,) = struct.unpack_from(order + code, data, entry + (12 if big else 8))
            sides.setdefault(tag, value)
        pixels = sides.get(256, 0) * sides.get(257, 0)
    except (struct.error, OverflowError):
        return 0
    return pixels if pixels <= 2048 * len(data) else 0


def _exr(data: bytes) -> tuple[int, int]:
    pixels = 0
    for window in re.finditer(
        rb"(?:display|data)Window\0box2i\0\x10\0\0\0(.{16})", data, re.DOTALL
    ):
        left, top, right, bottom = struct.unpack("<4i", window[1])
        pixels = max(pixels, (abs(right - left) + 1) * (abs(bottom - top) + 1))
    for tile in re.finditer(rb"tiledesc\0\x09\0\0\0(.{8})", data, re.DOTALL):
        width, height = struct.unpack("<2I", tile[1])
        pixels = max(pixels, width * height if width * height <= 1 << 22 else 0)
    channels = 0
    for found in re.finditer(rb"channels\0chlist\0(.{4})", data, re.DOTALL):
        listed = data[found.end() : found.end() + struct.unpack("<I", found[1])[0]]
        channels += len(re.findall(rb"[^\0]+\0.{16}", listed, re.DOTALL))  # name, then its kind
    samples = pixels * channels
    dwa = re.search(rb"compression\0compression\0\x01\0\0\0[\x08\x09]", data) is not None
    if samples > (1 << 26) + (16512 if dwa else 1032) * len(data):
        return 0, 0
    return pixels, samples
