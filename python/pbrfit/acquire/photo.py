"""The photograph that all starts from, and what a network is shown of it or of a scene folder."""

from __future__ import annotations

import os
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pbrfit._core import InputError
from pbrfit.display.tone import codes, encoded
from pbrfit.io import images
from pbrfit.io.color import ColorSpace
from pbrfit.io.resampling import averaged_channels, averaged_where, reduced_size
from pbrfit.model.geometry import fov_from_focal_length
from pbrfit.result.metrics import white_of
from pbrfit.scene import folder as scene_folder
from pbrfit.scene.options import ReadOptions
from pbrfit.values.arrays import Array, Codes, Mask
from pbrfit.values.quoting import listed

LEAST_SIDE = 64
"""Fewest pixels of a side: below, FLUX.2 refuses, and a picture shows nothing to imagine from."""

WHITE_QUANTILE = 0.99
"""Share of the pixels of a float file that is shown below white: lamps and windows are not."""


@dataclass(frozen=True, eq=False)
class Photo:
    """A photograph at the size that pictures are generated at."""

    path: Path
    pixels: NDArray[np.float32]
    """(H, W, 3), linear Rec.709, upright. Finite; what the mask leaves out is as stored."""
    mask: Mask | None
    """(H, W), bool: what alpha and finite values leave; None = all."""
    sha256: str
    """Of the file, hexadecimal."""
    fov: float | None
    """Horizontal field of view in degrees, from EXIF; None if it says nothing."""
    exposure: float
    """In stops: `srgb8` shows pixels times 2^exposure. 0 of integer files, whose white is white."""
    full_size: tuple[int, int]
    """(height, width) of the file, upright."""
    assumed: dict[str, str] = field(default_factory=dict)
    """In words, what was found or decided about ``color``, ``size``, ``alpha``, ``exposure``."""

    @property
    def size(self) -> tuple[int, int]:
        """(height, width) that pictures of it have."""
        height, width = self.pixels.shape[:2]
        return height, width

    def srgb8(self) -> Codes:
        """What a network is shown: (H, W, 3), sRGB.

        Of an 8-bit sRGB file that was not scaled these are its bytes. What the mask leaves out has
        the mean colour of the rest, because files hold anything under transparent pixels.
        """
        pixels = self.pixels
        if self.mask is not None:
            pixels = np.where(self.mask[..., None], pixels, pixels[self.mask].mean(axis=0))
        return codes(encoded(pixels, self.exposure))


def read_photo(
    path: str | os.PathLike[str],
    *,
    color_space: ColorSpace | None = None,
    max_size: int | None = 1024,
) -> Photo:
    """Read a photograph: EXR, HDR, PNG, JPEG or TIFF, of any depth, colour or grey.

    The colour is decided as by `pbrfit.io.images.read_picture`, the EXIF orientation is applied,
    and alpha below a half leaves pixels out. `color_space` says how to read the stored values,
    whatever the file says. Larger photographs are averaged down in linear light to a longer side of
    `max_size` pixels; None keeps their size. Raises InputError if the file cannot be used, a side
    is below 64 pixels, before or after scaling, or nothing is left by alpha; OSError if it cannot
    be read.
    """
    if max_size is not None and max_size < LEAST_SIDE:
        raise InputError(f"max_size: expected at least {LEAST_SIDE} pixels, found {max_size}")
    path = Path(path)
    picture = images.read_picture(path, color_space)
    height, width = picture.pixels.shape[:2]
    size = (height, width) if max_size is None else reduced_size((height, width), max_size)
    if min(size) < LEAST_SIDE:
        made = f", which max_size {max_size} makes {size[1]} × {size[0]}"
        raise InputError(
            f"{path}: expected a photograph of at least {LEAST_SIDE} × {LEAST_SIDE} pixels, "
            f"found {width} × {height}{made * (size != (height, width))}"
        )
    assumed = {"color": picture.color}
    assumed |= {"picture": "; ".join(picture.notes)} if picture.notes else {}
    sound = np.asarray(np.isfinite(picture.pixels).all(axis=-1))
    pixels = np.where(sound[..., None], picture.pixels, np.float32(0))
    valid = sound if picture.alpha is None else sound & (picture.alpha >= 0.5)
    if not valid.all():
        assumed["alpha"] = f"{np.count_nonzero(~valid)} transparent or infinite pixels left out"
    if size != (height, width):
        assumed["size"] = f"averaged from {width} × {height} to {size[1]} × {size[0]} pixels"
        # Under transparent pixels is anything, often black, which must not darken an outline.
        small, share = averaged_where(pixels, valid, size)
        nothing = share[..., None] == 0
        pixels = np.where(nothing, averaged_channels(pixels, size), small).astype(np.float32)
        valid = share >= 0.5
    if not valid.any():
        raise InputError(
            f"{path}: expected opaque, finite pixels, found none at {size[1]} × {size[0]}"
        )
    exposure = 0.0
    if picture.stored is None:
        exposure = exposure_of(path, pixels[valid])
        assumed["exposure"] = (
            f"shown at {exposure:+.1f} stops: {100 * WHITE_QUANTILE:g} % of the pixels of a float "
            "file are to be below white"
        )
    fov = None
    if picture.taken.focal_length_35mm is not None:
        fov = fov_from_focal_length(picture.taken.focal_length_35mm, height, width)
    return Photo(
        path=path,
        pixels=pixels,
        mask=None if valid.all() else valid,
        sha256=picture.sha256,
        fov=fov,
        exposure=exposure,
        full_size=(height, width),
        assumed=assumed,
    )


def exposure_of(path: Path, pixels: NDArray[np.float32]) -> float:
    """Stops by which `WHITE_QUANTILE` of pixels (..., 3) of a float file end up below white.

    Raises InputError if all is black; it names `path`.
    """
    bright = float(np.quantile(pixels.max(axis=-1), WHITE_QUANTILE))
    if bright <= 0:
        bright = float(pixels.max())
    if bright <= 0:
        raise InputError(f"{path}: expected radiance above 0, found none")
    return float(-np.log2(bright))


def shown_to_network(
    folder: Path, picture: str | None = None, color_space: ColorSpace | None = None
) -> tuple[Codes, str]:
    """The picture of a scene folder that a network is shown, (H, W, 3), sRGB; and what it is.

    Without a name it is the mean of all pictures, each brought to the same mean radiance. Light
    adds up, so this is a photograph of the same view with all lamps on: even light, soft shadows,
    and fewer pixels that are clipped or black than in any single one. Its 98th percentile is white.
    A `color_space` of None is as `scene.toml` says, else the files. Raises InputError or OSError if
    there is no such picture, or one cannot be read, or all are black.
    """
    files = scene_folder.locate(folder)
    paths, names = files.pictures, files.names
    options = ReadOptions(color_space=color_space).or_else(files.settings())
    if picture is not None:
        if picture not in names:
            raise InputError(f"picture: expected one of {listed(names)}, found {picture!r}")
        paths = (paths[names.index(picture)],)
    total: Array = np.zeros(())
    for path in paths:
        read = options.picture(path).pixels
        pixels = np.where(np.isfinite(read), read, 0.0).astype(np.float64)
        mean = float(pixels.mean())
        if not total.ndim:
            total = np.zeros_like(pixels)
        if pixels.shape != total.shape:
            raise InputError(
                f"{path}: expected the size of {paths[0].name}, {total.shape[1]} × "
                f"{total.shape[0]} pixels, found {pixels.shape[1]} × {pixels.shape[0]}"
            )
        if mean > 0:  # a picture without any light tells nothing
            total += pixels / mean
    if not total.any():
        raise InputError(f"{paths[0].parent}: expected radiance above 0, found none")
    seen = codes(encoded(total / white_of(total)))
    what = f"picture {paths[0].stem}" if len(paths) == 1 else f"the mean of {len(paths)} pictures"
    return seen, what
