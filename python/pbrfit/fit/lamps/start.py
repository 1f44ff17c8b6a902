"""The start of a fit with lamps: normals, albedo and lamps from pictures alone, taken as diffuse.

Known lamps leave robust photometric stereo at each pixel (`photometric`). Unknown ones are found
with the pseudo-normals, up to a matrix, by a factorisation (`factorization`); the matrix by all
cues at once (`ambiguity`, `cues`). What no cue tells is named in `undetermined`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from pbrfit._core import InputError
from pbrfit.fit.lamps.ambiguity import EQUALLY_LIKELY, Minimum, minima
from pbrfit.fit.lamps.cues import Places, unit_and_length
from pbrfit.fit.lamps.factorization import Factors, factors
from pbrfit.fit.lamps.integrability import equations
from pbrfit.fit.lamps.outline import Outline, inflated, outline
from pbrfit.fit.lamps.photometric import PseudoNormals, brightness, pseudo_normals
from pbrfit.fit.lamps.strengths import color_of_lamps, strengths_along

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

FACTORED_MAX = 4000
"""Pixels that the lamps' space is found from: N unknown lamps of three numbers each are known to a
per cent of σ by as many."""

PLACES_MAX = 2500
"""Pixels that cues look at: the sampling error of a mean over them, 2 %, is below that of the
blocks, 12 %."""

OUTLINE_MAX = 600
"""Pixels of the outline that cues look at."""

BLOCKS = 8
"""Blocks of the picture across the mask's larger side: what light from other surfaces, gloss and
shadows put in error together is about an eighth of an object."""

PARTNERS = 12
"""Pixels at random that the one of the likest colour is taken from, as a partner of equal
albedo."""

KNOWN_MIN = 0.05
"""Least part of a pixel's information, in the direction it says least of, of the median pixel's,
with which its normal is its own and not its neighbours'."""


SAME_DEGREES = 5.0
"""Mean angle between two minima's normals, in degrees, up to which they are one surface."""

FLAT = 0.01
"""Least singular value of the lamps' directions, of the largest, below which they lie in a plane:
their largest angle to it is about a degree."""

COLORED_MAX = 20_000
"""Pixels that the lamps' colours are found from."""

RADII = (3.0, 12.0, 48.0)
"""Standard deviations in pixels of the mean normal around a pixel that does not know its own."""

ENOUGH = 0.05
"""Share of known pixels, by the weights of that mean, from which on it is taken."""


@dataclass(frozen=True, eq=False)
class LampStart:
    """Where a fit with lamps begins.

    Attributes
    ----------
    normals
        (H, W, 3) unit vectors in camera space, NaN outside the mask.
    albedo
        (H, W, 3) linear, up to a factor for each channel; NaN outside the mask.
    directions
        (N, 3) unit vectors from the scene to the lamps.
    strengths
        (N, 3) linear, such that a sample is albedo times strength times max(n·l, 0).
    weights
        (N, H, W) in [0, 1], how far each sample follows this law: small in highlights and shadows.
    known
        (H, W), True where the pixel's own samples tell its normal.
    figures
        What each step and each cue said.
    undetermined
        Sentences on what is not determined; empty if nothing is known of that kind.
    """

    normals: Array
    albedo: Array
    directions: Array
    strengths: Array
    weights: Array
    known: Mask
    figures: dict[str, float]
    undetermined: tuple[str, ...]


def start_of_known_lamps(
    samples: Array,
    usable: Mask,
    mask: Mask,
    views: Array,
    directions: Array,
    strengths: Array | None = None,
) -> LampStart:
    """Start with lamps whose directions are known.

    Parameters
    ----------
    samples
        (N, H, W) or (N, H, W, 3) linear radiance.
    usable
        (N, H, W): samples that are not clipped and belong to the mask.
    mask
        (H, W).
    views
        (H, W, 3) unit vectors to the camera.
    directions
        (N, 3) unit vectors.
    strengths
        (N,) or (N, 3); None = unknown, found up to a common factor.

    Raises
    ------
    InputError
        If there are fewer than three pictures or shapes do not fit.
    """
    data = _Samples.of(samples, usable, mask)
    lamps = np.asarray(directions, np.float64)
    if lamps.shape != (data.pictures, 3):
        raise InputError(f"directions: expected {(data.pictures, 3)}, found {lamps.shape}")
    undetermined: tuple[str, ...] = ()
    if strengths is None:
        grey, undetermined = _strengths_of_known(data, lamps)
    else:
        grey = np.asarray(strengths, np.float64).reshape(data.pictures, -1).mean(axis=1)
    normals = pseudo_normals(data.grey, data.usable, lamps * grey[:, None])
    flat = _in_plane(lamps)
    rough = None
    if flat:
        rough = inflated(mask, views) if len(outline(mask, views)) else np.array(views, np.float64)
    figures = {"spread of samples": normals.scale}
    words = undetermined + flat
    return _finished(data, views, normals, lamps * grey[:, None], figures, words, rough)


def start_of_unknown_lamps(
    samples: Array,
    usable: Mask,
    mask: Mask,
    views: Array,
    fov: float = 0.0,
    guide: Array | None = None,
) -> LampStart:
    """Start with lamps of which nothing is known but that there is a far one in each picture.

    Parameters
    ----------
    samples, usable, mask, views
        As in `start_of_known_lamps`.
    fov
        Horizontal field of view in degrees; 0 = orthographic or unknown.
    guide
        (H, W, 3) unit normals from elsewhere, NaN where there are none; None = none.

    Raises
    ------
    InputError
        If there are fewer than three pictures or shapes do not fit.
    """
    data = _Samples.of(samples, usable, mask)
    rays = views if fov > 0 else np.broadcast_to([0.0, 0.0, 1.0], views.shape)
    chosen = _some(len(data.grey), FACTORED_MAX)
    product = factors(data.grey[chosen], data.usable[chosen])
    edge = outline(mask, views)
    if product.rank < 3:
        return _start_of_few(data, views, edge, product, guide)
    lamps = product.lamps * product.sizes
    normals = pseudo_normals(data.relative, data.usable, lamps)
    places = _places(data, rays, views, normals, lamps, edge, guide)
    rough = inflated(mask, views)[data.where] if len(edge) else None
    found = minima(places.of, None if rough is None else rough[places.chosen])
    best, undetermined = _decided(found, places.of, len(edge) > 0 or guide is not None)
    scaled = PseudoNormals(
        normals.vectors @ best.normals * data.brightness[:, None],
        normals.weights,
        _turned(normals.precision, best.normals),
        normals.scale,
    )
    figures = {
        "spread of samples": normals.scale,
        **{f"size of direction {i + 1}": float(product.sizes[i]) for i in range(3)},
        **{f"cost of {name}": value for name, value in best.parts.items()},
    }
    return _finished(data, views, scaled, lamps @ best.lamps, figures, undetermined)


@dataclass(frozen=True, eq=False)
class _Samples:
    """Pixels of the mask: (P, N) grey samples, what of them is usable, and their colours."""

    colors: Array
    """(P, N, C)."""
    grey: Array
    usable: Mask
    brightness: Array
    where: tuple[NDArray[np.intp], ...]
    mask: Mask

    @classmethod
    def of(cls, samples: Array, usable: Mask, mask: Mask) -> _Samples:
        samples = np.asarray(samples, np.float64)
        if samples.ndim == 3:
            samples = samples[..., None]
        if samples.ndim != 4 or len(samples) < 3:
            raise InputError(
                f"pictures: expected three or more of one size, found {samples.shape[:3]}"
            )
        for name, array, shape in (
            ("usable", usable, samples.shape[:3]),
            ("mask", mask, samples.shape[1:3]),
        ):
            if np.shape(array) != shape:
                raise InputError(f"{name}: expected shape {shape}, found {np.shape(array)}")
        if not mask.any():
            raise InputError("mask: expected pixels, found none")
        colors = np.moveaxis(samples[:, mask], 0, 1)
        used = np.moveaxis(usable[:, mask], 0, 1) & np.isfinite(colors).all(axis=2)
        colors = np.where(used[..., None], colors, 0.0)
        grey = colors.mean(axis=2)
        return cls(colors, grey, used, brightness(grey, used), np.nonzero(mask), mask)

    @property
    def pictures(self) -> int:
        return int(self.grey.shape[1])

    @property
    def relative(self) -> Array:
        return np.asarray(self.grey / self.brightness[:, None])

    def plane(self, values: NDArray[Any], outside: float) -> Array:
        """(H, W, ...) of values of pixels (P, ...)."""
        found = np.full(self.mask.shape + values.shape[1:], outside)
        found[self.mask] = values
        return found


@dataclass(frozen=True, eq=False)
class _Chosen:
    of: Places
    chosen: NDArray[np.intp]


def _some(count: int, most: int) -> NDArray[np.intp]:
    """At most so many of the indices below `count`, at random but always the same."""
    if count <= most:
        return np.arange(count)
    return np.sort(np.random.default_rng(0).choice(count, most, replace=False))


def _blocks(where: tuple[NDArray[np.intp], ...]) -> NDArray[np.intp]:
    """Number of the block of each pixel."""
    rows, columns = where
    size = max(np.ptp(rows), np.ptp(columns)) / BLOCKS + 1e-9
    down = np.minimum((rows - rows.min()) / size, BLOCKS - 1).astype(np.intp)
    right = np.minimum((columns - columns.min()) / size, BLOCKS - 1).astype(np.intp)
    return np.asarray(down * BLOCKS + right)


def _information(normals: PseudoNormals) -> Array:
    """(P,) least eigenvalue of each pixel's precision."""
    return np.asarray(np.linalg.eigvalsh(normals.precision)[:, 0])


def _places(
    data: _Samples,
    rays: Array,
    views: Array,
    normals: PseudoNormals,
    lamps: Array,
    edge: Outline,
    guide: Array | None,
) -> _Chosen:
    """What cues look at."""
    blocks = _blocks(data.where)
    information = _information(normals)
    good = information > KNOWN_MIN * np.median(information)
    ridge = KNOWN_MIN * float(np.median(information)) * np.eye(3) + 1e-12 * np.eye(3)
    covariances = np.linalg.inv(normals.precision + ridge)
    known = data.plane(good, 0.0).astype(bool)
    integrable = equations(
        data.plane(np.where(good[:, None], normals.vectors, 0.0), 0.0),
        data.plane(covariances, 0.0),
        known,
        rays,
        data.plane(blocks.astype(np.float64), -1.0).astype(np.intp),
    )
    candidates = np.flatnonzero(good)
    chosen = candidates[_some(len(candidates), PLACES_MAX)]
    at_edge = np.flatnonzero(known[edge.rows, edge.columns])
    at_edge = at_edge[_some(len(at_edge), OUTLINE_MAX)]
    where = (edge.rows[at_edge], edge.columns[at_edge])
    planes = data.plane(normals.vectors, 0.0)
    at_outline = data.plane(blocks.astype(np.float64), -1.0)[where]
    places = Places(
        vectors=normals.vectors[chosen],
        views=views[data.where][chosen],
        blocks=len(np.unique(blocks[chosen])),
        brightness=data.brightness[chosen],
        pairs=_pairs(_chroma(data, normals, chosen)),
        outline_vectors=planes[where],
        outline_views=views[where],
        outward=edge.outward[at_edge],
        facing=edge.facing[at_edge],
        outline_blocks=len(np.unique(at_outline)),
        guide=None if guide is None else np.asarray(guide, np.float64)[data.where][chosen],
        lamps=lamps,
        integrability=integrable,
    )
    return _Chosen(places, chosen)


def _chroma(data: _Samples, normals: PseudoNormals, chosen: NDArray[np.intp]) -> Array:
    """(P, C) shares of the channels in the samples that follow the law."""
    sums = np.einsum("pn,pnc->pc", normals.weights[chosen], data.colors[chosen])
    return np.asarray(sums / np.maximum(sums.sum(axis=1, keepdims=True), 1e-12))


def _pairs(chroma: Array) -> NDArray[np.intp]:
    """(R, 2) pixels, each beside the one of the likest colour of some at random."""
    count = len(chroma)
    if count < 2:
        return np.zeros((0, 2), np.intp)
    others = np.random.default_rng(0).integers(0, count - 1, (count, PARTNERS))
    first = np.arange(count)
    others += others >= first[:, None]
    unlike = np.sum((chroma[others] - chroma[:, None]) ** 2, axis=2)
    return np.stack([first, others[first, unlike.argmin(axis=1)]], axis=1)


def _turned(precision: Array, G: Array) -> Array:
    """Precision of Gᵀ b from that of b."""
    inverse = np.linalg.inv(G)
    return np.asarray(np.einsum("ij,pjk,lk->pil", inverse, precision, inverse, optimize=True))


def _decided(found: list[Minimum], places: Places, told: bool) -> tuple[Minimum, tuple[str, ...]]:
    """The most likely minimum, and in words what others are as likely."""
    best = found[0]
    undetermined = []
    if not told:
        # The surface that is bulged the other way, with lamps from the other side: without
        # perspective no cue but the outline knows it from this one.
        flip = np.diag([-1.0, -1.0, 1.0])
        C = best.lamps * np.sign(np.linalg.det(best.lamps))
        twin = Minimum.at(C @ flip, places)
        height = float(unit_and_length(places.lamps @ best.lamps)[0][:, 1].mean())
        if twin is not None and twin.cost - best.cost < EQUALLY_LIKELY:
            if height < 0:
                best = twin
            undetermined.append(
                "No outline and no perspective tells a surface from the one bulged the other way "
                "under lamps from the other side: lamps are taken to be above rather than below "
                f"(mean of their y: {abs(height):.2f})"
            )
    normals = unit_and_length(places.vectors @ best.normals)[0]
    for other in found[1:]:
        if other.cost - found[0].cost > EQUALLY_LIKELY:
            break
        elsewhere = unit_and_length(places.vectors @ other.normals)[0]
        apart = float(np.degrees(angles(normals, elsewhere).mean()))
        if apart > SAME_DEGREES:
            undetermined.append(
                f"Another surface, {apart:.0f} degrees apart, is about as likely: the cues' "
                f"likelihoods differ by a factor of {np.exp(other.cost - found[0].cost):.1f}"
            )
            break
    return best, tuple(undetermined)


def angles(first: Array, second: Array) -> Array:
    """Angles in radians between unit vectors (P, 3)."""
    return np.asarray(2 * np.arcsin(np.clip(np.linalg.norm(first - second, axis=1) / 2, 0, 1)))


def _strengths_of_known(data: _Samples, lamps: Array) -> tuple[Array, tuple[str, ...]]:
    """Strengths (N,) of lamps with known directions; equal ones, with a word, if nothing tells."""
    chosen = _some(len(data.grey), FACTORED_MAX)
    product = factors(data.grey[chosen], data.usable[chosen])
    found = strengths_along(product.lamps * product.sizes, lamps) if product.rank == 3 else None
    if found is None:
        return np.ones(len(lamps)), (
            "The lamps' directions do not tell their strengths, which are taken as equal",
        )
    return found, ()


def _in_plane(lamps: Array) -> tuple[str, ...]:
    """Words on lamps (N, 3) that lie in a plane with the surface."""
    _, values, axes = np.linalg.svd(lamps, full_matrices=False)
    if values[2] >= FLAT * values[0]:
        return ()
    x, y, z = axes[2] * (1 if axes[2][2] >= 0 else -1)
    return (
        "All lamps lie in a plane with the scene: the part of a normal along "
        f"({x:.2f}, {y:.2f}, {z:.2f}) is not determined and taken from a smooth shape",
    )


def _start_of_few(
    data: _Samples, views: Array, edge: Outline, product: Factors, guide: Array | None
) -> LampStart:
    """Start with lamps in a plane or a line: normals of a rough shape, corrected where lamps tell.

    A factorisation of rank 2 leaves more than a 3 × 3 matrix open. So lamps are those that suit
    given normals best, or those of the mask blown up as a balloon, or of a plane.
    """
    rough = inflated(data.mask, views) if len(edge) else np.array(views, np.float64)
    if guide is not None:
        rough = np.where(np.isfinite(guide).all(axis=2, keepdims=True), guide, rough)
    normals = rough[data.where]
    rows = np.clip(data.relative, 0.0, 2.0) * data.usable
    ridge = 1e-3 * len(normals) * np.eye(3)
    lamps = np.asarray(np.linalg.solve(normals.T @ normals + ridge, normals.T @ rows).T)
    if product.rank > 0:
        space = product.lamps[:, : product.rank]
        lamps = space @ (space.T @ lamps) / len(lamps)
    found = pseudo_normals(data.grey, data.usable, lamps)
    words = (
        f"The samples have rank {product.rank}: lamps lie in a plane with the scene or are too "
        "few or too close to each other; normals across it are those of "
        + ("the given ones" if guide is not None else "a rough shape from the mask"),
    )
    figures = {"spread of samples": found.scale, "rank": float(product.rank)}
    return _finished(data, views, found, lamps, figures, words, rough)


def _finished(
    data: _Samples,
    views: Array,
    found: PseudoNormals,
    lamps: Array,
    figures: dict[str, float],
    undetermined: tuple[str, ...],
    rough: Array | None = None,
) -> LampStart:
    """Normals, albedo and colours from pseudo-normals under lamps, directions times strengths.

    A pixel whose samples tell little, because most are in shadow, leans on the mean normal of those
    around it: b is the most likely one if beside its own samples it is normal about that one, with
    a precision that is a small part of what pixels know on the whole.
    """
    information, axes = np.linalg.eigh(found.precision)
    told = information[:, 0]
    # Where lamps lie in a plane no sample tells the third part: the least that is told counts.
    medians = np.median(information, axis=0)
    lean = KNOWN_MIN * float(medians[medians > 1e-6 * medians[2]].min(initial=np.inf))
    lean = lean if np.isfinite(lean) else 1.0
    known = told > lean
    unit, albedo = unit_and_length(found.vectors)
    if rough is None:
        certain = known if known.any() else np.ones_like(known)
        around = _around(data, np.where(certain[:, None], unit, 0.0), views)
    else:
        around = rough[data.where]
    typical = np.where(known, albedo, data.brightness)
    expected = np.einsum("pji,pj->pi", axes, typical[:, None] * around)
    own = np.einsum("pji,pj->pi", axes, found.vectors)
    precision = np.maximum(information, 0.0)
    mixed = (precision * own + lean * expected) / (precision + lean)
    vectors = np.where(known[:, None], found.vectors, np.einsum("pij,pj->pi", axes, mixed))
    unit, _ = unit_and_length(vectors)
    along, strengths = unit_and_length(lamps)
    shading = np.maximum(unit @ along.T, 0.0)
    some = _some(len(unit), COLORED_MAX)
    _, colors = color_of_lamps(data.colors[some], shading[some], found.weights[some], strengths)
    planes = _albedo(data.colors, shading, found.weights, colors)
    weights = np.zeros((data.pictures, *data.mask.shape))
    weights[:, data.mask] = found.weights.T
    return LampStart(
        normals=data.plane(unit, np.nan),
        albedo=data.plane(planes, np.nan),
        directions=along,
        strengths=colors,
        weights=weights,
        known=data.plane(known.astype(np.float64), 0.0).astype(bool),
        figures={**figures, "share of pixels that tell their normal": float(known.mean())},
        undetermined=undetermined,
    )


def _around(data: _Samples, unit: Array, views: Array) -> Array:
    """Mean normal (P, 3) around each pixel, of `unit`, which is 0 where there is none."""
    found = views[data.where].astype(np.float64)
    plane = data.plane(unit, 0.0)
    weight = np.einsum("hwi,hwi->hw", plane, plane)
    for radius in RADII[::-1]:  # from far to near, what is nearer replaces what is farther
        near = np.stack([gaussian_filter(plane[..., i], radius) for i in range(3)], axis=-1)
        share = gaussian_filter(weight, radius)[data.where]
        enough = share > ENOUGH
        found[enough] = near[data.where][enough]
    return unit_and_length(found)[0]


def _albedo(colors: Array, shading: Array, weights: Array, strengths: Array) -> Array:
    """Albedo (P, 3) by weighted least squares; without a sample of weight, by the sum of all."""
    channels = colors.shape[2]
    used = strengths[:, :channels]
    product = shading[..., None] * used
    tiny = np.finfo(np.float64).tiny
    below = np.einsum("pn,pnc,pnc->pc", weights, product, product)
    found = np.einsum("pn,pnc,pnc->pc", weights, product, colors) / np.maximum(below, tiny)
    total = colors.sum(axis=1) / np.maximum(product.sum(axis=1), 1e-3 * used.sum(axis=0))
    found = np.where(below > 1e-6 * np.median(below, axis=0), found, total)
    return np.asarray(np.maximum(np.broadcast_to(found, (len(found), 3)), 0.0))
