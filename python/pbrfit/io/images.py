"""Picture files to linear float32, and back.

Files are recognised by their content, not by their name. `read_picture` decodes colour;
`read_data`, `read_ids` and `read_channels` never do.
"""

from __future__ import annotations

import hashlib
import logging
import operator
import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pbrfit import _core
from pbrfit._core import InputError
from pbrfit.io import exif, radiance, raw_files
from pbrfit.io.color import (
    CODED_CURVES,
    CODED_PRIMARIES,
    REC709,
    ColorSpace,
    Conversion,
    Curve,
    Primaries,
    conversion,
    from_icc,
    from_primaries,
    near_rec709,
    nearest_name,
    rgb_to_xyz,
)
from pbrfit.io.file_noise import Stored
from pbrfit.io.input_files import PICTURE_BYTES, content_of, names_file, open_file
from pbrfit.io.jpeg_noise import read_tables
from pbrfit.io.limits import AT_LEAST, AT_MOST, ORDINARY, Limits, converted, of_codes
from pbrfit.io.quoting import listed

logger = logging.getLogger("pbrfit")

PICTURE_SUFFIXES = (".exr", ".hdr", ".png", ".jpg", ".jpeg", ".tif", ".tiff")
"""Suffixes, in lower case, of files that `read_picture` reads."""

PngTag = Literal["srgb", "linear"] | None
"""What a PNG file says about its encoding."""

Orientation = Literal["exif", "as-stored"]
"""Whether pictures are turned as their EXIF data says."""

RAW = "RAW"
"""Format of cameras' raw files, beside those that the core tells."""

LIMITS = "limits"
"""Layer of an EXR file whose channels R, G and B are the limits of the picture's samples."""

CODE_RANGE = (1, 250)
"""Codes of a JPEG file that are data; of lossless files all but the first and the last are. JPEG
smears clipped areas: of samples that were clipped before a JPEG of quality 75 to 95 with halved
colour, 15 to 22 % come back with all channels below 254, and 5 to 9 % with all below 251, which
takes 2 % of the sound samples of bright photographs for clipped."""

_HEIF_SUFFIXES = frozenset({".heic", ".heif", ".hif", ".avif"})
_HEIF_BRANDS = frozenset({b"heic", b"heix", b"heim", b"heis", b"hevc", b"mif1", b"msf1", b"avif"})


@dataclass(frozen=True)
class Picture:
    """One picture, decoded."""

    pixels: NDArray[np.float32]
    """(H, W, 3), linear Rec.709 with D65, float32."""
    alpha: NDArray[np.float32] | None
    """(H, W), coverage in [0, 1], float32, or None. The colours are as stored: not divided and not
    multiplied by it."""
    limits: Limits | None
    """(H, W, 3), uint8: where `pixels` bound the radiance, `AT_LEAST` or `AT_MOST`, because a code
    is outside the code range, or because an EXR file has them in a layer; 0 elsewhere. None where
    no code is, and for other float files."""
    negative: NDArray[np.bool_]
    """(H, W), bool: some colour channel is below 0 in the file's own primaries. Colours outside of
    Rec.709 are negative in `pixels` without that."""
    color: str
    """One sentence on how the colour was decided."""
    focal_length_35mm: float | None
    """From EXIF, millimetres, or None."""
    sha256: str
    """Of the file, hexadecimal."""
    bit_depth: int
    """Bits of a sample: 8 or 16 for integer files, 32 for float files."""
    stored: Stored | None
    """The samples as they are in an integer file; None for float files."""
    curve_told: bool
    """Whether a caller, a profile or the file type says by which curve values are decoded; False
    where sRGB is only what most files without a profile are."""
    settings: Mapping[str, str] = field(default_factory=dict)
    """What pictures of a set share, as far as it is known, in words: camera, exposure, focal
    length, orientation, colour profile."""
    notes: tuple[str, ...] = ()
    """What of the file was left out or undone, in words."""


@names_file
def read_picture(
    path: str | os.PathLike[str],
    color_space: ColorSpace | None = None,
    layer: str | None = None,
    code_range: tuple[int, int] | None = None,
    orientation: Orientation = "exif",
) -> Picture:
    """Read a picture as linear Rec.709.

    A given `color_space` decides. Else integer files (PNG, JPEG, TIFF) follow their ICC profile,
    the colour chunks of a PNG, or EXIF data that says Adobe RGB, and are sRGB without; float files
    (EXR, HDR, float TIFF) are linear Rec.709, or linear in the chromaticities that an EXR or HDR
    file states. Grey is repeated to three channels. Alpha of 0 everywhere is none. Raw files are
    developed to linear Rec.709 (`pbrfit.io.raw_files`). Raises InputError if the content cannot be
    used: another format, a damaged file, a profile that is not made of curves and a matrix, no
    colour channels, an unknown `color_space` or `orientation`; or if `code_range` is none; OSError
    if the file cannot be read.

    Parameters
    ----------
    path
        EXR, HDR, PNG, JPEG, TIFF or raw file.
    color_space
        How to read the stored values, whatever the file says.
    layer
        Of an EXR file: read ``layer.R``, ``layer.G``, ``layer.B`` (or ``layer.Y``) and
        ``layer.A`` instead of ``R``, ``G``, ``B`` (or ``Y``) and ``A``.
    code_range
        Lowest and highest code that is data, of an 8-bit file; a 16-bit file has the same shares
        of its maximum. None = `CODE_RANGE` of a JPEG file, of others all but 0 and the maximum.
        What is outside is marked in `limits`, channel by channel; pixels stay as they are.
    orientation
        Whether the EXIF orientation is applied.
    """
    asked = None if code_range is None else _checked(code_range)
    if orientation not in get_args(Orientation):
        raise InputError(f"orientation: expected exif or as-stored, found {orientation!r}")
    path, data, kind = _load(path, raw=True)
    if kind == RAW:
        _refuse_layer(path, kind, layer)
        return _raw_picture(path, data, color_space, asked, orientation)
    chosen: Conversion | None = None
    if color_space is not None:
        try:
            chosen = conversion(color_space)
        except ValueError as error:
            raise InputError(str(error)) from None
    samples: NDArray[Any]
    raster = stored = limits = None
    taken, settings, notes, told, turned = exif.Exif(), {}, [], True, 1
    if kind == "EXR":
        samples, limits, found, color = _exr_picture(path, data, layer)
    else:
        _refuse_layer(path, kind, layer)
        raster, header = _decoded(path, data)
        turned = raster.orientation if orientation == "exif" else 1
        samples = _oriented(raster.samples, turned if header is None else header.orientation)
        taken = exif.read(data if kind == "TIFF" else raster.exif)
        found, color, told = _raster_color(path, raster, taken, decide=chosen is None)
        settings = {**taken.settings, "orientation": str(raster.orientation)}
        if raster.passed_over:
            notes.append(f"smaller pages not read ({raster.passed_over} of each file)")
        if header is not None:
            samples, found, color, notes = _hdr_color(path, header, samples)
    if chosen is not None:
        color, told = f"{color_space} (as asked for)", True

    colors, alpha = samples, None
    if samples.shape[2] in (2, 4):
        colors, alpha = samples[..., :-1], samples[..., -1]
        if not alpha.any():
            alpha = None
            notes.append("alpha is 0 in all pixels and ignored")
    negative = np.zeros(samples.shape[:2], dtype=np.bool_)
    bit_depth = 8 * samples.dtype.itemsize
    if samples.dtype.kind == "u":
        maximum = int(np.iinfo(samples.dtype).max)
        unit = maximum // 255  # 65535 is 257 times 255
        low, high = 1, maximum - 1
        if asked is not None or kind == "JPEG":
            low, high = (unit * code for code in asked or CODE_RANGE)
        limits = of_codes(colors, low, high)
        if alpha is not None:
            alpha = np.divide(alpha, np.float32(maximum), dtype=np.float32)
    else:
        np.any(colors < 0, axis=-1, out=negative)
        if alpha is not None:
            alpha = alpha.astype(np.float32)
    convert = chosen or found
    if raster is not None and samples.dtype.kind == "u":
        plain = raster.samples[..., : colors.shape[2]]
        tables = read_tables(data, plain.shape[2]) if kind == "JPEG" else None
        stored = Stored(plain, turned >= 5, convert, raster.format, tables)
        if chosen is None:
            unnamed = f"{color}, sha256 {hashlib.sha256(raster.icc_profile or b'').hexdigest()[:8]}"
            settings["colour profile"] = nearest_name(convert, samples.dtype) or unnamed
    pixels = convert(np.broadcast_to(colors, (*colors.shape[:2], 3)))
    if limits is not None:
        limits = converted(np.broadcast_to(limits, pixels.shape), convert.matrix)
    return Picture(
        pixels=pixels,
        alpha=alpha,
        limits=limits,
        negative=negative,
        color=color,
        focal_length_35mm=taken.focal_length_35mm,
        sha256=hashlib.sha256(data).hexdigest(),
        bit_depth=bit_depth,
        stored=stored,
        curve_told=told,
        settings=settings,
        notes=tuple(notes),
    )


def _raw_picture(
    path: Path,
    data: bytes,
    color_space: ColorSpace | None,
    asked: tuple[int, int] | None,
    orientation: Orientation,
) -> Picture:
    if color_space not in (None, "linear"):
        raise InputError(
            f"{path}: expected colour space linear for a raw file, found {color_space}"
        )
    low, high = (257 * code for code in asked) if asked is not None else (1, 65534)
    found = raw_files.develop(path, data, (low, high), turned=orientation == "exif")
    linear = Conversion("linear")
    return Picture(
        pixels=linear(found.samples),
        alpha=None,
        limits=found.limits,
        negative=np.zeros(found.samples.shape[:2], dtype=np.bool_),
        color=found.color,
        focal_length_35mm=found.exif.focal_length_35mm,
        sha256=hashlib.sha256(data).hexdigest(),
        bit_depth=16,
        stored=Stored(found.samples, False, linear, RAW, None),
        curve_told=True,
        settings={**found.exif.settings, "orientation": found.orientation},
    )


@names_file
def read_data(path: str | os.PathLike[str], layer: str | None = None) -> NDArray[np.float64]:
    """Read a mask, normals or other data: never decoded as colour.

    `layer` of an EXR file is as in `read_picture`. Returns (H, W, C), float64. Integers are divided
    by the maximum of their type; floats are as stored. C is 1 grey, 2 grey and alpha, 3 RGB, 4 RGB
    and alpha. Of an EXR file: R, G, B and, if there is one, A; else X, Y, Z; else Y and A; else the
    only channel there is. Raises InputError if the content cannot be used; OSError if the file
    cannot be read.
    """
    path, data, kind = _load(path)
    if kind == "EXR":
        channels, _ = _core.decode_exr(data, path)
        prefix = f"{layer}." if layer else ""
        found = _pick(channels, prefix, "RGBA", "RGB", "XYZ", "YA", "Y")
        if not found and len(channels) == 1 and not layer:
            found = list(channels.values())
        if not found:
            raise _no_layer(path, channels, f"channels {prefix}R, {prefix}G, {prefix}B or X, Y, Z")
        return np.stack(found, axis=-1).astype(np.float64)
    _refuse_layer(path, kind, layer)
    samples = upright(path, data)
    if samples.dtype.kind == "u":
        return samples / np.float64(np.iinfo(samples.dtype).max)
    return samples.astype(np.float64)


@names_file
def read_ids(path: str | os.PathLike[str]) -> NDArray[np.uint16]:
    """Read a picture of integer ids, such as segments: (H, W) uint16, as they are stored.

    The file is a grey PNG or TIFF of 8 or 16 bits, or a palette PNG, of which the indices are
    taken. Raises InputError if the file has several channels, floats, or is of a lossy format;
    OSError if the file cannot be read.
    """
    path, data, kind = _load(path)
    expected = "expected ids in a grey 8 or 16-bit PNG or TIFF"
    if kind not in ("PNG", "TIFF"):
        raise InputError(f"{path}: {expected}, found {_article(kind)} file")
    raster = _core.decode_raster(data, path, indices=True)
    samples = _oriented(raster.samples, raster.orientation)
    if samples.shape[2] != 1 or samples.dtype.kind != "u":
        raise InputError(f"{path}: {expected}, found {samples.shape[2]} channels {samples.dtype}")
    return np.ascontiguousarray(samples[..., 0], dtype=np.uint16)


@names_file
def read_channels(path: str | os.PathLike[str]) -> dict[str, NDArray[np.float32]]:
    """Read all channels of an EXR file as they are: (H, W) float32 by full name, ``albedo.R``.

    In a file with several parts the name of the part comes first. Raises InputError if this is not
    a sound EXR file of flat, full-resolution channels; OSError if the file cannot be read.
    """
    path, data, kind = _load(path)
    if kind != "EXR":
        raise InputError(f"{path}: expected an EXR file, found {_article(kind)} file")
    return _core.decode_exr(data, path)[0]


def write_exr(
    path: str | os.PathLike[str], channels: Mapping[str, ArrayLike], half: bool = False
) -> None:
    """Write an EXR file of one part: ZIP, linear Rec.709 stated in it.

    The file is there as a whole or not at all, and equal channels give equal bytes. Channels are
    (H, W) arrays by name, all of one shape; values are written as given, with `half` as 16-bit
    floats, where values beyond 65504 become infinite. An existing file is replaced. Raises
    InputError if there is no channel or their shapes differ; OSError if the file cannot be written.
    """
    planes = []
    for name, channel in channels.items():
        plane = np.asarray(channel, dtype=np.float32)
        if plane.ndim != 2:
            raise InputError(f"channels: expected (H, W) in {name}, found {plane.shape}")
        planes.append((name, plane))
    _core.write_exr(path, planes, half)


def write_png(path: str | os.PathLike[str], image: NDArray[Any], tag: PngTag) -> None:
    """Write a PNG file.

    The file is there as a whole or not at all, and equal images give equal bytes. The image is (H,
    W) or (H, W, 1 to 4), uint8 or uint16, already encoded. The tag is what the file is to say about
    its encoding: "srgb" (sRGB chunk), "linear" (gAMA chunk of 1: data, or linear light) or None
    (nothing). An existing file is replaced. Raises InputError if the shape or type of `image` is
    another; OSError if the file cannot be written.
    """
    _core.write_png(path, image, tag)


def encode_png(image: NDArray[Any], tag: PngTag) -> bytes:
    """Encode the PNG file that `write_png` writes.

    Raises InputError if the shape or type of `image` is another.
    """
    return _core.encode_png(image, tag)


def _checked(code_range: tuple[int, int]) -> tuple[int, int]:
    try:
        low, high = (operator.index(code) for code in code_range)
    except (TypeError, ValueError):
        low, high = 0, 0
    if not 0 <= low < high <= 255:
        raise InputError(
            f"code_range: expected two 8-bit codes, 0 ≤ low < high ≤ 255, found {code_range}"
        )
    return low, high


def _load(path: str | os.PathLike[str], *, raw: bool = False) -> tuple[Path, bytes, str]:
    """Read path, content and format of a file that can be read; raw files where they may be."""
    path = Path(path)
    with open_file(path) as file:
        head = file.read(_HEAD)  # what is no picture is not read, however large it is
        if not head:
            raise InputError(f"{path}: expected a picture, found an empty file")
        kind = _core.image_format(head)
        if raw_files.is_raw(path, head, kind):
            if not raw:
                raise InputError(
                    f"{path}: expected {_SUPPORTED}, found a raw file: "
                    f"{raw_files.how_to_develop(path)}"
                )
            kind = RAW
        if kind is None:
            raise InputError(f"{path}: expected {_SUPPORTED}, found {_guess(path, head)}")
        return path, content_of(file, path, PICTURE_BYTES), kind


_SUPPORTED = "EXR, HDR, PNG, JPEG or TIFF"

_HEAD = 64
"""Bytes by which a format is known."""


def _guess(path: Path, head: bytes) -> str:
    """Say what a file that is not supported seems to be."""
    if path.suffix.lower() in _HEIF_SUFFIXES or (
        head[4:8] == b"ftyp" and head[8:12] in _HEIF_BRANDS
    ):
        return (
            f"HEIC or AVIF: convert it first, for example with"
            f" `heif-convert {path.name} {path.stem}.png`"
        )
    if head[:4] == b"RIFF" and head[8:12] == b"WEBP":
        return "WebP"
    known = {b"GIF8": "GIF", b"BM": "BMP"}
    told = (name for start, name in known.items() if head.startswith(start))
    return next(told, f"a file that starts with {head[:8]!r}")


def _article(kind: str) -> str:
    return f"{'an' if kind in ('EXR', 'HDR') else 'a'} {kind}"


def _refuse_layer(path: Path, kind: str, layer: str | None) -> None:
    if layer is not None:
        raise InputError(f"{path}: expected an EXR file with layer {layer}, found {_article(kind)}")


def _decoded(path: Path, data: bytes) -> tuple[_core.Raster, radiance.Header | None]:
    """What a file other than EXR holds, and the header of an HDR file."""
    header = radiance.read(data)
    return _core.decode_raster(data if header is None else header.plain, path, False), header


def upright(path: Path, data: bytes) -> NDArray[Any]:
    """Samples (H, W, C) of a file other than EXR, as stored, turned to how they are to be seen."""
    raster, header = _decoded(path, data)
    return _oriented(raster.samples, raster.orientation if header is None else header.orientation)


def _oriented(samples: NDArray[Any], orientation: int) -> NDArray[Any]:
    """Turn samples to how they are to be seen: EXIF 2.32, table 6 (tag Orientation)."""
    if orientation >= 5:
        samples = samples.swapaxes(0, 1)
    # After the swap 5 is done, 6 lacks a left-right flip, 7 both flips, 8 an up-down flip.
    if orientation in (2, 3, 6, 7):
        samples = samples[:, ::-1]
    if orientation in (3, 4, 7, 8):
        samples = samples[::-1]
    return samples


def _raster_color(
    path: Path, raster: _core.Raster, taken: exif.Exif, decide: bool
) -> tuple[Conversion, str, bool]:
    """Decide the conversion by the rules of `read_picture`; a sentence, and whether it is told."""
    samples = raster.samples
    if samples.dtype.kind == "f":
        if decide and raster.icc_profile is not None:
            logger.warning("%s: its ICC profile is ignored because it is a float file", path)
        return Conversion("linear"), f"linear Rec.709 (float {raster.format})", True
    bits = 8 * samples.dtype.itemsize
    form = f"{bits}-bit {raster.format}"
    if decide and raster.icc_profile is not None:
        grey = samples.shape[2] < 3
        curves, to_xyz = _core.decode_icc(raster.icc_profile, 1 << bits, path)
        if to_xyz is None and not grey:
            raise InputError(
                f"{path}: expected an ICC profile for RGB, found one for grey: convert the"
                " picture to sRGB or give its colour space"
            )
        return from_icc(curves, to_xyz), f"ICC profile of the {form}", True
    if not decide:
        return Conversion("srgb"), "", False
    if (found := _png_color(path, raster)) is not None:
        return found[0], f"{found[1]} of the {form}", True
    if taken.color_space == "adobe-rgb":
        return conversion("adobe-rgb"), f"Adobe RGB (EXIF of the {form})", True
    uncalibrated = ", and EXIF says another colour space" * (taken.color_space is not None)
    return Conversion("srgb"), f"sRGB ({form} without a profile{uncalibrated})", False


def _png_color(path: Path, raster: _core.Raster) -> tuple[Conversion, str] | None:
    """The conversion by a PNG's chunks cICP, gAMA and cHRM, and their names; None = sRGB."""
    curve: Curve | float = "srgb"
    primaries = REC709
    if raster.code_points is not None:
        coded, transfer = raster.code_points
        if coded not in CODED_PRIMARIES or transfer not in CODED_CURVES:
            chunk = f"cICP chunk (primaries {coded}, transfer {transfer})"
            logger.warning("%s: read as sRGB; its %s is ignored", path, chunk)
            return None
        names, primaries, curve = "cICP chunk", CODED_PRIMARIES[coded], CODED_CURVES[transfer]
    else:
        if raster.chromaticities is not None:
            primaries = _primaries(raster.chromaticities)
        # 0.45455 beside the primaries of Rec.709 is what encoders write to mean sRGB.
        usual = near_rec709(primaries) and abs((raster.gamma or 0.45455) - 0.45455) <= 0.01
        if raster.gamma and not usual:
            curve = 1 / raster.gamma
        names = "gAMA chunk" if near_rec709(primaries) else "gAMA and cHRM chunks"
    if curve == "srgb" and near_rec709(primaries):
        return None
    try:
        return from_primaries(curve, primaries), names
    except ValueError as error:
        raise InputError(f"{path}: {error}") from None


def _primaries(x_y: Sequence[float]) -> Primaries:
    return Primaries(*zip(x_y[::2], x_y[1::2], strict=True))


def _hdr_color(
    path: Path, header: radiance.Header, samples: NDArray[Any]
) -> tuple[NDArray[Any], Conversion, str, list[str]]:
    """Samples before exposure, their conversion and its sentence, and what was undone."""
    undone = []
    if header.factors != (1.0, 1.0, 1.0):
        samples = samples / np.array(header.factors, dtype=np.float32)
        undone.append(
            f"EXPOSURE and COLORCORR undone: {' '.join(map('{:g}'.format, header.factors))}"
        )
    if header.primaries is None or near_rec709(header.primaries):
        return samples, Conversion("linear"), "linear Rec.709 (float HDR)", undone
    try:
        convert = from_primaries("linear", header.primaries)
    except ValueError as error:
        raise InputError(f"{path}: {error}") from None
    return samples, convert, "linear, converted from the HDR's primaries", undone


def _exr_picture(
    path: Path, data: bytes, layer: str | None
) -> tuple[NDArray[np.float32], Limits | None, Conversion, str]:
    """Find samples (H, W, 1 to 4), their limits if it has any, conversion and its sentence."""
    channels, chromaticities = _core.decode_exr(data, path)
    prefix = f"{layer}." if layer else ""
    chroma = ("Y", "RY", "BY")
    found = _pick(channels, prefix, "RGBA", "RGB", (*chroma, "A"), chroma, "YA", "Y")
    if not found:
        raise _no_layer(path, channels, f"channels {prefix}R, {prefix}G, {prefix}B or {prefix}Y")
    primaries = REC709 if chromaticities is None else _primaries(chromaticities)
    linear = Conversion("linear")
    try:
        if len(found) > 2 and not near_rec709(primaries):
            linear = from_primaries("linear", primaries)
        if len(found) > 2 and f"{prefix}R" not in channels:
            # OpenEXR: RY = (R - Y) / Y, BY = (B - Y) / Y, and Y a weighted sum of R, G and B.
            luma, red, blue = found[0], (found[1] + 1) * found[0], (found[2] + 1) * found[0]
            weights = rgb_to_xyz(primaries)[1].astype(np.float32)  # they add up to 1
            green = (luma - weights[0] * red - weights[2] * blue) / weights[1]
            found[:3] = red, green, blue
    except ValueError as error:
        raise InputError(f"{path}: {error}") from None
    samples = np.stack(found, axis=-1)
    limits = None
    stored = _pick(channels, f"{prefix}{LIMITS}.", "RGB")
    if stored:
        if not np.isin(stored, (ORDINARY, AT_LEAST, AT_MOST)).all():
            raise InputError(
                f"{path}: expected 0, 1 or 2 in channels {prefix}{LIMITS}, found others"
            )
        limits = np.stack(stored, axis=-1).astype(np.uint8)
    del channels, found, stored
    if chromaticities is None:
        return samples, limits, linear, "linear Rec.709 (EXR without chromaticities)"
    if near_rec709(primaries):
        return samples, limits, linear, "linear Rec.709 (chromaticities of the EXR)"
    if samples.shape[2] < 3:
        return samples, limits, linear, "linear grey (EXR)"
    return samples, limits, linear, "linear, converted from the EXR's chromaticities"


def _pick(
    channels: Mapping[str, NDArray[np.float32]], prefix: str, *sets: Iterable[str]
) -> list[NDArray[np.float32]]:
    """Choose the channels of the first set that is there as a whole."""
    for own in sets:
        names = [prefix + name for name in own]
        if all(name in channels for name in names):
            return [channels[name] for name in names]
    return []


def _no_layer(path: Path, channels: Mapping[str, object], expected: str) -> InputError:
    layers = sorted({name.rpartition(".")[0] for name in channels if "." in name})
    layers_found = f" in layers {listed(layers)}" if layers else ""
    found = f"{listed(channels)}{layers_found}"
    return InputError(f"{path}: expected {expected}, found {found}")
