"""Whether pictures of one view line up, measured in a way that the light does not change.

Light changes how strong an edge is, and which of its sides is the brighter one, but not where it
lies and how it runs. So a picture becomes a field of edges

    e = g² / (|g|² + s²),    g = ∂x log I + i ∂y log I

The square doubles the angle, so that an edge and the same edge with its sides exchanged are alike
(Bigün and Granlund 1987); the division lets all edges above s count about the same, whether albedo
or a lamp makes them. The logarithm makes brightness irrelevant. The correlation

    C(d) = Re Σ e_a(x)* e_b(x + d) / √(Σ |e_a|² Σ |e_b|²)

is 1 for equal fields, about 0 for unrelated ones, and has its peak where b lies relative to a.
Edges of shadows and highlights, which move with the lamp, lower the peak, but have no place in
common where they could make another.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pbrfit.io.resampling import averaged_where, reduced_size

Field = NDArray[np.complex64]

SIDE = 512
"""Longer side in pixels at which pictures are compared; larger ones are averaged down."""

REACH = 24
"""Largest shift that is looked for, in pixels at that size."""

TILE = 96
"""Side of the tiles that are compared by themselves, in pixels at that size."""

NEARLY_ALL = 0.999
"""Share of what is averaged that holds data, above which a mean does."""

_TILE_REACH = 12
_WEAK = 0.03  # s: gradients of the logarithm below this fade out
_FLOOR = 0.02  # added before the logarithm, of the picture's bright end
_BLUR = 1.0  # pixels
_LEAST_EDGES = 0.005
"""Mean |e|² below which a tile or picture has nothing to be compared by."""

_MOVED = 1.0
_SURE = 0.3
_GAIN = 0.08
"""A tile has moved if its peak is more than `_MOVED` pixels away, `_SURE` high, and by `_GAIN`
higher than the correlation in place. Chosen on scenes of seeds 2000 to 2104."""


@dataclass(frozen=True)
class Alignment:
    """How a picture lies relative to a reference."""

    shift: tuple[float, float]
    """Pixels (right, down) by which it is shifted as a whole."""
    agreement: float
    """Correlation of the edges at that shift: 1 the same, about 0 unrelated."""
    warp: float
    """Median displacement of tiles that can be told, in pixels: a shift, or what is bent."""
    moved: float
    """Share of the edges in tiles that are displaced, 0 to 1."""
    pixel: float
    """Pixels of the picture per pixel that was compared: errors are about 0.2 of it."""


def gradient(values: NDArray[np.floating[Any]]) -> NDArray[np.complexfloating[Any]]:
    """Central differences of (H, W, ...), right + i down; 0 where the border cuts them off."""
    found = np.zeros(values.shape, np.result_type(values, np.complex64))
    found[:, 1:-1] = (values[:, 2:] - values[:, :-2]) / 2
    found[1:-1] += 1j * (values[2:] - values[:-2]) / 2
    return found


def edges(image: NDArray[Any], mask: NDArray[np.bool_] | None = None) -> Field:
    """Field of edges of a picture, at most `SIDE` pixels long.

    The image is (H, W, 3) linear radiance in any unit, the mask (H, W) False where there is no
    picture. Returns (h, w) complex64, |e| ≤ 1; 0 outside the mask.
    """
    from scipy.ndimage import binary_erosion, gaussian_filter

    size = reduced_size(image.shape, SIDE)
    used = np.isfinite(image).all(axis=-1)
    if mask is not None:
        used &= mask
    grey = np.where(used, np.asarray(image).clip(0).mean(axis=-1), 0.0)
    if size != image.shape[:2]:
        grey, share = averaged_where(grey, used, size)
        used = share > NEARLY_ALL
    if not used.any():
        return np.zeros(size, np.complex64)
    bright = np.quantile(grey[used], 0.97)
    log = np.log(gaussian_filter(grey / max(bright, 1e-30), _BLUR).clip(0) + _FLOOR)
    g = gradient(log)
    inside = binary_erosion(used, iterations=3, border_value=1)
    field = np.where(inside, g * g / (np.abs(g) ** 2 + _WEAK**2), 0)
    return field.astype(np.complex64)


def of_the_others(fields: Sequence[Field]) -> list[Field]:
    """For each field of a view the mean of all others: lasting edges stay, those of one fade.

    Its own edges would agree with themselves, wherever they are.
    """
    total = np.sum(fields, axis=0)
    others = max(len(fields) - 1, 1)
    return [((total - field) / others).astype(np.complex64) for field in fields]


@dataclass(frozen=True)
class Shift:
    """Where the edges of two pictures agree best."""

    shift: tuple[float, float]
    """Pixels of the fields (down, right); 0 where the peak is too far to be looked for."""
    agreement: float
    in_place: float
    """Correlations there, and without a shift."""
    elsewhere: bool  # more than a pixel away

    @property
    def displaced(self) -> bool:
        """Whether the peak is clearly another place."""
        return self.elsewhere and self.agreement > max(_SURE, self.in_place + _GAIN)


def shift_between(reference: Field, field: Field) -> Shift | None:
    """Where the edges of `field` agree best with those of `reference`.

    Both are fields of `edges`, of one size. Returns None if there are no edges to tell by.
    """
    # On small pictures a large shift leaves nothing to compare.
    reach = min(REACH, min(reference.shape) // 4)
    found = _peak(reference, field, reach)
    if found is not None and max(map(abs, found.shift)) > reach - 1:  # it may be beyond
        return Shift((0.0, 0.0), found.in_place, found.in_place, elsewhere=True)
    return found


def compare(reference: Field, field: Field, *, pixel: float = 1.0) -> Alignment | None:
    """Say how the picture of `field` lies relative to that of `reference`.

    Both are fields of `edges`, of one size; `pixel` is in pixels of the picture per pixel of the
    fields. Returns None if there are no edges to tell by.
    """
    found = shift_between(reference, field)
    if found is None:
        return None
    warp, moved = _tiles(reference, field)
    down, right = found.shift
    return Alignment((pixel * right, pixel * down), found.agreement, pixel * warp, moved, pixel)


MOST_SHIFT = 1.0
"""Pixels that were compared."""

MOST_MOVED = 0.25


def in_place(a: Field, b: Field) -> float:
    """Correlation of two fields without a shift, 0 without edges."""
    scale = np.sqrt(_energy(a) * _energy(b))
    return float(np.sum((a.conj() * b).real, dtype=np.float64) / scale) if scale > 0 else 0.0


def _energy(field: NDArray[np.complex64]) -> float:
    return float(np.sum(np.abs(field) ** 2, dtype=np.float64))


def _peak(a: Field, b: Field, reach: int) -> Shift | None:
    """Where C(d) is highest, up to `reach` pixels away; None if there are no edges to tell by.

    Between samples by the parabola through the peak and its neighbours, along each axis.
    """
    from scipy.fft import fft2, ifft2, next_fast_len

    energies = _energy(a), _energy(b)
    if min(energies) < _LEAST_EDGES * a.size:
        return None
    # So much zero around the fields that nothing meets its periodic copy.
    size = [next_fast_len(side + reach) for side in a.shape]
    product = np.conj(fft2(a, size)) * fft2(b, size)
    found = np.roll(ifft2(product).real, (reach, reach), axis=(0, 1)).astype(np.float64)
    found = found[: 2 * reach + 1, : 2 * reach + 1] / np.sqrt(energies[0] * energies[1])
    peak = np.array(np.unravel_index(found.argmax(), found.shape))
    height, shift = found[tuple(peak)], (peak - reach).astype(np.float64)
    for axis, step in enumerate(np.eye(2, dtype=int)):
        if 0 < peak[axis] < 2 * reach:
            before, after = found[tuple(peak - step)], found[tuple(peak + step)]
            curvature = before - 2 * height + after
            if curvature < 0:
                shift[axis] += np.clip((before - after) / (2 * curvature), -0.5, 0.5)
    place = float(shift[0]), float(shift[1])
    far = bool(np.hypot(*place) > _MOVED)
    return Shift(place, float(height), float(found[reach, reach]), far)


def _tiles(reference: Field, field: Field) -> tuple[float, float]:
    """Median displacement of tiles, and share of the edges in those that have moved."""
    side = min(TILE, *reference.shape)
    rows, columns = (
        np.unique(
            np.linspace(0, length - side, 2 * (length - side) // side + 2).round().astype(int)
        )
        for length in reference.shape
    )
    window = np.sqrt(np.outer(*[np.hanning(side + 2)[1:-1]] * 2)).astype(np.float32)
    tiles, weights = [], []
    for y, x in itertools.product(rows, columns):
        a, b = (whole[y : y + side, x : x + side] * window for whole in (reference, field))
        found = _peak(a, b, min(_TILE_REACH, side // 4))
        if found is not None:
            tiles.append(found)
            weights.append(min(_energy(a), _energy(b)))
    if not tiles:
        return 0.0, 0.0
    clear = [np.hypot(*tile.shift) for tile in tiles if tile.agreement > _SURE]
    moved = np.average([tile.displaced for tile in tiles], weights=weights)
    return float(np.median(clear or [0.0])), float(moved)
