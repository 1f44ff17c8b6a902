"""The matrix that a factorisation leaves open: the most likely one by all cues.

C has nine entries, of which the size does not matter. The negative log likelihood of `cues` is
minimised over it by the method of Broyden, Fletcher, Goldfarb and Shanno from several starts,
because it has several minima: a surface and the one that is bulged in where it was bulged out, and
flatter and steeper ones. c₁ and c₂ start as integrability has them, with either sign, and c₃ such
that lamps stand about equally far in front, at several heights; beside these, at the matrix that
makes the surface most like the mask blown up as a balloon.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from pbrfit.fit.lamps.cues import CUES, Places, Transforms, unit_and_length

Array = NDArray[np.float64]

SLANTS = (0.25, 0.5, 1.0, 2.0)
"""Tangents of the lamps' root mean square angle to the camera's axis that c₃ starts from."""

IMPOSSIBLE = 1e6
"""Cost of a C that no matrix has; far above any other."""

STEPS_MAX = 100
"""Steps of a search at most."""

STEP = 1e-7
"""Step of the differences, of the length of C: errors of rounding and of curvature are both about
1e-7 of the slope's own scale."""

SLOPE_MAX = 0.1
"""Slope of the negative log likelihood by entries of C, which are of length 1 together, at which a
search ends: C changes the surface by a degree where an entry changes by about 0.02."""

FEW = 500
"""Places from which each start is followed; what leads to likely minima goes on with all."""

POLISHED_MAX = 4
"""Minima that are found with all places."""

SAME = 0.05
"""Mean chord of the angle between normals, 3 degrees, up to which two searches have led to one
minimum."""

FAR = 20.0
"""Negative log likelihood above the least at which a minimum is not looked at again."""

EQUALLY_LIKELY = 3.0
"""Difference of the negative log likelihood below which two minima are told to be undecided: odds
of 20 to 1."""


@dataclass(frozen=True, eq=False)
class Minimum:
    """A C that is most likely among its neighbours.

    Attributes
    ----------
    normals, lamps
        (3, 3): what b and s are multiplied by, in rows.
    cost
        Negative log likelihood but for a constant.
    parts
        That of each cue.
    """

    normals: Array
    lamps: Array
    cost: float
    parts: dict[str, float]

    @classmethod
    def at(cls, C: Array, places: Places) -> Minimum | None:
        """What the cues say of C (3, 3); None if no matrix has these cofactors."""
        transforms = Transforms.of(C[None], places)
        if not transforms.possible[0]:
            return None
        parts = {cue.name: float(cue.values(transforms, places)[0]) for cue in CUES}
        return cls(transforms.normals[0], transforms.lamps[0], sum(parts.values()), parts)


def minima(places: Places, rough: Array | None, few_places: int = FEW) -> list[Minimum]:
    """Minima of the negative log likelihood, the least first.

    Parameters
    ----------
    places
        What cues look at.
    rough
        (P, 3) normals of a rough shape to start from beside other starts; None = there is none.
    few_places
        From which each start is followed.
    """
    few = places.thinned(few_places)
    rounds = [_searched(start, few, places) for start in _starts(places, rough)]
    rounds.sort(key=lambda one: one[0])
    found: list[Minimum] = []
    seen: list[Array] = []
    for cost, C in rounds:
        if cost > rounds[0][0] + FAR or len(found) == POLISHED_MAX:
            break
        about = Minimum.at(C, places)
        if about is None:
            continue
        normals, _ = unit_and_length(places.vectors @ about.normals)
        if any(np.linalg.norm(normals - other, axis=1).mean() < SAME for other in seen):
            continue
        seen.append(normals)
        _, better = _searched(C, places, places)
        found.append(Minimum.at(better, places) or about)
    found.sort(key=lambda one: one.cost)
    return found


def _searched(start: Array, few: Places, places: Places) -> tuple[float, Array]:
    """Cost, at all places, and C of the minimum that a search at a few places leads to."""
    search = minimize(
        _cost_and_slope,
        start.ravel() / np.linalg.norm(start),
        (few,),
        jac=True,
        method="BFGS",
        options={"maxiter": STEPS_MAX, "gtol": SLOPE_MAX},
    )
    C = np.asarray(search.x.reshape(3, 3))
    return float(_costs(C[None], places)[0]), C / np.linalg.norm(C)


def _cost_and_slope(c: Array, places: Places) -> tuple[float, Array]:
    """Cost of C (9,), and its slope by forward differences."""
    step = STEP * np.linalg.norm(c)
    costs = _costs((c + step * np.vstack([np.zeros(9), np.eye(9)])).reshape(-1, 3, 3), places)
    return float(costs[0]), (costs[1:] - costs[0]) / step


def _costs(C: Array, places: Places) -> Array:
    """Costs (T,) of C (T, 3, 3)."""
    transforms = Transforms.of(C, places)
    total = np.sum([cue.values(transforms, places) for cue in CUES], axis=0)
    return np.where(transforms.possible, total, IMPOSSIBLE)


def _starts(places: Places, rough: Array | None) -> list[Array]:
    """Matrices C (3, 3) of determinant above 0."""
    starts = []
    lamps = places.lamps
    _, null = places.integrability.null_vectors()
    for sign in (1.0, -1.0):
        across = sign * null[0].reshape(2, 3).T
        size = np.sqrt(np.mean(np.sum((lamps @ across) ** 2, axis=1)))
        level = np.linalg.lstsq(lamps, np.ones(len(lamps)), rcond=None)[0]
        for slant in SLANTS:
            starts.append(np.column_stack([across, size / slant * level]))
    if rough is not None:
        starts.append(_like(places.vectors, rough))
    starts = [C / np.linalg.norm(C) for C in starts if np.isfinite(C).all()]
    for C in starts:
        if np.linalg.det(C) < 0:
            C[:, 2] *= -1  # G mirrors b: lamps are in front of it by S C/det G all the same
    return [C for C in starts if np.linalg.det(C) > 1e-10]


def _like(vectors: Array, normals: Array) -> Array:
    """C of the G with which b G is most like albedo times given normals, in alternation."""
    G = np.linalg.lstsq(vectors, normals, rcond=None)[0]
    for _ in range(10):
        albedo = np.maximum(np.einsum("pi,pi->p", vectors @ G, normals), 0.0)
        weight = 1 / (albedo + 0.1 * albedo.mean() + 1e-12)
        G = np.linalg.lstsq(
            vectors * weight[:, None], normals * (albedo * weight)[:, None], rcond=None
        )[0]
        G /= max(np.linalg.norm(G), 1e-12)
    if np.linalg.matrix_rank(G, tol=1e-6) < 3:
        return np.full((3, 3), np.nan)
    return np.asarray(np.linalg.inv(G).T * np.linalg.det(G))
