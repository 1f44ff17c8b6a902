"""Files made to deceive: a few bytes that claim huge sizes, and streams that grow out of them.

Each function gives names and contents of files of its format.
"""

from __future__ import annotations

import json
import struct
import zlib
from collections.abc import Iterator

from fuzz.damage import png_chunk

_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_SIDES = (
    (0x7FFFFFFF, 0x7FFFFFFF), (0x7FFFFFFF, 1), (1, 0x7FFFFFFF), (16384, 16384), (65535, 65535),
    (16385, 16384), (4096, 4096), (0, 0), (0xFFFFFFFF, 0xFFFFFFFF),
)  # fmt: skip


def _header(width: int, height: int, depth: int = 8, color: int = 2, interlace: int = 0) -> bytes:
    body = struct.pack(">IIBBBBB", width, height, depth, color, 0, 0, interlace)
    return _SIGNATURE + png_chunk(b"IHDR", body)


def png() -> Iterator[tuple[str, bytes]]:
    """PNG: sizes, bombs in IDAT, iCCP, zTXt and iTXt, animation frames beside the picture."""
    data, end = png_chunk(b"IDAT", zlib.compress(b"\0\0\0\0")), png_chunk(b"IEND", b"")
    for width, height in _SIDES:
        for depth, color, interlace in ((8, 2, 0), (16, 6, 1), (1, 0, 0), (8, 3, 0)):
            name = f"claims {width} x {height} depth {depth} color {color}"
            palette = png_chunk(b"PLTE", b"abc") if color == 3 else b""
            yield name, _header(width, height, depth, color, interlace) + palette + data + end
    bomb = zlib.compress(bytes(1 << 28), 9)
    yield "data bomb", _header(8, 8) + png_chunk(b"IDAT", bomb) + end
    profile = png_chunk(b"iCCP", b"p\0\0" + bomb)
    yield "profile bomb", _header(1, 1) + profile + data + end
    yield "text bomb", _header(1, 1) + png_chunk(b"zTXt", b"p\0\0" + bomb) + data + end
    itxt = png_chunk(b"iTXt", b"pbrfit\0\1\0\0\0" + bomb)
    yield "international text bomb", _header(1, 1) + itxt + data + end
    # As large as these bytes can be: black at a thousandth of its size.
    side = 2048
    black = zlib.compress(bytes(side * (1 + 3 * side)), 9)
    yield "black", _header(side, side) + png_chunk(b"IDAT", black) + end
    control = png_chunk(b"acTL", struct.pack(">II", 0xFFFFFFFF, 0))
    frame = struct.pack(">IIIIIHHBB", 0, 0x7FFFFFFF, 0x7FFFFFFF, 0, 0, 1, 1, 0, 0)
    yield "animation", _header(1, 1) + control + png_chunk(b"fcTL", frame) + data + end
    yield "no data", _header(16, 16) + end
    yield "many chunks", _header(1, 1) + png_chunk(b"tEXt", b"a\0b") * 50_000 + data + end


def jpeg() -> Iterator[tuple[str, bytes]]:
    """JPEG: sizes, a picture of very many scans, segments without end."""
    tables = b"\xff\xdb\0\x43\0" + bytes([1] * 64)
    huffman = b"\xff\xc4\0\x14\0\x01" + bytes(15) + b"\0"
    huffman += b"\xff\xc4\0\x14\x10\x01" + bytes(15) + b"\0"
    scan = b"\xff\xda\0\x0c\x03\1\0\2\0\3\0\0\x3f\0" + bytes(64)
    for frame in (0xC0, 0xC1, 0xC2, 0xC3, 0xC9):
        for width, height in ((65535, 65535), (65535, 1), (1, 65535), (0, 0), (16384, 16384)):
            for sampling in (0x11, 0x22, 0x44, 0xFF):
                parts = bytes([1, sampling, 0, 2, 0x11, 0, 3, 0x11, 0])
                sof = bytes([0xFF, frame]) + struct.pack(">HBHHB", 17, 8, height, width, 3) + parts
                yield (
                    f"frame {frame:x} {width} x {height} sampled {sampling:x}",
                    b"\xff\xd8" + tables + sof + huffman + scan + b"\xff\xd9",
                )
    # Every scan of a progressive picture goes over all of it.
    sof = b"\xff\xc2" + struct.pack(">HBHHB", 11, 8, 4096, 4096, 1) + bytes([1, 0x11, 0])
    one = b"\xff\xda\0\x08\x01\1\0\0\0\0" + b"\0"
    again = b"\xff\xda\0\x08\x01\1\0\1\x3f\0" + b"\0"
    for count in (100, 20_000):
        many = b"\xff\xd8" + tables + sof + huffman + one + again * count + b"\xff\xd9"
        yield f"{count} scans", many
    small = sof.replace(struct.pack(">HH", 4096, 4096), struct.pack(">HH", 1024, 1024))
    filled = one + bytes(60_000)
    many = b"\xff\xd8" + tables + small + huffman + filled + again * 10_000 + b"\xff\xd9"
    yield "10000 scans of a filled picture", many
    yield "many segments", b"\xff\xd8" + b"\xff\xe1\0\x08abcdef" * 100_000 + b"\xff\xd9"
    yield "only fill bytes", b"\xff\xd8" + b"\xff" * 3_000_000


def tiff() -> Iterator[tuple[str, bytes]]:
    """TIFF: sizes, counts of strips and tiles, values larger than the file, a loop of pages."""

    def file(**changed: tuple[int, int, int]) -> bytes:
        entries: dict[int, tuple[int, int, int]] = {
            256: (4, 1, 16), 257: (4, 1, 16), 258: (3, 1, 8), 259: (3, 1, 1), 262: (3, 1, 1),
            273: (4, 1, 8), 277: (3, 1, 1), 278: (4, 1, 16), 279: (4, 1, 256),
        }  # fmt: skip
        entries |= {int(key[1:]): value for key, value in changed.items()}
        body = struct.pack("<H", len(entries))
        for tag, (kind, count, value) in sorted(entries.items()):
            body += struct.pack("<HHII", tag, kind, count, value & 0xFFFFFFFF)
        return b"II*\0" + struct.pack("<I", 264) + bytes(256) + body + struct.pack("<I", 264)

    for width, height in _SIDES:
        for compression in (1, 5, 8, 7, 32773):
            for bits in (8, 16, 32, 64, 65535):
                name = f"claims {width} x {height} compression {compression} bits {bits}"
                yield name, file(
                    _256=(4, 1, width), _257=(4, 1, height), _259=(3, 1, compression),
                    _258=(3, 1, bits), _278=(4, 1, height),
                )  # fmt: skip
    big = 0xFFFFFFFF
    yield "rows of no strip", file(_278=(4, 1, 0))
    yield "one row a strip", file(_257=(4, 1, 1 << 20), _278=(4, 1, 1), _273=(4, 1 << 20, 8))
    yield "many strips", file(_273=(4, big, 8), _279=(4, big, 8))
    yield "long strip", file(_279=(4, 1, big))
    yield "many samples", file(_277=(3, 1, 65535))
    yield "tiles without size", file(_322=(4, 1, 0), _323=(4, 1, 0), _324=(4, 1, 8))
    for side in (1, 16, 1 << 16, 1 << 31, big):
        tiles = file(_322=(4, 1, side), _323=(4, 1, side), _324=(4, 1, 8), _325=(4, 1, 256))
        yield f"tiles of {side}", tiles
    yield "profile beyond the file", file(_34675=(7, big, 8))
    yield "large profile", file(_34675=(7, 1 << 25, 8))
    yield "exif loop", file(_34665=(4, 1, 264))
    yield "sub pages", file(_330=(4, big, 264))


def hdr() -> Iterator[tuple[str, bytes]]:
    """Radiance HDR: sizes, runs, headers without end."""
    head = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n"
    for width, height in (*_SIDES, (1 << 40, 1), (10**30, 10**30), (-1, -1)):
        yield f"claims {width} x {height}", head + f"-Y {height} +X {width}\n".encode() + bytes(64)
    runs = b"\1\1\1\xff" * 64
    for width in (4096, 32767, 65536, 1 << 24):
        yield f"old runs over {width}", head + f"-Y 16 +X {width}\n".encode() + b"abcd" + runs
    yield "long header", b"#?RADIANCE\n" + b"EXPOSURE=1\n" * 300_000
    yield "long line", b"#?RADIANCE\n" + b"x" * 3_000_000


def exr() -> Iterator[tuple[str, bytes]]:
    """EXR: windows, channels, tiles, chunk counts and counters of chunks that claim too much."""

    def attribute(name: str, kind: str, body: bytes) -> bytes:
        return f"{name}\0{kind}\0".encode() + struct.pack("<I", len(body)) + body

    def file(
        data: tuple[int, int, int, int],
        display: tuple[int, int, int, int] | None = None,
        *,
        channels: int = 3,
        compression: int = 3,
        tile: tuple[int, int, int] | None = None,
        chunks: int = 4,
        chunk: bytes = bytes(64),
    ) -> bytes:
        names = [f"c{k}" if channels > 3 else "BGR"[k] for k in range(channels)]
        listed = b"".join(
            name.encode() + b"\0" + struct.pack("<IIII", 2, 0, 1, 1) for name in sorted(names)
        )
        head = b"\x76\x2f\x31\x01" + struct.pack("<I", 2 | (0x200 if tile else 0))
        head += attribute("channels", "chlist", listed + b"\0")
        head += attribute("compression", "compression", bytes([compression]))
        head += attribute("dataWindow", "box2i", struct.pack("<4i", *data))
        head += attribute("displayWindow", "box2i", struct.pack("<4i", *(display or data)))
        head += attribute("lineOrder", "lineOrder", b"\0")
        head += attribute("pixelAspectRatio", "float", struct.pack("<f", 1))
        head += attribute("screenWindowCenter", "v2f", bytes(8))
        head += attribute("screenWindowWidth", "float", struct.pack("<f", 1))
        if tile:
            head += attribute("tiles", "tiledesc", struct.pack("<IIB", *tile))
        head += b"\0"
        start = len(head) + 8 * chunks
        table = b"".join(struct.pack("<Q", start + 8 * k) for k in range(chunks))
        return head + table + struct.pack("<ii", data[1], len(chunk)) + chunk

    far = 2**31 - 1
    windows = ((0, 0, far, far), (-far - 1, -far - 1, far, far), (0, 0, far, 0), (0, 0, 0, far),
               (5, 5, 0, 0), (0, 0, 16383, 16383), (0, 0, 4095, 4095), (far - 1, far - 1, far, far),
               (-far - 1, 0, -far, 15), (0, 0, 0, 0))  # fmt: skip
    for window in windows:
        for compression in (0, 1, 3, 4, 5, 6, 8, 9, 200):
            yield (
                f"window {window} compression {compression}",
                file(window, compression=compression),
            )
        yield f"display {window}", file((0, 0, 3, 3), window)
        yield f"data {window} in a small frame", file(window, (0, 0, 3, 3))
    for channels in (0, 64, 1000, 20_000):
        yield f"{channels} channels of 4096 x 4096", file((0, 0, 4095, 4095), channels=channels)
        yield f"{channels} channels of 64 x 64", file((0, 0, 63, 63), channels=channels)
    for tile in ((far, far, 0), (0, 0, 0), (1, 1, 2), (1 << 16, 1 << 16, 1), (16, 16, 255)):
        for compression in (0, 3, 4, 9):
            name = f"tiles {tile} compression {compression}"
            yield name, file((0, 0, 1023, 1023), tile=tile, compression=compression)
    huge = struct.pack("<11Q", 2, *([1 << 40] * 9), 1)
    yield "DWA counters", file((0, 0, 255, 255), compression=8, chunk=huge)
    yield "many chunks", file((0, 0, 0, 99_999), chunks=100_000, compression=0)


def npy() -> Iterator[tuple[str, bytes]]:
    """Arrays of numpy: shapes, types and headers."""
    for shape in ("(2147483648, 2147483648, 3)", "(1099511627776,)", "(-1, 16, 3)", "(0, 0, 3)",
                  "(65536, 65536, 3)", "(4096, 4096, 3)", "()", "(16, 16, 3.0)", "('a',)",
                  "(1,) * 99", "(" * 300 + ")" * 300, "(True, 3)"):  # fmt: skip
        for kind in ("<f4", "<f8", "|O", "<U1000000000", "|V999999999", "<i8"):
            text = f"{{'descr': '{kind}', 'fortran_order': False, 'shape': {shape}, }}".encode()
            header = text + b" " * (-(len(text) + 11) % 64) + b"\n"
            yield (
                f"{kind} {shape[:40]}",
                (b"\x93NUMPY\1\0" + struct.pack("<H", len(header)) + header + bytes(64)),
            )
    yield "empty", b""
    yield "a zip archive", b"PK\3\4" + bytes(30)
    yield "an empty zip archive", b"PK\5\6" + bytes(18)
    yield "a pickle", b"\x80\4N."
    yield "long header", b"\x93NUMPY\2\0" + struct.pack("<I", 2**31 - 1) + b"{'descr': "


def journal() -> Iterator[tuple[str, bytes]]:
    """Pictures without an entry: sizes, texts that grow, texts that are nested."""
    data, end = png_chunk(b"IDAT", zlib.compress(b"\0\0\0\0")), png_chunk(b"IEND", b"")

    def told(text: bytes) -> bytes:
        return png_chunk(b"iTXt", b"pbrfit\0\1\0\0\0" + zlib.compress(text, 9))

    lists: dict[str, list[int]] = {key: [] for key in ("name", "prompt", "negative", "seed")}
    for width, height in _SIDES:
        yield f"claims {width} x {height}", _header(width, height) + told(b"{}") + data + end
    for name, text in (
        ("bomb", b'"' + b" " * (1 << 28) + b'"'), ("nested", b"[" * 100_000), ("list", b"[]"),
        ("large", b'"' + b"x" * (1 << 20) + b'"'),
        ("lists", json.dumps({"request": lists, "about": {}, "record": {}}).encode()),
    ):  # fmt: skip
        yield name, _header(1, 1) + told(text) + data + end
