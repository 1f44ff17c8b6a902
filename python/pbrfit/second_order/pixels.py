"""Materials of pixels, each by itself, when the lights are given."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pbrfit.objective import Objective

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
pure noise in 16 pictures of three channels one in 10⁹ is."""

NEIGHBOURS = ((0, 1), (1, 0), (0, -1), (-1, 0))
SPREADS = 8
"""Rounds in which outlying pixels take over materials from beside them, at most."""

CLEARLY = 0.5
"""Of its squares: a pixel that is left with less has gained by what it took over."""

STEPS = 12
"""Of a descent from a node."""

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
    """X with these materials (Q, D) of some pixels."""
    x = x.copy()
    x[objective.layout.maps].reshape(-1, objective.pixels)[:, pixels] = materials.T
    return x


def descended(
    objective: Objective,
    x: Array,
    pixels: Pixels,
    *,
    steps: int,
    exact_steps: int = 1,
    starts: int = 0,
    nodes: tuple[Array, Array] = (ROUGHNESS, METALLIC),
    towards: Towards | None = None,
) -> tuple[Array, Array]:
    """Materials (Q, D) of some pixels, no worse than those of x, and their squares (Q,).

    Parameters
    ----------
    steps, exact_steps
        Of Levenberg and Marquardt's method: on sums over pictures made once, which know squares to
        half their digits, and then on residuals.
    starts
        Beside their own material, pixels start from so many of the best `nodes`.
    towards
        A pull, with rows of `pixels`.
    """
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
        centre=None if towards is None else towards.centre,
        precision=None if towards is None else towards.precision,
    )
    return found, squares


def chunks(count: int) -> list[Pixels]:
    """All pixels, in pieces that take a fraction of a second."""
    everything = np.arange(count, dtype=np.uint64)
    return [everything[first : first + AT_ONCE] for first in range(0, count, AT_ONCE)]


def fitted(
    objective: Objective,
    x: Array,
    *,
    starts: int,
    steps: int = STEPS,
    towards: Towards | None = None,
    stop: Callable[[], bool] = lambda: False,
) -> tuple[Array, Array] | None:
    """X with all pixels' best materials for its lights, and their squares (P,); None if stopped."""
    x = x.copy()
    squares = np.empty(objective.pixels)
    maps = x[objective.layout.maps].reshape(-1, objective.pixels)
    for chunk in chunks(objective.pixels):
        if stop():
            return None
        rows = None if towards is None else towards.of(chunk)
        found, squares[chunk] = descended(
            objective, x, chunk, steps=steps, starts=starts, towards=rows
        )
        maps[:, chunk] = found.T
    return x, squares


def retried(objective: Objective, x: Array, squares: Array) -> tuple[Array, Array]:
    """X and squares after pixels whose squares stand out were tried again.

    From more nodes, and from the materials of the pixels around them: an object is seldom of a
    single pixel, and where its neighbours have found their way, so can it.
    """
    outlying = np.flatnonzero(squares > OUTLYING * np.median(squares)).astype(np.uint64)
    if not outlying.size:
        return x, squares
    x, squares = x.copy(), squares.copy()
    maps = x[objective.layout.maps].reshape(-1, objective.pixels)
    for first in range(0, len(outlying), AT_ONCE):
        chunk = outlying[first : first + AT_ONCE]
        found, squares[chunk] = descended(
            objective,
            x,
            chunk,
            steps=2 * STEPS,
            starts=FINE_STARTS,
            nodes=(FINE_ROUGHNESS, FINE_METALLIC),
        )
        maps[:, chunk] = found.T
    for _ in range(SPREADS):
        gained = False
        for offset in NEIGHBOURS:
            chunk, other = _beside(objective, outlying, offset)
            if not chunk.size:
                continue
            trial = x.copy()
            trial[objective.layout.maps].reshape(-1, objective.pixels)[:, chunk] = maps[:, other]
            found, left = descended(objective, trial, chunk, steps=STEPS)
            better = left < squares[chunk]
            maps[:, chunk[better]] = found[better].T
            squares[chunk[better]] = left[better]
            gained |= bool((left < CLEARLY * squares[chunk]).any())
        if not gained:
            break
    return x, squares


def _beside(objective: Objective, pixels: Pixels, offset: tuple[int, int]) -> tuple[Pixels, Pixels]:
    """Those of `pixels` that have a valid pixel at this offset (rows, columns), and that pixel."""
    valid = objective.layout.valid
    index = np.full(valid.shape, -1)
    index[valid] = np.arange(objective.pixels)
    rows, columns = np.nonzero(valid)
    there = rows[pixels] + offset[0], columns[pixels] + offset[1]
    inside = (
        (there[0] >= 0)
        & (there[0] < valid.shape[0])
        & (there[1] >= 0)
        & (there[1] < valid.shape[1])
    )
    other = np.full(len(pixels), -1)
    other[inside] = index[there[0][inside], there[1][inside]]
    found = other >= 0
    return pixels[found], other[found].astype(np.uint64)
