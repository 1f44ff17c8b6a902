"""Picture files are read as their makers meant them: layouts, pages, scan orders, colour."""

from __future__ import annotations

import itertools
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any, get_args

import numpy as np
import OpenEXR
import pytest
import tifffile
from numpy.typing import NDArray
from PIL import Image

from fuzz import seeds
from fuzz.damage import png_chunk
from pbrfit._core import InputError
from pbrfit.io import color, images
from pbrfit.io.input_files import digest
from scene_files import known

RNG = np.random.default_rng(4)
RGBA8: NDArray[np.uint8] = RNG.integers(1, 255, (41, 53, 4), dtype=np.uint8)
RGB8 = np.ascontiguousarray(RGBA8[..., :3])
GREY8 = np.ascontiguousarray(RGBA8[..., 0])
RGB16 = RGB8.astype(np.uint16) * 257 + 3
FLOAT = RNG.random((41, 53, 3)).astype(np.float32)


TILES: dict[str, Any] = {"planarconfig": "separate", "tile": (16, 16)}


@pytest.mark.parametrize("options", [
    {}, {"byteorder": ">"}, {"bigtiff": True}, {"compression": "deflate"}, {"tile": (48, 64)},
])  # fmt: skip
@pytest.mark.parametrize("pixels", [RGB8, RGBA8, RGB16, FLOAT])
def test_tiles_in_separate_planes(tmp_path: Path, pixels: Any, options: dict[str, Any]) -> None:
    path = tmp_path / "a.tif"
    alpha = {"extrasamples": ["unassalpha"]} if pixels.shape[2] == 4 else {}
    how = {**TILES, "photometric": "rgb", **alpha, **options}
    unit = 1 if pixels.dtype.kind == "f" else np.iinfo(pixels.dtype).max
    for strips in ({}, {"tile": None}):
        tifffile.imwrite(path, np.moveaxis(pixels, -1, 0), **how | strips)
        np.testing.assert_array_equal(images.read_data(path), pixels / np.float64(unit))


def test_tiles_that_are_far_larger_than_the_picture(tmp_path: Path) -> None:
    path = tmp_path / "a.tif"
    tifffile.imwrite(path, np.moveaxis(RGB8, -1, 0), photometric="rgb", **TILES)
    with tifffile.TiffFile(path, mode="r+") as file:
        file.pages.first.tags["TileLength"].overwrite(1 << 30)
    with pytest.raises(InputError, match=r"a\.tif: expected a whole TIFF file, found"):
        images.read_data(path)


def pages(*written: tuple[NDArray[Any], dict[str, Any]]) -> Callable[[Path, bool], None]:
    def write(path: Path, big: bool) -> None:
        with tifffile.TiffWriter(path, bigtiff=big, byteorder=">" if big else "<") as file:
            for pixels, options in written:
                file.write(pixels, **{"photometric": "rgb", "metadata": None, **options})

    return write


SMALL, QUARTER, HALF = RGB8[:10, :13], RGB8[:11, :14], RGB8[:21, :27]
REDUCED, OLD = {"subfiletype": 1}, {"extratags": [(255, 3, 1, 2, True)]}
PAGES: dict[str, tuple[Callable[[Path, bool], None], int | str]] = {
    "thumbnail first": (pages((SMALL, REDUCED), (RGB8, {})), 1),
    "thumbnail last": (pages((RGB8, {}), (SMALL, REDUCED)), 1),
    "thumbnail of the old kind": (pages((SMALL, OLD), (RGB8, {})), 1),
    "thumbnail that does not say so": (pages((SMALL, {}), (RGB8, {})), 1),
    "pyramid": (pages((RGB8, {"tile": (16, 16)}), (HALF, REDUCED), (QUARTER, REDUCED)), 2),
    "pyramid that does not say so": (pages((RGB8, {}), (HALF, {}), (QUARTER, {})), 2),
    "mask": (pages((RGB8, {}), (GREY8 > 99, {"subfiletype": 4, "photometric": "mask"})), 1),
    "levels below": (pages((RGB8, {"subifds": 1}), (HALF, REDUCED)), 0),
    "picture below its thumbnail": (pages((SMALL, {"subifds": 1, **REDUCED}), (RGB8, {})), 1),
    "says that it is reduced": (pages((RGB8, REDUCED)), 0),
    "planar tiles behind a thumbnail": (
        pages((SMALL, REDUCED), (np.moveaxis(RGB8, -1, 0), TILES)), 1
    ),
    "stack": (pages(*[(RGB8, {})] * 6), "expected one picture, found 6 pages"),
    "scans of two sizes": (pages((RGB8, {}), (RGB8[:22], {})), "found 2 pages that differ"),
    "more than half": (pages((RGB8, {}), (RGB8[:22, :27], {})), "found 2 pages that differ"),
    "another kind": (pages((RGB8, {}), (GREY8, {"photometric": "minisblack"})), "that differ"),
}  # fmt: skip


@pytest.mark.parametrize("big", [False, True])
@pytest.mark.parametrize("name", PAGES)
def test_the_one_page_of_full_resolution(tmp_path: Path, name: str, big: bool) -> None:
    write, expected = PAGES[name]
    path = tmp_path / "a.tif"
    write(path, big)
    if isinstance(expected, str):
        with pytest.raises(InputError, match=rf"a\.tif: .*{expected}"):
            images.read_picture(path)
        return
    np.testing.assert_array_equal(images.read_data(path), RGB8 / 255)
    notes = (f"smaller pages not read ({expected} of each file)",) if expected else ()
    assert images.read_picture(path).notes == notes


STACK = [np.ascontiguousarray(np.roll(RGB8, i, axis=0)) for i in range(12)]


@pytest.mark.parametrize("big", [False, True])
@pytest.mark.parametrize(("written", "count"), [
    ([(one, {"subfiletype": 2}) for one in STACK], 12),
    ([(np.moveaxis(one, -1, 0), TILES) for one in STACK[:3]], 3),
    ([page for one in STACK[:3] for page in ((SMALL, REDUCED), (one, {}))], 3),
    ([page for one in STACK[:3] for page in ((SMALL, {"subifds": 1, **REDUCED}), (one, {}))], 3),
    ([(one.astype(np.uint16) * 257, {}) for one in STACK[:2]], 2),
    ([(one.astype(np.float32) / 255, {}) for one in STACK[:2]], 2),
])  # fmt: skip
def test_pages_of_a_stack_are_pictures(tmp_path: Path, written: Any, count: int, big: bool) -> None:
    path = tmp_path / "a.tif"
    pages(*written)(path, big)
    names = [f"a_{i + 1:02}" if count > 9 else f"a_{i + 1}" for i in range(count)]
    found = images.pages(path)
    assert found == [path / f"{name}.tif" for name in names]
    for page, expected in zip(found, STACK, strict=False):
        picture = images.read_picture(page, "linear")
        np.testing.assert_allclose(picture.pixels, expected / np.float32(255), rtol=1e-6)
        assert picture.notes[0] == "pages of a.tif"
        assert picture.sha256 == digest(images.file_of(page)) == digest(path)
    with pytest.raises(InputError, match=r"a\.tif.a_99.*found: fewer pages"):
        images.read_picture(path / "a_99.tif")
    png(tmp_path / "b.png")
    assert images.pages(tmp_path / "b.png") == [tmp_path / "b.png"]


@pytest.mark.parametrize("unit", [255, 65535, 1])
def test_colours_of_tiff_that_are_multiplied_by_alpha(tmp_path: Path, unit: int) -> None:
    kind = {255: np.uint8, 65535: np.uint16, 1: np.float32}[unit]
    alpha = np.tile(np.linspace(0, unit, 53).astype(kind), (41, 1))
    stored = np.dstack([np.minimum((FLOAT * unit).astype(kind), alpha[..., None]), alpha])
    path = tmp_path / "a.tif"
    for extra in ("assocalpha", "unassalpha"):
        tifffile.imwrite(path, stored, photometric="rgb", extrasamples=[extra])
        part = (2.0 * alpha >= unit) & (extra == "assocalpha")
        expected = stored[..., :3] / np.where(part, alpha, unit)[..., None]
        found = images.read_picture(path, "linear").pixels
        np.testing.assert_allclose(found, expected, rtol=1e-6, atol=0.51 / unit if unit > 1 else 0)
        np.testing.assert_array_equal(images.read_data(path), stored / unit)
        as_stored = images.read_picture(path, "linear", straight=False).pixels
        np.testing.assert_allclose(as_stored, stored[..., :3] / unit, rtol=1e-6)


@pytest.mark.parametrize("how", [{"imagej": True}, {"ome": True}])
def test_pages_that_are_channels_are_refused(tmp_path: Path, how: Any) -> None:
    path = tmp_path / "a.tif"
    channels = {"axes": "CYX", "mode": "composite"}
    tifffile.imwrite(path, np.moveaxis(RGB16, -1, 0), **how, metadata=channels)
    with pytest.raises(InputError, match=r"a\.tif: expected pages that are pictures, found one"):
        images.pages(path)
    tifffile.imwrite(path, np.stack(STACK[:3]), **how)  # whose channels are not pages
    assert len(images.pages(path)) == 3


@pytest.mark.parametrize("options", [{}, {"subsampling": 0}])
def test_ycbcr_of_jpeg(tmp_path: Path, options: dict[str, Any]) -> None:
    path = tmp_path / "a.tif"
    smooth = Image.fromarray(np.linspace(0, 255, 48 * 64 * 3).reshape(48, 64, 3).astype(np.uint8))
    smooth.convert("YCbCr").save(path, compression="jpeg", quality=95, **options)
    with Image.open(path) as theirs:
        off = images.read_data(path) * 255 - np.asarray(theirs.convert("RGB"))
    assert np.abs(off).max() <= 4  # as of JPEG files, decoders differ in chroma
    smooth.convert("YCbCr").save(path)
    with pytest.raises(InputError, match=r"a\.tif: expected a grey or RGB TIFF, found"):
        images.read_data(path)


def test_pages_that_follow_each_other_for_ever(tmp_path: Path) -> None:
    path = tmp_path / "a.tif"
    pages((RGB8, {}))(path, False)
    data = bytearray(path.read_bytes())
    [first] = struct.unpack_from("<I", data, 4)
    [count] = struct.unpack_from("<H", data, first)
    struct.pack_into("<I", data, first + 2 + 12 * count, first)
    path.write_bytes(data)
    with pytest.raises(InputError, match=r"a\.tif: .*cycle"):
        images.read_data(path)


WIDE: NDArray[np.uint8] = RNG.integers(128, 256, (5, 9, 4), dtype=np.uint8)
WIDE[..., 3] = 129
RADIANCE = WIDE[..., :3] / 256 * 2


def hdr(
    path: Path, scanlines: NDArray[Any], order: str, lines: str = "", kind: str = "rgbe"
) -> Path:
    first, second = order.split()
    head = f"#?RADIANCE\n{lines}FORMAT=32-bit_rle_{kind}\n\n"
    head += f"{first} {len(scanlines)} {second} {scanlines.shape[1]}\n"
    path.write_bytes(head.encode() + scanlines.tobytes())
    return path


@pytest.mark.parametrize("slow", ["-Y", "+Y", "-X", "+X"])
@pytest.mark.parametrize("fast", ["-Y", "+Y", "-X", "+X"])
def test_hdr_in_all_orders(tmp_path: Path, slow: str, fast: str) -> None:
    """ "-Y" counts rows from the top, as Radiance's Y grows upwards; "+X" columns from the left."""
    if slow[1] == fast[1]:
        hdr(tmp_path / "a.hdr", WIDE, f"{slow} {fast}")
        with pytest.raises(InputError, match=r"a\.hdr: expected a whole HDR file"):
            images.read_picture(tmp_path / "a.hdr")
        return
    scanlines = WIDE
    if "+Y" in (slow, fast):
        scanlines = scanlines[::-1]
    if "-X" in (slow, fast):
        scanlines = scanlines[:, ::-1]
    if slow[1] == "X":
        scanlines = scanlines.swapaxes(0, 1)
    path = hdr(tmp_path / "a.hdr", np.ascontiguousarray(scanlines), f"{slow} {fast}")
    for orientation in get_args(images.Orientation):
        found = images.read_picture(path, orientation=orientation).pixels
        np.testing.assert_array_equal(found, RADIANCE.astype(np.float32))
    np.testing.assert_array_equal(images.read_data(path), RADIANCE)


P3 = "0.68 0.32 0.265 0.69 0.15 0.06 0.3127 0.329"


@pytest.mark.parametrize(
    ("lines", "kind", "matrix", "factors"),
    [
        ("EXPOSURE=2\n", "rgbe", None, (2, 2, 2)),
        ("EXPOSURE= 2\nEXPOSURE=0.25\n", "rgbe", None, (0.5, 0.5, 0.5)),
        ("EXPOSURE=2\nCOLORCORR=1 0.5 2\n", "rgbe", None, (2, 1, 4)),
        ("EXPOSURE=much\nEXPOSURE=0\nEXPOSURE=inf\nVIEW=x\n", "rgbe", None, (1, 1, 1)),
        (
            f"PRIMARIES={' '.join('0' * 8)}\n",
            "rgbe",
            np.eye(3),
            (1, 1, 1),
        ),  # of files that know none
        (f"PRIMARIES={P3}\n", "rgbe", color.to_rec709(color.DISPLAY_P3), (1, 1, 1)),
        ("", "xyze", color.to_rec709(color.CIE_XYZ), (1, 1, 1)),
        ("EXPOSURE=4\n", "xyze", color.to_rec709(color.CIE_XYZ), (4, 4, 4)),
    ],
)
def test_the_header_of_an_hdr_file_counts(
    tmp_path: Path, lines: str, kind: str, matrix: Any, factors: tuple[float, ...]
) -> None:
    picture = images.read_picture(hdr(tmp_path / "a.hdr", WIDE, "-Y +X", lines, kind))
    expected = RADIANCE / factors @ (np.eye(3) if matrix is None else matrix).T
    np.testing.assert_allclose(picture.pixels, expected, rtol=1e-5, atol=1e-6)
    assert len(picture.notes) == (factors != (1, 1, 1))


XYZ = (1.0, 0.0, 0.0, 1.0, 0.0, 0.0, 1 / 3, 1 / 3)
AP0 = (0.7347, 0.2653, 0.0, 1.0, 0.0001, -0.077, 0.32168, 0.33767)
AP1 = (0.713, 0.293, 0.165, 0.830, 0.128, 0.044, 0.32168, 0.33767)
XY0 = (0.64, 0.33, 0.3, 0.6, 0.2, 0.0, 0.3127, 0.329)


@pytest.mark.parametrize("chromaticities", [None, XYZ, AP0, AP1, XY0])
@pytest.mark.parametrize("layer", [None, "beauty"])
@pytest.mark.parametrize("alpha", [False, True])
@pytest.mark.parametrize("luminance", [False, True])
def test_exr_primaries_and_luminance(
    tmp_path: Path, chromaticities: Any, layer: str | None, alpha: bool, luminance: bool
) -> None:
    """Files of Y, RY and BY (OpenEXR, ImfRgbaYca.h) hold the colours that files of R, G, B do."""
    header: dict[str, Any] = {"compression": OpenEXR.ZIP_COMPRESSION}
    points = (0.64, 0.33, 0.3, 0.6, 0.15, 0.06, 0.3127, 0.329)
    if chromaticities is not None:
        points = header["chromaticities"] = chromaticities
    # The matrix by hand: columns (x, y, z) of the primaries, scaled so that they add up to white.
    columns = np.array(
        [(x, y, 1 - x - y) for x, y in zip(points[::2], points[1::2], strict=True)]
    ).T
    to_xyz = columns[:, :3] * np.linalg.solve(columns[:, :3], columns[:, 3] / columns[1, 3])
    planes = dict(zip("RGB", np.moveaxis(FLOAT, -1, 0), strict=True))
    if luminance and chromaticities is not XYZ:
        y = FLOAT @ to_xyz[1]
        planes = {"Y": y, "RY": (planes["R"] - y) / y, "BY": (planes["B"] - y) / y}
    if alpha:
        planes["A"] = FLOAT[..., 0]
    prefix = "" if layer is None else f"{layer}."
    channels = {prefix + name: np.ascontiguousarray(p, np.float32) for name, p in planes.items()}
    path = str(tmp_path / "a.exr")
    OpenEXR.File(header, channels).write(path)
    picture = images.read_picture(path, layer=layer)
    rec709 = color.rgb_to_xyz(color.REC709)
    cones = color._BRADFORD
    gain = (cones @ rec709.sum(axis=1)) / (cones @ to_xyz.sum(axis=1))
    adapted = np.linalg.solve(cones, gain[:, None] * (cones @ to_xyz))
    expected = FLOAT @ np.linalg.solve(rec709, adapted).T
    if alpha:  # by which colours are multiplied
        expected /= np.where((FLOAT >= 0.5) & (FLOAT < 1), FLOAT, 1)[..., :1]
    np.testing.assert_allclose(picture.pixels, expected, rtol=1e-4, atol=2e-4)
    np.testing.assert_array_equal(picture.alpha, FLOAT[..., 0] if alpha else None)
    if chromaticities is None:
        assert picture.color.endswith("linear Rec.709 (EXR without chromaticities)")
    else:
        assert picture.color.endswith("linear, converted from the EXR's chromaticities")
    assert picture.color.startswith("layer beauty, ") == (layer == "beauty")


NAMES: list[tuple[dict[str, Any], str | None, str]] = [
    ({"colorInteropID": "lin_rec709_scene"}, None, "linear"),
    ({"colorInteropID": "lin_ap1_scene"}, None, "acescg"),
    ({"colorInteropID": "lin_ap1_scene", "chromaticities": AP1}, "acescg", "acescg"),
    ({"colorInteropID": "lin_ap1_scene", "oiio:ColorSpace": "sRGB"}, None, "acescg"),
    ({"colorInteropID": "srgb_rec709_display"}, None, "srgb"),
    ({"colorInteropID": "srgb_p3d65_scene"}, "display-p3", "display-p3"),
    ({"oiio:ColorSpace": "lin_srgb"}, None, "linear"),
    ({"oiio:ColorSpace": "ACEScg"}, None, "acescg"),
    ({"oiio:ColorSpace": "Linear Rec.709 (sRGB)"}, None, "linear"),
    ({"oiio:ColorSpace": "Linear", "chromaticities": AP1}, None, "acescg"),
    ({"colorInteropID": "unknown"}, "srgb", "srgb"),
    ({"colorInteropID": "pq_rec2020_display"}, "linear", "linear"),
    ({"colorInteropID": 3}, None, "linear"),
    ({"colorInteropID": "pq_rec2020_display"}, None, "a known .*, found pq_rec2020_display"),
    ({"colorInteropID": "lin_ap1_scene", "chromaticities": AP0}, None, "acescg"),
    ({"colorInteropID": "lin_ap1_scene"}, "linear", "colour space linear, as .*, found lin_ap1"),
]


@pytest.mark.parametrize(("header", "asked", "expected"), NAMES)
def test_colour_spaces_that_exr_files_name(
    tmp_path: Path, header: dict[str, Any], asked: Any, expected: Any
) -> None:
    path = str(tmp_path / "a.exr")
    OpenEXR.File(header, {"RGB": FLOAT}).write(path)
    if expected not in get_args(color.ColorSpace):
        with pytest.raises(InputError, match=rf"a\.exr: expected .*{expected}"):
            images.read_picture(path, asked)
        return
    found = images.read_picture(path, asked)
    wanted = color.conversion(expected)(FLOAT)
    np.testing.assert_allclose(found.pixels, wanted, rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("alpha", [None, 0, 1])
def test_what_is_outside_of_the_data_window_is_untold(tmp_path: Path, alpha: int | None) -> None:
    """Without alpha that tells, it is NaN, which is no sample; with alpha, it is transparent."""
    path = str(tmp_path / "a.exr")
    corners = {"displayWindow": ((0, 0), (59, 40)), "dataWindow": ((0, 0), (52, 40))}
    header = {name: tuple(np.array(p, np.int32) for p in of) for name, of in corners.items()}
    channels = {"RGB": FLOAT}
    if alpha is not None:
        channels = {"RGBA": np.dstack([FLOAT, np.full((41, 53), alpha, np.float32)])}
    OpenEXR.File(header, channels).write(path)
    found = images.read_picture(path)
    np.testing.assert_array_equal(found.pixels[:, :53], FLOAT)
    np.testing.assert_array_equal(found.pixels[:, 53:], 0 if alpha else np.nan)
    assert (found.alpha is not None) == bool(alpha)
    if alpha:
        assert known(found.alpha)[:, :53].all()
        assert not known(found.alpha)[:, 53:].any()
    assert np.isnan(images.read_picture(path, straight=False).pixels[:, 53:]).all()


@pytest.mark.parametrize(
    ("points", "message"),
    [
        ((*XYZ[:6], 0.5, 0.0), "of white y > 0"),
        ((*XYZ[:6], 0.5, 0.5), "triangle"),
        ((0.1, 0.1, 0.2, 0.2, 0.3, 0.3, 0.3127, 0.329), "triangle"),
    ],
)
def test_primaries_that_are_none_are_refused(tmp_path: Path, points: Any, message: str) -> None:
    path = str(tmp_path / "a.exr")
    OpenEXR.File({"chromaticities": points}, {"RGB": FLOAT}).write(path)
    with pytest.raises(InputError, match=rf"a\.exr: chromaticities: expected .*{message}"):
        images.read_picture(path)


def power(exponent: float) -> NDArray[np.float64]:
    return (RGB8 / 255) ** exponent


SRGB = color.decode_srgb(RGB8 / 255)
ADOBE = power(563 / 256) @ color.to_rec709(color.ADOBE_RGB).T


def exif(color_space: int, index: str | None = None) -> Image.Exif:
    tags = Image.Exif()
    tags[0x8769] = {0xA001: color_space} | ({} if index is None else {0xA005: {1: index}})
    return tags


def chrm(points: color.Primaries) -> bytes:
    x_y = itertools.chain(points.white, points.red, points.green, points.blue)
    return struct.pack(">8I", *(round(1e5 * value) for value in x_y))


def png(path: Path, **chunks: bytes) -> None:
    """A PNG with chunks behind its header, without a profile."""
    Image.fromarray(RGB8).save(path)
    data = path.read_bytes()
    more = b"".join(png_chunk(name.encode(), body) for name, body in chunks.items())
    path.write_bytes(data[:33] + more + data[33:])


def gama(gamma: float) -> bytes:
    return struct.pack(">I", round(1e5 * gamma))


P3_MATRIX = color.to_rec709(color.DISPLAY_P3).T
CHUNKS: dict[str, tuple[dict[str, bytes], NDArray[np.float64]]] = {
    "linear": ({"gAMA": gama(1)}, power(1)),
    "of old displays": ({"gAMA": gama(1 / 1.8)}, power(1 / round(1 / 1.8, 5))),
    "of sRGB": ({"gAMA": gama(0.45455), "cHRM": chrm(color.REC709)}, SRGB),
    "usual": ({"gAMA": gama(0.45455)}, SRGB),
    "none": ({"gAMA": gama(0)}, SRGB),
    "coded sRGB": ({"cICP": bytes([1, 13, 0, 1])}, SRGB),
    "Adobe RGB": (
        {"gAMA": gama(256 / 563), "cHRM": chrm(color.ADOBE_RGB)},
        power(1 / round(256 / 563, 5)) @ color.to_rec709(color.ADOBE_RGB).T,
    ),
    "primaries alone": ({"cHRM": chrm(color.DISPLAY_P3)}, SRGB @ P3_MATRIX),
    "sRGB before others": ({"sRGB": b"\0", "gAMA": gama(1), "cHRM": chrm(color.DISPLAY_P3)}, SRGB),
    "Display P3": ({"cICP": bytes([12, 13, 0, 1]), "gAMA": gama(1)}, SRGB @ P3_MATRIX),
    "linear Rec.2020": ({"cICP": bytes([9, 8, 0, 1])}, power(1) @ color.to_rec709(color.REC2020).T),
    "coded power": ({"cICP": bytes([1, 4, 0, 1])}, power(2.2)),
}


@pytest.mark.parametrize("name", CHUNKS)
def test_colour_chunks_of_png(tmp_path: Path, name: str) -> None:
    chunks, expected = CHUNKS[name]
    png(tmp_path / "a.png", **chunks)
    picture = images.read_picture(tmp_path / "a.png")
    np.testing.assert_allclose(picture.pixels, expected, rtol=1e-4, atol=2e-6)
    assert picture.curve_told == (expected is not SRGB)
    assert picture.color.endswith(
        "chunk of the 8-bit PNG" if "cICP" in chunks and picture.curve_told
        else "sRGB (8-bit PNG without a profile)" if expected is SRGB else "of the 8-bit PNG"
    )  # fmt: skip
    asked = images.read_picture(tmp_path / "a.png", color_space="srgb")
    np.testing.assert_allclose(asked.pixels, SRGB, rtol=1e-6)
    noise = known(picture.stored).noise(picture.pixels.shape[:2]).deviation(np.zeros((1, 1, 3)))
    assert (noise > 0).all()  # also where a power is flat


def test_primaries_of_a_png_that_are_none_are_refused(tmp_path: Path) -> None:
    png(tmp_path / "a.png", cHRM=bytes(32))
    with pytest.raises(InputError, match=r"a\.png: chromaticities: expected"):
        images.read_picture(tmp_path / "a.png")


@pytest.mark.parametrize("form", ["JPEG", "PNG", "TIFF"])
def test_that_exif_says_another_space_than_the_assumed_one(tmp_path: Path, form: str) -> None:
    Image.fromarray(RGB8).save(tmp_path / "a", form, exif=exif(65535).tobytes())
    said = f"sRGB (8-bit {form} without a profile, and EXIF says another colour space)"
    assert images.read_picture(tmp_path / "a").color == said


@pytest.mark.parametrize("form", ["JPEG", "PNG"])
@pytest.mark.parametrize(
    ("tags", "profile", "expected", "told"),
    [
        (exif(65535, "R03"), None, ADOBE, "Adobe RGB (EXIF of the 8-bit {})"),
        (exif(2), None, ADOBE, "Adobe RGB (EXIF of the 8-bit {})"),
        (exif(1, "R98"), None, SRGB, "sRGB (8-bit {} without a profile)"),
        (exif(65535, "R03"), "srgb", SRGB, "ICC profile of the 8-bit {}"),
    ],
)
def test_adobe_rgb_by_exif(
    tmp_path: Path, form: str, tags: Image.Exif, profile: str | None, expected: Any, told: str
) -> None:
    more = {} if profile is None else {"icc_profile": seeds.profile()}
    path = tmp_path / "a"
    flat = np.full((16, 16, 3), (200, 40, 90), np.uint8)
    Image.fromarray(flat).save(path, form, exif=tags.tobytes(), **more)
    picture = images.read_picture(path)
    assert picture.color == told.format(form)
    space: color.ColorSpace = "adobe-rgb" if expected is ADOBE else "srgb"
    by_name = images.read_picture(path, color_space=space)
    np.testing.assert_allclose(picture.pixels, by_name.pixels, atol=1e-3)
    assert picture.taken.settings["colour profile"] == space
