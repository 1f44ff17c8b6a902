"""The pixels that cues look at, and what the pictures say there."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pbrfit.fit.lamps.cues import Places
from pbrfit.fit.lamps.integrability import equations
from pbrfit.fit.lamps.outline import Outline
from pbrfit.fit.lamps.photometric import PseudoNormals
from pbrfit.fit.lamps.samples import Samples, blocks_of, some_of

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

PLACES_MAX = 2500
"""Pixels that cues look at: the sampling error of a mean over them, 2 %, is below that of the
blocks, 12 %."""

OUTLINE_MAX = 600
"""Pixels of the outline that cues look at."""

PARTNERS = 12
"""Pixels at random that the one of the likest colour is taken from, as a partner of equal
albedo."""

KNOWN_MIN = 0.05
"""Least part of a pixel's information, in the direction it says least of, of the median pixel's,
with which its normal is its own and not its neighbours'."""


@dataclass(frozen=True, eq=False)
class Chosen:
    """Places, and which of the mask's pixels they are."""

    of: Places
    chosen: NDArray[np.intp]


def chosen_places(
    data: Samples,
    rays: Array,
    views: Array,
    normals: PseudoNormals,
    lamps: Array,
    edge: Outline,
    most: int = PLACES_MAX,
) -> Chosen:
    """What cues look at: at most so many pixels."""
    blocks = blocks_of(data.where)
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
    chosen = candidates[some_of(len(candidates), most)]
    at_edge = np.flatnonzero(known[edge.rows, edge.columns])
    at_edge = at_edge[some_of(len(at_edge), OUTLINE_MAX)]
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
        lamps=lamps,
        integrability=integrable,
    )
    return Chosen(places, chosen)


def _information(normals: PseudoNormals) -> Array:
    """(P,) least eigenvalue of each pixel's precision."""
    return np.asarray(np.linalg.eigvalsh(normals.precision)[:, 0])


def _chroma(data: Samples, normals: PseudoNormals, chosen: NDArray[np.intp]) -> Array:
    """(P, C) shares of the channels in the samples that follow the law."""
    weights = normals.weights[chosen] * data.told[chosen].all(axis=2)
    sums = np.einsum("pn,pnc->pc", weights, data.colors[chosen])
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
