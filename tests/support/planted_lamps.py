"""Scenes that obey the model of lamps: far or near ones, dielectrics and metals, made by hand."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lamp_scenes import around
from pbrfit import Scene
from pbrfit.fit.lamps.problem import LampPixels, LampState, radiance
from pbrfit.fit.run import FitSetup
from pbrfit.fit.whole_picture import FitOutput
from pbrfit.model import geometry
from pbrfit.model.lamps import Lamps
from pbrfit.model.reflection import Model
from pbrfit.result.options import FitOptions
from pbrfit.values.arrays import Array
from reference import unit

ROUGHNESS = 0.25, 0.5
"""Of the two segments."""


@dataclass(frozen=True, eq=False)
class Planted:
    """What a fit is given, and the truth."""

    scene: Scene
    lamps: Lamps
    albedo: Array
    roughness: Array
    metallic: Array
    normals: Array
    """Maps of whole pictures."""

    def of_valid(self, name: str) -> Array:
        """Values of a map inside the mask."""
        return np.asarray(getattr(self, name)[self.scene.valid])

    def directions_off(self, found: Lamps) -> Array:
        """(K,): angles between far lamps and the true ones, degrees."""
        return np.asarray(geometry.angles_between(found.places, self.lamps.places))

    def normals_off(self, found: Array) -> Array:
        """(P,): angles between normals and the true ones, degrees."""
        return np.asarray(geometry.angles_between(found, self.normals)[self.scene.valid])

    def albedo_off(self, found: NDArray[Any]) -> float:
        """Root mean square, after the best factor a channel."""
        a, b = found[self.scene.valid], self.of_valid("albedo")
        return float(np.sqrt(np.mean((a * (a * b).sum(0) / (a * a).sum(0) - b) ** 2)))


def colors(count: int, seed: int = 1) -> Array:
    """(K, 3): of lamps that are about equally strong, and grey on the whole."""
    rng = np.random.default_rng(seed)
    strength, tint = rng.uniform(0.8, 1.25, (count, 1)), rng.uniform(0.95, 1.05, (count, 3))
    return np.asarray(1.2 * strength * tint)


def far(count: int, slant: float = 35, spread: float = 15) -> Lamps:
    """One lamp a picture."""
    return Lamps(np.arange(count), around(count, slant, spread), colors=colors(count))


def setup(model: Model = "principled", **options: Any) -> FitSetup:
    """Of a fit without anybody who looks on."""
    threads = options.pop("threads", 0)
    chosen = FitOptions(**({"model": model, "light": "lamps"} | options))
    return FitSetup(chosen, threads, None, time.perf_counter())


def dome(size: int) -> tuple[Array, NDArray[np.bool_], Array]:
    """Normals of a ball without its edge, their mask, and a depth that says nothing of it."""
    y, x = np.mgrid[:size, :size]
    x, y = (x - (size - 1) / 2) / (0.46 * size), ((size - 1) / 2 - y) / (0.46 * size)
    mask = x**2 + y**2 < 0.8
    normals = np.stack([x, y, np.sqrt(np.maximum(1 - x**2 - y**2, 1e-9))], axis=-1)
    return unit(normals), mask, np.full((size, size), 2.0)


def relief(size: int, fov: float) -> tuple[Array, NDArray[np.bool_], Array]:
    """Normals, mask and depth of waves about 2 away, which agree."""
    y, x = np.mgrid[:size, :size] / size * 2 * np.pi
    depth = 2.0 + 0.12 * np.cos(2 * x + 0.4) * np.cos(1.5 * y) + 0.05 * np.sin(x - 2 * y)
    points = geometry.positions(depth, fov)
    by_column, by_row = np.gradient(points, axis=1), np.gradient(points, axis=0)
    normals = unit(np.cross(by_row, by_column))
    normals *= np.sign(normals[..., 2:])
    mask = np.zeros((size, size), bool)
    mask[1:-1, 1:-1] = True
    return normals, mask, depth


def planted(
    lamps: Lamps,
    *,
    size: int = 40,
    model: Model = "principled",
    metal: bool = False,
    segments: bool = True,
    shape: tuple[Array, NDArray[np.bool_], Array] | None = None,
    fov: float = 0.0,
    with_depth: bool = False,
    known: Lamps | None = None,
    normals_known: bool = True,
    ambient: float = 0.0,
    shadow: NDArray[np.bool_] | None = None,
    ceiling: float | None = None,
    card: tuple[int, int, float] | None = None,
) -> Planted:
    """Pictures of dielectrics with two roughnesses, the right one a metal if that is asked for.

    Samples of `shadow` (N, H, W) are black; above `ceiling` they are clipped. A `card` at (column,
    row) has the third as albedo.
    """
    normals, mask, depth = dome(size) if shape is None else shape
    rows, columns = np.indices(mask.shape)
    right: NDArray[np.bool_] = np.asarray(columns >= size // 2)
    stripe = (rows // max(size // 8, 1)) % 2
    base = np.array([[0.5, 0.35, 0.25], [0.2, 0.3, 0.45]])
    albedo: Array = base[stripe]
    metallic = np.zeros(mask.shape)
    if metal:
        albedo = np.where(right[..., None], [0.9, 0.7, 0.4], albedo)
        metallic[right] = 1.0
    if card is not None:
        column, row, value = card
        albedo[row - 2 : row + 3, column - 2 : column + 3] = value
    roughness = np.where(right, *ROUGHNESS[::-1]).astype(float)
    count = int(lamps.pictures.max()) + 1
    places = np.flatnonzero(mask.ravel())
    points = geometry.positions(depth, fov).reshape(-1, 3)[places]
    blank = np.zeros((len(places), count, 3))
    pixels = LampPixels(
        blank,
        np.ones_like(blank),
        np.zeros(blank.shape, np.uint8),
        geometry.view_directions(mask.shape[0], mask.shape[1], fov).reshape(-1, 3)[places],
        points,
        normals.reshape(-1, 3)[places],
        np.zeros(len(places), np.intp),
        places,
        1.0,
        model,
        0,
    )
    around_light = np.zeros((count, 16, 3))
    around_light[:, 0] = ambient
    state = LampState(
        lamps,
        around_light,
        pixels.normals,
        albedo.reshape(-1, 3)[places],
        roughness.reshape(-1)[places],
        metallic.reshape(-1)[places],
    )
    images = np.zeros((count, *mask.shape, 3))
    images[:, mask] = radiance(pixels, state).swapaxes(0, 1)
    limits = np.zeros(images.shape, np.uint8)
    if shadow is not None:
        images[shadow] = 0.0
    if ceiling is not None:
        limits[images >= ceiling] = 1
        images = np.minimum(images, ceiling)
    given: Any = np.where(mask[..., None], normals, [0, 0, 1.0]) if normals_known else None
    scene = Scene(
        images=images,
        normals=given,
        mask=mask,
        fov=fov,
        depth=depth if with_depth else None,
        segments=np.where(right, 2, 1) if segments else None,
        lamps=known,
        limits=limits,
    )
    return Planted(scene, lamps, albedo, roughness, metallic, normals)


def without_colors(lamps: Lamps) -> Lamps:
    """The same where only places are known."""
    return replace(lamps, colors=np.full_like(lamps.colors, np.nan))


def best_factor(found: FitOutput, truth: Planted) -> float:
    """Of the albedo, all channels together."""
    a, b = found.materials.albedo[truth.scene.valid], truth.of_valid("albedo")
    return float((a * b).sum() / (a * a).sum())
