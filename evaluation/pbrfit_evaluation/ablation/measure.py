"""Rooms fitted with one set of priors each.

Their materials keep to their segments or not, and segments are right or wrong.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation

from pbrfit.result.options import Priors, prior_names
from pbrfit.scene.scene import Scene
from pbrfit.synthetic.patterns import checker, clouds, patches, stripes
from pbrfit_evaluation.arrays import Array, Floats, known
from pbrfit_evaluation.grid import NOISE, Case, Grid, measured
from pbrfit_evaluation.recipes import PAPER_PRIORS, Way, lit_anew

Ids = NDArray[np.integer[Any]]

TITLES = {
    "constant": "constant in true segments",
    "varying": "varying inside segments",
    "shifted": "segments shifted by a pixel",
    "merged": "a third of the segments merged",
    "none": "no segments",
}
"""What tables and plots say."""

VARIED_IN = ("constant", "varying", "merged")
"""Cases in which the weights of priors are varied: those that differ in segments and materials."""

SPREAD = (0.08, 0.12)
"""Standard deviation of the roughness inside a varying segment, before it is clipped to `RANGE`."""

RANGE = (0.05, 1.0)

PATTERNS = (clouds, checker, clouds, stripes, clouds, patches)
"""Of segments in turn: every second one varies smoothly, the others by patterns with outlines."""

PERIOD = (0.1, 0.3)
"""Period of the patterns, in widths of the picture; at most the side of a square as large as the
segment, or a tile could hold all of it."""

MERGED = 1 / 3
"""Share of the segments that take another's id."""


def room(of: Case) -> Scene:
    """Make the room of a case, with its ground truth and held-out lights.

    All but "varying" have the same pictures for the same seed: those of
    `make_scene`, with roughness and metallic the median of their segment wherever the kind lets
    them vary ("room" does not). In "varying" a pattern is added to that roughness, `SPREAD` strong,
    and the pictures are rendered anew under the same lights. The segments are the true ones, but
    for "shifted" by one pixel to the right and one down; "merged", where `MERGED` of them take the
    id of another, in turn of a neighbour and of any other; and "none".

    The case's seed is of the scene, its lights and its noise, which are those of `make_scene`, and
    of what is changed here, which is drawn apart from them.
    """
    scene = of.drawn(model=of.model)
    truth, segments = known(scene.truth), known(scene.segments)
    # The first four are make_scene's own, and the fourth is its noise.
    streams = np.random.SeedSequence(of.seed).spawn(6)
    noise_rng, pattern_rng, merging_rng = map(np.random.default_rng, streams[3:])

    materials = truth.materials
    if of.condition == "varying":
        roughness = varied(materials.roughness, segments, pattern_rng)
        materials = replace(materials, roughness=roughness)
    made = lit_anew(scene, materials, known(truth.lighting), known(truth.relight_lighting))
    images = made.images + noise_rng.normal(scale=NOISE, size=made.images.shape)
    made = replace(made, images=images)
    match of.condition:
        case "shifted":
            return replace(made, segments=shifted(segments))
        case "merged":
            return replace(made, segments=merged(segments, merging_rng))
        case "none":
            return replace(made, segments=None)
    return made


def varied(roughness: Floats, segments: Ids, rng: Generator) -> Array:
    """Roughness with a pattern of mean 0 added inside each segment.

    Patterns are painted on the picture. Their points are (x, y, x + y) in widths of it: a plane on
    which a pattern along any axis varies. The same state of `rng` gives the same patterns at any
    picture size, but for the smallest segments.
    """
    height, width = segments.shape
    y, x = (np.mgrid[:height, :width] + 0.5) / width
    points = np.stack([x, y, x + y], axis=-1)
    found = roughness.astype(np.float64)
    for order, i in enumerate(np.unique(segments)):
        here = segments == i
        side = np.sqrt(here.sum()) / width
        pattern = PATTERNS[order % len(PATTERNS)](rng, min(rng.uniform(*PERIOD), side))
        values = pattern(points[here])
        values = values - values.mean()
        deviation, spread = values.std(), rng.uniform(*SPREAD)
        if deviation > 0:  # a segment of a few pixels may lie inside one tile
            found[here] += spread / deviation * values
    return np.asarray(np.clip(found, *RANGE))


def shifted(segments: Ids) -> Ids:
    """Move the segments one pixel right and down; the first row and column stay."""
    return np.pad(segments, ((1, 0), (1, 0)), mode="edge")[:-1, :-1]


def merged(segments: Ids, rng: Generator) -> Ids:
    """Give `MERGED` of the segments another's id, in turn a neighbour's and any other's.

    Those that give their ids keep them, so as many ids are missing afterwards; where nothing
    but merged segments is around, any other's is taken. A single segment stays.
    """
    ids = rng.permutation(np.unique(segments))
    count = round(MERGED * len(ids))
    takers, givers = ids[:count], ids[count:]
    found = segments.copy()
    for order, i in enumerate(takers):
        here = segments == i
        near = np.intersect1d(givers, segments[binary_dilation(here) & ~here])
        found[here] = rng.choice(near if order % 2 == 0 and len(near) else givers)
    return found


WEIGHTS = (0.01, 0.1, 1.0, 10.0)
"""At which a prior is tried alone."""

VARIED = ("material", "cohesion")
"""Priors whose weight is varied, each alone."""


def _with(title: str, priors: Priors) -> Way:
    """By the default solver where it knows the priors."""
    penalties = priors.cohesion or priors.smoothness or priors.sparsity
    return Way(title, {"priors": priors, "solver": "lbfgsb" if penalties else "gauss-newton"})


def _alone(name: str, weight: float) -> Way:
    priors = replace(Priors.none(), **{name: weight})
    return _with(f"{name} {weight:g} alone", priors)


TABLE: Mapping[str, Way] = {
    "none": Way("no priors", {"priors": None}),
    "default": Way("default"),
    "material=1": _alone("material", 1.0),
    "paper": _with("the paper's four", PAPER_PRIORS),
    **{
        f"paper-no-{name}": _with(
            f"the paper's four without {name}", replace(PAPER_PRIORS, **{name: 0.0})
        )
        for name in prior_names()
        if getattr(PAPER_PRIORS, name) != 0
    },
}
"""Priors that are tried in every case; all are compared with the first."""

CURVES: Mapping[str, Way] = {
    f"{name}={weight:g}": _alone(name, weight) for name in VARIED for weight in WEIGHTS
}

FEW = ("none", "default", "cohesion=0.1")
"""For a quick look; and what pictures show."""

WAYS = {**TABLE, **CURVES}

GRID = Grid(
    TITLES,
    WAYS,
    of_condition={name: (*TABLE, FEW[-1]) for name in TITLES if name not in VARIED_IN},
    kinds=("room",),
    pictured=FEW,
    few_ways=FEW,
)


def run(of: Case, threads: int) -> dict[str, Any]:
    """Scores, and perhaps maps."""
    return measured(of, WAYS[of.way], room(of), threads)[1]
