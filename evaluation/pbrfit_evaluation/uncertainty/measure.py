"""Scenes fitted with the defaults: their posterior beside the true errors.

Scenes are as the model has them, with wrong input, or lit by other light. All are furnished rooms
with a mean radiance of 0.4, in float32. Where nothing else is said, there is no noise: what is
wrong is then all that is wrong. Shares and sums are over values: of albedo each channel of each
pixel.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from pbrfit.fit.settings import MEAN_RADIANCE
from pbrfit.model.geometry import positions, unit
from pbrfit.model.lamps import Lamps
from pbrfit.model.reflection import Model, chosen_model, render_lamps
from pbrfit.result.result import Result
from pbrfit.result.verdict import PARAMETERS, deserved
from pbrfit.scene.arrays import Truth
from pbrfit.scene.integration import depth_from_normals
from pbrfit.scene.scene import Scene
from pbrfit.transport.decision import Transport
from pbrfit.transport.scenery import Scenery
from pbrfit_evaluation.arrays import Array, known
from pbrfit_evaluation.everyday import measure as everyday
from pbrfit_evaluation.everyday.measure import grey, in_files, jpeg, write_png
from pbrfit_evaluation.grid import NOISE, Case, Grid, measured
from pbrfit_evaluation.jobs import Values
from pbrfit_evaluation.normals.measure import MEAN_OF_THETA, disturbed
from pbrfit_evaluation.recipes import OTHER, constant_guess

GROUPS = ("model holds", "wrong input", "other light and files")

FEW = 3
"""Pictures of a scene that has few."""

FOV_TOLD = 90.0
"""Degrees; 60 are true."""

LITTLE_NOISE = 0.005
"""Standard deviation in radiance where other light than the model's is what is wrong."""

AMBIENT = 0.3
"""Share of a picture's mean radiance that is environment light, beside its lamp."""

NEAREST, FARTHEST = 0.2, 0.6
"""Distance of a near lamp from the camera over that of the surface behind it."""

PALEST = 0.6
"""Least of a lamp's channels over the largest that it can have."""


@dataclass(frozen=True)
class Condition:
    """What a row of the suite is about."""

    title: str
    """What tables and plots say."""
    group: str
    """With which others it is drawn, one of `GROUPS`."""
    options: Mapping[str, Any] = field(default_factory=dict)
    """Of `pbrfit.decompose`, beside its defaults."""


CONDITIONS: Mapping[str, Condition] = {
    "clean": Condition("no noise", "model holds"),
    "noise": Condition("noise", "model holds"),
    "no-priors": Condition("noise, no priors", "model holds", {"priors": None}),
    "three": Condition("noise, three pictures", "model holds"),
    "grey": Condition("noise, grey", "model holds"),
    "fov-90": Condition("90° given, 60° true", "wrong input"),
    "sh-2": Condition("lights of order 2 fitted", "wrong input", {"sh_order": 2}),
    "normals-3": Condition("normals 3° off, noise", "wrong input"),
    "normals-5": Condition("normals 5° off, noise", "wrong input"),
    "other-model": Condition("other reflection model", "wrong input"),
    "png": Condition("PNG of 8 bits, noise", "other light and files"),
    "jpeg": Condition("JPEG 90, 4:2:0", "other light and files"),
    "shadows": Condition("shadows, no depth given", "other light and files"),
    "bounces": Condition("bounced light, no depth given", "other light and files"),
    "lamps": Condition("lamps, fitted as harmonics", "other light and files", {"light": "sh"}),
}


def made(name: str, kind: str, seed: int, size: int, model: Model, threads: int = 0) -> Scene:
    """Make the scene of a condition, with its true materials.

    `kind`, `seed` and `size` are those of `pbrfit.synthetic.make_scene`; what is drawn here has a
    stream of its own. `model` is fitted; the pictures are of it, but for "other-model".
    """
    of = OTHER[model] if name == "other-model" else model
    drawn = partial(everyday.made, kind, seed, size, model=of, held_out=1)
    rng = np.random.default_rng([seed, 9, list(CONDITIONS).index(name)])
    match name:
        case "noise" | "no-priors":
            return drawn(NOISE)
        case "three":
            return drawn(NOISE, lights=FEW)
        case "grey":
            return grey(drawn(), rng)
        case "fov-90":
            return replace(drawn(), fov=FOV_TOLD)
        case "normals-3" | "normals-5":
            scene, degrees = drawn(NOISE), float(name[-1])
            wrong = disturbed(scene, "correlated", degrees / MEAN_OF_THETA, seed)
            return replace(scene, normals=wrong)
        case "png":
            return in_files(drawn(NOISE), write_png)
        case "jpeg":
            return in_files(drawn(), jpeg("90-420"))
        case "shadows" | "bounces":
            return _among_surfaces(drawn(), bounces=name == "bounces", rng=rng, threads=threads)
        case "lamps":
            return _under_lamps(drawn(), rng, threads)
    return drawn()


def _depth(scene: Scene) -> NDArray[np.float32]:
    """Depth of the surfaces whose normals the scene has: 1 at the median."""
    return depth_from_normals(scene.normals, scene.fov, scene.valid, scene.segments)


def _with_little_noise(pictures: Array, rng: Generator) -> NDArray[np.float32]:
    noisy = pictures + LITTLE_NOISE * rng.standard_normal(pictures.shape)
    return np.asarray(noisy, np.float32)


def _among_surfaces(scene: Scene, *, bounces: bool, rng: Generator, threads: int) -> Scene:
    """Light that surfaces block, and perhaps reflect to others, at the same mean radiance."""
    truth = known(scene.truth)
    lighting = known(truth.lighting)
    scenery = Scenery(_depth(scene), scene.normals, scene.valid, scene.segments, scene.fov)
    pictures = scenery.render(
        truth.materials,
        scene.normals,
        lighting,
        Transport("bounce" if bounces else "occlusion", "", scenery.extents),
        model=chosen_model(None, scene.model),
        threads=threads,
    )
    exposure = MEAN_RADIANCE / float(pictures[:, scene.valid].mean())
    truth = Truth(truth.materials, exposure * lighting)
    return replace(scene, images=_with_little_noise(exposure * pictures, rng), truth=truth)


def _under_lamps(scene: Scene, rng: Generator, threads: int) -> Scene:
    """Every picture under one lamp, far ones and near ones in turn, and its light as ambient."""
    truth = known(scene.truth)
    lighting = known(truth.lighting)
    model = chosen_model(None, scene.model)
    depth = _depth(scene)
    rendered = partial(
        render_lamps,
        *(truth.materials, scene.normals),
        fov=scene.fov,
        depth=depth,
        threads=threads,
        model=model,
    )
    lamps = drawn_lamps(len(scene.images), positions(depth, scene.fov)[scene.valid], rng)
    direct = rendered(lamps, None)
    level = scene.images[:, scene.valid].mean(axis=(1, 2), dtype=np.float64)
    gains = (1 - AMBIENT) * level / direct[:, scene.valid].mean(axis=(1, 2))
    lamps = replace(lamps, colors=gains[:, None] * lamps.colors)
    pictures = rendered(lamps, AMBIENT * lighting)
    # No harmonics light these pictures, so nobody knows true ones.
    return replace(scene, images=_with_little_noise(pictures, rng), truth=Truth(truth.materials))


def drawn_lamps(count: int, points: Array, rng: Generator) -> Lamps:
    """One lamp a picture, far and near in turn.

    Far ones shine from the camera's side. Near ones hang between the camera and one of the points
    (P, 3) that it sees, where nothing is in the way.
    """
    far = rng.standard_normal((count, 3))
    far[:, 2] = np.abs(far[:, 2]) + 0.3  # not grazing
    behind = points[rng.integers(len(points), size=count)]
    hanging = rng.uniform(NEAREST, FARTHEST, (count, 1)) * behind
    near = np.arange(count) % 2 == 1
    return Lamps(
        np.arange(count),
        np.where(near[:, None], hanging, unit(far)),
        near,
        rng.uniform(PALEST, 1.0, (count, 3)),
    )


EXACT = 1e-6
"""Error that counts as none: pictures without noise in float32 leave some 1e-7, which is rounding
and which no deviation is of."""

GRID = Grid(
    {name: condition.title for name, condition in CONDITIONS.items()},
    few=("clean", "noise", "fov-90"),
)


def run(case: Case, threads: int) -> Values:
    """What the posterior of a scene says, beside what is true.

    Returns
    -------
    `scores`, and `said`: by name, see `calibration`, with `guess`, the RMSE of the constant guess,
    and the verdict.
    """
    assert case.model is not None
    scene = made(case.condition, case.kind, case.seed, case.size, case.model, threads)
    options = {"refine_normals": "auto", **CONDITIONS[case.condition].options}
    result, found = measured(case, GRID.ways[case.way], scene, threads, **options)
    return {**found, "said": said(result, scene)}


def said(result: Result, scene: Scene) -> dict[str, Any]:
    """`calibration` of each map of a result, with the constant guess and the verdict."""
    told, true, guess = (
        known(result.uncertainty),
        known(scene.truth).materials,
        constant_guess(scene),
    )
    found: dict[str, Any] = {}
    for name in PARAMETERS:
        maps = (result.materials, true, told.deviation, told.low, told.high, guess)
        values = [np.asarray(getattr(of, name)[scene.valid], np.float64).ravel() for of in maps]
        of_map, verdict = calibration(*values[:5]), told.verdicts[name]
        found[name] = {
            **of_map,
            "guess": _rms(values[5] - values[1]),
            "said": verdict.level,
            "expected_error": verdict.expected_error,
            "cause": verdict.cause,
            "deserved": deserved(name, of_map["rmse"]),
        }
    return found


def calibration(
    found: Array, true: Array, deviation: Array, low: Array, high: Array
) -> dict[str, float]:
    """Errors of the values (Q,) of a map beside what is said of them.

    Returns
    -------
    `rmse`. `deviation`: the median. `within_1`, `within_2`: share of the errors within so many
    deviations. `in_interval`: share of the true values within the quantiles.
    """
    error = np.abs(found - true)
    error[error <= EXACT] = 0.0
    inside = (true >= low - EXACT) & (true <= high + EXACT)
    return {
        "rmse": _rms(error),
        "deviation": float(np.median(deviation)),
        "within_1": float(np.mean(error <= deviation)),
        "within_2": float(np.mean(error <= 2 * deviation)),
        "in_interval": float(np.mean(inside)),
    }


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(np.square(values))))
