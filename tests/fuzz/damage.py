"""Damage: what happens to a sound file in a case, by the kind of file.

Every function takes a random generator and the bytes of a file, and gives other bytes. Damage that
any checksum would catch says little about what lies behind it, so the kinds of files that have
checksums, lengths or compressed parts are taken apart, damaged inside, and put together again.
"""

from __future__ import annotations

import json
import re
import struct
import zlib
from collections.abc import Callable
from random import Random
from typing import Any, Literal

Damage = Callable[[Random, bytes], bytes]

INTERESTING = (
    0, 1, 2, 7, 8, 0x7F, 0x80, 0xFF, 0x100, 0x7FFF, 0x8000, 0xFFFF, 0x10000, 0x7FFFFFFF,
    0x80000000, 0xFFFFFFFF, 1 << 40, (1 << 63) - 1, (1 << 64) - 1,
)  # fmt: skip
"""Numbers at which lengths and counts go wrong."""

# What a number or a text in JSON, TOML or CSV may be replaced by.
DEEP = 20_000
VALUES = (
    "0", "-0", "-1", "1", "2", "1.5", "1e-400", "1e308", "-1e308", "1e999", "-1e999", "NaN",
    "Infinity", "-Infinity", "nan", "inf", "-inf", "1_000", "0x10", "1979-05-27", "07:32:00",
    "9" * 25, "9" * 400, "9" * 5000, "-" + "9" * 400, "null", "true", "false", "", '""', '"x"',
    '"1"', '"a\\nb"', '"\\ud800"', '"\\u0000"', '"\\u001b[2J"', '"' + "x" * 100_000 + '"', "[]",
    "{}", "[[[]]]", '[1, "a", null]', '{"a": 1}', "[" * DEEP, "[" * DEEP + "]" * DEEP,
    '{"a":' * DEEP, "'", '"', "\\", "\0", "\x1b[31m", "\ufeff", "é", ",", "\n", "\r", "a = 1\n",
)  # fmt: skip

_NUMBER = re.compile(rb"-?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?")
_TEXT = re.compile(rb'"(?:[^"\\\n]|\\.)*"')
_WORD = re.compile(rb"[A-Za-z_][\w.]*")


def raw(rng: Random, data: bytes) -> bytes:
    """Damage that knows nothing of the format."""
    changed = bytearray(data)
    for _ in range(rng.choice((1, 1, 1, 2, 3, 6))):
        changed = rng.choice(_RAW)(rng, changed)
    return bytes(changed)


def _cut(rng: Random, data: bytearray) -> bytearray:
    return data[: rng.randrange(len(data) + 1)]


def _flip(rng: Random, data: bytearray) -> bytearray:
    for _ in range(rng.choice((1, 1, 2, 4, 16))):
        if data:
            data[_place(rng, len(data))] ^= 1 << rng.randrange(8)
    return data


def _byte(rng: Random, data: bytearray) -> bytearray:
    if data:
        data[_place(rng, len(data))] = rng.choice((0, 1, 0x7F, 0x80, 0xFF, rng.randrange(256)))
    return data


def _number(rng: Random, data: bytearray) -> bytearray:
    size = rng.choice((2, 4, 4, 4, 8))
    if len(data) >= size:
        at = _place(rng, len(data) - size + 1)
        order: Literal["little", "big"] = "little" if rng.random() < 0.5 else "big"
        if rng.random() < 0.5:
            value = rng.choice(INTERESTING)
        else:
            value = int.from_bytes(data[at : at + size], order) + rng.choice((-1, 1, 256, -256))
        data[at : at + size] = (value % (1 << 8 * size)).to_bytes(size, order)
    return data


def _slices(rng: Random, data: bytearray) -> bytearray:
    """A piece twice, moved, gone, zeroed, or of noise."""
    length = rng.choice((1, 2, 4, 8, 64, max(1, len(data) // 4)))
    at, to = _place(rng, len(data) + 1), _place(rng, len(data) + 1)
    piece = data[at : at + length]
    match rng.randrange(5):
        case 0:
            data[to:to] = piece
        case 1:
            data[to : to + len(piece)] = piece
        case 2:
            del data[at : at + length]
        case 3:
            data[at : at + len(piece)] = bytes(len(piece))
        case _:
            data[at : at + len(piece)] = rng.randbytes(len(piece))
    return data


_RAW = (_cut, _flip, _flip, _byte, _number, _number, _slices)


def _place(rng: Random, size: int) -> int:
    """An offset, half of the time among the first: there the structure is."""
    return rng.randrange(min(size, 400) if rng.random() < 0.5 else size)


def png(rng: Random, data: bytes) -> bytes:
    """Chunks, with checksums that hold; what is deflated in them is damaged inside."""
    if rng.random() < 0.2:
        return raw(rng, data)
    chunks = list(_png_chunks(data))
    for _ in range(rng.choice((1, 1, 2, 3))):
        k = rng.randrange(len(chunks))
        kind, body = chunks[k]
        choice = rng.random()
        if choice < 0.15:
            chunks.insert(rng.randrange(len(chunks) + 1), chunks[k])
        elif choice < 0.25 and len(chunks) > 1:
            del chunks[k]
        elif choice < 0.35:
            other = rng.randrange(len(chunks))
            chunks[k], chunks[other] = chunks[other], chunks[k]
        elif choice < 0.5:
            chunks.insert(rng.randrange(len(chunks) + 1), (rng.choice(_PNG_KINDS), rng.randbytes(
                rng.choice((0, 1, 4, 8, 13, 26, 40)))))  # fmt: skip
        elif kind in (b"IDAT", b"iCCP", b"iTXt", b"zTXt") and rng.random() < 0.7:
            chunks[k] = kind, _inside(rng, kind, body)
        else:
            chunks[k] = kind, raw(rng, body)
    return data[:8] + b"".join(png_chunk(kind, body) for kind, body in chunks)


_PNG_KINDS = (b"PLTE", b"tRNS", b"gAMA", b"cHRM", b"sRGB", b"cICP", b"iCCP", b"eXIf", b"acTL",
              b"fcTL", b"fdAT", b"sBIT", b"bKGD", b"pHYs", b"tEXt", b"zTXt", b"iTXt", b"IDAT",
              b"IEND", b"mDCV", b"cLLI")  # fmt: skip


def _png_chunks(data: bytes) -> Any:
    at = 8
    while at + 12 <= len(data):
        (length,) = struct.unpack_from(">I", data, at)
        yield data[at + 4 : at + 8], data[at + 8 : at + 8 + length]
        at += 12 + length


def png_chunk(kind: bytes, body: bytes) -> bytes:
    """A chunk with its length and checksum."""
    return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))


def png_of(
    size: tuple[int, ...], *chunks: tuple[bytes, bytes], kind: int = 0, interlaced: int = 0
) -> bytes:
    """An 8-bit PNG of (width, height), grey by default, whose header these chunks follow."""
    header = struct.pack(">IIBBBBB", *size, 8, kind, 0, 0, interlaced)
    every = ((b"IHDR", header), *chunks, (b"IEND", b""))
    return b"\x89PNG\r\n\x1a\n" + b"".join(png_chunk(*one) for one in every)


def _inside(rng: Random, kind: bytes, body: bytes) -> bytes:
    """Damage what is deflated at the end of a chunk."""
    start = 0
    if kind != b"IDAT":
        start = body.find(b"\0") + (5 if kind == b"iTXt" else 2)
    try:
        inner = zlib.decompress(body[start:])
    except zlib.error:
        return raw(rng, body)
    return body[:start] + zlib.compress(raw(rng, inner), 1)


def jpeg(rng: Random, data: bytes) -> bytes:
    """Segments, with lengths that hold; the scan as bytes."""
    if rng.random() < 0.3:
        return raw(rng, data)
    segments: list[bytes] = []
    at = 2
    while at + 4 <= len(data) and data[at] == 0xFF and data[at + 1] != 0xDA:
        (length,) = struct.unpack_from(">H", data, at + 2)
        segments.append(data[at : at + 2 + length])
        at += 2 + length
    if not segments:
        return raw(rng, data)
    scan = data[at:]
    for _ in range(rng.choice((1, 1, 2))):
        k = rng.randrange(len(segments))
        choice = rng.random()
        if choice < 0.15:
            segments.insert(rng.randrange(len(segments) + 1), segments[k])
        elif choice < 0.25 and len(segments) > 1:
            del segments[k]
        elif choice < 0.35:
            segments[k], segments[0] = segments[0], segments[k]
        elif choice < 0.45:
            scan = raw(rng, scan)
        elif choice < 0.5:
            scan = scan[:-2] + scan if rng.random() < 0.5 else scan * rng.choice((2, 10))
        else:
            body = raw(rng, segments[k][4:])
            segments[k] = segments[k][:2] + struct.pack(">H", (len(body) + 2) % 65536) + body
    return data[:2] + b"".join(segments) + scan


def tiff(rng: Random, data: bytes) -> bytes:
    """Entries of the first directory, or bytes."""
    if rng.random() < 0.35 or data[:4] != b"II*\0":
        return raw(rng, data)
    changed = bytearray(data)
    (at,) = struct.unpack_from("<I", data, 4)
    (entries,) = struct.unpack_from("<H", data, at)
    for _ in range(rng.choice((1, 1, 2, 3))):
        entry = at + 2 + 12 * rng.randrange(entries)
        offset, size = rng.choice(((0, 2), (2, 2), (4, 4), (8, 4), (8, 4), (8, 2)))
        if entry + 12 > len(changed):
            continue
        value = rng.choice((*INTERESTING, rng.randrange(1 << 16), len(data), 3, 4, 5, 16, 64))
        changed[entry + offset : entry + offset + size] = (value % (1 << 8 * size)).to_bytes(
            size, "little"
        )
    return bytes(changed)


def hdr(rng: Random, data: bytes) -> bytes:
    """The line with the size, or bytes."""
    if rng.random() < 0.6:
        return raw(rng, data)
    size = re.search(rb"-Y (\d+) \+X (\d+)\n", data)
    if size is None:
        return raw(rng, data)
    height, width = (
        str(rng.choice((*INTERESTING, -1, int(size[k]) + 1, int(size[k]) * 2))) for k in (1, 2)
    )
    sign = rng.choice(("-Y {} +X {}\n", "+X {1} -Y {0}\n", "-Y {}\n", "+Y {} +X {}\n", "\n"))
    line = sign.format(height, width).encode()
    return data[: size.start()] + line + data[size.end() :]


def exr(rng: Random, data: bytes) -> bytes:
    """Attributes of the header by their names, or bytes."""
    if rng.random() < 0.5:
        return raw(rng, data)
    attributes = list(_EXR_ATTRIBUTE.finditer(data))
    if not attributes:
        return raw(rng, data)
    found = rng.choice(attributes)
    (size,) = struct.unpack_from("<I", data, found.end() - 4)
    body = data[found.end() : found.end() + size]
    choice = rng.random()
    if choice < 0.15:  # the attribute twice
        return data[: found.start()] + found[0] + body + data[found.start() :]
    if choice < 0.25:  # or not at all
        return data[: found.start()] + data[found.end() + size :]
    changed = raw(rng, body)
    if rng.random() < 0.7:  # of the same length, so that what follows is still found
        changed = changed[:size].ljust(size, b"\0")
    head = found[0][:-4] + struct.pack("<I", len(changed))
    return data[: found.start()] + head + changed + data[found.end() + size :]


_EXR_ATTRIBUTE = re.compile(
    rb"(?:channels\0chlist|compression\0compression|dataWindow\0box2i|displayWindow\0box2i"
    rb"|lineOrder\0lineOrder|tiles\0tiledesc|chromaticities\0chromaticities|name\0string"
    rb"|type\0string|chunkCount\0int|version\0int|pixelAspectRatio\0float"
    rb"|screenWindowWidth\0float|screenWindowCenter\0v2f)\0.{4}",
    re.DOTALL,
)


def npy(rng: Random, data: bytes) -> bytes:
    """The header as text, or bytes."""
    if rng.random() < 0.4:
        return raw(rng, data)
    (length,) = struct.unpack_from("<H", data, 8)
    header = text(rng, data[10 : 10 + length])[:65535]
    if rng.random() < 0.5:
        header = re.sub(rb"'<f\d'", rng.choice(_NPY_TYPES), header)
    return data[:8] + struct.pack("<H", min(len(header), 65535)) + header + data[10 + length :]


_NPY_TYPES = (b"'|O'", b"'<U9'", b"'<c16'", b"'|V8'", b"'<f2'", b"'<f16'", b"'<i8'", b"'|b1'",
              b"[('a','<f4')]", b"'<M8[s]'", b"'|S0'", b"'<f4,<f4'")  # fmt: skip


def text(rng: Random, data: bytes) -> bytes:
    """Numbers, texts, words and lines of a text file."""
    for _ in range(rng.choice((1, 1, 1, 2, 4))):
        choice = rng.random()
        value = rng.choice(VALUES).encode("utf-8", "surrogatepass")
        if choice < 0.55:
            pattern = rng.choice((_NUMBER, _NUMBER, _TEXT, _WORD))
            places = list(pattern.finditer(data))
            if places:
                found = rng.choice(places)
                data = data[: found.start()] + value + data[found.end() :]
        elif choice < 0.75:
            lines = data.split(b"\n")
            k, other = rng.randrange(len(lines)), rng.randrange(len(lines))
            match rng.randrange(4):
                case 0:
                    lines.insert(other, lines[k])
                case 1:
                    del lines[k]
                case 2:
                    lines[k], lines[other] = lines[other], lines[k]
                case _:
                    lines.insert(other, value)
            data = b"\n".join(lines)
        else:
            data = raw(rng, data)
    return data


def json_text(rng: Random, data: bytes) -> bytes:
    """A node of a JSON document replaced, dropped or doubled; or its text damaged."""
    if rng.random() < 0.4:
        return text(rng, data)
    try:
        document = json.loads(data)
    except ValueError:
        return text(rng, data)
    places: list[tuple[Any, Any]] = []
    pending = [document]
    while pending:
        node = pending.pop()
        inside = node.items() if isinstance(node, dict) else enumerate(node)
        for key, value in inside:
            # Long lists of numbers would take all the damage for themselves.
            if isinstance(node, list) and isinstance(key, int) and key > 3:
                break
            places.append((node, key))
            if isinstance(value, (dict, list)):
                pending.append(value)
    if not places:
        return text(rng, data)
    mark = "\ue000put here\ue000"
    node, key = rng.choice(places)
    choice = rng.random()
    if choice < 0.15:
        del node[key]
    elif choice < 0.25 and isinstance(node, dict):
        node[rng.choice(_KEYS)] = node.pop(key)
    elif choice < 0.35:
        other, at = rng.choice(places)
        try:
            node[key] = json.loads(json.dumps(other[at]))
        except (KeyError, IndexError):
            del node[key]
    else:
        node[key] = mark
    written = json.dumps(document)
    return written.replace(json.dumps(mark), rng.choice(VALUES)).encode("utf-8", "surrogatepass")


_KEYS = ("", "x", "a\nb", "\x1b[2J", "k" * 100_000, "\ud800", "__class__")
