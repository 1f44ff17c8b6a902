"""What is given, held against itself and the pictures: normals, lamps and lights of a file.

Nothing here changes a fit. What is contradicted is named, with what would explain the pictures.

**The normals of a surface agree with each other.** Integrability (`fit.lamps.integrability`) asks
that a = b along the ray (x, y, -1),

    a = (0, 1, y)·(n × ∂_y n),    b = -(1, 0, x)·(n × ∂_x n).

Where X or Y is flipped, one of the two has the other sign. On planes both are 0, whatever their
normal. At the outline of a mask, normals point away from it (`fit.lamps.outline`). Each patch of
the picture votes by Σ ab / Σ ½(a² + b²), and by the same of normals and outward directions.

**Lights agree with the pictures.** A sample is albedo times strength times s = (n·ω)⁺ of a lamp, of
near ones over d², or the irradiance of harmonics at n. Albedos and strengths are fitted by the sum
of |residuals|, so that highlights and shadows do not govern. Where no normals are given, those of
each pixel are fitted with its albedo. Then lamps that are flipped, or in a ring and turned, leave
as much as the right ones, but the normals are those of no surface. Other turns, and other slants,
change how likely the surface is and how alike albedos within a colour (`fit.lamps.ambiguity`).

**The strength of lights agrees with highlights.** Albedo takes up a common factor of known lights;
what dielectrics mirror does not (`fit.scale`), and the best materials leave more of the pictures.

Alternatives and what is given are compared patch by patch.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pbrfit.fit.lamps.given_normals import TINY
from pbrfit.fit.lamps.photometric import DARK, ROUNDS, factors, pseudo_normals, solved
from pbrfit.fit.lamps.problem import LampPixels
from pbrfit.fit.lamps.samples import MATT_PIXELS, Samples
from pbrfit.fit.left_out import patches_of
from pbrfit.fit.objective import Objective
from pbrfit.fit.pixels import fit_level
from pbrfit.fit.scale import IRRADIANCE
from pbrfit.fit.settings import COMPARE_PIXELS_MIN
from pbrfit.fit.windows import cut, strided_window, without_shape
from pbrfit.io.resampling import averaged, averaged_channels, reduced_size
from pbrfit.model.geometry import facing_away, unit, view_directions
from pbrfit.model.lamps import Lamps
from pbrfit.model.reflection import DEFAULT_MODEL, Model, sh_basis
from pbrfit.scene.arrays import consecutive_labels
from pbrfit.scene.depth import DISAGREEMENT_MIN, compared
from pbrfit.scene.outline import outline
from pbrfit.scene.scene import Scene
from pbrfit.values.arrays import Array, Mask

ERRORS_MIN, CHANCE_MAX = 3.0, 0.001
"""Standard errors by which an alternative has to be better: where six tell nothing, one of them is
in one scene of 120. Bound on the probability that by chance some turn of lamps is likelier."""

GAIN_MIN = 0.05
"""Share by which an alternative has to lower what lamps leave: fits end within a hundredth."""

SIDE = 128
"""Longer side in pixels that given normals are averaged down to, which evens out 8 bits' steps."""

AWAY_MAX = 0.5
"""Share of normals facing away from the camera that contradicts them: at edges some do by noise."""

OF_A_SURFACE = "they are those of a surface"

FLIPS = {"Y": (1.0, -1.0, 1.0), "X": (-1.0, 1.0, 1.0), "X and Y": (-1.0, -1.0, 1.0)}
"""Signs of flipped axes: first Y, DirectX's, for where slopes do not tell it from flipped X."""

STRENGTHS = {f"{times:g} times as bright": times for times in (0.5, 0.9, 1.1, 2.0)}
"""Known lights that are tried, in words: by a tenth no albedo is off by more than 0.1."""

MIRRORED = {"left and right": (1,), "top and bottom": (0,), "both": (0, 1)}
"""Axes of segments (H, W) that are exchanged."""


@dataclass(frozen=True)
class Contradiction:
    """Something given that is contradicted."""

    what: str
    """Which: "normals", "lamps", "lights", "depth" or "segments"."""
    why: str
    """In which way, and what speaks for that: a clause."""
    remedy: str
    """What to give instead."""

    def in_words(self) -> str:
        """A sentence without its full stop."""
        return f"{self.why}; try {self.remedy}"


def contradiction(
    scene: Scene, averaged: Scene | None = None, model: Model | None = None
) -> Contradiction | None:
    """What is contradicted of a scene's normals, lights, depth and segments: one, or nothing.

    Lamps are looked at where there is one in each picture; without normals, where there are four or
    more, far away: three fit any normal. `averaged` is such a scene as `without_shape` gives it.
    Known lights are reflected by `model`, else by that of the pictures.
    """
    return (
        _of_normals_and_lights(scene, averaged)
        or _of_strength(scene, model)
        or _of_depth(scene)
        or _of_segments(scene)
    )


def _of_strength(scene: Scene, model: Model | None) -> Contradiction | None:
    lights = scene.lighting
    if lights is None or not scene.normals_known:
        return None
    few = cut(scene, strided_window(scene.valid, MATT_PIXELS))
    patches = patches_of(few.valid)

    def left(times: float) -> Array:
        objective = Objective(replace(few, lighting=times * lights), model=model)
        sum_sq = fit_level(objective, objective.start())
        return np.asarray(np.bincount(patches, np.sqrt(sum_sq)) / np.bincount(patches))

    given, others = left(1.0), {which: left(times) for which, times in STRENGTHS.items()}
    which = _lowest(given, others)
    if which is None:
        return None
    said = f"the strength of the lights looks wrong: {which}, {_times(given, others[which])}"
    return Contradiction("lights", said, f"lights {which}")


def _of_depth(scene: Scene) -> Contradiction | None:
    if scene.depth is None or not scene.normals_known:
        return None
    off = compared(scene.depth, scene.normals, scene.fov)[0]
    if not off > DISAGREEMENT_MIN:
        return None
    said = f"normals of the depth are {off:.0f} degrees from the given ones in the median"
    return Contradiction("depth", said, "depth and normals of one view")


def _of_segments(scene: Scene) -> Contradiction | None:
    """Of one material colours are alike: mirrored segments may not leave less of their means."""
    if scene.segments is None:
        return None
    window = strided_window(scene.valid, MATT_PIXELS)
    few = cut(scene, window)
    colors = np.mean([few.samples(i) for i in range(len(few.images))], axis=0, dtype=np.float64)
    colors = np.log(np.maximum(colors, TINY + 0.01 * colors.mean()))
    patches = patches_of(few.valid)

    def left(segments: NDArray[np.integer[Any]]) -> Array:
        labels, count = consecutive_labels(window.of(segments)[few.valid])
        sizes = np.bincount(labels, minlength=count + 1).clip(1)
        rests = [of - (np.bincount(labels, of, count + 1) / sizes)[labels] for of in colors.T]
        rest = np.abs(rests).mean(axis=0)
        return np.asarray(np.bincount(patches, rest) / np.bincount(patches))

    given = left(scene.segments)
    others = {which: left(np.flip(scene.segments, axes)) for which, axes in MIRRORED.items()}
    which = _lowest(given, others)
    if which is None:
        return None
    said = f"the segments look mirrored: with {which} exchanged, {_times(given, others[which])}"
    return Contradiction("segments", said, "the segments of this picture")


def _of_normals_and_lights(scene: Scene, averaged: Scene | None) -> Contradiction | None:
    lamps = scene.lamps
    if lamps is not None and not np.array_equal(lamps.pictures, np.arange(len(scene.images))):
        lamps = None
    if not scene.normals_known:
        if lamps is None or lamps.near.any() or len(lamps) < 4:
            return None
        return _of_lamps(_Matt(averaged or without_shape(scene)))
    away = facing_away(scene.normals[scene.valid], scene.views[scene.valid]).mean()
    if away > AWAY_MAX:
        said = f"{100 * away:.0f} % of the normals face away from the camera"
        return Contradiction("normals", said, "the other sign of Z, which points to the viewer")
    normals, mask = _reduced(np.asarray(scene.normals, np.float64), scene.valid)
    surface = _Surface(mask, scene.fov)
    flipped = _surely_best(surface.votes(normals), surface.flips(normals))
    found = None if flipped is None else _turned(flipped, OF_A_SURFACE, "normals")
    if scene.lighting is not None or lamps is not None:
        matt = _Matt(cut(scene, strided_window(scene.valid, MATT_PIXELS)))
        if lamps is None or matt.pixels.points is not None or not lamps.near.any():
            found = _of_lights_and_normals(matt, flipped) or found
    return found


def _turned(axes: str, why: str, what: str = "lamps") -> Contradiction:
    look = "look" if len(axes) > 1 else "looks"
    said = f"{axes} of the {what} {look} flipped: with the other sign, {why}"
    remedy = f"the other sign of {axes}"
    if what == "normals" and axes == "Y":
        remedy += " (normals = directx or opengl in scene.toml)"
    return Contradiction(what, said, remedy)


def _of_others(which: str, why: str, what: str = "lamps") -> Contradiction:
    said = f"the {what} look like those of other pictures: with {which}, {why}"
    return Contradiction(what, said, which)


def _of_lights_and_normals(matt: _Matt, flipped: str | None) -> Contradiction | None:
    """Of lights beside given normals, some of whose axes look flipped by their slopes, or none."""
    given, _ = matt.left()
    others = {axes: matt.left(signs=signs)[0] for axes, signs in FLIPS.items()}
    others |= {which: matt.left(order)[0] for which, order in matt.otherwise.items()}
    turned = _turned_lamps(matt.lamps)
    for which, lamps in turned.items():
        others[which] = _Matt(replace(matt.scene, lamps=lamps)).left()[0]
    best = _lowest(given, others)
    if best is None:
        return None
    why, what = _times(given, others[best]), "lights" if matt.lamps is None else "lamps"
    if best in turned:
        said = f"the directions of the lamps look wrong: {best}, {why}"
        return Contradiction(what, said, f"lamps {best}")
    if best not in FLIPS:
        return _of_others(best, why, what)
    if flipped is not None:
        return _turned(best, f"{OF_A_SURFACE}, and {why}", "normals")
    return _turned(best, why, what)


def _turns() -> dict[str, Array]:
    """(3, 3) each: what lamps that are turned, or slanted otherwise, are multiplied by."""
    from scipy.spatial.transform import Rotation

    found = {
        f"turned by {angle} degrees about {axis}": Rotation.from_euler(axis, angle, degrees=True)
        for axis in "XYZ"
        for angle in (-15, 15)  # off by less, lamps rarely bring albedos off by 0.1
    }
    slants = {f"{times} times as slanted": np.diag([times, times, 1.0]) for times in (0.7, 1.5)}
    return {which: turn.as_matrix() for which, turn in found.items()} | slants


def _turned_lamps(lamps: Lamps | None) -> dict[str, Lamps]:
    """Far lamps with these turns; none of near ones."""
    if lamps is None or lamps.near.any():
        return {}
    places = {which: lamps.places @ turn.T for which, turn in _turns().items()}
    return {which: replace(lamps, places=unit(of)) for which, of in places.items()}


def _of_lamps(matt: _Matt) -> Contradiction | None:
    """Of lamps alone: the normals that they tell have to be those of a surface."""
    given, normals = matt.left()
    surface = _Surface(matt.scene.valid, matt.scene.fov)
    others = surface.flips(normals)
    for which, order in matt.otherwise.items():
        left, of_these = matt.left(order)
        if _is_lower(left, given):
            return _of_others(which, _times(given, left))
        if not _is_lower(given, left):
            others[which] = surface.votes(of_these)
    best = _surely_best(surface.votes(normals), others)
    if best is None:
        return _of_turns(matt)
    return (_turned if best in FLIPS else _of_others)(best, "they tell normals of a surface")


def _of_turns(matt: _Matt) -> Contradiction | None:
    """Of far lamps alone: by how likely surface and albedos are under lamps that are turned."""
    from pbrfit.fit.lamps.ambiguity import Places, albedo_cost, integrability_cost  # scipy.optimize
    from pbrfit.fit.lamps.surface import strengths_along

    scene, data, views = matt.scene, matt.data, matt.scene.views
    assert scene.lamps is not None
    product = factors(data.relative, data.usable)
    strengths = strengths_along(product.lamps, scene.lamps.places) if product.rank == 3 else None
    if strengths is None:
        return None
    lamps = scene.lamps.places * strengths[:, None]
    normals = pseudo_normals(data.relative, data.usable, lamps, 1)
    wide = scene.fov_known and scene.fov > 0
    rays = views if wide else np.broadcast_to((0.0, 0.0, 1.0), views.shape)
    places = Places.of(data, rays, views, normals, lamps, outline(scene.valid, views))
    if len(places.chosen) < COMPARE_PIXELS_MIN:
        return None

    def cost(turn: Array) -> float:
        albedo = np.linalg.norm(places.vectors @ np.linalg.inv(turn), axis=-1)
        return albedo_cost(albedo, places)[0] + integrability_cost(turn.T, places)[0]

    costs = {which: cost(turn) for which, turn in _turns().items()}
    which = min(costs, key=lambda one: costs[one])
    if cost(np.eye(3)) - costs[which] < np.log(len(costs) / CHANCE_MAX):
        return None
    said = f"the directions of the lamps look wrong: {which}, shape and albedos are likelier"
    return Contradiction("lamps", said, f"lamps {which}")


def _times(given: Array, other: Array) -> str:
    return f"{given.mean() / other.mean():.2g} times less of the pictures is left"


class _Matt:
    """Matt surfaces at some pixels of a scene, under one lamp in each picture, or harmonics."""

    def __init__(self, scene: Scene) -> None:
        self.scene, self.lamps = scene, scene.lamps if scene.lighting is None else None
        given = np.asarray(scene.normals, np.float64)[scene.valid]
        self.pixels = LampPixels.of(scene, given, DEFAULT_MODEL, 1, scene.places)
        samples, told = self.pixels.samples, self.pixels.told
        self.data = Samples.of(lambda some: (samples[some], told[some]), scene.valid, 1)
        self._patches = patches_of(scene.valid)
        self._in_order = np.arange(len(scene.images))
        self.otherwise = {
            "those of the next pictures": np.roll(self._in_order, -1),
            "those of the pictures before": np.roll(self._in_order, 1),
            "those in reverse order": self._in_order[::-1],
        }
        """The same lights as of other pictures: which, in words, and their order."""

    def _shading(self, signs: ArrayLike) -> Array:
        """(P, N): of white surfaces, with these signs of the axes of lights."""
        if self.lamps is None:
            assert self.scene.lighting is not None
            basis = IRRADIANCE * sh_basis(self.pixels.normals * np.asarray(signs))
            return np.asarray(np.maximum(basis @ self.scene.lighting.mean(axis=-1).T, 0.0))
        lamps = replace(self.lamps, places=self.lamps.places * np.asarray(signs))
        directions, near = lamps.at(self.pixels.points, len(self.pixels))
        cosines = np.einsum("pkx,px->pk", directions, self.pixels.normals)
        return np.asarray(np.maximum(cosines, 0.0) * near)

    def left(
        self, order: NDArray[np.intp] | None = None, signs: ArrayLike = (1.0, 1.0, 1.0)
    ) -> tuple[Array, Array]:
        """Mean |residual| in each patch, of pixels' brightness; and normals (H, W, 3) if fitted.

        With lights in another order, or with other signs of their axes.
        """
        order = self._in_order if order is None else order
        relative, usable, known = self.data.relative, self.data.usable, self.scene.normals_known
        # A sample of a lamp behind the surface says nothing of its normal.
        counted = usable & (known | (relative > DARK))
        weights, strengths = counted.astype(np.float64), np.ones(len(order))
        vectors = self.pixels.normals
        if known:
            shading = self._shading(signs)[:, order]
        else:
            assert self.lamps is not None
            places = self.lamps.places[order]
        for _ in range(2 * ROUNDS):
            if known:
                shown = shading * strengths
                albedo = (weights * relative * shown).sum(axis=1)
                albedo /= (weights * shown**2).sum(axis=1) + TINY
                shown = albedo[:, None] * shading
            else:
                vectors = solved(relative, weights, places * strengths[:, None])
                shown = np.maximum(vectors @ places.T, 0.0)
            strengths = (weights * relative * shown).sum(axis=0)
            strengths /= (weights * shown**2).sum(axis=0) + TINY
            residuals = np.abs(relative - shown * strengths)
            middle = np.median(residuals[usable]) + TINY
            weights = counted / np.hypot(1.0, residuals / middle)
        # Of a highlight no more than the pixel's brightness counts.
        sums = np.bincount(self._patches, (usable * np.minimum(residuals, 1.0)).sum(axis=1))
        counts = np.bincount(self._patches, usable.sum(axis=1))
        normals = np.full((*self.scene.valid.shape, 3), np.nan)
        normals[self.scene.valid] = unit(vectors, TINY)
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


def _lowest(given: Array, others: dict[str, Array]) -> str | None:
    """Of those that leave surely less than what is given, the one that leaves least."""
    lower = [which for which, left in others.items() if _is_lower(left, given)]
    return min(lower, key=lambda which: others[which].mean(), default=None)


def _is_lower(left: Array, other: Array) -> bool:
    """Whether something leaves surely less than another, by its factor in each patch."""
    factors = np.log((other + TINY) / (left + TINY))
    return bool(left.mean() < (1 - GAIN_MIN) * other.mean()) and _is_surely_positive(factors)


def _is_surely_positive(differences: Array) -> bool:
    """Whether patches differ by more than `ERRORS_MIN` standard errors from 0 in the mean."""
    found = differences[np.isfinite(differences)]
    if found.size < 2:
        return False
    error = max(float(found.std(ddof=1)) / np.sqrt(found.size), TINY)
    return bool(found.mean() > ERRORS_MIN * error)
