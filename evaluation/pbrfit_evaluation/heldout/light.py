"""The light of a picture that a fit has not seen, so that the values in its file come out best.

A light gives radiance c; the file has values y(c). Light is fitted to radiance first. Then Gauss
and Newton: near what was found, c₀, the file's values are y(c₀) + y′(c₀) (c − c₀), so that light is
fitted to the radiance c₀ + (y − y(c₀)) / y′(c₀), whose samples weigh y′(c₀)² as much.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Literal

import numpy as np

from pbrfit.fit.lamps.picture_light import light_of_picture
from pbrfit.model.geometry import view_directions
from pbrfit.model.materials import Materials
from pbrfit.model.reflection import Model, shade
from pbrfit.result.result import Result
from pbrfit.scene.scene import Scene
from pbrfit_evaluation.arrays import Array, Mask

ROUNDS = 4
"""Of Gauss and Newton; the best of them counts."""

UNDETERMINED = 1e-12
"""Combinations of unknowns whose singular value is below this share of the largest are left 0: with
flat normals, for one, pictures do not show most of the light."""

KNOTS = 4096
"""Of the tabulated tone curve, over eight powers of ten."""

Solve = Callable[[Array, Array], Array]
"""The radiance (P, 3) that light can give nearest to one (P, 3), whose samples weigh (P, 3)."""

Curve = Callable[[Array], Array]
"""Values of a file from radiance, both (P, 3), pixel by pixel."""


@dataclass(frozen=True)
class Score:
    """How well one picture is explained, in values of its file."""

    name: str
    samples: int
    """How many are not clipped, over which the others are means."""
    rms: float
    """Root mean square of the values."""
    rmse: float
    """That of what is left of them."""


def relative_error(scores: Sequence[Score]) -> float:
    """RMSE over the RMS of several pictures together; NaN if they are black."""
    left, signal = (
        math.fsum(one.samples * value**2 for one, value in zip(scores, of, strict=True))
        for of in ([one.rmse for one in scores], [one.rms for one in scores])
    )
    return math.sqrt(left / signal) if signal > 0 else math.nan


@dataclass(frozen=True, eq=False)
class Target:
    """A picture at P pixels, its arrays (P, 3)."""

    values: Array
    """What its file holds, 1 is white."""
    radiance: Array
    """That as radiance."""
    weights: Array
    """How much each sample counts."""
    curve: Curve | None
    """Which values light of a radiance leaves; None = the same."""

    def shown(self, radiance: Array) -> Array:
        """Values (P, 3) of a file, which are not negative."""
        values = radiance if self.curve is None else self.curve(radiance)
        return np.maximum(values, 0.0)

    def left(self, shown: Array) -> float:
        """Sum of weighted squares."""
        return float((self.weights * (shown - self.values) ** 2).sum())

    def explained(self, solve: Solve) -> Array:
        """(P, 3): the picture's values, light fitted."""
        radiance = solve(self.radiance, self.weights)
        best = self.shown(radiance)
        if self.curve is None:
            return best
        for _ in range(ROUNDS):
            step = 1e-4 * (np.abs(radiance) + 1e-3)
            slope = (self.curve(radiance + step) - self.curve(radiance - step)) / (2 * step)
            tangent = radiance + (self.values - self.curve(radiance)) / slope
            radiance = solve(tangent, self.weights * slope**2)
            shown = self.shown(radiance)
            best = min(best, shown, key=self.left)
        return best


def target(scene: Scene, picture: int, used: Mask, curve: Curve | None) -> Target:
    """A picture of a scene at the pixels `used` (H, W); the scene's correction is undone."""
    weights = scene.channel_weights(picture)
    counted = np.ones((int(used.sum()), 3)) if weights is None else weights[used].astype(np.float64)
    values = np.asarray(scene.file_values(scene.images[picture]), np.float64)[used]
    radiance = np.asarray(scene.picture(picture, slice(None)), np.float64)[used]
    known = counted > 0
    return Target(np.where(known, values, 0.0), np.where(known, radiance, 0.0), counted, curve)


def curve_of(scene: Scene) -> Curve | None:
    """From radiance to values of the scene's files: its correction undone."""
    correction = scene.correction
    encoded = scene.response == "srgb"
    if correction is None:
        return (lambda radiance: np.asarray(scene.file_values(radiance))) if encoded else None
    samples = correction.reference * np.geomspace(1e-4, 1e4, KNOTS)
    arriving = correction.applied(samples)
    gains, knots = arriving / samples, np.log(arriving)

    def curve(radiance: Array) -> Array:
        level = np.log(np.maximum(radiance, arriving[0]))
        return np.asarray(scene.file_values(radiance / np.interp(level, knots, gains)), np.float64)

    return curve


def combination(planes: Array, radiance: Array, weights: Array) -> Array:
    """(P, 3): the sum of planes (K, P, 3), a factor each and channel, nearest to a radiance.

    By QR and not by normal equations, whose condition number is the square.
    """
    found = np.empty(radiance.shape)
    for c in range(3):
        rows = np.column_stack([planes[..., c].T, radiance[:, c]]).astype(np.float64)
        rows *= np.sqrt(weights[:, c])[:, None]
        triangle = np.asarray(np.linalg.qr(rows, mode="r"))
        factors = np.linalg.lstsq(triangle[:, :-1], triangle[:, -1], UNDETERMINED)[0]
        found[:, c] = factors @ planes[..., c]
    return found


# -------------------------------------------------------------------------- materials of a fit


def harmonics(materials: Materials, normals: Array, fov: float, used: Mask, model: Model) -> Solve:
    """Light as spherical harmonics on maps of a view, at the pixels `used`."""
    height, width = used.shape
    views = view_directions(height, width, fov)[used]
    maps = (materials.albedo[used], materials.roughness[used], materials.metallic[used])
    weights = shade(normals[used], views, *maps, model=model)
    return partial(combination, np.moveaxis(weights, -1, 0))


def lamp(result: Result, used: Mask, threads: int) -> Solve:
    """A far lamp, and constant ambient light."""
    height, width = used.shape
    views = view_directions(height, width, result.fov)[used]
    maps = result.albedo[used], result.roughness[used], result.metallic[used]
    surfaces = result.normals[used], views, tuple(np.asarray(one, np.float64) for one in maps)

    def solve(radiance: Array, weights: Array) -> Array:
        return light_of_picture(radiance, weights, *surfaces, result.model, threads)[2]

    return solve


def explained_by(
    result: Result,
    scene: Scene,
    pictures: Sequence[int],
    light: Literal["own", "lamp"] = "own",
    threads: int = 0,
) -> list[Score]:
    """How well materials and normals of a result explain pictures of its view, a scene.

    Its valid pixels are judged; what the result has no materials for is not explained. Light is of
    the result's "own" kind, or a far "lamp" and constant ambient light.
    """
    camera = result.camera
    if camera is not None:
        if camera.response is not None and scene.response is not None:
            scene = scene.decoded_by(camera.response)
        scene = scene.through(result.fov, camera.correction)
    used = scene.valid & result.mask
    if light == "lamp" or result.lamps is not None:
        solve = lamp(result, used, threads)
    else:
        solve = harmonics(result.materials, result.normals, result.fov, used, result.model)
    curve = curve_of(scene)
    scores = []
    for i in pictures:
        shown = np.zeros((int(scene.valid.sum()), 3))
        shown[used[scene.valid]] = target(scene, i, used, curve).explained(solve)
        scores.append(score(scene, i, shown))
    return scores


def score(scene: Scene, picture: int, shown: Array) -> Score:
    """Error of the values (P, 3) of a picture at the scene's valid pixels."""
    of = target(scene, picture, scene.valid, None)
    counted = of.weights > 0
    left = (shown - of.values)[counted]
    rms = (float(np.sqrt(np.mean(values**2))) for values in (of.values[counted], left))
    return Score(scene.names[picture], int(counted.sum()), *rms)
