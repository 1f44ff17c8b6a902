"""Random small scenes at the edges of all ranges: the model against 50 digits, and whole fits."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from pbrfit import _core
from pbrfit._core import InputError
from pbrfit.fit.decompose import decompose
from pbrfit.model.geometry import unit, view_directions
from pbrfit.model.lamps import Lamps
from pbrfit.model.materials import Materials
from pbrfit.model.reflection import MODELS
from pbrfit.result.result import Result
from pbrfit.result.verdict import PARAMETERS, ROUGH_ERROR
from pbrfit.scene.arrays import Truth
from pbrfit.scene.scene import Scene
from pbrfit_evaluation.arrays import Array
from pbrfit_evaluation.float32_model import MIN_COSINE
from pbrfit_evaluation.jobs import Values, unlogged
from pbrfit_evaluation.stability.double_precision import (
    Case,
    Change,
    Rows,
    compare,
    grazing,
    random_case,
    scaled,
    seen_at,
    worst_entry,
)
from pbrfit_evaluation.stability.stiff_fits import nonsense

DIGITS = 50
STEP = 1e-20
"""Of central differences in so many digits: exact to 10⁻²⁵ down to lobes of 10⁻⁶ radians."""

FOV = 60.0
BRIGHTEST = 1e9
"""Radiance at an exposure of 1, at most: at 10⁶ beyond 10¹⁶ is refused, which mirrors reach."""

PIXELS_UNDER_LAMPS = 6
"""Pixels of a scene that are computed in 50 digits under lamps, which takes long."""

SHARE = 0.25
"""Probability of each edge in a scene."""

ITERATIONS = 20
"""Of a fit at most."""


def _one_of(name: str, values: Sequence[float], rng: Generator, case: Case) -> Case:
    """Each value of a map is one of these."""
    drawn: Any = {name: rng.choice(np.array(values), getattr(case.pixels, name).shape)}
    return replace(case, pixels=replace(case.pixels, **drawn))


def _alike(_: Generator, case: Case) -> Case:
    """Of one material; normals and views differ."""
    first: Any = {name: 0 * (of := getattr(case.pixels, name)) + of[:1] for name in PARAMETERS}
    return replace(case, pixels=replace(case.pixels, **first))


def _shown(case: Case, images: NDArray[Any]) -> Case:
    return replace(case, images=images.astype(np.float32))


def _black(rng: Generator, case: Case) -> Case:
    kept = np.arange(len(case.images)) >= rng.integers(1, len(case.images) + 1)
    return _shown(case, case.images * kept[:, None, None])


def _white(rng: Generator, case: Case) -> Case:
    return _shown(case, np.minimum(case.images, rng.uniform(0.05, 0.5) * case.images.max()))


def _one_lit(rng: Generator, case: Case) -> Case:
    lit = np.arange(len(case.pixels)) == rng.integers(len(case.pixels))
    return _shown(case, case.images * lit[:, None])


METALS = "m 0 or 1"
SURFACES: Mapping[str, Change] = {
    "r 0, 10⁻³, 1 − 10⁻⁷ or 1": partial(_one_of, "roughness", (0.0, 1e-3, 1 - 1e-7, 1.0)),
    METALS: partial(_one_of, "metallic", (0.0, 1.0)),
    "ρ 0 or 1": partial(_one_of, "albedo", (0.0, 1.0)),
    "n·v from 10⁻⁴": partial(grazing, -4.0, 0),
    "pixels alike": _alike,
}
HIDING: Mapping[str, Change] = {"black": _black, "white": _white, "one pixel lit": _one_lit}
"""Such pictures do not show the scene's materials."""

PICTURES: Mapping[str, Change] = {
    "two pictures": lambda _, case: Case(case.pixels, case.lighting[:2], case.images[:2]),
    **HIDING,
    "exposures 10⁻⁶ to 10⁶": partial(scaled, 1e-6, 1e6),
}


@dataclass(frozen=True, eq=False)
class EdgeScene:
    """A case, and how it is fitted: what `Scene` is given beside pictures, options of `decompose`.

    `lamps` are directions (N, 3) of one in each picture, as bright as the first coefficient of the
    picture's light; None = harmonics.
    """

    edges: list[str]
    case: Case
    lamps: Array | None
    given: Mapping[str, Any]
    options: Mapping[str, Any]


def drawn(rng: Generator) -> EdgeScene:
    """A random scene at some edges, or at none but those of being small."""
    height, width = rng.integers(2, 6, 2).tolist()
    count, model = round(2 ** rng.uniform(1, 4)), str(rng.choice(MODELS))
    case = random_case(rng, height * width, count)
    views = view_directions(height, width, FOV).reshape(-1, 3)
    normals = seen_at(rng, views, rng.uniform(0.05, 1, len(views)))
    case = replace(case, pixels=replace(case.pixels, views=views, normals=normals))
    edges = [name for name in (*SURFACES, *PICTURES) if rng.random() < SHARE]
    for name in [one for one in edges if one in SURFACES]:
        case = SURFACES[name](rng, case)
    p, lamps = case.pixels, None
    shown = _core.render(*p.arrays, case.lighting, 1, model)
    if rng.random() < SHARE:
        # From anywhere before the pixels, every second one where a pixel shows its highlight.
        mirrors = 2 * np.sum(p.normals * p.views, axis=-1, keepdims=True) * p.normals - p.views
        lamps = rng.normal(size=(count, 3)) * [1, 1, 0] + [0, 0, 1]
        lamps[::2] = mirrors[rng.integers(len(p), size=len(lamps[::2]))]
        lamps = unit(lamps)
        of_unit = _core.lamp_radiance(*p.arrays, np.tile(lamps, (len(p), 1, 1)), 1, model)
        shown = of_unit.transpose(1, 0, 2) * np.abs(case.lighting[:, :1])
    case = _shown(case, np.clip(shown, 0, BRIGHTEST))
    for name in [one for one in edges if one in PICTURES]:
        case = PICTURES[name](rng, case)
    given: dict[str, Any] = {"normals": None, "fov": FOV}
    if rng.random() < 0.8:
        given["normals"] = p.normals.reshape(height, width, 3)
    if not HIDING.keys() & edges:
        maps = (of.reshape(height, width, *of.shape[1:]) for of in p.arrays[2:])
        given["truth"] = Truth(Materials(*maps))
    if lamps is not None:
        edges, lamps = [*edges, "lamps"], lamps[: len(case.images)]
        given["lamps"] = Lamps(np.arange(len(lamps)), lamps) if rng.random() < 0.5 else None
    given["images"] = case.images.reshape(-1, height, width, 3)
    options = {
        "model": model,
        "light": str(rng.choice(["auto", "sh", "auto" if lamps is None else "lamps"])),
        "refine_normals": str(rng.choice(["auto", "on", "off"])),
    }
    return EdgeScene(edges, case, lamps, given, options)


def measure(rng: Generator, threads: int, scenes: int) -> Values:
    """Draw scenes, hold the model at each against 50 digits, and fit it."""
    rows: Rows = {}
    for number, of_scene in enumerate(rng.spawn(scenes), start=1):
        one = drawn(of_scene)
        name = f"{number}: {', '.join(one.edges) or 'small'}"
        rows[name] = {**errors(one, threads), **fitted(one, threads)}
    return {"rows": rows}


# ----------------------------------------------------------------------------------- 50 digits


def errors(one: EdgeScene, threads: int) -> dict[str, float]:
    """Errors of loss, radiance and gradient, of the paper's model, over what rounding explains.

    At lights 0.7 times those of the pictures, so that residuals are a part of the signal.
    """
    from mpmath import mp

    case = replace(one.case, lighting=0.7 * one.case.lighting)
    with mp.workdps(DIGITS):
        if one.lamps is not None:
            return {"lamps_error": _lamps_error(case, one.lamps, threads)}
        loss, gradient = _exact_objective(case)
        found = compare(case, threads)
        true = found.true
        scale = np.append(true.gradient_scale, true.loss_scale)

        def error(values: Array, of_loss: float) -> float:
            off = np.append(values, of_loss) - np.append(gradient, loss)  # of mpf
            return worst_entry(off.astype(np.float64), scale)

        least = np.sum(case.pixels.normals * case.pixels.views, axis=-1).min()
        return {
            "float32_error": error(found.gradient, found.loss),
            "float64_error": error(true.gradient, true.loss) * max(least, MIN_COSINE),
        }


def _digits(values: Any) -> Any:
    """The same numbers as mpf, in an array of objects."""
    from mpmath import mpf

    return np.vectorize(lambda value: mpf(float(value)), otypes=[object])(values)


def _exact_objective(case: Case) -> tuple[Any, Any]:
    """Loss, and its gradient in the order of x, in 50 digits."""
    from pbrfit_evaluation.exact_model import shade_with_slopes

    normals, views, albedo, roughness, metallic = map(_digits, case.pixels.arrays)
    weights, by_albedo, by_roughness, by_metallic = np.array(
        [
            [
                shade_with_slopes(n, v, rho[c], r, m)
                for n, v, rho, r, m in zip(normals, views, albedo, roughness, metallic, strict=True)
            ]
            for c in range(3)
        ]
    ).transpose(2, 0, 1, 3)  # (3, P, 16) each
    lights = _digits(case.lighting).transpose(2, 0, 1)  # (3, N, 16)
    residual = weights @ lights.transpose(0, 2, 1) - _digits(case.images).transpose(2, 1, 0)
    by_weights = 2 * (residual @ lights) / residual.size
    of_lights = 2 * (residual.transpose(0, 2, 1) @ weights) / residual.size
    materials = (
        np.sum(by_weights * by_albedo, axis=-1).ravel(),
        np.sum(by_weights * by_roughness, axis=(0, 2)),
        np.sum(by_weights * by_metallic, axis=(0, 2)),
    )
    gradient = np.concatenate([*materials, of_lights.transpose(1, 2, 0).ravel()])
    return np.sum(residual**2) / residual.size, gradient


def _lamps_error(case: Case, lamps: Array, threads: int) -> float:
    """Worst error of radiance, and of the gradient of ½ Σ e² by albedo and roughness.

    Relative to what it is if each component of normals, views and directions of lamps is off by 1,
    and each term by its own size.
    """
    p, count = case.pixels[:PIXELS_UNDER_LAMPS], len(lamps)
    colors = np.abs(case.lighting[:, 0])
    pictures = case.images[:, : len(p)].transpose(1, 0, 2)  # (P, N, 3)
    radiance = _core.lamp_radiance(*p.arrays, np.tile(lamps, (len(p), 1, 1)), threads)
    samples = _core.LampSamples(
        *(pictures.astype(np.float64), None, p.views, lamps[None].copy(), colors[None].copy()),
        *(np.arange(count, dtype=np.uint64), np.zeros((count, 3)), threads),
    )
    maps, fixed = p.arrays[2:], (np.ones((1, count)), np.zeros((1, count, 4)))
    system = samples.system(np.ones(pictures.shape), (p.normals, *maps), *fixed, of_lights=False)
    found = np.concatenate([radiance.reshape(len(p), -1), system[0][:, 6, 2:]], axis=1)
    exact, scales = _digits(np.zeros((2, *found.shape)))
    for i, (rho, r, m) in enumerate(zip(*map(_digits, maps), strict=True)):
        of_pixel = (_exact_lamp(p.normals[i], p.views[i], lamp, rho, r, m) for lamp in lamps)
        of, size = np.array(list(of_pixel)).transpose(1, 2, 0, 3)  # (3, N, channel)
        color, shown = _digits(colors), _digits(pictures[i])
        residual = color * of[0] - shown
        sizes = color * size[0] + np.abs(shown)
        slopes = color * of[1:] * residual
        terms = color * (np.abs(of[1:]) * sizes + size[1:] * np.abs(residual))
        for whole, one, by in ((exact, of[0], slopes), (scales, size[0], terms)):
            whole[i] = [*one.ravel(), *by[0].sum(axis=0), by[1].sum()]
    return worst_entry((found - exact).astype(np.float64), scales.astype(np.float64))


def _exact_lamp(normal: Array, view: Array, lamp: Array, rho: Any, r: Any, m: Any) -> Any:
    """(2, 3, channel): radiance, its derivatives by albedo and roughness; then their scales."""
    from pbrfit_evaluation.exact_model import lamp_parts, lamp_radiance

    step = _digits(STEP)[()]

    def told(moved: Any) -> Any:
        n, v, l = moved.reshape(3, 3)  # noqa: E741
        here, above, below = (lamp_parts(n, v, l, r + s) for s in (0, step, -step))
        at = [lamp_radiance(here, rho + s, m) for s in (0, step, -step)]
        by_roughness = lamp_radiance(above, rho, m) - lamp_radiance(below, rho, m)
        return np.array([at[0], (at[1] - at[2]) / (2 * step), by_roughness / (2 * step)])

    given = _digits(np.concatenate([normal, view, lamp]))
    moves = np.eye(9, dtype=int) * step
    values = told(given)
    size = sum((np.abs(told(given + by) - told(given - by)) for by in moves), 0 * values)
    return np.array([values, np.abs(values) + size / (2 * step)])


# ----------------------------------------------------------------------------------- whole fits


def fitted(one: EdgeScene, threads: int) -> dict[str, Any]:
    """How a fit ended, and what must not be found of it."""
    with unlogged(), warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        try:
            scene = Scene(**one.given)
            result = decompose(scene, iterations=ITERATIONS, threads=threads, **one.options)
            of_fit = _facts(one, result)
        except InputError as error:
            of_fit = {"ended by": f"refused: {error}"}
        except Exception as error:  # whatever it is, the other scenes are fitted
            of_fit = {"fits_failed": 1, "ended by": f"{type(error).__name__}: {error}"}
    warned = [str(of.message) for of in said if issubclass(of.category, RuntimeWarning)]
    of_fit["ended by"] = "; ".join([of_fit["ended by"], *warned])
    return {"fits_failed": 0, "fits_warned": len(warned), **of_fit}


def _facts(one: EdgeScene, result: Result) -> dict[str, Any]:
    # A fit under lamps takes each pixel for a metal or a dielectric: mixtures are not of its model.
    mixed = one.lamps is not None and METALS not in one.edges
    wrong = [
        name
        for name, verdict in result.verdicts.items()
        if verdict.level == "usable" and result.metrics.get(f"{name}_rmse", 0) > ROUGH_ERROR[name]
    ]
    ended = f"{result.status}, {result.history.iterations} iterations"
    misjudged = {"mixed_misjudged" if mixed else "fits_misjudged": len(wrong)}
    return {**nonsense(result), **misjudged, "ended by": ended.replace("_", " ")}
