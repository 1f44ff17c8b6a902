"""Picture files to linear float32, and back.

Files are recognised by their content, not by their name. `read_picture` decodes colour;
`read_data`, `read_ids` and `read_channels` never do. All raise OSError where a file cannot be read.
"""

from __future__ import annotations

import contextlib
import hashlib
import io
import logging
import operator
import os
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.lib import format as npy
from numpy.typing import ArrayLike, NDArray

from pbrfit import _core
from pbrfit._core import InputError
from pbrfit.io import color as coding
from pbrfit.io import exif, layers, radiance, raw_files
from pbrfit.io.color import ColorSpace, Conversion, Curve, Place, Primaries
from pbrfit.io.file_noise import Stored, read_tables
from pbrfit.io.input_files import PICTURE_BYTES, content_of, names_file, open_file, unexpected
from pbrfit.io.limits import AT_LEAST, AT_MOST, ORDINARY, Limits
from pbrfit.values.arrays import Array, Mask
from pbrfit.values.checks import errors_about, one_of
from pbrfit.values.quoting import shown

logger = logging.getLogger("pbrfit")

PICTURE_SUFFIXES = (".exr", ".hdr", ".png", ".jpg", ".jpeg", ".tif", ".tiff")
"""Suffixes, in lower case, of files that `read_picture` reads."""

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

NO_SPACE = ("linear", "scene_linear", "data", "raw", "unknown", "")
"""Names of colour spaces, in lower case, that say no more than a float file does without."""

_OF_CHANNELS = re.compile(
    rb"ImageJ=[^\0]{0,200}\nchannels=[34]\n[^\0]{0,200}mode=co"
    rb"|SizeC=.[34][^>]{0,200}>\s{0,99}<Channel[^>]{0,200}SamplesPerPixel=.1\b"
)
"""In the description of a TIFF file (by ImageJ, or OME) whose pages are channels of a picture."""

_OTHERS = {
    rb"....ftyp(hei[cxms]|hevc|m[is]f1|avif)": "HEIC or AVIF: convert it first, for example with "
    "`heif-convert {0.name} {0.stem}.png`",
    rb"RIFF....WEBP": "WebP",
    rb"\xff\n|....JXL ": "JPEG XL",
    rb"version https://git-lfs": "a pointer of Git LFS: fetch the file with `git lfs pull`",
    rb"GIF8": "GIF",
    rb"BM": "BMP",
}
"""What files that begin so are called, where they are not read."""


@dataclass(frozen=True)
class Picture:
    """One picture, decoded."""

    pixels: NDArray[np.float32]
    """(H, W, 3), linear Rec.709 with D65, float32."""
    alpha: NDArray[np.float32] | None
    """(H, W), coverage in [0, 1], float32, not averaged, or None."""
    limits: Limits | None
    """(H, W, 3), uint8: `AT_LEAST` or `AT_MOST` where `pixels` bound the radiance, as a code is
    outside the code range, or an EXR file's layer says so; 0 elsewhere. None = nowhere."""
    negative: Mask
    """(H, W), bool, not averaged: some channel is below 0 in the file's own primaries."""
    color: str
    """One sentence on how the colour was decided."""
    taken: exif.Exif
    """How it was taken; of `settings`, pictures of a set share what is said."""
    sha256: str
    """Of the file, hexadecimal."""
    stored: Stored | None
    """The samples as they are in an integer file; None for float files."""
    curve_told: bool
    """Whether the caller or the file says which curve decodes the values; else sRGB is assumed."""
    notes: tuple[str, ...] = ()
    """What of the file was left out or undone, in words."""
    warnings: tuple[str, ...] = ()
    """What of the file is to be warned of."""


@dataclass(frozen=True)
class _Decoded:
    """What the reader of a format found in a file; names that `Picture` has mean the same."""

    samples: NDArray[Any]
    """(H, W, 1 to 4), as stored."""
    conversion: Conversion
    color: str
    taken: exif.Exif = field(default_factory=exif.Exif)
    curve_told: bool = True
    turn: int = 1
    """EXIF orientation that is still to be applied."""
    premultiplied: bool = False
    """Whether colours are multiplied by alpha, if there is one."""
    limits: Limits | None = None
    """(H, W, 3): what the file says of them, beside the range of its codes."""
    notes: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()


@names_file
def read_picture(
    path: str | os.PathLike[str],
    color_space: ColorSpace | None = None,
    layer: str | None = None,
    code_range: tuple[int, int] | None = None,
    orientation: Orientation = "exif",
    color_matrix: ArrayLike | None = None,
    straight: bool = True,
    place: Callable[[tuple[int, ...]], Place] | None = None,
    look: int | None = None,
) -> Picture:
    """Read a picture as linear Rec.709.

    A given `color_space` decides, unless an EXR file names another. Else integer files (PNG, JPEG,
    TIFF) follow their ICC profile, the colour chunks of a PNG, or EXIF data that says Adobe RGB,
    and are sRGB without; float files (EXR, HDR, float TIFF) are linear Rec.709, or as an EXR file
    names, or linear in the chromaticities that an EXR or HDR file states; raw files are developed
    to that (`raw_files`). Outside of an EXR file's data window is NaN, of alpha 0 where there is
    one. Grey is repeated to three channels.

    A `color_matrix` (3, 3) is applied after that. Colours that are multiplied by alpha, as in EXR
    and some TIFF files, become `straight` where alpha is at least half. Of an EXR file a `layer` is
    read by name, with or without what stands before its last dot; else channels as of
    `layers.PICTURE`.

    `code_range` is the lowest and the highest code of 255 that is data; others are marked in
    `limits`, channel by channel; None = `CODE_RANGE` of a JPEG file, of others all but 0 and the
    maximum. `place` tells from its size (H, W) where it is put, and which part; without that
    `warnings` are logged. To `look` at all of it at a longer side of so many pixels, every few rows
    and columns are enough, two a pixel. Raises InputError if content or an argument is unusable.
    """
    asked = None if code_range is None else checked_codes(code_range)
    one_of("orientation", orientation, Orientation)
    path = Path(path)
    file = file_of(path)
    page = int(path.stem.rpartition("_")[2]) - 1 if file != path else None
    _, data, form = _load(file, raw=True)
    if layer is not None and form != "EXR":
        raise unexpected(path, f"an EXR file with layer {shown(layer)}", form)
    if form == RAW and color_space not in (None, "linear"):
        raise unexpected(path, "colour space linear for a raw file", color_space)
    chosen = None if color_space is None or form == RAW else coding.conversion(color_space)
    if form == "EXR":
        found = _of_exr(path, data, layer, color_space)
    elif form == RAW:
        samples, limits, color, taken = raw_files.develop(path, data, orientation == "exif")
        found = _Decoded(samples, Conversion("linear"), color, taken, limits=limits)
    else:
        found = _of_raster(path, data, page, orientation, decide=chosen is None)
    convert, notes = chosen or found.conversion, found.notes
    if color_matrix is not None:
        before = np.eye(3) if convert.matrix is None else convert.matrix
        convert = Conversion(convert.curve, np.asarray(color_matrix, np.float64) @ before)

    samples, turn = found.samples, found.turn
    if found.premultiplied and straight and samples.shape[2] in (2, 4):
        samples = _straight(samples)
    to = (place or Place.new)(exif.turned(samples, turn).shape[:2])
    step = 1
    if look is not None and samples.shape[2] in (1, 3):
        step = max(1, max(samples.shape) // (2 * look))
        samples, to = np.ascontiguousarray(samples[::step, ::step]), replace(to, used=np.s_[:, :])
    seen = exif.turned(samples, turn)
    colors, alpha = seen[to.used], None
    if seen.shape[2] in (2, 4):
        colors, alpha = colors[..., :-1], colors[..., -1]
        if not seen[..., -1].any():
            alpha = None
            notes = (*notes, "alpha is 0 in all pixels and ignored")
    stored, codes, maximum = None, None, 1
    negative: Mask = np.broadcast_to(False, colors.shape[:2])
    if samples.dtype.kind == "u":
        maximum = int(np.iinfo(samples.dtype).max)
        codes = (1, maximum - 1)
        if asked is not None or form == "JPEG":
            low, high = asked or CODE_RANGE
            codes = (maximum // 255 * low, maximum // 255 * high)
        plain = samples[..., : colors.shape[2]]
        tables = read_tables(data, plain.shape[2]) if form == "JPEG" else None
        stored = Stored(plain, turn >= 5, convert, form, tables)
    elif colors.min() < 0:
        negative = np.any(colors < 0, axis=-1)
    if to.pixels.nbytes > samples.nbytes:  # what is smaller is turned
        samples, turn = np.ascontiguousarray(seen), 1
    lying = to
    if turn != 1:
        size = to.limits.shape[1::-1] if turn >= 5 else to.limits.shape[:2]
        lying = Place.new(size, exif.as_stored(samples.shape[:2], turn, to.used))
    limited = convert.average(samples, lying, codes)
    if turn != 1:
        to.pixels[:], to.limits[:] = (exif.turned(a, turn) for a in (lying.pixels, lying.limits))
    if found.limits is not None:
        told = found.limits[::step, ::step]
        if codes is not None:  # where a value is at its end, that is nearer the truth
            told = np.where(samples < codes[0], AT_MOST, told)
            told = np.where(samples > codes[1], AT_LEAST, told)
        to.limits[:] = convert.of_limits(told[to.used], to.limits.shape[:2])
        limited = True
    for warning in () if place else found.warnings:
        logger.warning(warning)
    return Picture(
        pixels=to.pixels,
        alpha=None if alpha is None else np.divide(alpha, maximum, dtype=np.float32),
        limits=to.limits if limited else None,
        negative=negative,
        color=found.color if chosen is None else f"{color_space} (as asked for)",
        taken=found.taken,
        sha256=hashlib.sha256(data).hexdigest(),
        stored=stored,
        curve_told=found.curve_told or chosen is not None,
        notes=notes,
        warnings=found.warnings,
    )


def pages(path: Path) -> list[Path]:
    """The pictures that a file holds: itself, or the pages of a stack, which is a TIFF file.

    They are told as if they lay in it: ``scan.tif/scan_01.tif`` is the first of ten or more. Raises
    InputError if pages of full size differ in size or kind, or have one colour each, as ImageJ and
    OME write 16-bit colours; or the file is damaged, or none.
    """
    with open_file(path) as file:
        head = file.read(1 << 16)  # with the description that these programs write first
    kind = _core.image_format(head)
    if kind != "TIFF" or raw_files.is_raw(path, head, kind) or (n := _core.tiff_pages(path)) == 1:
        return [path]
    if _OF_CHANNELS.search(head):
        raise unexpected(path, "pages that are pictures", "one for each channel: save it as RGB")
    return [path / f"{path.stem}_{i + 1:0{len(str(n))}}{path.suffix}" for i in range(n)]


def file_of(path: Path) -> Path:
    """The file that a picture is in: itself, or that of the page of a stack."""
    return path.parent if re.search(r"_\d+$", path.stem) and path.parent.is_file() else path


def read_data(path: str | os.PathLike[str]) -> Array:
    """Read a mask or other data: never decoded as colour.

    Returns (H, W, C), float64: grey, grey and alpha, RGB, or RGB and alpha. Integers are divided by
    the maximum of their type; floats are as stored. Of an EXR file the only channel there is, else
    those of a picture. Raises InputError if the content cannot be used.
    """
    stored = read_stored(Path(path))
    if isinstance(stored, dict):
        names = list(stored)
        if len(names) > 1:
            _, names = layers.chosen(Path(path), names, layers.PICTURE, "channels R, G, B or Y")
        return np.stack([stored[name] for name in names], axis=-1).astype(np.float64)
    unit = np.iinfo(stored.dtype).max if stored.dtype.kind == "u" else 1
    return stored / np.float64(unit)


@names_file
def read_ids(path: str | os.PathLike[str]) -> NDArray[np.uint16]:
    """Read a picture of integer ids, such as segments: (H, W) uint16, as they are stored.

    Raises InputError unless it is a grey PNG or TIFF of 8 or 16 bits, or a palette PNG (indices).
    """
    path, data, kind = _load(path)
    expected = "ids in a grey 8 or 16-bit PNG or TIFF"
    if kind not in ("PNG", "TIFF"):
        raise unexpected(path, expected, kind)
    raster = _core.decode_raster(data, path, indices=True)
    samples = exif.turned(raster.samples, raster.orientation)
    if samples.shape[2] != 1 or samples.dtype.kind != "u":
        raise unexpected(path, expected, f"{samples.shape[2]} channels {samples.dtype}")
    return np.ascontiguousarray(samples[..., 0], dtype=np.uint16)


@names_file
def read_channels(path: str | os.PathLike[str]) -> dict[str, NDArray[np.float32]]:
    """Read all channels of an EXR file as they are: (H, W) float32 by full name, ``albedo.R``.

    In a file with several parts the name of the part comes first; NaN is outside of a part's data
    window. Raises InputError if this is not a sound EXR file of flat, full-resolution channels.
    """
    path, data, kind = _load(path)
    if kind != "EXR":
        raise unexpected(path, "an EXR file", kind)
    return _core.decode_exr(data, path)[0]


@names_file
def read_stored(path: Path) -> NDArray[Any] | dict[str, NDArray[np.float32]]:
    """Read data, such as normals and depth, as it is stored.

    Returns the channels of an EXR file as `read_channels`; of another picture (H, W, C) in the type
    that the file has; of .npy the array, float64. Raises InputError if the content cannot be used.
    """
    content = None
    with open_file(path) as file:
        of_numpy = file.read(len(npy.MAGIC_PREFIX)) == npy.MAGIC_PREFIX
        if of_numpy or path.suffix.lower() == ".npy":
            # Read, not mapped: a mapped file that shrinks would end the process.
            content = content_of(file, path, PICTURE_BYTES)
    if content is None:
        path, data, kind = _load(path)
        if kind == "EXR":
            return _core.decode_exr(data, path)[0]
        raster, header = _raster(path, data)
        turn = raster.orientation if header is None else header.orientation
        return exif.turned(raster.samples, turn)
    try:
        with exif.without_warnings():  # about headers of long ago
            array = np.load(io.BytesIO(content), allow_pickle=False)
        if array.dtype.kind not in "uif" or not array.size:
            raise ValueError(f"{array.dtype} of shape {array.shape}")
    except Exception as error:  # headers are Python expressions, and fail in all ways of these
        raise unexpected(path, "an array of real numbers in .npy", shown(error)) from None
    with np.errstate(all="ignore"):  # of more than 64 bits; infinity is no normal, and no depth
        return np.asarray(array, np.float64)


def write_exr(
    path: str | os.PathLike[str], channels: Mapping[str, ArrayLike], half: bool = False
) -> None:
    """Write an EXR file of one part: ZIP, linear Rec.709 stated in it.

    Channels are (H, W) arrays by name, of one shape; `half` writes 16-bit floats, where values
    beyond 65504 become infinite. Equal channels give equal bytes. An existing file is replaced, as
    a whole or not at all. Raises InputError if there is no channel or their sizes differ.
    """
    planes = [(name, np.asarray(channel, dtype=np.float32)) for name, channel in channels.items()]
    _core.write_exr(path, planes, half)


write_png, encode_png = _core.write_png, _core.encode_png


def checked_codes(code_range: Any) -> tuple[int, int]:
    """The lowest and the highest 8-bit code; InputError if these are none, or not in this order."""
    low = high = 0
    with contextlib.suppress(TypeError, ValueError):
        low, high = map(operator.index, code_range)
    if not 0 <= low < high <= 255:
        raise unexpected("code_range", "two 8-bit codes, 0 ≤ low < high ≤ 255", code_range)
    return low, high


def _load(path: str | os.PathLike[str], *, raw: bool = False) -> tuple[Path, bytes, str]:
    """Read path, content and format of a file that can be read; raw files where they may be."""
    path = Path(path)
    with open_file(path) as file:
        head = file.read(64)  # tells formats; what is no picture is not read, however large it is
        kind = _core.image_format(head)
        is_raw = raw_files.is_raw(path, head, kind)
        if is_raw:
            kind = RAW if raw else None
        if kind is None:
            if not head:
                raise unexpected(path, "a picture", "an empty file")
            kinds = (of for start, of in _OTHERS.items() if re.match(start, head, re.DOTALL))
            found = next((of.format(path) for of in kinds), f"a file that starts with {head[:8]!r}")
            if is_raw:
                found = f"a raw file: {raw_files.how_to_develop(path)}"
            raise unexpected(path, "EXR, HDR, PNG, JPEG or TIFF", found)
        data = content_of(file, path, PICTURE_BYTES)
    return path, data, kind


def _raster(
    path: Path, data: bytes, page: int | None = None
) -> tuple[_core.Raster, radiance.Header | None]:
    """What a file other than EXR holds, or a page of it, and the header of an HDR file."""
    header = radiance.read(data)
    return _core.decode_raster(header.plain if header else data, path, False, page), header


def _of_raster(
    path: Path, data: bytes, page: int | None, orientation: Orientation, decide: bool
) -> _Decoded:
    """A file other than EXR or raw; without `decide`, the colour of integers is left open."""
    raster, header = _raster(path, data, page)
    samples, turn = raster.samples, raster.orientation if orientation == "exif" else 1
    taken = exif.read(data if raster.format == "TIFF" else raster.exif, raster.orientation)
    convert, color, told = Conversion("linear"), f"linear Rec.709 (float {raster.format})", True
    doubts: list[str] = []
    notes = [] if page is None else [f"pages of {shown(path.parent.name)}"]
    if raster.passed_over:
        notes.append(f"smaller pages not read ({raster.passed_over} of each file)")
    if header is not None:
        turn = header.orientation
        if header.factors != (1.0, 1.0, 1.0):
            samples = samples / np.array(header.factors, dtype=np.float32)
            factors = " ".join(map("{:g}".format, header.factors))
            notes.append(f"EXPOSURE and COLORCORR undone: {factors}")
        convert = _stated(path, "linear", header.primaries)
        if convert.matrix is not None:
            color = "linear, converted from the HDR's primaries"
    elif samples.dtype.kind == "u" and decide:
        convert, color, told = _integer_color(path, raster, taken, doubts)
        unnamed = f"{color}, sha256 {hashlib.sha256(raster.icc_profile or b'').hexdigest()[:8]}"
        profile = coding.nearest_name(convert, samples.dtype) or unnamed
        taken = replace(taken, settings={**taken.settings, "colour profile": profile})
    elif decide and raster.icc_profile is not None:
        if linear := _of_linear_profile(path, raster.icc_profile):
            convert, color = linear, "linear, ICC profile of the float TIFF"
        else:
            said = "its ICC profile is ignored because it is a float file's and not linear"
            doubts.append(f"{path}: {said}")
    multiplied = raster.format == "TIFF" and taken.premultiplied
    found = _Decoded(samples, convert, color, taken, told, turn, multiplied)
    return replace(found, notes=tuple(notes), warnings=tuple(doubts))


def _of_linear_profile(path: Path, profile: bytes) -> Conversion | None:
    """Conversion by an ICC profile whose curves are linear, to 1/255; None = it is another."""
    with contextlib.suppress(InputError):
        curves, to_xyz = _core.decode_icc(profile, 256, path)
        if np.abs(curves - np.linspace(0, 1, 256)).max() <= 1 / 255:
            return Conversion("linear", coding.from_icc(curves, to_xyz).matrix)
    return None


def _integer_color(
    path: Path, raster: _core.Raster, taken: exif.Exif, doubts: list[str]
) -> tuple[Conversion, str, bool]:
    """Conversion of an integer file, words on it, and whether it tells its curve; adds `doubts`."""
    bits = 8 * raster.samples.dtype.itemsize
    form = f"{bits}-bit {raster.format}"
    if raster.icc_profile is not None:
        curves, to_xyz = _core.decode_icc(raster.icc_profile, 1 << bits, path)
        if to_xyz is None and raster.samples.shape[2] >= 3:
            remedy = "convert the picture to sRGB or give its colour space"
            raise unexpected(path, "an ICC profile for RGB", f"one for grey: {remedy}")
        return coding.from_icc(curves, to_xyz), f"ICC profile of the {form}", True
    convert, chunks = _png_color(path, raster, doubts)
    if convert.curve != "srgb" or convert.matrix is not None:
        return convert, f"{chunks} of the {form}", True
    if taken.color_space == "adobe-rgb":
        return coding.conversion("adobe-rgb"), f"Adobe RGB (EXIF of the {form})", True
    uncalibrated = ", and EXIF says another colour space" * (taken.color_space is not None)
    return convert, f"sRGB ({form} without a profile{uncalibrated})", False


def _png_color(path: Path, raster: _core.Raster, doubts: list[str]) -> tuple[Conversion, str]:
    """Conversion by a PNG's chunks cICP, gAMA and cHRM, and their names; sRGB without."""
    if raster.code_points is not None:
        coded, transfer = raster.code_points
        primaries, curve = coding.CODED_PRIMARIES.get(coded), coding.CODED_CURVES.get(transfer)
        if primaries and curve:
            return _stated(path, curve, primaries), "cICP chunk"
        chunk = f"cICP chunk (primaries {coded}, transfer {transfer})"
        doubts.append(f"{path}: read as sRGB; its {chunk} is ignored")
        return Conversion("srgb"), ""
    told = raster.chromaticities
    primaries = coding.REC709 if told is None else Primaries(*told)
    plain = coding.near_rec709(primaries)
    # 0.45455 beside the primaries of Rec.709 is what encoders write to mean sRGB.
    usual = plain and abs((raster.gamma or 0.45455) - 0.45455) <= 0.01
    curve = 1 / raster.gamma if raster.gamma and not usual else "srgb"
    return _stated(path, curve, primaries), "gAMA chunk" if plain else "gAMA and cHRM chunks"


def _stated(path: Path, curve: Curve | float, primaries: Primaries) -> Conversion:
    """Conversion from what a file states; InputError if these are no primaries."""
    with errors_about(path):
        return coding.from_primaries(curve, primaries)


def _straight(samples: NDArray[Any]) -> NDArray[Any]:
    """Samples (H, W, 2 or 4), colours over their alpha where that is from a half up to 1."""
    unit = np.iinfo(samples.dtype).max if samples.dtype.kind == "u" else 1
    alpha = samples[..., -1:] / np.float32(unit)
    # Outside of an EXR file's data window nothing is covered, or, with alpha 0 all over, untold.
    samples[np.isnan(alpha[..., 0]), 0 if (alpha > 0).any() else -1 :] = 0
    part = (alpha >= 0.5) & (alpha < 1)
    if not part.any():
        return samples
    colors = samples[..., :-1] / np.where(part, alpha, np.float32(1))
    if unit > 1:
        colors = np.rint(np.minimum(colors, unit))
    return np.concatenate([colors.astype(samples.dtype), samples[..., -1:]], axis=-1)


def _of_exr(path: Path, data: bytes, layer: str | None, asked: ColorSpace | None) -> _Decoded:
    channels, chromaticities, spaces = _core.decode_exr(data, path)
    of, names = layers.chosen(path, channels, layers.PICTURE, "channels R, G, B or Y", layer)
    found = [channels[name] for name in names]
    prefix = f"{of}." if of else ""
    named = ", ".join(dict.fromkeys(one for one in spaces if one.lower() not in NO_SPACE))
    if named:
        wanted = coding.of_name(asked or named)
        if wanted is None or (coding.of_name(named) or wanted) != wanted:
            known = "a known colour space, as lin_ap1_scene, unless one is asked for"
            expected = f"colour space {asked}, as asked for" if asked else known
            raise unexpected(path, expected, shown(named))
        (curve, primaries), color = wanted, f"{shown(named)} (named by the EXR)"
    elif chromaticities is None or not np.any(chromaticities):  # zeros: of who knows none
        curve, primaries = "linear", coding.REC709
        color = "linear Rec.709 (EXR without chromaticities)"
    else:
        curve, primaries = "linear", Primaries(*chromaticities)
        color = "linear, converted from the EXR's chromaticities"
        if coding.near_rec709(primaries):
            color = "linear Rec.709 (chromaticities of the EXR)"
        elif len(found) < 3:
            color = "linear grey (EXR)"
    convert = _stated(path, curve, primaries) if len(found) > 2 else Conversion(curve)
    if len(found) > 2 and names[1].upper() == f"{prefix}RY".upper():
        # OpenEXR: RY = (R - Y) / Y, BY = (B - Y) / Y, and Y a weighted sum of R, G and B.
        luma, red, blue = found[0], (found[1] + 1) * found[0], (found[2] + 1) * found[0]
        weights = coding.rgb_to_xyz(primaries)[1].astype(np.float32)  # they add up to 1
        green = (luma - weights[0] * red - weights[2] * blue) / weights[1]
        found[:3] = red, green, blue
    limits = None
    of_limits = [f"{prefix}{LIMITS}.{channel}" for channel in "RGB"]
    if channels.keys() >= set(of_limits):
        stored = [np.nan_to_num(channels[name]) for name in of_limits]
        if not np.isin(stored, (ORDINARY, AT_LEAST, AT_MOST)).all():
            raise unexpected(path, f"0, 1 or 2 in channels {prefix}{LIMITS}", "others")
        limits = np.stack(stored, axis=-1).astype(np.uint8)
    color = f"layer {shown(of)}, {color}" if of else color
    return _Decoded(np.stack(found, axis=-1), convert, color, premultiplied=True, limits=limits)
