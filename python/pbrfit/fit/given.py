"""What is given, held against itself and against the pictures: normals, and lamps of a file.

Nothing here changes a fit. What is contradicted is named, with what would explain the pictures.

**The normals of a surface agree with each other.** Integrability (`fit.lamps.integrability`) asks
that a = b along the ray (x, y, -1),

    a = (0, 1, y)·(n × ∂_y n),    b = -(1, 0, x)·(n × ∂_x n).

Where X or Y is flipped, one of the two has the other sign. On planes both are 0, whatever their
normal. At the outline of a mask, normals point away from it (`fit.lamps.outline`). Each patch of
the picture votes by Σ ab / Σ ½(a² + b²), and by the same of normals and outward directions.

**Lamps agree with the pictures.** A sample is albedo times strength times s = (n·ω)⁺, of near lamps
over d². Albedos and strengths are fitted by the sum of |residuals|, so that highlights and shadows
do not govern. Where no normals are given, those of each pixel are fitted with its albedo. Then
lamps that are flipped, or in a ring and turned, leave as much as the right ones, but the normals
are those of no surface.

Alternatives and what is given are compared patch by patch.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pbrfit.fit import settings
from pbrfit.fit.lamps.given_normals import TINY
from pbrfit.fit.lamps.outline import outline
from pbrfit.fit.lamps.photometric import DARK, ROUNDS, brightness, solved
from pbrfit.fit.lamps.problem import LampPixels
from pbrfit.fit.lamps.samples import grey_samples
from pbrfit.fit.left_out import patches_of
from pbrfit.fit.tiles.windows import cut, strided_window, without_shape
from pbrfit.io.resampling import averaged, averaged_channels, reduced_size
from pbrfit.model.geometry import view_directions
from pbrfit.model.lamps import Lamps
from pbrfit.model.reflection import DEFAULT_MODEL
from pbrfit.scene.scene import Scene

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

ERRORS_MIN = 3.0
"""Standard errors by which an alternative has to be better. Six are tried: where what is given
tells nothing, one of them is in one scene of 120, by chance."""

GAIN_MIN = 0.05
"""Share by which an alternative has to lower what lamps leave: fits end within a hundredth."""

PIXELS = 4000
"""At which lamps beside given normals are looked at: 60 in each patch."""

SIDE = 128
"""Longer side in pixels that given normals are averaged down to: noise, and the steps of 8 bits, go
from their slopes."""

OF_A_SURFACE = "they are those of a surface"

FLIPS = {"Y": (1.0, -1.0, 1.0), "X": (-1.0, 1.0, 1.0), "X and Y": (-1.0, -1.0, 1.0)}
"""Signs of the axes where some are flipped. Flipped Y, which is DirectX's, is named where slopes do
not tell it from flipped X."""


@dataclass(frozen=True)
class Contradiction:
    """Something given that is contradicted."""

    what: str
    """Which: "normals" or "lamps"."""
    why: str
    """In which way, and what speaks for that: a clause."""
    remedy: str
    """What to give instead."""

    def in_words(self) -> str:
        """A sentence without its full stop."""
        return f"{self.why}; try {self.remedy}"


def contradiction(scene: Scene) -> Contradiction | None:
    """What is contradicted of a scene's normals and lamps: one of them, or nothing.

    Lamps are looked at where there is one in each picture; without normals, where there are four or
    more, far away: three fit any normal.
    """
    lamps, count = scene.lamps, len(scene.images)
    flipped = None
    if scene.normals_known:
        normals, mask = _reduced(np.asarray(scene.normals, np.float64), scene.valid)
        surface = _Surface(mask, scene.fov)
        flipped = _surely_best(surface.votes(normals), surface.flips(normals))
    if lamps is not None and np.array_equal(lamps.pictures, np.arange(count)):
        if not scene.normals_known:
            told = count > 3 and not lamps.near.any()
            return _of_lamps(_Matt(without_shape(scene, settings.COMPARE_SIDE))) if told else None
        matt = _Matt(cut(scene, strided_window(scene.valid, PIXELS)))
        if matt.pixels.points is not None or not lamps.near.any():
            return _of_lamps_and_normals(matt, flipped)
    return None if flipped is None else _turned(flipped, OF_A_SURFACE, "normals")


def _turned(axes: str, why: str, what: str = "lamps") -> Contradiction:
    look = "look" if len(axes) > 1 else "looks"
    said = f"{axes} of the {what} {look} flipped: with the other sign, {why}"
    remedy = f"the other sign of {axes}"
    if what == "normals" and axes == "Y":
        remedy += " (normals = directx or opengl in scene.toml)"
    return Contradiction(what, said, remedy)


def _of_others(which: str, why: str) -> Contradiction:
    said = f"the lamps look like those of other pictures: with {which}, {why}"
    return Contradiction("lamps", said, which)


def _of_lamps_and_normals(matt: _Matt, flipped: str | None) -> Contradiction | None:
    """Of lamps beside given normals, some of whose axes look flipped by their slopes, or none."""
    given, _ = matt.left(matt.lamps)
    others = {
        axes: matt.left(replace(matt.lamps, places=matt.lamps.places * signs))[0]
        for axes, signs in FLIPS.items()
    } | {which: matt.left(lamps)[0] for which, lamps in matt.paired_otherwise()}
    lower = {what: left for what, left in others.items() if _is_lower(left, given)}
    if not lower:
        return None if flipped is None else _turned(flipped, OF_A_SURFACE, "normals")
    best = min(lower, key=lambda what: lower[what].mean())
    why = _times(given, lower[best])
    if best not in FLIPS:
        return _of_others(best, why)
    if flipped is not None:
        return _turned(best, f"{OF_A_SURFACE}, and {why}", "normals")
    return _turned(best, why)


def _of_lamps(matt: _Matt) -> Contradiction | None:
    """Of lamps alone: the normals that they tell have to be those of a surface."""
    given, normals = matt.left(matt.lamps)
    surface = _Surface(matt.scene.valid, matt.scene.fov)
    others = surface.flips(normals)
    for which, lamps in matt.paired_otherwise():
        left, of_these = matt.left(lamps)
        if _is_lower(left, given):
            return _of_others(which, _times(given, left))
        if not _is_lower(given, left):
            others[which] = surface.votes(of_these)
    best = _surely_best(surface.votes(normals), others)
    if best is None:
        return None
    return (_turned if best in FLIPS else _of_others)(best, "they tell normals of a surface")


def _times(given: Array, other: Array) -> str:
    return f"{given.mean() / other.mean():.2g} times less of the pictures is left"


class _Matt:
    """Matt surfaces under lamps, one in each picture, at some pixels of a scene."""

    def __init__(self, scene: Scene) -> None:
        assert scene.lamps is not None
        self.scene, self.lamps = scene, scene.lamps
        given = np.asarray(scene.normals, np.float64)
        self.pixels = LampPixels.of(scene, given, DEFAULT_MODEL, 1)
        grey, self._usable = grey_samples(self.pixels.samples, self.pixels.told)
        self._relative = grey / brightness(grey, self._usable)[:, None]
        self._patches = patches_of(scene.valid)

    def paired_otherwise(self) -> Iterator[tuple[str, Lamps]]:
        """The same lamps as of other pictures, and which, in words."""
        for which, order in (
            ("those of the next pictures", np.roll(self.lamps.pictures, -1)),
            ("those of the pictures before", np.roll(self.lamps.pictures, 1)),
            ("those in reverse order", self.lamps.pictures[::-1]),
        ):
            of_others = self.lamps.of_pictures(order.tolist())
            yield which, replace(of_others, pictures=self.lamps.pictures)

    def left(self, lamps: Lamps) -> tuple[Array, Array]:
        """Mean |residual| in each patch, of pixels' brightness; and normals (H, W, 3) if fitted."""
        relative, known = self._relative, self.scene.normals_known
        # A sample of a lamp behind the surface says nothing of its normal.
        counted = self._usable & (known | (relative > DARK))
        weights, strengths = counted.astype(np.float64), np.ones(len(lamps))
        vectors = self.pixels.normals
        if known:
            directions, near = lamps.at(self.pixels.points, len(self.pixels))
            shading = np.maximum(np.einsum("pkx,px->pk", directions, vectors), 0.0) * near
        for _ in range(2 * ROUNDS):
            if known:
                shown = shading * strengths
                albedo = (weights * relative * shown).sum(axis=1)
                albedo /= (weights * shown**2).sum(axis=1) + TINY
                shown = albedo[:, None] * shading
            else:
                vectors = solved(relative, weights, lamps.places * strengths[:, None])
                shown = np.maximum(vectors @ lamps.places.T, 0.0)
            strengths = (weights * relative * shown).sum(axis=0)
            strengths /= (weights * shown**2).sum(axis=0) + TINY
            residuals = np.abs(relative - shown * strengths)
            middle = np.median(residuals[self._usable]) + TINY
            weights = counted / np.hypot(1.0, residuals / middle)
        # Of a highlight no more than the pixel's brightness counts.
        sums = np.bincount(self._patches, (self._usable * np.minimum(residuals, 1.0)).sum(axis=1))
        counts = np.bincount(self._patches, self._usable.sum(axis=1))
        normals = np.full((*self.scene.valid.shape, 3), np.nan)
        lengths = np.linalg.norm(vectors, axis=-1, keepdims=True)
        normals[self.scene.valid] = vectors / np.maximum(lengths, TINY)
        return sums / np.maximum(counts, 1), normals


def _reduced(normals: Array, valid: Mask) -> tuple[Array, Mask]:
    """Given normals and their mask, averaged down."""
    size = reduced_size(valid.shape, SIDE)
    mask = averaged(valid, size) > 1 - 1e-4
    return averaged_channels(np.where(valid[..., None], normals, 0.0), size), mask


class _Surface:
    """What normals inside a mask (H, W) have to be like, seen with a field of view in degrees."""

    def __init__(self, valid: Mask, fov: float) -> None:
        self._valid, self._views = valid, view_directions(valid.shape[0], valid.shape[1], fov)
        self._patches = np.zeros(valid.shape, np.intp)
        self._patches[valid] = patches_of(valid)
        self._edge = outline(valid, self._views)

    def flips(self, normals: Array) -> dict[str, Array]:
        """Votes of normals some of whose axes are flipped, by their names."""
        found = {axes: self.votes(normals * signs) for axes, signs in FLIPS.items()}
        # Both together leave slopes as they are, but for a perspective that may be told wrong.
        of_slopes = found["X and Y"].size // 2
        found["X and Y"][:of_slopes] = self.votes(normals)[:of_slopes]
        return found

    def votes(self, normals: Array) -> Array:
        """In [-1, 1], of each patch: whether normals (H, W, 3) are a surface's; NaN = no vote."""
        x, y = (-self._views[..., i] / self._views[..., 2] for i in (0, 1))
        n = np.where(self._valid[..., None], normals, np.nan)
        a, b = np.full((2, *self._valid.shape), np.nan)
        across = np.cross(n[1:-1], n[:-2] - n[2:])
        a[1:-1] = across[..., 1] + y[1:-1] * across[..., 2]
        across = np.cross(n[:, 1:-1], n[:, 2:] - n[:, :-2])
        b[:, 1:-1] = -across[..., 0] - x[:, 1:-1] * across[..., 2]
        known = np.isfinite(a) & np.isfinite(b)
        edge, patches, last = self._edge, self._patches, int(self._patches.max())
        at, ahead = (edge.rows, edge.columns), self._views[edge.rows, edge.columns]
        found, true = (
            of - np.einsum("ei,ei->e", of, ahead)[:, None] * ahead
            for of in (normals[at], edge.normals)
        )
        of_slopes = _agreement(a[known][:, None], b[known][:, None], patches[known], last)
        return np.append(of_slopes, _agreement(found, true, patches[at], last))


def _surely_best(given: Array, others: dict[str, Array]) -> str | None:
    """Of other votes that are surely better than the given, the first that none surely beats."""
    best = None
    for name, votes in others.items():
        beaten = given if best is None else others[best]
        if _is_surely_positive(votes - given) and _is_surely_positive(votes - beaten):
            best = name
    return best


def _agreement(a: Array, b: Array, patches: NDArray[np.intp], last: int) -> Array:
    """Of vectors (E, D) in patches up to the last: Σ a·b / Σ ½(a² + b²), NaN where all are 0."""
    sums = np.bincount(patches, (a * b).sum(axis=1), last + 1)
    sizes = np.bincount(patches, 0.5 * (a**2 + b**2).sum(axis=1), last + 1)
    return np.where(sizes > TINY, sums / np.maximum(sizes, TINY), np.nan)


def _is_lower(left: Array, other: Array) -> bool:
    """Whether some lamps leave surely less than others."""
    return bool(left.mean() < (1 - GAIN_MIN) * other.mean()) and _is_surely_positive(other - left)


def _is_surely_positive(differences: Array) -> bool:
    """Whether patches differ by more than `ERRORS_MIN` standard errors from 0 in the mean."""
    found = differences[np.isfinite(differences)]
    if found.size < 2:
        return False
    error = max(float(found.std(ddof=1)) / np.sqrt(found.size), TINY)
    return bool(found.mean() > ERRORS_MIN * error)
