"""The objective in float64, and the size that its rounding errors are measured against.

Vectorised numpy on top of `kernel.shade` and `kernel.shade_vjp`, in pieces that fit the cache; sums
over pieces are exact (`math.fsum`). It shares with the fast objective the model in double
precision, not the arithmetic that is under test.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from pbrfit import _core
from pbrfit.fit.scale import IRRADIANCE
from pbrfit.model.geometry import unit
from pbrfit.model.lighting import BAND_OF
from pbrfit.model.reflection import Model, ggx_band_weights, shade, shade_vjp
from pbrfit_evaluation.arrays import Array
from pbrfit_evaluation.float32_model import DIELECTRIC_F0, MIN_COSINE

Rows = dict[str, dict[str, float]]
"""What was found, by case and key."""

ROUNDING = 2.0**-24
"""u: the largest relative error of rounding to float32."""

PIECE = 4096
"""Pixels at a time."""

FIRST_OF_BAND = (0, 1, 4, 9)
BASIS_SIZE = np.sqrt((2 * BAND_OF + 1) / (4 * math.pi))
"""Largest value of a band's basis functions. They are polynomials whose terms cancel, so their
errors go with this and not with their value."""

MODEL: Model = "paper"
"""Whose terms the natural scales below are made of."""


@dataclass(frozen=True, eq=False)
class Pixels:
    """Directions and materials: normals, views, albedo (P, 3); roughness, metallic (P,)."""

    normals: Array
    views: Array
    albedo: Array
    roughness: Array
    metallic: Array

    def __len__(self) -> int:
        return len(self.roughness)

    @property
    def arrays(self) -> tuple[Array, Array, Array, Array, Array]:
        """All of them, in the order of `shade`."""
        return self.normals, self.views, self.albedo, self.roughness, self.metallic

    def __getitem__(self, rows: slice | NDArray[np.intp]) -> Pixels:
        return Pixels(*(array[rows] for array in self.arrays))

    def shade(self) -> Array:
        """Weights, (P, 3, 16)."""
        return shade(*self.arrays, model=MODEL)

    def render(self, lighting: Array, threads: int = 0) -> Array:
        """Radiance (N, P, 3) in float64."""
        return _core.render(*self.arrays, lighting, threads, MODEL)


@dataclass(frozen=True, eq=False)
class Case:
    """Pictures and a point at which their objective is evaluated."""

    pixels: Pixels
    """P of them."""
    lighting: Array
    """(N, 16, 3)."""
    images: NDArray[np.float32]
    """(N, P, 3) float32 targets."""

    @cached_property
    def x(self) -> Array:
        """The point as the fast objective takes it."""
        p = self.pixels
        return np.concatenate([p.albedo.T.ravel(), p.roughness, p.metallic, self.lighting.ravel()])

    def problem(self, threads: int = 0) -> _core.Problem:
        """The fast objective."""
        return _core.Problem(
            self.images, self.pixels.normals, self.pixels.views, threads, model=MODEL
        )

    def blocks(self) -> dict[str, slice]:
        """Where in x and the gradient each kind of unknown lies."""
        p = len(self.pixels)
        return {
            "albedo": slice(0, 3 * p),
            "roughness": slice(3 * p, 4 * p),
            "metallic": slice(4 * p, 5 * p),
            "lights": slice(5 * p, 5 * p + self.lighting.size),
        }


@dataclass(frozen=True, eq=False)
class Evaluation:
    """Loss and gradient in float64, each with its natural scale.

    The scale is the same sum with every term replaced by its size, down to the single products
    that make up a weight; each residual I − T by Σ_k |w_k L_k| + |T|; and each basis function by
    the largest value in its band. However floating-point arithmetic orders the terms, its error is
    a small multiple of its precision times that scale; relative to the sum itself it can be
    anything, because terms cancel.

    `lights_terms` is a tighter scale of the last block: with residuals as large as they are.
    """

    loss: float
    gradient: Array
    loss_scale: float
    gradient_scale: Array
    lights_terms: Array


def evaluate(case: Case) -> Evaluation:
    """Loss and gradient of a case in float64, with scales."""
    count = len(case.pixels)
    lights = np.ascontiguousarray(case.lighting.transpose(2, 0, 1))  # (3, N, 16)
    factor = 2.0 / (3 * count * len(case.lighting))
    materials = np.empty((2, 5, count))
    by_lights = []
    losses, loss_scales = [], []
    for start in range(0, count, PIECE):
        piece = case.pixels[start : start + PIECE]
        rows = slice(start, start + len(piece))
        weights = piece.shade().transpose(1, 0, 2)  # (3, P, 16)
        sizes = _Sizes(piece)
        targets = case.images[:, rows].transpose(2, 1, 0).astype(np.float64)  # (3, P, N)
        residual = weights @ lights.transpose(0, 2, 1) - targets
        size = sizes.weights @ np.abs(lights).transpose(0, 2, 1) + np.abs(targets)
        losses.append(float(np.sum(residual * residual)))
        loss_scales.append(float(np.sum(np.abs(residual) * size)))
        by_weights = factor * (residual @ lights)
        d_albedo, d_roughness, d_metallic, _ = shade_vjp(
            *piece.arrays, by_weights.transpose(1, 0, 2), model=MODEL
        )
        materials[0, :3, rows] = d_albedo.T
        materials[0, 3, rows] = d_roughness
        materials[0, 4, rows] = d_metallic
        materials[1, :, rows] = sizes.by_material(factor * (size @ np.abs(lights)))
        of_lights = ((residual, weights), (size, sizes.weights), (np.abs(residual), sizes.weights))
        by_lights.append(factor * np.stack([a.transpose(0, 2, 1) @ b for a, b in of_lights]))
    lights_sum = _exact_sum(by_lights).transpose(0, 2, 3, 1)  # (3, N, 16, 3)
    return Evaluation(
        math.fsum(losses) * factor / 2,
        np.concatenate([materials[0].ravel(), lights_sum[0].ravel()]),
        math.fsum(loss_scales) * factor,
        np.concatenate([materials[1].ravel(), lights_sum[1].ravel()]),
        lights_sum[2].ravel(),
    )


@dataclass(frozen=True, eq=False)
class Compared:
    """Loss and gradient of a case by the fast objective, beside those in float64."""

    loss: float
    gradient: Array
    true: Evaluation

    @property
    def loss_error(self) -> float:
        """Relative to the loss."""
        return ratio(abs(self.loss - self.true.loss), self.true.loss)

    def block_error(self, block: slice) -> float:
        """Of a block of the gradient, relative to its norm."""
        true = self.true.gradient[block]
        off = np.linalg.norm(self.gradient[block] - true)
        return ratio(float(off), float(np.linalg.norm(true)))

    def entry_error(self, block: slice, least: float = 0.0) -> float:
        """Worst entry of a block, relative to its natural scale plus `least`."""
        errors = self.gradient[block] - self.true.gradient[block]
        return worst_entry(errors, self.true.gradient_scale[block] + least)


def compare(case: Case, threads: int) -> Compared:
    """Evaluate a case both ways."""
    return Compared(*case.problem(threads).value_and_grad(case.x), evaluate(case))


def ratio(error: float, size: float) -> float:
    """Error relative to a size, where nothing is allowed of nothing."""
    if error == 0:
        return 0.0
    return error / size if size else math.inf


def worst_entry(errors: Array, scale: Array) -> float:
    """Return the largest |error| over its entry's scale, where nothing is allowed of nothing."""
    errors = np.abs(errors)
    relative = np.divide(errors, scale, out=np.full_like(errors, np.inf), where=scale > 0)
    relative[(errors == 0) & (scale == 0)] = 0
    return float(relative.max())


def _exact_sum(parts: list[Array]) -> Array:
    """Sum of equal arrays, correctly rounded entry by entry."""
    stacked = np.stack(parts)
    flat = stacked.reshape(len(parts), -1)
    return np.array([math.fsum(column) for column in flat.T]).reshape(stacked.shape[1:])


class _Sizes:
    """Sizes of the terms that make up weights and their derivatives, for some pixels."""

    def __init__(self, pixels: Pixels) -> None:
        cosine = np.sum(pixels.normals * pixels.views, axis=-1)
        cosine = np.maximum(cosine, MIN_COSINE)
        rho = pixels.albedo.T  # (3, P), as all below
        r, m = pixels.roughness, pixels.metallic
        h, slope = (np.abs(b) for b in ggx_band_weights(r))
        schlick = (1 - cosine) ** 5
        k = r**4 / 2
        below = cosine * (1 - k) + k
        g1 = cosine / below
        g1_slope = cosine * (1 - cosine) / below**2 * 2 * r**3
        f0 = DIELECTRIC_F0 * (1 - m) + m * rho
        fresnel = f0 + (1 - f0) * schlick
        transmitted = (1 - fresnel) / math.pi
        # Factors of the two sets of basis functions, and their derivatives' terms.
        self._specular = (fresnel * g1 / 4)[..., None] * h  # (3, P, 4)
        self._diffuse = transmitted * (1 - m) * rho
        by_f0 = (1 - schlick) * (1 - m) * rho / math.pi
        self._by_albedo = (transmitted * (1 - m) + m * by_f0, (m * (1 - schlick) * g1 / 4, h))
        contrast = np.abs(rho - DIELECTRIC_F0)
        self._by_metallic = (
            transmitted * rho + contrast * by_f0,
            (contrast * (1 - schlick) * g1 / 4, h),
        )
        self._by_roughness = (fresnel / 4)[..., None] * (
            g1_slope[:, None] * h + g1[:, None] * slope
        )  # (3, P, 4)

    @cached_property
    def weights(self) -> Array:
        """(3, P, 16)."""
        diffuse = self._diffuse[..., None] * (IRRADIANCE * BASIS_SIZE)
        return np.asarray(diffuse + self._specular[..., BAND_OF] * BASIS_SIZE)

    def by_material(self, by_weights: Array) -> Array:
        """Sizes (5, P) of the material derivatives from sizes (3, P, 16) of those by weights."""
        at_normal = np.sum(by_weights * (IRRADIANCE * BASIS_SIZE), axis=-1)
        at_mirror = by_weights * BASIS_SIZE
        bands = np.add.reduceat(at_mirror, FIRST_OF_BAND, axis=-1)

        def pull_back(factors: tuple[Array, tuple[Array, Array]]) -> Array:
            diffuse, (specular, h) = factors
            return np.asarray(diffuse * at_normal + specular * np.sum(h * bands, axis=-1))

        return np.concatenate(
            [
                pull_back(self._by_albedo),
                np.sum(self._by_roughness * bands, axis=(0, -1))[None],
                pull_back(self._by_metallic).sum(axis=0)[None],
            ]
        )


# ------------------------------------------------------------------- random and extreme pixels

NEAR = 1e-8
"""How near to a special value "near" is."""

Change = Callable[[Generator, Case], Case]
"""Gives random pixels something special."""


def random_pixels(rng: Generator, count: int) -> Pixels:
    """Draw materials all over their range, seen at all cosines from 0.05 to 1."""
    views = unit(np.stack([*rng.uniform(-0.6, 0.6, (2, count)), np.ones(count)], axis=-1))
    return Pixels(
        seen_at(rng, views, rng.uniform(0.05, 1.0, count)),
        views,
        rng.uniform(0, 1, (count, 3)),
        rng.uniform(0, 1, count),
        rng.uniform(0, 1, count),
    )


def seen_at(rng: Generator, views: Array, cosine: Array) -> Array:
    """Normals (P, 3) with the given n·v, turned about the view direction at random."""
    across = unit(np.cross(views, rng.normal(size=views.shape)))
    return np.asarray(cosine[:, None] * views + np.sqrt(1 - cosine**2)[:, None] * across)


def random_lights(rng: Generator, count: int, variation: float = 0.5) -> Array:
    """Lights (N, 16, 3) of radiance about 1, with bands that vary by `variation` and fall off."""
    spread = np.repeat([0.3, 1.0, 0.6, 0.4], [1, 3, 5, 7])
    lights = variation * spread[:, None] * rng.normal(size=(count, 16, 3))
    lights[:, 0] += 2.0
    return np.asarray(lights)


def random_case(rng: Generator, pixels: int, pictures: int) -> Case:
    """Pixels and lights, and pictures that have nothing to do with them: residuals like them."""
    drawn, lighting = random_pixels(rng, pixels), random_lights(rng, pictures)
    return Case(drawn, lighting, rng.uniform(0, 2, (pictures, pixels, 3)).astype(np.float32))


def _with_roughness(center: float, low: float, high: float, rng: Generator, case: Case) -> Case:
    """Roughness within [low, high] of `center`, one pixel in eight exactly on it."""
    r = center + rng.uniform(low, high, len(case.pixels))
    r[::8] = center
    return replace(case, pixels=replace(case.pixels, roughness=r))


def grazing(lowest: float, away: int, rng: Generator, case: Case) -> Case:
    """n·v from 1 to ten to the power of `lowest`; one in `away` faces away, none if 0."""
    cosine = 10.0 ** rng.uniform(lowest, 0, len(case.pixels))
    if away:
        cosine[::away] *= -1
    normals = seen_at(rng, case.pixels.views, cosine)
    return replace(case, pixels=replace(case.pixels, normals=normals))


def _on_bounds(rng: Generator, case: Case) -> Case:
    # Albedo, roughness and metallic exactly 0 or 1, in all combinations.
    n = len(case.pixels)
    albedo = rng.integers(0, 2, (n, 3)).astype(np.float64)
    roughness, metallic = rng.integers(0, 2, (2, n)).astype(np.float64)
    pixels = replace(case.pixels, albedo=albedo, roughness=roughness, metallic=metallic)
    return replace(case, pixels=pixels)


def scaled(low: float, high: float, rng: Generator, case: Case) -> Case:
    """Pictures of different exposure, log-uniform between low and high."""
    scale = np.exp(rng.uniform(np.log(low), np.log(high), (len(case.lighting), 1, 1)))
    scale[0], scale[-1] = low, high
    images = (case.images * scale).astype(np.float32)
    return Case(case.pixels, case.lighting * scale, images)


def _dark_channel(_: Generator, case: Case) -> Case:
    # Blue is black in light and picture, in half of the pictures in the picture alone.
    lighting, images = case.lighting.copy(), case.images.copy()
    images[..., 2] = 0
    lighting[: len(lighting) // 2, :, 2] = 0
    return Case(case.pixels, lighting, images)


_AT_ALL_ANGLES = partial(grazing, -7, 8)
"""From facing the camera to beyond the clamp."""


def _everything(rng: Generator, case: Case) -> Case:
    for change in (_AT_ALL_ANGLES, _on_bounds, partial(scaled, 1e-6, 1e6), _dark_channel):
        case = change(rng, case)
    return case


KINDS: Mapping[str, Change] = {
    "random": lambda _, case: case,
    "r near 0": partial(_with_roughness, 0.0, 0.0, NEAR),
    "r near 1": partial(_with_roughness, 1.0, -NEAR, 0.0),
    "r across 0.4": partial(_with_roughness, 0.4, -NEAR, NEAR),
    "n·v from 1 to 10⁻⁷, or negative": _AT_ALL_ANGLES,
    "ρ, r, m exactly 0 or 1": _on_bounds,
    "lights × 10⁻⁶": partial(scaled, 1e-6, 1e-6),
    "lights × 10⁶": partial(scaled, 1e6, 1e6),
    "lights × 10⁻⁶ … 10⁶ in one problem": partial(scaled, 1e-6, 1e6),
    "blue dark": _dark_channel,
    "grazing, on bounds, mixed lights, blue dark": _everything,
}
