"""A ColorChecker in a picture: the matrix from the camera's colours to linear Rec.709.

The chart's 24 patches have known reflectances r under D65. Of their colours c in the picture the
matrix is that of least squares in linear light,

    M = argmin Σ |M c − r|²,

so that a white surface in the chart's place under its light is 1 in all channels. Camera and
exposure are the same in all pictures, so M holds for each, and lights keep their own colours.
"""

from __future__ import annotations

import itertools
from importlib import import_module
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pbrfit._core import InputError
from pbrfit.io.color import ICC_D50, colorants_to_rec709, encode_srgb
from pbrfit.io.images import Picture
from pbrfit.values.arrays import Array
from pbrfit.values.quoting import listed

PATCHES = {
    "dark skin": (37.54, 14.37, 14.92),
    "light skin": (64.66, 19.27, 17.50),
    "blue sky": (49.32, -3.82, -22.54),
    "foliage": (43.46, -12.74, 22.72),
    "blue flower": (54.94, 9.61, -24.79),
    "bluish green": (70.48, -32.26, -0.37),
    "orange": (62.73, 35.83, 56.50),
    "purplish blue": (39.43, 10.75, -45.17),
    "moderate red": (50.57, 48.64, 16.67),
    "purple": (30.10, 22.54, -20.87),
    "yellow green": (71.77, -24.13, 58.19),
    "orange yellow": (71.51, 18.24, 67.37),
    "blue": (28.37, 15.42, -49.80),
    "green": (54.38, -39.72, 32.27),
    "red": (42.43, 51.05, 28.62),
    "yellow": (81.80, 2.67, 80.41),
    "magenta": (50.63, 51.28, -14.12),
    "cyan": (49.57, -29.71, -28.32),
    "white": (95.19, -1.03, 2.93),
    "neutral 8": (81.29, -0.57, 0.44),
    "neutral 6.5": (66.89, -0.75, -0.06),
    "neutral 5": (50.76, -0.13, 0.14),
    "neutral 3.5": (35.63, -0.46, -0.48),
    "black": (20.64, 0.07, -0.46),
}
"""CIE L*a*b* under D50 of the patches, row by row: X-Rite, charts made since November 2014."""

COLUMNS, ROWS = 6, 4

GREYS = slice(18, 24)
"""The last row, from white to black."""

SIDE = 0.87
"""Side of a patch, in distances of the middles of neighbours: 40 mm of 46 mm of the classic chart;
smaller charts are within 5 % of that."""

SAMPLED = 0.5
"""Share of a patch's side around its middle that is looked at: corners may be off by a quarter."""


def read_chart(path: Path, picture: Picture, corners: Array | None) -> tuple[Array, str]:
    """The matrix (3, 3) that a picture of a ColorChecker tells, and how well it explains patches.

    It leads from linear Rec.709 as the picture's file says it to that of the chart. `corners`
    (4, 2) are x and y in pixels of the outer corners of dark skin, bluish green, black and white,
    where somebody gave them; else the chart is sought (pbrfit[chart]). Raises InputError if there
    is no chart, or patches are clipped.
    """
    places = _sought(path, picture) if corners is None else corners
    rows, columns = _samples(places)
    height, width = picture.pixels.shape[:2]
    inside = (rows >= 0) & (rows < height) & (columns >= 0) & (columns < width)
    if not inside.all():
        raise InputError(
            f"{path}: expected corners of a ColorChecker within {width} × {height} pixels, "
            f"found {np.round(places, 1).tolist()}"
        )
    patches = np.median(picture.pixels[rows, columns], axis=1).astype(np.float64)
    if picture.limits is not None:
        of_patches = zip(PATCHES, picture.limits[rows, columns], strict=True)
        clipped = [name for name, limits in of_patches if limits.any()]
        if clipped:
            raise InputError(f"{path}: expected no clipped patch, found {listed(clipped)}")
    if (np.diff(patches[GREYS].mean(axis=1)) >= 0).any():
        raise InputError(
            f"{path}: expected a ColorChecker whose last row goes from white to black, found "
            f"{np.round(patches[GREYS].mean(axis=1), 3).tolist()}: corners are those of dark skin, "
            "bluish green, black and white, in this order"
        )
    lab = np.array(list(PATCHES.values()))
    true = _from_lab(lab)
    matrix = np.asarray(np.linalg.lstsq(patches, true, rcond=None)[0].T, np.float64)
    before = patches * (true[GREYS][0].mean() / patches[GREYS][0].mean())  # exposure alone
    off = [np.linalg.norm(_to_lab(of) - lab, axis=1).mean() for of in (before, patches @ matrix.T)]
    said = f"a ColorChecker, mean colour difference {off[1]:.1f} (CIE 1976; {off[0]:.1f} without)"
    return matrix, said


def _samples(corners: Array) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Rows and columns (24, S) of pixels within the patches.

    The plane of the chart is seen by a homography: 8 of its 9 numbers by the four corners.
    """
    square = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], np.float64)
    equations = []
    for (u, v), (x, y) in zip(square, corners, strict=True):
        equations.append([u, v, 1, 0, 0, 0, -x * u, -x * v, -x])
        equations.append([0, 0, 0, u, v, 1, -y * u, -y * v, -y])
    homography = np.linalg.svd(np.array(equations))[2][-1].reshape(3, 3)
    steps = SIDE * SAMPLED * (np.arange(15) / 14 - 0.5)
    across = np.add.outer(np.arange(COLUMNS) + SIDE / 2, steps) / (COLUMNS - 1 + SIDE)
    down = np.add.outer(np.arange(ROWS) + SIDE / 2, steps) / (ROWS - 1 + SIDE)
    v, u = np.broadcast_arrays(down[:, None, :, None], across[None, :, None, :])
    seen = np.stack([u, v, np.ones_like(u)], axis=-1).reshape(len(PATCHES), -1, 3) @ homography.T
    x, y = seen[..., 0] / seen[..., 2], seen[..., 1] / seen[..., 2]
    return np.rint(y).astype(np.intp), np.rint(x).astype(np.intp)


def _sought(path: Path, picture: Picture) -> Array:
    """Corners (4, 2) of the chart by OpenCV 5, in whichever of four turns it is seen."""
    try:
        cv2 = import_module("cv2")
    except ImportError:
        raise InputError(
            f"{path}: expected --chart-corners, or the Python package cv2, which finds them, found "
            "neither: pip install 'pbrfit[chart]'"
        ) from None
    linear = np.nan_to_num(picture.pixels, posinf=0.0)
    shown = encode_srgb(linear / max(float(linear.max()), 1e-30))
    codes = np.rint(255 * shown.clip(0, 1)).astype(np.uint8)[..., ::-1]
    height, width = codes.shape[:2]
    # OpenCV groups what looks like patches by chance: one of two to thirty tries finds a chart.
    for seed, turn in itertools.product(range(32), range(4)):
        cv2.setRNGSeed(seed)
        detector = cv2.mcc.CCheckerDetector_create()
        if detector.process(np.ascontiguousarray(np.rot90(codes, turn)), 1):
            x, y = np.array(detector.getBestColorChecker().getColorCharts(), np.float64).T
            for size in (width, height, width)[:turn][::-1]:
                x, y = size - 1 - y, x
            of_patches = np.stack([x, y], axis=-1).reshape(ROWS, COLUMNS, 4, 2)
            return of_patches[[0, 0, -1, -1], [0, -1, -1, 0], [0, 1, 2, 3]]
    raise InputError(
        f"{path}: expected a ColorChecker of 24 patches, found none; --chart-corners tells where "
        "it is"
    )


def _from_lab(lab: Array) -> Array:
    """Linear Rec.709 (..., 3) under D65 of CIE L*a*b* (..., 3) under D50 (CIE 15:2018, 8.2.1)."""
    y = (lab[..., 0] + 16) / 116
    f = np.stack([y + lab[..., 1] / 500, y, y - lab[..., 2] / 200], axis=-1)
    xyz = ICC_D50 * np.where(f > 6 / 29, f**3, 3 * (6 / 29) ** 2 * (f - 4 / 29))
    return np.asarray(xyz @ colorants_to_rec709(np.eye(3), ICC_D50).T)


def _to_lab(rgb: Array) -> Array:
    """Undoes `_from_lab`."""
    xyz = rgb @ np.linalg.inv(colorants_to_rec709(np.eye(3), ICC_D50)).T / ICC_D50
    f = np.where(xyz > (6 / 29) ** 3, np.cbrt(xyz), xyz / (3 * (6 / 29) ** 2) + 4 / 29)
    x, y, z = np.moveaxis(f, -1, 0)
    return np.stack([116 * y - 16, 500 * (x - y), 200 * (y - z)], axis=-1)
