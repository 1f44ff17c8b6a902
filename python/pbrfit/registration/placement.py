"""Registration: pictures that are out of line with the others are found and put back.

Where a picture lies is told by least squares (`displacement`); displacements that are too large for
these by the correlation of edges (`alignment`), and whether it shows the same view at all.

A displacement is looked into where it is long enough (`LEAST_DISPLACEMENT`) and explains a share
of what the light leaves (`LEAST_SHARE`). It is believed where the picture, put back, is explained
better by that share, and its edges lie where the others have theirs (`SURE_AGREEMENT`).
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from pbrfit.io.resampling import reduced_size
from pbrfit.model.materials import nearest_inside
from pbrfit.registration import alignment
from pbrfit.registration.displacement import (
    COMPONENTS,
    LEAST_DISPLACEMENT,
    LEAST_SHARE,
    SCREENING,
    Fit,
    Greys,
    Level,
    displacement_at,
)
from pbrfit.scene.scene import Scene
from pbrfit.threads import in_pieces, one_blas_thread
from pbrfit.values.arrays import Array, Codes, Mask

log = logging.getLogger("pbrfit")

Stop = Callable[[], bool]

COARSE_SIDE, SCREENING_SIDE = 128, 64
"""Longer sides in pixels at which far displacements are found, and at which any are looked for."""

LEAST_SIDE = 24
"""Pixels along the shorter side, below which pictures are not registered: windows need some."""

ROUNDED = 0.05
"""Distance in pixels from a whole number up to which a shift is taken for it: the estimate is not
surer, and whole shifts need no interpolation."""

INTERPOLATION_ERROR = 0.02
"""Error of interpolation, as a share of the picture's mean radiance, at which a sample counts half:
everyday noise. It is taken for the difference between cubic and linear interpolation. With full
weight one of 16 pictures, put back by half a pixel, makes errors of a fit 2 to 8 times as large."""

SETTLED = 0.02
"""Change in pixels of all displacements at which rounds end."""

ROUNDS_MAX = 6

OTHER_AGREEMENT = 0.15
"""Agreement of edges below which a picture shows something else, unless it is highest in place: by
chance once in 270 (9 of 49² places), and as low of the same view under light along its edges."""

SURE_AGREEMENT = 0.5
"""Agreement of edges that the median picture has to have for pictures to be registered, and that a
picture has to have where it is put. On smooth bodies under hard lamps it is 0 to 0.4: their edges
are all of light, and what would move a highlight onto another is no displacement."""

LARGEST_SHIFT, LARGEST_TURN = 1 / 8, 1 / 16
"""Largest displacement as a share of the longer side, and largest slope of one: 3.6 degrees, or 6 %
in scale. What has moved further is no picture of a view that was to stay."""

NEIGHBOURS_AGREE = 0.8
"""Correlation of neighbouring pixels from which what a picture shows is not its noise."""

_STEPS = 4  # on a level
_AGREEMENT_NOISE = 0.05
_LONGEST_STEP = 2.0  # pixels of a level

NOT_CHECKED = "not checked"
IN_LINE = "pictures line up"
"""In `Scene.assumed` where no picture was moved or left out."""


@dataclass(frozen=True, eq=False)
class Placement:
    """How a picture lies relative to the others, or why it is left out."""

    name: str
    affine: Array = field(default_factory=lambda: np.zeros((2, 3)))
    """(2, 3): displacement (down, right) in pixels at (1, y, x), with y and x from the middle of
    the picture in halves of its longer side."""
    left_out: str = ""
    """Why it is left out; empty if it is not."""

    @property
    def in_line(self) -> bool:
        """Whether it stays as it is."""
        return not self.affine.any() and not self.left_out

    def in_words(self) -> str:
        """What was found and done, a sentence without its full stop."""
        if self.left_out:
            return f"{self.name} is left out: {self.left_out}"
        down, right = self.affine[:, 0].round(1) + 0.0  # no -0.0
        found = f"{self.name} was shifted by ({right:.1f}, {down:.1f}) pixels"
        (yy, yx), (xy, xx) = self.affine[:, 1:]
        if yy or yx or xy or xx:
            most = np.hypot(*np.abs(self.affine[:, 1:]).sum(axis=1))
            found += f" and turned or scaled by up to {most:.1f} pixels at the corners"
        return f"{found}, and put back"


@dataclass(frozen=True, eq=False)
class Registration:
    """What was found of the pictures of a scene."""

    placements: tuple[Placement, ...] = ()
    """One a picture; none where it cannot be told."""
    hindrance: str = ""
    """Why it cannot be told."""

    @property
    def in_line(self) -> bool:
        """Whether nothing is to be done."""
        return all(one.in_line for one in self.placements)

    def in_words(self) -> str:
        """For `Scene.assumed`."""
        if not self.placements:
            return f"{NOT_CHECKED}: {self.hindrance}"
        moved = [one.in_words() for one in self.placements if not one.in_line]
        return "; ".join(moved) or IN_LINE


def aligned(scene: Scene, *, stop: Callable[[], bool] = lambda: False, threads: int = 0) -> Scene:
    """The scene with pictures that are out of line put back or left out.

    `assumed["alignment"]` says what was done; a scene that has it is returned as it is. Where
    nothing is to be done, or `stop` becomes true before it is known, all arrays are the given ones.
    """
    if "alignment" in scene.assumed:
        return scene
    found = register(scene, stop=stop, threads=threads)
    for one in found.placements:
        if not one.in_line:
            place = "" if scene.source is None else f"{scene.source.path}: "
            log.warning("%s%s", place, one.in_words())
    assumed = {**scene.assumed, "alignment": found.in_words()}
    if found.in_line:
        return replace(scene, assumed=assumed)
    return replace(put_back(scene, found), assumed=assumed)


def register(scene: Scene, *, stop: Stop = lambda: False, threads: int = 0) -> Registration:
    """Find how the pictures of a scene lie relative to each other, by so many threads (0 = all).

    Where most lie in one place, others are put there; where few do, as with a camera in the hand,
    all are put to their middle (the median of each part of the displacement).
    """
    if len(scene.images) < 2:
        return Registration(hindrance="there is one picture")
    if min(scene.height, scene.width) < LEAST_SIDE:
        return Registration(hindrance=f"pictures below {LEAST_SIDE} pixels")
    with one_blas_thread():
        return _Register(scene, stop, threads).run()


class _Register:
    """The registration of one scene, under way."""

    def __init__(self, scene: Scene, stop: Stop, threads: int) -> None:
        self._scene, self._pictures, self._stop = scene, Greys(scene), stop
        self._threads = threads
        self._all = range(len(scene.images))
        self._small = reduced_size(self._pictures.shape, COARSE_SIDE)
        self._scale = max(self._pictures.shape) / max(self._small)
        self._reasons: dict[int, str] = {}
        self._affine = np.zeros((len(self._all), 2, 3))
        self._fields = in_pieces(threads, self._edges, self._all)

    def run(self) -> Registration:
        """How all pictures lie."""
        peaks = self._peaks()
        if self._usual < SURE_AGREEMENT:
            return Registration(hindrance="most edges are shadows or highlights")
        if suspects := self._suspects(peaks):
            self._settle(suspects)
        if self._stop():
            return Registration(hindrance="the time limit was reached before")
        return Registration(
            tuple(
                Placement(name, self._affine[i], self._reasons.get(i, ""))
                for i, name in enumerate(self._scene.names)
            )
        )

    def _peaks(self) -> dict[int, alignment.Shift]:
        """Of pictures that are shifted far: where their edges agree with those of the others.

        The others are taken from where they agree best, found in rounds. Pictures of something else
        are left out here.
        """
        place = np.zeros((len(self._fields), 2), int)
        found: dict[int, alignment.Shift] = {}
        for _ in range(ROUNDS_MAX):
            there = [np.roll(f, -at, (0, 1)) for f, at in zip(self._fields, place, strict=True)]
            peaks = [
                alignment.shift_between(reference, field)
                for reference, field in zip(alignment.of_the_others(there), there, strict=True)
            ]
            found = {
                i: replace(peak, shift=(peak.shift[0] + at[0], peak.shift[1] + at[1]))
                for i, (peak, at) in enumerate(zip(peaks, place, strict=True))
                if peak is not None
            }
            was = place.copy()
            for i, peak in enumerate(peaks):
                if peak is not None and peak.displaced:
                    place[i] = np.rint(found[i].shift)
            place -= np.rint(np.median(place, axis=0)).astype(int)
            if (place == was).all():
                break
        self._usual = usual = float(np.median([one.agreement for one in found.values()] or [0.0]))
        for i, one in found.items():
            if one.agreement < OTHER_AGREEMENT and one.elsewhere and self._neighbours_agree(i):
                self._reasons[i] = (
                    f"its edges agree with those of the others to {max(one.agreement, 0):.2f} of "
                    f"1, the median picture's to {usual:.2f}"
                )
        if len(self._all) - len(self._reasons) < 2:
            self._reasons.clear()
        return {i: one for i, one in found.items() if place[i].any()}

    def _edges(self, i: int, affine: Array | None = None) -> alignment.Field:
        """Edges of picture i averaged down, taken from x + u(x)."""
        from scipy.ndimage import map_coordinates

        grey, used = self._pictures.of(i, self._small)
        if affine is not None:
            places = _displaced(self._small, affine / self._scale)
            grey = map_coordinates(grey, places, order=3, mode="nearest")
            used = map_coordinates(used.astype(np.float32), places, order=1) > 0.999
        return alignment.edges(grey[..., None], used)

    def _neighbours_agree(self, i: int) -> bool:
        """Whether a picture shows more than noise."""
        grey, used = self._pictures.of(i, self._pictures.shape)
        pairs = np.stack([grey[:, :-1], grey[:, 1:]])[:, used[:, 1:] & used[:, :-1]]
        return bool(np.corrcoef(pairs)[0, 1] > NEIGHBOURS_AGREE)

    def _others(self, i: int, among: Iterable[int]) -> list[int]:
        return [j for j in among if j != i and j not in self._reasons]

    def _suspects(self, peaks: dict[int, alignment.Shift]) -> list[int]:
        """Pictures that are out of line as far as a few pixels tell."""
        sizes = {self._pictures.shape, reduced_size(self._pictures.shape, SCREENING_SIDE)}
        levels = [Level(self._pictures, size, SCREENING) for size in sorted(sizes)]
        every = self._others(-1, self._all)

        def seems(i: int) -> bool:
            fits = [level.fit(i, self._others(i, self._all)) for level in levels]
            return i in peaks or seems_displaced(levels[0], *fits)

        found = in_pieces(self._threads, seems, every)
        seem = [i for i, one in zip(every, found, strict=True) if one]
        # Where others are out of line too, they may not yet explain one that is put back.
        least = LEAST_SHARE if 2 * len(seem) <= len(every) else 0.0
        for i in peaks.keys() & set(seem):
            self._affine[i, :, 0] = self._scale * np.array(peaks[i].shift)
        return [i for i in seem if self._confirmed(i, levels, least)]

    def _confirmed(self, i: int, levels: list[Level], least: float) -> bool:
        """Whether the slopes at picture i lead to a place where it is explained better.

        Of a picture in line they are of light: steps along them go on and on, or gain nothing. What
        is found of others is kept, to go on from.
        """
        others = self._others(i, self._all)
        settled = [self._descend(level, i, others, COMPONENTS) for level in levels][-1]
        self._affine[i] = self._believed(levels[-1], i, least) if settled else 0.0
        for level in levels:
            level.move(i, np.zeros((2, 3)))
        return bool(self._affine[i].any())

    def _settle(self, suspects: list[int]) -> None:
        """Find the places of the suspects, in rounds."""
        self._fine = Level(self._pictures, self._pictures.shape)
        placed = set(self._others(-1, self._all)) - set(suspects)
        components = COMPONENTS if len(placed) > len(self._all) // 2 else COMPONENTS // 3
        for number in range(ROUNDS_MAX):
            before = self._affine.copy()
            for i in list(suspects):
                others = self._others(i, placed)
                if len(others) < max(2, len(self._all) // 3):
                    others = self._others(i, self._all)
                self._descend(self._fine, i, others, components)
                if self._too_far(self._affine[i]):
                    self._affine[i] = 0.0
                    suspects.remove(i)
                placed.add(i)
                self._fine.move(i, self._affine[i])
            change = max(map(self._fine.rms, self._affine - before))
            if number > 0 and change < SETTLED and components == COMPONENTS:
                break
            if change < LEAST_DISPLACEMENT:
                components = COMPONENTS
        everything = self._others(-1, self._all)
        now = [
            self._edges(i, self._affine[i]) if self._affine[i].any() else field
            for i, field in enumerate(self._fields)
        ]
        believed = np.zeros_like(self._affine)
        for i in suspects:
            others = np.mean([now[j] for j in self._others(i, everything)], axis=0)
            was, there = (alignment.in_place(others, of[i]) for of in (self._fields, now))
            if there > max(SURE_AGREEMENT, was - _AGREEMENT_NOISE):
                believed[i] = self._believed(self._fine, i, LEAST_SHARE)
        if len(suspects) > len(everything) // 2:
            believed[everything] -= np.median(believed[everything], axis=0)
        for i in everything:
            self._affine[i] = self._simplest(self._fine, believed[i])

    def _descend(self, level: Level, i: int, others: list[int], components: int) -> bool:
        """Move picture i to where the others explain it best; whether steps end there.

        They do where the last is shorter than the least displacement.
        """
        length = np.inf
        for _ in range(_STEPS):
            if self._stop():
                break
            level.move(i, self._affine[i])
            fit = level.fit(i, others, components)
            if fit is None:
                return False
            step = fit.shift.affine
            if fit.bend.believed or self._affine[i, :, 1:].any():
                step = step + fit.bend.affine
            length = level.rms(step) / level.pixel
            self._affine[i] += step * min(1.0, _LONGEST_STEP / max(length, 1e-9))
            if length < SETTLED:
                break
        return length < LEAST_DISPLACEMENT

    def _too_far(self, affine: Array) -> bool:
        """Whether no camera that was to stand still moves so."""
        longer = max(self._pictures.shape)
        shift, slope = np.abs(affine[:, 0]).max(), np.abs(affine[:, 1:]).max()
        return bool(shift > LARGEST_SHIFT * longer or slope > LARGEST_TURN * longer / 2)

    def _believed(self, level: Level, i: int, least: float) -> Array:
        """The simplest displacement of picture i where it explains enough on a level, else 0."""
        found, none = self._simplest(level, self._affine[i]), np.zeros((2, 3))
        fits = []
        for affine in (none, found):
            level.move(i, affine)
            fits.append(level.fit(i, self._others(i, self._all)))
        before, after = fits
        if before is None or after is None or self._too_far(found):
            return none
        return found if before.share_explained_by(after) >= least else none

    def _simplest(self, level: Level, affine: Array) -> Array:
        """A displacement without what is too small: an affine part, parts of a pixel, or all."""
        shift = np.column_stack([affine[:, 0], np.zeros((2, 2))])
        if level.rms(affine) < LEAST_DISPLACEMENT:
            return np.zeros((2, 3))
        if level.rms(affine - shift) >= LEAST_DISPLACEMENT:
            return affine.copy()
        near = np.abs(shift - shift.round()).max() <= ROUNDED
        return np.asarray(shift.round() if near else shift)


def seems_displaced(averaged: Level, coarse: Fit | None, fine: Fit | None = None) -> bool:
    """Whether a picture is out of line by its fit to averaged pictures, or one to them as they are.

    What both would show has to be in both: a bend that a few windows of detail seem to tell is not.
    """
    if coarse is None or fine is None or coarse.out_of_line:
        return any(fit is not None and fit.out_of_line for fit in (coarse, fine))
    return any(
        of_fine.believed
        and averaged.rms(of_fine.affine - of_coarse.affine) < LEAST_DISPLACEMENT * averaged.pixel
        for of_coarse, of_fine in ((coarse.shift, fine.shift), (coarse.bend, fine.bend))
    )


# --- Putting back ------------------------------------------------------------------------------


def put_back(scene: Scene, registration: Registration) -> Scene:
    """The scene with each picture where the others are, without those that are left out.

    Between pixels by cubic splines in linear radiance; whole shifts are exact. Samples that come
    from outside, or from one that has no weight, get weight 0.
    """
    kept = [i for i, one in enumerate(registration.placements) if not one.left_out]
    moved = [(to, registration.placements[i].affine) for to, i in enumerate(kept)]
    moved = [(to, affine) for to, affine in moved if affine.any()]
    if not moved:
        return scene.of_pictures(kept)
    every = np.ones(1) if scene.mask is None else scene.mask[..., None]
    given = np.broadcast_to(every, scene.images.shape) if scene.weights is None else scene.weights
    images, weights = scene.images[kept], given[kept].astype(np.float32)
    limits = None if scene.limits is None else scene.limits[kept]
    for to, affine in moved:
        used = (weights[to] > 0) & np.isfinite(images[to])
        images[to], weights[to] = _resampled(images[to], used, weights[to], affine)
        if limits is not None:
            limits[to] = _touched(limits[to], affine)
    return scene.of_pictures(kept, images=images, weights=weights, limits=limits)


def _resampled(
    image: NDArray[Any], used: Mask, weights: NDArray[np.float32], affine: Array
) -> tuple[NDArray[Any], NDArray[np.float32]]:
    """Picture and weights (H, W, 3) at x + u(x); what unused values have a part in weighs 0."""
    from scipy.ndimage import map_coordinates

    places = _displaced(used.shape[:2], affine)
    shape = np.array(used.shape[:2])[:, None, None]
    inside = np.asarray(((places >= 0) & (places <= shape - 1)).all(axis=0))[..., None]
    # The splines' prefilter spreads values that are not used a little: they are made like others.
    filled = np.stack([image[..., c][nearest_inside(used[..., c])] for c in range(3)], axis=-1)

    def at(planes: NDArray[Any], order: Literal[1, 3]) -> NDArray[Any]:
        found = [
            map_coordinates(planes[..., c], places, order=order, mode="nearest") for c in range(3)
        ]
        return np.stack(found, axis=-1)

    # Linear interpolation leaves values at pixels as they are, to the bit.
    moved = at(filled, 1 if (places == places.round()).all() else 3)
    error = np.abs(moved - at(filled, 1)).max(axis=-1, keepdims=True)
    half = INTERPOLATION_ERROR * max(float(np.abs(image[used]).mean()), 1e-30)
    near = at(weights, 1) / (1 + (error / half) ** 2)
    unused = _touched((~used).astype(np.uint8), affine) > 0
    return moved.astype(image.dtype), np.where(inside & ~unused, near, 0).astype(np.float32)


def _touched(kinds: Codes, affine: Array) -> Codes:
    """Largest kind (H, W, C) among the four samples around x + u(x)."""
    places, last = _displaced(kinds.shape[:2], affine), np.array(kinds.shape[:2]) - 1
    before, after = (
        np.clip(side(places), 0, last[:, None, None]).astype(np.intp)
        for side in (np.floor, np.ceil)
    )
    rows, columns = ((before[axis], after[axis]) for axis in (0, 1))
    return np.asarray(np.max([kinds[row, column] for row in rows for column in columns], axis=0))


def _displaced(shape: Sequence[int], affine: Array) -> Array:
    """(2, H, W): rows and columns x + u(x)."""
    grid = np.stack(np.meshgrid(*map(np.arange, shape), indexing="ij")).astype(np.float64)
    return grid + displacement_at(affine, grid, shape)
