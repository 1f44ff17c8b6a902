"""Random pixels under random lights, rendered by the slow reference, and what it says of them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

import reference
from pbrfit import _core

Array = NDArray[np.float64]
Pixels = NDArray[np.uint64]


@dataclass(frozen=True)
class Kind:
    """A kind of problem; weights of each pixel of a picture (2), of each sample (3), or none."""

    channels: int = 3
    sh_order: int = 3
    metallic: float | None = None
    mono: bool = False
    weights: int | None = None
    known_lights: bool = False
    free_normals: bool = False

    @property
    def of_material(self) -> int:
        """Unknowns of a pixel's material."""
        return self.channels + (2 if self.metallic is None else 1)

    @property
    def unknowns(self) -> int:
        """Of a pixel."""
        return self.of_material + 2 * self.free_normals

    @property
    def coefficients(self) -> int:
        """Of a light's channel."""
        return (self.sh_order + 1) ** 2


class Example:
    """Pixels, their pictures, and tangent offsets from the given normals where those are free.

    `change` is done to materials (P, C + 2) before rendering; with `grazing` half of the pixels
    are seen at grazing angles, on both sides of the clamp of n·v.
    """

    def __init__(
        self,
        kind: Kind,
        pixels: int = 300,
        pictures: int = 12,
        *,
        noise: float = 0.0,
        brightness: float = 1.0,
        grazing: bool = False,
        degrees: float = 12.0,
        change: Callable[[Array], object] | None = None,
    ) -> None:
        rng = np.random.default_rng(3)
        self.kind, self.pixels, self.pictures = kind, pixels, pictures
        p, n, c = pixels, pictures, kind.channels
        self.given = reference.unit(rng.normal(size=(p, 3)) * 0.4 + (0, 0, 1))
        self.views = reference.unit(rng.normal(size=(p, 3)) * 0.1 + (0, 0, 1))
        if grazing:
            # v·n from -0.2 to 0.2 at the given normal, some within the clamp when changed.
            side = reference.unit(np.cross(self.views, rng.normal(size=(p, 3))))
            cosine = rng.uniform(-0.2, 0.2, (p, 1))
            graze = cosine * self.views + np.sqrt(1 - cosine**2) * side
            self.given[::2] = reference.unit(graze)[::2]
        self.offsets = np.zeros((p, 2))
        if kind.free_normals:
            self.offsets = np.tan(np.radians(degrees)) * reference.unit(rng.normal(size=(p, 2)))
        self.truth = rng.uniform(0.1, 0.9, (p, c + 2))
        if change is not None:
            change(self.truth)
        if kind.metallic is not None:
            self.truth[:, -1] = kind.metallic
        self.lights = brightness * rng.normal(size=(n, kind.coefficients, c)) * 0.4
        self.lights[:, 0] = brightness * rng.uniform(1, 3, (n, c))
        if kind.mono:
            self.lights[:] = self.lights[..., :1]
        self.weights: NDArray[np.float32] | None = None
        if kind.weights is not None:
            self.weights = rng.uniform(0.2, 1, (n, p, c)[: kind.weights]).astype(np.float32)
        self.targets = self.radiance(self.truth)
        self.targets += noise * rng.normal(size=self.targets.shape)

    @property
    def normals(self) -> Array:
        """At the tangent offsets."""
        if not self.kind.free_normals:
            return self.given
        return np.asarray(reference.turned(self.given, self.offsets.T), float)

    @property
    def omega(self) -> Array:
        """Weights of all samples, (P, N, C)."""
        omega = np.ones((self.pixels, self.pictures, self.kind.channels))
        if self.weights is not None:
            weights = self.weights if self.weights.ndim == 3 else self.weights[..., None]
            omega[:] = weights.swapaxes(0, 1)
        return omega

    @property
    def everything(self) -> Pixels:
        """Indices of all pixels."""
        return np.arange(self.pixels, dtype=np.uint64)

    def material(self, values: Array) -> tuple[Array, Array, Array]:
        """Albedo in three channels, roughness and metallic of values (P, C + 2)."""
        c = self.kind.channels
        return np.broadcast_to(values[:, :c], (len(values), 3)), values[:, c], values[:, c + 1]

    def radiance(
        self, values: Array, normals: Array | None = None, pixels: Any = slice(None)
    ) -> Array:
        """(P, N, C) by the reference."""
        normals = self.normals[pixels] if normals is None else normals
        weights = reference.shade(normals, self.views[pixels], *self.material(values))
        weights = weights[:, : self.kind.channels, : self.kind.coefficients]
        return np.asarray(np.einsum("pck,nkc->pnc", weights, self.lights))

    def slopes(self) -> tuple[Array, Array]:
        """Derivatives of radiance by a channel's own albedo, roughness, metallic and, where they
        are free, offsets, (P, N, C, 3 or 5), and by the light, (P, C, K); by the reference."""
        own = (slice(None), slice(self.kind.channels), slice(self.kind.coefficients))
        at = self.material(self.truth)
        where = self.normals, self.views
        by_unknowns = [*reference.shade_derivatives(*where, *at)]
        if self.kind.free_normals:
            for direction in reference.turned_by(self.given, self.offsets.T):
                by_unknowns.append(reference.by_turning(*where, *at, direction))
        moved = [np.einsum("pck,nkc->pnc", slope[own], self.lights) for slope in by_unknowns]
        return np.stack(moved, axis=-1), np.asarray(reference.shade(*where, *at)[own])

    def jacobian(self) -> tuple[Array, Array]:
        """Derivatives of radiance by all unknowns of a pixel, (P, N, C, D), and by the light."""
        slopes, by_light = self.slopes()
        own = slopes[..., :1] * np.eye(self.kind.channels)
        shared = slopes[..., 1:]
        if self.kind.metallic is not None:
            shared = np.delete(shared, 1, axis=-1)
        return np.concatenate([own, shared], axis=-1), by_light

    def problem(self, threads: int = 1, **options: Any) -> _core.Problem:
        """With all digits of the targets, or with other `images`."""
        given: dict[str, Any] = {
            "images": list(np.ascontiguousarray(self.targets.swapaxes(0, 1))),
            "normals": self.given,
            "views": self.views,
            "weights": self.weights,
            "sh_order": self.kind.sh_order,
            "metallic": self.kind.metallic,
            "lighting": self.lights if self.kind.known_lights else None,
            "free_normals": self.kind.free_normals,
        }
        return _core.Problem(**(given | options), threads=threads)

    def unknowns(self, values: Array, offsets: Array | None = None) -> Array:
        """(P, D) of materials (P, C + 2) and tangent offsets, those of the truth by default."""
        parts = [values[:, : self.kind.of_material]]
        if self.kind.free_normals:
            parts.append(self.offsets if offsets is None else offsets)
        return np.hstack(parts)

    def x(self, values: Array | None = None, offsets: Array | None = None) -> Array:
        """All unknowns of the problem; the true materials by default."""
        maps = self.unknowns(self.truth if values is None else values, offsets).T.ravel()
        return maps if self.kind.known_lights else np.concatenate([maps, self.lights.ravel()])

    def squares(self, found: Array, pixels: Any = slice(None)) -> Array:
        """Σ ω (I − T)² of pixels at unknowns (P, D), by the reference."""
        values = found[:, : self.kind.of_material]
        if self.kind.metallic is not None:
            values = np.column_stack([values, np.full(len(found), self.kind.metallic)])
        normals = self.given[pixels]
        if self.kind.free_normals:
            normals = np.asarray(reference.turned(normals, found[:, -2:].T), float)
        off = self.radiance(values, normals, pixels) - self.targets[pixels]
        return np.asarray((self.omega[pixels] * off**2).sum(axis=(1, 2)))
