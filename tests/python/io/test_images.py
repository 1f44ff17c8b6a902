"""Picture files of independent writers, read exactly; ours, read by independent readers."""

from __future__ import annotations

import dataclasses
import hashlib
import io
import logging
import re
import struct
import sys
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR
import pytest
import tifffile
from numpy.typing import NDArray
from PIL import Image, ImageOps

from fuzz import seeds
from fuzz.damage import png_of
from pbrfit._core import InputError
from pbrfit.io import color, images
from pbrfit.io.limits import AT_LEAST, AT_MOST
from pbrfit.io.resampling import averaged_channels
from scene_files import known

RNG = np.random.default_rng(0)
RGB8: NDArray[np.uint8] = RNG.integers(0, 256, (6, 9, 3), dtype=np.uint8)
RGB8[0, 0], RGB8[0, 1], RGB8[0, 2] = (255, 0, 0), (254, 254, 1), (255, 9, 99)
RGB16: NDArray[np.uint16] = RNG.integers(0, 65536, (6, 9, 3), dtype=np.uint16)
RGB16[0, 0], RGB16[0, 1] = (0, 65535, 0), (65534, 1, 0)
GREY8, GREY16 = RGB8[..., 0], RGB16[..., 1]
FLOAT: NDArray[np.float32] = (RNG.random((6, 9, 3), dtype=np.float32) * 4 - 1).astype(np.float32)


def limits_of(codes: NDArray[Any], low: int, high: int) -> NDArray[np.uint8]:
    return np.where(codes > high, AT_LEAST, np.where(codes < low, AT_MOST, 0)).astype(np.uint8)


def linear(samples: NDArray[Any]) -> NDArray[np.float32]:
    return color.decode_srgb(samples / np.iinfo(samples.dtype).max).astype(np.float32)


def save_exr(path: Path, channels: dict[str, Any], **header: Any) -> Path:
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage} | header
    OpenEXR.File(header, dict(channels)).write(str(path))
    return path


def save_png(path: Path, array: NDArray[Any], **options: Any) -> Path:
    Image.fromarray(array).save(path, format="PNG", **options)
    return path


def tiff(pixels: NDArray[Any], **options: Any) -> Callable[[Path], object]:
    """Write a TIFF by tifffile."""
    return lambda path: tifffile.imwrite(path, pixels, **{"photometric": "rgb", **options})


def pillow(pixels: NDArray[Any], **options: Any) -> Callable[[Path], object]:
    """Write a file by Pillow."""
    return lambda path: Image.fromarray(pixels).save(path, **options)


PALETTE = Image.fromarray(RGB8).quantize(7)
TILED = np.tile(RGB8, (8, 8, 1))
INTEGERS: dict[str, tuple[Callable[[Path], object], NDArray[Any]]] = {
    "8-bit.png": (pillow(RGB8), RGB8),
    "16-bit.png": (lambda path: images.write_png(path, RGB16, tag="srgb"), RGB16),
    "grey.png": (pillow(GREY8), GREY8),
    "16-bit grey.png": (pillow(GREY16), GREY16),
    "palette.png": (PALETTE.save, np.asarray(PALETTE.convert("RGB"))),
    "1-bit.png": (pillow(GREY8 > 99), 255 * (GREY8 > 99).astype(np.uint8)),
    "interlaced.png": (lambda path: path.write_bytes(seeds.interlaced(GREY8)), GREY8),
    "deflated.tif": (tiff(RGB16, compression="deflate"), RGB16),
    "big-endian.tif": (tiff(RGB16, byteorder=">"), RGB16),
    "planar.tif": (tiff(np.moveaxis(RGB16, -1, 0), planarconfig="separate"), RGB16),
    "tiled.tif": (tiff(TILED, tile=(16, 16)), TILED),
    "big.tif": (tiff(RGB8, bigtiff=True), RGB8),
    "white is zero.tif": (tiff(GREY8, photometric="miniswhite"), 255 - GREY8),
    "lzw.tif": (pillow(RGB8, compression="tiff_lzw", tiffinfo={317: 2}), RGB8),
    "a PNG by content.jpg": (pillow(RGB8, format="PNG"), RGB8),
}


@pytest.mark.parametrize("name", INTEGERS)
def test_integer_files_are_read_to_the_last_bit(tmp_path: Path, name: str) -> None:
    write, codes = INTEGERS[name]
    path = tmp_path / name
    write(path)
    picture = images.read_picture(path)
    rgb = codes if codes.ndim == 3 else np.repeat(codes[..., None], 3, axis=-1)
    np.testing.assert_array_equal(picture.pixels, linear(rgb))
    assert picture.pixels.dtype == np.float32
    assert picture.pixels.flags.c_contiguous
    limits = limits_of(rgb, 1, np.iinfo(rgb.dtype).max - 1)
    np.testing.assert_array_equal(picture.limits, limits if limits.any() else None)
    assert picture.alpha is None
    assert known(picture.stored).codes.dtype == codes.dtype
    assert picture.sha256 == hashlib.sha256(path.read_bytes()).hexdigest()
    assert picture.taken.focal_length_35mm is None


@pytest.mark.parametrize(("low", "high"), [(1, 250), (0, 255), (17, 18), (254, 255)])
def test_codes_at_the_thresholds(tmp_path: Path, low: int, high: int) -> None:
    """The lowest and the highest code are data; others are limits, each channel by itself."""
    for dtype, unit in ((np.uint8, 1), (np.uint16, 257)):
        codes = np.clip(
            np.array([low * unit - 1, low * unit, high * unit, high * unit + 1]), 0, 255 * unit
        )
        first, second = np.meshgrid(codes, codes)
        rgb = np.stack([first, second, second], axis=-1).astype(dtype)
        images.write_png(tmp_path / "a.png", rgb, tag="srgb")
        picture = images.read_picture(tmp_path / "a.png", code_range=(low, high))
        if (low, high) == (0, 255):
            assert picture.limits is None
        else:
            assert picture.limits is not None
            np.testing.assert_array_equal(picture.limits, limits_of(rgb, low * unit, high * unit))
            assert (AT_MOST in picture.limits) == (low > 0)
            assert (AT_LEAST in picture.limits) == (high < 255)
        whole = images.read_picture(tmp_path / "a.png", code_range=(0, 255))
        np.testing.assert_array_equal(picture.pixels, whole.pixels)


def test_codes_of_jpeg_above_250_are_limits(tmp_path: Path) -> None:
    codes = np.repeat(np.array([0, 1, 250, 251, 254, 255]), 16)[None].repeat(16, 0)
    Image.fromarray(codes.astype(np.uint8)).save(tmp_path / "a.jpg", quality=100)
    stored = np.asarray(Image.open(tmp_path / "a.jpg"))
    assert set(np.unique(stored)) == {0, 1, 250, 251, 254, 255}
    of_jpeg = images.read_picture(tmp_path / "a.jpg").limits
    np.testing.assert_array_equal(of_jpeg, np.stack([limits_of(stored, 1, 250)] * 3, axis=-1))


def test_an_exr_file_can_say_its_limits(tmp_path: Path) -> None:
    plane, limits = np.full((1, 3), 0.5), np.array([[0.0, 1.0, 2.0]])
    channels = dict.fromkeys("RGB", plane) | {f"limits.{c}": limits for c in "RGB"}
    images.write_exr(tmp_path / "a.exr", channels)
    picture = images.read_picture(tmp_path / "a.exr")
    assert known(picture.limits)[0, :, 1].tolist() == [0, AT_LEAST, AT_MOST]
    images.write_exr(tmp_path / "a.exr", channels | {"limits.G": limits + 1})
    with pytest.raises(InputError, match="expected 0, 1 or 2 in channels limits"):
        images.read_picture(tmp_path / "a.exr")


@pytest.mark.parametrize("codes", [(-1, 250), (1, 256), (7, 7), (9, 3), (0.5, 3), (1,), "no"])
def test_a_code_range_that_is_none_is_refused(tmp_path: Path, codes: Any) -> None:
    path = save_png(tmp_path / "a.png", RGB8)
    with pytest.raises(InputError, match="code_range: expected two 8-bit codes"):
        images.read_picture(path, code_range=codes)
    with pytest.raises(InputError, match="orientation: expected one of exif, as-stored, found"):
        images.read_picture(path, orientation=codes)


def test_alpha_is_straight(tmp_path: Path) -> None:
    with_alpha = np.dstack([RGB8, GREY8])
    for name in ("rgba.png", "rgba.tif"):
        Image.fromarray(with_alpha).save(tmp_path / name)
        picture = images.read_picture(tmp_path / name)
        np.testing.assert_array_equal(picture.pixels, linear(RGB8))
        np.testing.assert_array_equal(picture.alpha, np.float32(GREY8) / np.float32(255))
        np.testing.assert_array_equal(picture.limits, limits_of(RGB8, 1, 254))

    la = np.ascontiguousarray(RGB8[..., :2])
    picture = images.read_picture(save_png(tmp_path / "la.png", la))
    np.testing.assert_array_equal(picture.pixels[..., 1], linear(la[..., 0]))
    np.testing.assert_array_equal(picture.alpha, np.float32(la[..., 1]) / np.float32(255))


@pytest.mark.parametrize("options", [{}, {"progressive": True}, {"subsampling": 0}])
def test_jpeg_agrees_with_another_decoder(tmp_path: Path, options: dict[str, Any]) -> None:
    y, x = np.mgrid[:64, :96] / 96
    smooth = np.stack([x, y, 1 - x], axis=-1)
    Image.fromarray(np.uint8(255 * smooth)).save(tmp_path / "a.jpg", quality=95, **options)
    theirs = np.asarray(Image.open(tmp_path / "a.jpg")).astype(int)
    ours = images.read_data(tmp_path / "a.jpg") * 255
    # Decoders round the transforms and interpolate subsampled chroma differently.
    assert np.abs(ours - theirs).max() <= (2.01 if options == {"subsampling": 0} else 4.01)
    Image.fromarray(np.uint8(255 * x)).save(tmp_path / "g.jpg")
    theirs = np.asarray(Image.open(tmp_path / "g.jpg")).astype(int)
    grey = images.read_data(tmp_path / "g.jpg")
    assert grey.shape == (64, 96, 1)
    assert np.abs(grey[..., 0] * 255 - theirs).max() <= 1.01


@pytest.mark.parametrize("orientation", range(1, 9))
def test_exif_orientation_is_applied(tmp_path: Path, orientation: int) -> None:
    exif = Image.Exif()
    exif[0x0112] = orientation
    exif[0x010F] = "maker"
    for name in ("a.png", "a.jpg", "a.tif"):
        # Blocks of 16 pixels come out of the JPEG decoder in their places.
        picture = np.repeat(np.repeat(RGB8[:2, :3], 16, axis=0), 16, axis=1)
        Image.fromarray(picture).save(tmp_path / name, exif=exif)
        with Image.open(tmp_path / name) as stored:
            expected = np.asarray(ImageOps.exif_transpose(stored)).astype(int)
        found = images.read_data(tmp_path / name) * 255
        assert found.shape == expected.shape
        assert np.abs(found - expected).max() <= 3
        assert images.read_picture(tmp_path / name).pixels.shape == expected.shape


@pytest.mark.parametrize("orientation", range(1, 9))
@pytest.mark.parametrize("kind", ["RGB", "RGBA", "L", "16-bit", "float"])
@pytest.mark.parametrize("space", ["srgb", "display-p3"])
def test_a_part_averaged_while_it_is_read_is_the_mean_of_what_is_read_whole(
    tmp_path: Path, space: Any, kind: str, orientation: int
) -> None:
    codes = np.random.default_rng(orientation).integers(0, 256, (23, 31, 4), np.uint8)
    codes[:8, :9] //= 4  # means without a limit
    codes[:8, :9] += 60
    codes[12:14, 12], codes[14, 8:12] = 0, 255
    path, tag = tmp_path / "a.tif", [(274, "H", 1, orientation, True)]
    samples: Any = {
        "16-bit": codes[..., :3] * np.uint16(257),
        "float": codes[..., :3] / np.float32(255) - np.float32(0.1),
        "RGB": codes[..., :3],
        "RGBA": codes,
        "L": codes[..., 0],
    }[kind]
    photometric = "rgb" if samples.ndim == 3 else "minisblack"
    tifffile.imwrite(path, samples, photometric=photometric, extratags=tag)
    whole = images.read_picture(path, space)
    used = np.s_[2:19, 1:22]
    place = dataclasses.replace(color.Place.new((6, 8)), used=used)
    found = images.read_picture(path, space, place=lambda _: place)
    means = averaged_channels(whole.pixels[used], (6, 8))
    np.testing.assert_allclose(place.pixels, means, rtol=3e-7, atol=3e-7)
    assert found.pixels is place.pixels
    assert (found.limits is None) == (whole.limits is None) == (kind == "float")
    if whole.limits is not None:
        expected = np.zeros((6, 8, 3))
        for limit in (AT_MOST, AT_LEAST):  # the latter counts where both have a part
            expected[averaged_channels(whole.limits[used] == limit, (6, 8)) > 0] = limit
        np.testing.assert_array_equal(found.limits, expected)
        assert 0 < np.count_nonzero(expected) < expected.size
    if kind == "RGBA":
        np.testing.assert_array_equal(known(found.alpha), known(whole.alpha)[used])


@pytest.mark.parametrize("name", ["a.png", "a.jpg", "a.tif"])
def test_focal_length_is_read(tmp_path: Path, name: str) -> None:
    for stored, expected in ((28, 28.0), (0, None)):
        exif = Image.Exif()
        exif[0x8769] = {0xA405: stored}
        Image.fromarray(RGB8).save(tmp_path / name, exif=exif.tobytes())
        assert images.read_picture(tmp_path / name).taken.focal_length_35mm == expected


def icc(space: bytes, tags: dict[bytes, bytes], pcs: bytes = b"XYZ ") -> bytes:
    """A minimal ICC profile, version 4.3."""
    start = 128 + 4 + 12 * len(tags)
    table, body = struct.pack(">I", len(tags)), b""
    for name, tag in tags.items():
        table += name + struct.pack(">II", start + len(body), len(tag))
        body += tag + bytes(-len(tag) % 4)
    header = struct.pack(">I4sI4s4s4s", start + len(body), b"none", 0x04300000, b"mntr", space, pcs)
    header += struct.pack(">6H", 2024, 1, 1, 0, 0, 0) + b"acsp" + bytes(28)
    return header + struct.pack(">3i", 63190, 65536, 54061) + bytes(48) + table + body


def icc_xyz(values: NDArray[np.float64]) -> bytes:
    return b"XYZ \0\0\0\0" + struct.pack(">3i", *np.rint(values * 65536).astype(int))


def icc_gamma(gamma: float) -> bytes:
    return b"curv\0\0\0\0" + struct.pack(">IH", 1, round(gamma * 256)) + b"\0\0"


def icc_srgb_curve() -> bytes:
    numbers = np.array([2.4, 1 / 1.055, 0.055 / 1.055, 1 / 12.92, 0.04045])
    return b"para\0\0\0\0\0\x03\0\0" + struct.pack(">5i", *np.rint(numbers * 65536).astype(int))


def icc_rgb(primaries: color.Primaries, curve: bytes) -> bytes:
    to_xyz = color.rgb_to_xyz(primaries)
    cones = color._BRADFORD
    gain = (cones @ color.ICC_D50) / (cones @ to_xyz.sum(axis=1))
    to_xyz = np.linalg.solve(cones, gain[:, None] * (cones @ to_xyz))
    tags = {b"rXYZ": icc_xyz(to_xyz[:, 0]), b"gXYZ": icc_xyz(to_xyz[:, 1])}
    tags |= {b"bXYZ": icc_xyz(to_xyz[:, 2]), b"wtpt": icc_xyz(color.ICC_D50)}
    return icc(b"RGB ", tags | {b"rTRC": curve, b"gTRC": curve, b"bTRC": curve})


@pytest.mark.parametrize(("name", "kind"), [("a.png", "PNG"), ("a.tif", "TIFF"), ("a.jpg", "JPEG")])
def test_an_srgb_profile_changes_nothing(tmp_path: Path, name: str, kind: str) -> None:
    Image.fromarray(RGB8).save(tmp_path / name, icc_profile=seeds.profile())
    tagged = images.read_picture(tmp_path / name)
    assert tagged.color == f"ICC profile of the 8-bit {kind}"
    assert tagged.curve_told
    Image.fromarray(RGB8).save(tmp_path / f"plain_{name}")
    assert not images.read_picture(tmp_path / f"plain_{name}").curve_told
    plain = images.read_picture(tmp_path / name, color_space="srgb")
    np.testing.assert_allclose(tagged.pixels, plain.pixels, rtol=2e-4, atol=5e-6)


def test_a_display_p3_profile_is_converted(tmp_path: Path) -> None:
    profile = icc_rgb(color.DISPLAY_P3, icc_srgb_curve())
    save_png(tmp_path / "a.png", RGB8, icc_profile=profile)
    tagged = images.read_picture(tmp_path / "a.png")
    named = images.read_picture(tmp_path / "a.png", color_space="display-p3")
    np.testing.assert_allclose(tagged.pixels, named.pixels, atol=1e-4)
    assert tagged.pixels.min() < -0.01  # colours outside Rec.709 are kept
    # In Rec.709 P3 red is 1.22 R − 0.22 G, green −0.04 R + 1.04 G: clipped R bounds either way.
    only_red = (RGB8[..., 0] == 255) & ((RGB8[..., 1:] > 0) & (RGB8[..., 1:] < 255)).all(axis=-1)
    assert only_red.any()
    assert (known(tagged.limits)[only_red][:, :2] == [AT_LEAST, AT_MOST]).all()


def test_a_grey_profile(tmp_path: Path) -> None:
    profile = icc(b"GRAY", {b"kTRC": icc_gamma(1.5), b"wtpt": icc_xyz(color.ICC_D50)})
    save_png(tmp_path / "a.png", RGB8[..., 0], icc_profile=profile)
    expected = (RGB8[..., 0] / 255) ** 1.5
    pixels = images.read_picture(tmp_path / "a.png").pixels
    np.testing.assert_allclose(pixels, np.repeat(expected[..., None], 3, axis=-1), rtol=1e-5)
    Image.fromarray(RGB8).save(tmp_path / "a.jpg", icc_profile=profile)
    with pytest.raises(InputError, match="found one for grey"):
        images.read_picture(tmp_path / "a.jpg")


def test_unusable_profiles_are_refused_but_can_be_overruled(tmp_path: Path) -> None:
    white = {b"wtpt": icc_xyz(color.ICC_D50)}
    lab = icc(b"GRAY", white | {b"kTRC": icc_gamma(1.5)}, pcs=b"Lab ")
    cases = {
        "a damaged one": b"nonsense" * 30,
        "a damaged one.*": seeds.profile()[:200],
        "one for Cmyk pictures": icc(b"CMYK", white),
        "one made of lookup tables only": icc(b"RGB ", white),
        "one that connects through Lab": lab,
    }
    for found, profile in cases.items():
        Image.fromarray(RGB8).save(tmp_path / "a.tif", icc_profile=profile)
        with pytest.raises(InputError, match=rf"a\.tif: .* ICC profile, found {found}"):
            images.read_picture(tmp_path / "a.tif")
        picture = images.read_picture(tmp_path / "a.tif", color_space="srgb")
        np.testing.assert_array_equal(picture.pixels, linear(RGB8))


def test_a_given_color_space_decides(tmp_path: Path) -> None:
    path = save_png(tmp_path / "a.png", RGB8, icc_profile=seeds.profile())
    picture = images.read_picture(path, color_space="linear")
    np.testing.assert_array_equal(picture.pixels, (RGB8 / 255).astype(np.float32))
    assert picture.color == "linear (as asked for)"
    assert picture.curve_told
    expected = RGB8 / 255 @ color.to_rec709(color.ACES_AP1).T
    acescg = images.read_picture(path, color_space="acescg")
    np.testing.assert_allclose(acescg.pixels, expected, atol=1e-6)

    chromaticities = (0.68, 0.32, 0.265, 0.69, 0.15, 0.06, 0.3127, 0.329)
    exr = save_exr(tmp_path / "a.exr", {"RGB": FLOAT}, chromaticities=chromaticities)
    assert images.read_picture(exr).curve_told
    np.testing.assert_array_equal(images.read_picture(exr, color_space="linear").pixels, FLOAT)
    srgb = images.read_picture(exr, color_space="srgb").pixels
    np.testing.assert_allclose(srgb, color.decode_srgb(FLOAT), rtol=1e-6)
    with pytest.raises(InputError, match="color_space: expected one of srgb, linear, acescg"):
        images.read_picture(path, color_space="rec2020")  # type: ignore[arg-type]


def test_a_colour_chunk_that_is_not_followed_is_logged(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path = tmp_path / "a.png"
    pixel = zlib.compress(b"\0\x80")
    path.write_bytes(png_of((1, 1), (b"cICP", bytes([9, 16, 0, 1])), (b"IDAT", pixel)))
    with caplog.at_level(logging.WARNING, logger="pbrfit"):
        picture = images.read_picture(path)
        images.read_picture(path, color_space="linear")  # the user knows: no word about it
    np.testing.assert_allclose(picture.pixels, color.decode_srgb(128 / 255), rtol=1e-6)
    [record] = caplog.records
    note = "cICP chunk (primaries 9, transfer 16) is ignored"
    assert record.getMessage() == f"{path}: read as sRGB; its {note}"


@pytest.mark.parametrize("kind", [np.float16, np.float32, np.float64])
def test_float_tiff_is_linear(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, kind: type[np.floating[Any]]
) -> None:
    path, pixels = tmp_path / "a.tif", FLOAT.astype(kind)
    tiff(pixels)(path)
    picture = images.read_picture(path)
    np.testing.assert_array_equal(picture.pixels, pixels)
    np.testing.assert_array_equal(images.read_data(path), pixels)
    assert picture.limits is None
    assert (picture.stored, picture.color) == (None, "linear Rec.709 (float TIFF)")
    tifffile.imwrite(path, pixels[..., 0], compression="deflate")
    np.testing.assert_array_equal(images.read_picture(path).pixels[..., 2], pixels[..., 0])
    assert not caplog.records
    tiff(pixels, iccprofile=seeds.profile())(path)
    with caplog.at_level(logging.WARNING, logger="pbrfit"):
        np.testing.assert_array_equal(images.read_picture(path).pixels, pixels)
    assert "ICC profile is ignored because it is a float file" in caplog.text
    caplog.clear()
    tiff(pixels, iccprofile=icc_rgb(color.REC2020, icc_gamma(1)))(path)  # as darktable exports
    expected = pixels.astype(np.float32) @ color.to_rec709(color.REC2020).T
    np.testing.assert_allclose(images.read_picture(path).pixels, expected, atol=1e-3)
    np.testing.assert_array_equal(images.read_picture(path, "linear").pixels, pixels)
    assert not caplog.records


def test_radiance_hdr_of_both_signatures_and_encodings(tmp_path: Path) -> None:
    # Mantissa/256 times 2^(e-128); 8 pixels wide is the least that may be run-length encoded.
    pixel = bytes([128, 64, 255, 130])
    expected = np.array([128, 64, 255]) / 256 * 4
    flat = pixel * 8
    runs = b"\x02\x02\x00\x08" + b"".join(bytes([128 + 8, value]) for value in pixel)
    for signature in (b"#?RADIANCE", b"#?RGBE"):
        for rows in (flat, runs):
            header = signature + b"\nFORMAT=32-bit_rle_rgbe\n\n-Y 2 +X 8\n"
            (tmp_path / "a.hdr").write_bytes(header + rows + rows)
            picture = images.read_picture(tmp_path / "a.hdr")
            np.testing.assert_array_equal(picture.pixels, np.tile(expected, (2, 8, 1)))
            assert picture.color == "linear Rec.709 (float HDR)"


@pytest.mark.parametrize("compression", ["NO", "RLE", "ZIPS", "ZIP", "PIZ"])
@pytest.mark.parametrize("dtype", [np.float32, np.float16])
def test_exr_compressions(tmp_path: Path, compression: str, dtype: Any) -> None:
    value = getattr(OpenEXR, f"{compression}_COMPRESSION")
    pixels = np.tile(FLOAT, (9, 7, 1)).astype(dtype)
    path = save_exr(tmp_path / "a.exr", {"RGB": pixels}, compression=value)
    picture = images.read_picture(path)
    np.testing.assert_array_equal(picture.pixels, pixels.astype(np.float32))
    assert picture.color == "linear Rec.709 (EXR without chromaticities)"
    assert picture.stored is None


@pytest.mark.parametrize("compression", ["PXR24", "B44", "B44A", "DWAA", "DWAB"])
def test_lossy_exr_compressions_agree_with_openexr(tmp_path: Path, compression: str) -> None:
    value = getattr(OpenEXR, f"{compression}_COMPRESSION")
    y, x = np.mgrid[:40, :50].astype(np.float32) / 50
    pixels = np.stack([x, y, x * y], axis=-1).astype(np.float16)
    path = save_exr(tmp_path / "a.exr", {"RGB": pixels}, compression=value)
    with OpenEXR.File(str(path)) as file:
        theirs = file.channels()["RGB"].pixels.astype(np.float32)
    np.testing.assert_allclose(images.read_picture(path).pixels, theirs, atol=1e-3)


def test_exr_chromaticities_of_rec709_or_grey_change_nothing(tmp_path: Path) -> None:
    path = save_exr(tmp_path / "z.exr", {"RGB": FLOAT}, chromaticities=(0.0,) * 8)
    np.testing.assert_array_equal(images.read_picture(path).pixels, FLOAT)
    rec709 = (0.64, 0.33, 0.30, 0.60, 0.15, 0.06, 0.3127, 0.3290)
    path = save_exr(tmp_path / "a.exr", {"RGB": FLOAT}, chromaticities=rec709)
    np.testing.assert_array_equal(images.read_picture(path).pixels, FLOAT)
    ap1 = (0.713, 0.293, 0.165, 0.830, 0.128, 0.044, 0.32168, 0.33767)
    grey = save_exr(tmp_path / "y.exr", {"Y": FLOAT[..., 0].copy()}, chromaticities=ap1)
    np.testing.assert_array_equal(images.read_picture(grey).pixels[..., 1], FLOAT[..., 0])


def rgb(layer: str, letters: str = "RGB", factor: float = 1) -> dict[str, NDArray[Any]]:
    return {f"{layer}{c}": factor * FLOAT[..., k] for k, c in enumerate(letters)}


OTHERS = rgb("View.Normal.", "XYZ") | rgb("View.DiffCol.") | {"View.Depth.Z": FLOAT[..., 0]}
NUKE = "red", "green", "blue"
LAYERS: dict[str, tuple[dict[str, NDArray[Any]], str | None, str]] = {
    # what is stored, which layer is asked for, which is read or what is refused
    "plain": (rgb("") | rgb("rgba.", factor=2) | OTHERS, None, ""),
    "small letters": (rgb("", "rgb") | OTHERS, None, ""),
    "rgba": (rgb("rgba.") | rgb("diffuse.", factor=2) | OTHERS, None, "rgba"),
    "beauty": (rgb("Beauty.") | rgb("diffuse.", factor=2), None, "Beauty"),
    "blender": (rgb("V.Combined.") | rgb("V.Emit.", factor=2) | OTHERS, None, "V.Combined"),
    "of Nuke": ({f"a.{c}": FLOAT[..., "rgb".index(c[0])] for c in NUKE} | OTHERS, None, "a"),
    "of Houdini": (rgb("C.") | rgb("albedo.", factor=2) | rgb("diffuse.", factor=2), None, "C"),
    "beside short normals": (rgb("diffuse.") | rgb("N.", factor=2), None, "diffuse"),
    "the only one": (rgb("diffuse.") | OTHERS | rgb("diffuse.limits.", factor=0), None, "diffuse"),
    "by name": (rgb("") | rgb("a.", factor=2) | rgb("b."), "b", "b"),
    "by its end": (rgb("View.Combined.", factor=2) | rgb("View.Emit."), "emit", "View.Emit"),
    "by its whole name": (rgb("View.Emit.", factor=2) | rgb("Emit."), "Emit", "Emit"),
    "data by name": (rgb("") | OTHERS, "diffcol", "View.DiffCol"),
    "two": (rgb("a.") | rgb("b."), None, r"one layer of .*, found a\.R a\.G a\.B, b\.R b"),
    "two views": (rgb("a.rgba.") | rgb("b.rgba."), None, r"one layer of .*, found a\.rgba\.R a"),
    "two ends": (rgb("a.x.") | rgb("b.x."), "x", r"one layer of channels R, G, B or Y in layer x"),
    "data": (OTHERS, None, r"channels .* in layers View\.Depth, View\.DiffCol, View\.Normal"),
    "a path": (OTHERS, "C:\renders\new", r"channels R, G, B or Y in layer C:\\renders\\new, found"),
    "unknown": (rgb("") | OTHERS, "albedo", "channels R, G, B or Y in layer albedo, found B, G"),
}  # fmt: skip


@pytest.mark.parametrize("parts", [False, True])
@pytest.mark.parametrize("name", LAYERS)
def test_exr_layers(tmp_path: Path, name: str, parts: bool) -> None:
    planes, layer, expected = LAYERS[name]
    planes = {of: np.ascontiguousarray(plane) for of, plane in planes.items()}
    path = save_exr(tmp_path / "a.exr", planes)
    of_layers: dict[str, dict[str, Any]] = {}
    for of, plane in planes.items():
        part, _, channel = of.rpartition(".")
        of_layers.setdefault(part, {})[channel] = plane
    if parts and "" not in of_layers:  # one a layer, whose channels do not tell its name
        path.unlink()
        kind = OpenEXR.scanlineimage
        written = [OpenEXR.Part({"type": kind}, of, part) for part, of in of_layers.items()]
        OpenEXR.File(written).write(str(path))
    found = images.read_channels(path)
    assert found.keys() == planes.keys()
    for of, plane in planes.items():
        np.testing.assert_array_equal(found[of], plane)
    if " " in expected:
        with pytest.raises(InputError, match=rf"a\.exr: expected {expected}"):
            images.read_picture(path, layer=layer)
        return
    picture = images.read_picture(path, layer=layer)
    np.testing.assert_array_equal(picture.pixels, FLOAT)
    assert picture.color.startswith(f"layer {expected}, linear" if expected else "linear")
    assert (picture.limits is not None) == ("limits" in str(list(planes)))


def test_exr_data_window_is_placed_into_the_display_window(tmp_path: Path) -> None:
    def window(x: int, y: int, width: int, height: int) -> Any:
        corner = np.array([x, y], np.int32)
        return corner, np.array([x + width - 1, y + height - 1], np.int32)

    for x, y in ((3, 1), (-4, -2), (6, 5), (-20, 0), (0, 40), (10, 10)):
        display = (10, 10, 12, 8)
        path = save_exr(
            tmp_path / "a.exr",
            {"Y": FLOAT[..., 0].copy()},
            dataWindow=window(x, y, 9, 6),
            displayWindow=window(*display),
        )
        plane = np.full((100, 100), np.nan, np.float32)
        plane[40 + y : 46 + y, 40 + x : 49 + x] = FLOAT[..., 0]
        found = images.read_channels(path)["Y"]
        np.testing.assert_array_equal(found, plane[50:58, 50:62])


def test_subsampled_and_deep_exr_are_refused(tmp_path: Path) -> None:
    path = save_exr(tmp_path / "a.exr", {"Y": np.ones((4, 4), np.float32)})
    data = path.read_bytes()
    channel = b"Y\0" + struct.pack("<iixx", 2, 0)[:8]  # name, float, perceptual
    start = data.index(b"Y\0" + struct.pack("<i", 2)) + len(channel)
    sampled = data[:start] + struct.pack("<ii", 2, 2) + data[start + 8 :]
    path.write_bytes(sampled)
    with pytest.raises(InputError, match=r"a\.exr: expected flat pixels.*found: .*subsampling"):
        images.read_picture(path)

    samples = np.empty((4, 4), dtype=object)
    for index in np.ndindex(4, 4):
        samples[index] = np.zeros(2, np.float32)
    zips = OpenEXR.ZIPS_COMPRESSION
    save_exr(path, {"Z": samples}, type=OpenEXR.deepscanline, compression=zips)
    with pytest.raises(InputError, match=r"a\.exr: expected flat pixels.*deep"):
        images.read_channels(path)


def test_data_is_never_decoded(tmp_path: Path) -> None:
    path = save_png(tmp_path / "n.png", RGB8, icc_profile=seeds.profile())
    data = images.read_data(path)
    assert data.dtype == np.float64
    np.testing.assert_array_equal(data, RGB8 / 255)
    images.write_png(path, RGB16, tag=None)
    np.testing.assert_array_equal(images.read_data(path), RGB16 / 65535)
    ap1 = (0.713, 0.293, 0.165, 0.830, 0.128, 0.044, 0.32168, 0.33767)
    path = save_exr(tmp_path / "n.exr", {"RGB": FLOAT}, chromaticities=ap1)
    np.testing.assert_array_equal(images.read_data(path), FLOAT)
    path = save_exr(tmp_path / "m.exr", {"mask": FLOAT[..., 0].copy()})
    np.testing.assert_array_equal(images.read_data(path), FLOAT[..., :1])


def test_ids_are_the_stored_integers(tmp_path: Path) -> None:
    ids = images.read_ids(save_png(tmp_path / "a.png", RGB16[..., 0]))
    assert ids.dtype == np.uint16
    np.testing.assert_array_equal(ids, RGB16[..., 0])
    found = images.read_ids(save_png(tmp_path / "a.png", RGB8[..., 0]))
    np.testing.assert_array_equal(found, RGB8[..., 0])
    tifffile.imwrite(tmp_path / "a.tif", RGB16[..., 0])
    np.testing.assert_array_equal(images.read_ids(tmp_path / "a.tif"), RGB16[..., 0])

    for count in (2, 4, 16, 200):  # stored with 1, 2, 4 and 8 bits
        indices = RNG.integers(0, count, (5, 11), dtype=np.uint8)
        indices[0, 0] = count - 1
        palette = Image.fromarray(indices).convert("P")
        palette.putdata(indices.ravel().tolist())
        palette.putpalette(RNG.integers(0, 256, 3 * count, dtype=np.uint8).tobytes())
        palette.save(tmp_path / "p.png", bits=max(1, (count - 1).bit_length()))
        np.testing.assert_array_equal(images.read_ids(tmp_path / "p.png"), indices)
    Image.fromarray(RGB8[..., 0] > 99).save(tmp_path / "one.png")
    np.testing.assert_array_equal(images.read_ids(tmp_path / "one.png"), RGB8[..., 0] > 99)


def test_openexr_reads_what_is_written(tmp_path: Path) -> None:
    channels: dict[str, NDArray[Any]] = {f"albedo.{c}": FLOAT[..., k] for k, c in enumerate("RGB")}
    odd = FLOAT[..., 0].copy()
    odd[0, :4] = np.nan, np.inf, 1e-40, 0.1
    channels |= {"roughness.Y": odd, "mask.Y": FLOAT[..., 0] > 0}
    for half, dtype in ((False, np.float32), (True, np.float16)):
        path = tmp_path / "Überblick 測定.exr"
        images.write_exr(path, channels, half=half)
        copy = tmp_path / "copy.exr"
        copy.write_bytes(path.read_bytes())
        with OpenEXR.File(str(copy), separate_channels=True) as file:
            header = dict(file.header())
            found = {name: channel.pixels for name, channel in file.channels().items()}
        assert set(found) == set(channels)
        for name, plane in channels.items():
            assert found[name].dtype == dtype
            np.testing.assert_array_equal(found[name], np.asarray(plane, dtype))
        assert header["compression"] == OpenEXR.ZIP_COMPRESSION
        assert header["lineOrder"] == OpenEXR.INCREASING_Y
        np.testing.assert_allclose(
            header["chromaticities"],
            (0.64, 0.33, 0.30, 0.60, 0.15, 0.06, 0.3127, 0.3290),
            rtol=1e-6,
        )
        again = images.read_channels(path)
        np.testing.assert_array_equal(again["mask.Y"], FLOAT[..., 0] > 0)
        images.write_exr(copy, dict(reversed(channels.items())), half=half)
        assert copy.read_bytes() == path.read_bytes()
    assert sorted(p.name for p in tmp_path.iterdir()) == ["copy.exr", "Überblick 測定.exr"]


def test_pillow_reads_what_is_written(tmp_path: Path) -> None:
    path = tmp_path / "a.png"
    for samples in (RGB8, RGB8[..., 0], RGB8[::-1, ::2], np.dstack([RGB8, RGB8[..., 0]])):
        images.write_png(path, samples, tag="srgb")
        with Image.open(path) as picture:
            np.testing.assert_array_equal(np.asarray(picture), samples)
            assert picture.info["srgb"] == 0
    images.write_png(path, RGB16[..., 0], tag=None)
    with Image.open(path) as picture:
        np.testing.assert_array_equal(np.asarray(picture), RGB16[..., 0])
        assert "srgb" not in picture.info
    first = path.read_bytes()
    images.write_png(path, RGB16[..., 0], tag=None)
    assert path.read_bytes() == first == images.encode_png(RGB16[..., 0], tag=None)
    images.write_png(path, RGB16[..., 0], tag="linear")
    with Image.open(path) as picture:
        np.testing.assert_array_equal(np.asarray(picture), RGB16[..., 0])
        assert picture.info["gamma"] == 1.0
        assert "srgb" not in picture.info


@pytest.mark.parametrize(
    ("channels", "message"),
    [
        ({"a": FLOAT[..., 0], "b": FLOAT[:5, :, 0]}, "expected 6 x 9 values in b, found 45"),
        ({}, "expected at least one channel"),
        ({"": FLOAT[..., 0]}, "expected"),
    ],
)
def test_unwritable_channels_leave_no_file(tmp_path: Path, channels: Any, message: str) -> None:
    with pytest.raises(InputError, match=f"channels: {message}"):
        images.write_exr(tmp_path / "a.exr", channels)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("pixels", "tag", "message"),
    [
        (FLOAT, "srgb", "image: expected uint8 or uint16, found float32"),
        (np.zeros((2, 2, 5), np.uint8), "srgb", "image: expected"),
        (np.zeros(4, np.uint8), "srgb", "image: expected"),
        (RGB8, "rgb", 'tag: expected srgb, linear or None, found "rgb"'),
    ],
)
def test_unwritable_pictures_leave_no_file(
    tmp_path: Path, pixels: NDArray[Any], tag: Any, message: str
) -> None:
    with pytest.raises(InputError, match=message):
        images.write_png(tmp_path / "a.png", pixels, tag=tag)
    with pytest.raises(FileNotFoundError):
        images.write_png(tmp_path / "none" / "a.png", RGB8, tag="srgb")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("name", "data", "message"),
    [
        ("a.png", b"", r"a\.png: expected a picture, found an empty file"),
        ("a.webp", b"RIFF\0\0\0\0WEBPVP8 ", r"expected EXR, HDR, PNG, JPEG or TIFF, found WebP"),
        ("a.jxl", b"\xff\n\0\0\0\0\0\0", "found JPEG XL"),
        ("a.jxl", b"\0\0\0\x0cJXL \r\n\x87\n", "found JPEG XL"),
        ("a.png", b"version https://git-lfs.github.com/spec/v1\n", "Git LFS: .*`git lfs pull`"),
        ("a.gif", b"GIF89a\0\0\0\0", "found GIF"),
        ("a.bmp", b"BM\0\0\0\0\0\0", "found BMP"),
        ("a.png", b"<html></html>", "found a file that starts with b'<html></'"),
        ("a.NEF", b"MM\0*\0\0\0\x08", r"found a raw file.*darktable-cli a\.NEF a\.exr"),
        ("a.raf", b"FUJIFILMCCD-RAW ", "found a raw file.*dcraw -4 -T"),
        ("a.tif", b"II*\0\x10\0\0\0CR\x02\0", "found a raw file"),
        ("a.bin", b"\0\0\0\x18ftypcrx \0\0\0\x01", "found a raw file"),
        ("a.heic", b"\0\0\0\x18ftypheic\0\0\0\0", r"HEIC or AVIF.*heif-convert a\.heic a\.png"),
        ("a.jpg", b"\0\0\0\x18ftypheic\0\0\0\0", "found HEIC or AVIF"),
        ("a.avif", b"\0\0\0\x18ftypavif\0\0\0\0", "found HEIC or AVIF"),
        ("a.hdr", b"#?RADIANCE\nFORMAT=32-bit_rle_cmyk\n\n-Y 1 +X 1\n\0\0\0\0", "whole HDR file"),
    ],
)
def test_other_formats_say_what_to_do(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, data: bytes, message: str
) -> None:
    monkeypatch.setitem(sys.modules, "rawpy", None)  # as if it were not installed
    (tmp_path / name).write_bytes(data)
    with pytest.raises(InputError, match=message) as caught:
        images.read_picture(tmp_path / name)
    assert "\n" not in str(caught.value)
    assert str(tmp_path / name) in str(caught.value)


def as_ids(path: Path) -> object:
    return images.read_ids(path)


def as_layer(path: Path) -> object:
    return images.read_picture(path, layer="x")


CMYK = Image.fromarray(RGB8).convert("CMYK")


@pytest.mark.parametrize(
    ("name", "write", "read", "message"),
    [
        ("a.jpg", CMYK.save, None, "expected a grey or RGB JPEG, found CMYK"),
        ("a.tif", CMYK.save, None, "expected a grey or RGB TIFF, found CMYK"),
        ("p.tif", PALETTE.save, None, "expected a grey or RGB TIFF, found: .*RGBPalette"),
        (
            "i.tif",
            lambda path: tifffile.imwrite(path, GREY8.astype(np.int16)),
            None,
            "expected 8 or 16-bit unsigned integers or floats, found 16",
        ),
        ("one.tif", pillow(GREY8 > 99), None, "expected 8 bits or more a sample, found 1"),
        ("a.png", pillow(RGB8), as_layer, "expected an EXR file with layer x, found PNG"),
        ("a.png", pillow(RGB8), images.read_channels, "expected an EXR file, found PNG"),
        ("a.png", pillow(RGB8), as_ids, "expected ids in a grey .* found 3 channels uint8"),
        ("f.tif", tiff(FLOAT), as_ids, "expected ids in a grey .* found 3 channels float32"),
        ("a.jpg", pillow(GREY8), as_ids, "expected ids in a grey .* found JPEG"),
    ],
)
def test_unsupported_variants_are_refused(
    tmp_path: Path,
    name: str,
    write: Callable[[Path], object],
    read: Callable[[Path], object] | None,
    message: str,
) -> None:
    write(tmp_path / name)
    with pytest.raises(InputError, match=message):
        (read or images.read_picture)(tmp_path / name)


MAKERS = (seeds.png, seeds.jpeg, seeds.tiff, seeds.hdr, seeds.exr)
WHOLE = {seed.name: seed for make in MAKERS for seed in make()}


@pytest.mark.parametrize("name", sorted(WHOLE.keys() - {"tif tiled"}))  # its tiles are padded
def test_cut_off_files_are_errors(tmp_path: Path, name: str) -> None:
    path, data = tmp_path / WHOLE[name].target, WHOLE[name].data
    with pytest.raises(FileNotFoundError):
        images.read_picture(path)
    path.write_bytes(data)
    images.read_picture(path)
    lengths = {*range(0, len(data), max(1, len(data) // 25)), *range(len(data) - 6, len(data))}
    # Behind the strips of a TIFF may come padding, and a deflated strip ends in 6 bytes (end of
    # block, checksum) that no pixel needs; there a cut may do no harm.
    needed = strips_end(data) - 6 if name.startswith("tif") else len(data)
    for length in sorted(lengths):
        path.write_bytes(data[:length])
        if length < needed:
            with pytest.raises(InputError, match=f"^{re.escape(str(path))}: expected"):
                images.read_picture(path)


def strips_end(data: bytes) -> int:
    with tifffile.TiffFile(io.BytesIO(data)) as file:
        page = file.pages[0]
        return max(o + n for o, n in zip(page.dataoffsets, page.databytecounts, strict=True))
