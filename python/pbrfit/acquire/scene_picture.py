"""The one picture of a scene folder that a network is shown."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pbrfit._core import InputError
from pbrfit.io import images
from pbrfit.io.color import ColorSpace
from pbrfit.result.metrics import display, white_of
from pbrfit.scene import folder as scene_folder


def shown_to_network(
    folder: Path, picture: str | None = None, color_space: ColorSpace | None = None
) -> tuple[NDArray[np.uint8], str]:
    """Make it: (H, W, 3), sRGB; and what it is, in words.

    Without a name it is the mean of all pictures, each brought to the same mean radiance. Light
    adds up, so this is a photograph of the same view with all lamps on: even light, soft shadows,
    and fewer pixels that are clipped or black than in any single one. Its 98th percentile is white.

    Parameters
    ----------
    folder
        Scene folder.
    picture
        Name of one picture, without suffix, that is shown instead.
    color_space
        Of all pictures; None = as `scene.toml` says, else the files.

    Raises
    ------
    InputError, OSError
        If there is no such picture, or one cannot be read, or all are black.
    """
    paths = scene_folder.find_pictures(folder)
    if color_space is None:
        color_space = scene_folder.read_settings(folder / "scene.toml").color_space
    if picture is not None:
        names = [path.stem for path in paths]
        if picture not in names:
            raise InputError(
                f"picture: expected one of {', '.join(names[:12])}"
                f"{', ...' if len(names) > 12 else ''}, found {picture!r}"
            )
        paths = [paths[names.index(picture)]]
    total: NDArray[np.float64] | None = None
    for path in paths:
        read = images.read_picture(path, color_space)
        pixels = np.where(np.isfinite(read.pixels), read.pixels, 0.0).astype(np.float64)
        mean = float(pixels.mean())
        if total is None:
            total = np.zeros_like(pixels)
        if pixels.shape != total.shape:
            raise InputError(
                f"{path}: expected the size of {paths[0].name}, {total.shape[1]} × "
                f"{total.shape[0]} pixels, found {pixels.shape[1]} × {pixels.shape[0]}"
            )
        if mean > 0:  # a picture without any light tells nothing
            total += pixels / mean
    if total is None or not total.any():
        raise InputError(f"{paths[0].parent}: expected radiance above 0, found none")
    seen = np.rint(255 * display(total, white_of(total))).astype(np.uint8)
    what = f"picture {paths[0].stem}" if len(paths) == 1 else f"the mean of {len(paths)} pictures"
    return seen, what
