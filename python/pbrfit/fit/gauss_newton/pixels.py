"""Materials of pixels, each by itself, when the lights are given."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pbrfit.fit.objective import Objective

Array = NDArray[np.float64]
Pixels = NDArray[np.uint64]

ROUGHNESS = np.linspace(0.08, 1.0, 12)
METALLIC = np.linspace(0.0, 1.0, 6)
"""Nodes from which pixels start. Below roughness 0.1 pictures under SH light hardly change."""

FINE_ROUGHNESS = np.linspace(0.02, 1.0, 24)
FINE_METALLIC = np.linspace(0.0, 1.0, 11)
FINE_STARTS = 6
"""For pixels whose residuals stand out."""

OUTLYING = 5.0
"""Times the median of the pixels' squares: from here on a pixel is tried again from more starts. Of
pure noise in 16 pictures of three channels practically none is."""

NEIGHBOURS = ((0, 1), (1, 0), (0, -1), (-1, 0))
"""From where outlying pixels take over materials, in this order: (rows, columns)."""

STEPS = 12
"""Of a descent from a node."""

EXACT_STEPS = 1
TURNING_STEPS = 4
"""Of a descent on residuals, in which alone normals turn where they are free."""

AT_ONCE = 1 << 17
"""Pixels in one call, so that Python has its turn several times a second."""


@dataclass(frozen=True, eq=False)
class Towards:
    """What pulls at roughness and metallic of pixels: Σ a (v − c)² beside their squares.

    `centre` and `precision`, c and a, are (P, F): F = 2, or 1 where metallic is known.
    """

    centre: Array
    precision: Array

    def of(self, pixels: Pixels | slice) -> Towards:
        """The rows of some pixels."""
        return Towards(self.centre[pixels], self.precision[pixels])

    def cost(self, finish: Array) -> float:
        """At these roughness and metallic (P, F)."""
        return float((self.precision * (finish - self.centre) ** 2).sum())


def taken(objective: Objective, x: Array, pixels: Pixels | slice) -> Array:
    """Materials (Q, D) of some pixels."""
    return x[objective.layout.maps].reshape(-1, objective.pixels)[:, pixels].T


def put(objective: Objective, x: Array, pixels: Pixels | slice, materials: Array) -> Array:
    """A copy of x with these materials (Q, D) of some pixels."""
    x = x.copy()
    place(objective, x, pixels, materials)
    return x


def place(objective: Objective, x: Array, pixels: Pixels | slice, materials: Array) -> None:
    """Give some pixels of x these materials (Q, D)."""
    x[objective.layout.maps].reshape(-1, objective.pixels)[:, pixels] = materials.T


def descended(
    objective: Objective,
    x: Array,
    pixels: Pixels,
    *,
    steps: int,
    exact_steps: int | None = None,
    starts: int = 0,
    nodes: tuple[Array, Array] = (ROUGHNESS, METALLIC),
    towards: Towards | None = None,
) -> tuple[Array, Array]:
    """Materials (Q, D) of some pixels, no worse than those of x, and their squares (Q,).

    Parameters
    ----------
    steps, exact_steps
        Of Levenberg and Marquardt's method: on sums over pictures made once, which know squares to
        half their digits, and then on residuals. None = as many of the latter as it takes.
    starts
        Beside their own material, pixels start from so many of the best `nodes`.
    towards
        A pull, with rows of `pixels`.
    """
    if exact_steps is None:
        exact_steps = EXACT_STEPS if objective.tangent_offsets is None else TURNING_STEPS
    roughness, metallic = nodes
    if objective.known_metallic is not None:
        metallic = np.array([objective.known_metallic])
    if starts == 0:
        roughness = metallic = np.empty(0)
    found, squares = objective.problem.fit_materials(
        objective.for_core(x),
        pixels,
        roughness,
        metallic,
        starts=starts,
        steps=steps,
        exact_steps=exact_steps,
        mean=None if towards is None else towards.centre,
        precision=None if towards is None else towards.precision,
    )
    return found, squares


def chunks(count: int) -> Iterator[Pixels]:
    """All pixels, in pieces that take a fraction of a second."""
    for first in range(0, count, AT_ONCE):
        yield np.arange(first, min(first + AT_ONCE, count), dtype=np.uint64)


def fit_all(
    objective: Objective,
    x: Array,
    *,
    starts: int,
    steps: int = STEPS,
    towards: Towards | None = None,
    stop: Callable[[], bool] = lambda: False,
) -> Array | None:
    """Give all pixels of x their best materials for its lights; their squares (P,).

    None if stopped before all pixels had theirs.
    """
    squares = np.empty(objective.pixels)
    for chunk in chunks(objective.pixels):
        if stop():
            return None
        rows = None if towards is None else towards.of(chunk)
        found, squares[chunk] = descended(
            objective, x, chunk, steps=steps, starts=starts, towards=rows
        )
        place(objective, x, chunk, found)
    return squares


def try_from(
    objective: Objective,
    x: Array,
    squares: Array,
    pixels: Pixels,
    materials: Array,
    *,
    steps: int,
    starts: int = 0,
    towards: Towards | None = None,
) -> None:
    """Let some pixels of x descend from these materials (Q, D), and keep what is lower.

    Theirs of `squares` (P,) change too.
    """
    own = taken(objective, x, pixels)
    place(objective, x, pixels, materials)
    found, left = descended(objective, x, pixels, steps=steps, starts=starts, towards=towards)
    better = left < squares[pixels]
    place(objective, x, pixels, np.where(better[:, None], found, own))
    squares[pixels[better]] = left[better]


def retry(
    objective: Objective, x: Array, squares: Array, stop: Callable[[], bool] = lambda: False
) -> None:
    """Try pixels again whose squares stand out; x and `squares` change where that is better.

    From more nodes, and from the materials of the pixels around them: an object is seldom of a
    single pixel, and where its neighbours have found their way, so can it. Where it is stopped, the
    pixels that are left stay as they are.
    """
    outlying = np.flatnonzero(squares > OUTLYING * np.median(squares)).astype(np.uint64)
    for first in range(0, len(outlying), AT_ONCE):
        if stop():
            return
        chunk = outlying[first : first + AT_ONCE]
        found, squares[chunk] = descended(
            objective,
            x,
            chunk,
            steps=2 * STEPS,
            starts=FINE_STARTS,
            nodes=(FINE_ROUGHNESS, FINE_METALLIC),
        )
        place(objective, x, chunk, found)
    for pixels, others in _beside(objective, outlying):
        for first in range(0, len(pixels), AT_ONCE):
            if stop():
                return
            piece = slice(first, first + AT_ONCE)
            beside = taken(objective, x, others[piece])
            try_from(objective, x, squares, pixels[piece], beside, steps=STEPS)


def _beside(objective: Objective, pixels: Pixels) -> Iterator[tuple[Pixels, Pixels]]:
    """For each of `NEIGHBOURS`, those of `pixels` that have a valid pixel there, and that pixel."""
    if not pixels.size:
        return
    valid = objective.layout.valid
    index = np.full(valid.shape, -1)
    index[valid] = np.arange(objective.pixels)
    rows, columns = (of_all[pixels] for of_all in np.nonzero(valid))
    for down, right in NEIGHBOURS:
        there = rows + down, columns + right
        inside = (
            (there[0] >= 0)
            & (there[0] < valid.shape[0])
            & (there[1] >= 0)
            & (there[1] < valid.shape[1])
        )
        other = np.full(len(pixels), -1)
        other[inside] = index[there[0][inside], there[1][inside]]
        found = other >= 0
        if found.any():
            yield pixels[found], other[found].astype(np.uint64)
