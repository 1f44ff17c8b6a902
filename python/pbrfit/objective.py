"""Objective: a scene as a function of one vector, for this package's solver or any other."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pbrfit import _core
from pbrfit._core import InputError
from pbrfit.materials import Materials
from pbrfit.model import whole_number
from pbrfit.scene import Scene

MEAN_RADIANCE = 0.4
"""Mean valid radiance after division by the scene scale, so that exposure does not matter."""

START_MEAN_ALBEDO = 0.5
"""The mean picture is scaled to this mean, the middle of the range. The scale between albedo and
light is what the fit finds last, so it matters where it starts: from 0.4, its own mean, the errors
on synthetic rooms after 500 iterations are 1.5 times as large."""

START_ROUGHNESS = 0.5
START_METALLIC = 0.25
START_ALBEDO_RANGE = (0.02, 0.98)
"""The start keeps clear of the bounds, where the gradient by albedo may vanish."""

LARGEST_LIGHT = 1e15
"""Known lights beyond this multiple of the scene scale overflow float32 when squared."""

LIGHT_RIDGE = 1e-6
"""Of the mean eigenvalue: keeps the lights finite where the normals show only part of a sphere."""


class Objective:
    """Mean squared error of the pictures as a function of x, with its gradient.

    x = [albedo R, G, B (a plane of P valid pixels each) | roughness | metallic | lighting
    (N·16·3)], float64. With known lights the last part is absent. Inside, pictures are divided by
    one scene scale that makes their mean valid radiance 0.4; `pack` and `unpack` convert lights
    between the scene's own units and x.

    Parameters
    ----------
    scene
        The pictures.
    threads
        0 = one for each processor. Results do not depend on it, to the last bit.

    Attributes
    ----------
    size
        Length of x.
    roughness
        Where in x the roughness lies.
    bounds
        (size, 2): [0, 1] for materials, infinite for lights.
    scale
        The scene scale, in picture units.

    Raises
    ------
    InputError
        If the pictures are black on the whole.
    """

    def __init__(self, scene: Scene, *, threads: int = 0) -> None:
        threads = whole_number("threads", threads)
        self._valid = scene.valid
        self._known_lighting = scene.lighting
        self._pictures = len(scene.images)
        self.pixels = int(np.count_nonzero(self._valid))
        self.scale = _scene_scale(scene, self._valid)
        if scene.lighting is not None and np.abs(scene.lighting).max() > LARGEST_LIGHT * self.scale:
            raise InputError(
                f"lighting: expected coefficients like the pictures' radiance (mean "
                f"{self.scale * MEAN_RADIANCE:g}), found {np.abs(scene.lighting).max():g}"
            )
        images = np.empty((self._pictures, self.pixels, 3), dtype=np.float32)
        for scaled, image in zip(images, scene.images, strict=True):
            scaled[:] = image[self._valid].astype(np.float64) / self.scale
        self._mean_image = images.mean(axis=0, dtype=np.float64)
        self._problem = _core.Problem(
            images,
            scene.normals[self._valid].astype(np.float64),
            scene.views[self._valid],
            threads,
        )
        fitted_lights = 0 if self._known_lighting is not None else self._pictures * 48
        self.size = 5 * self.pixels + fitted_lights
        self.roughness = slice(3 * self.pixels, 4 * self.pixels)
        self.bounds = np.empty((self.size, 2))
        self.bounds[: 5 * self.pixels] = (0.0, 1.0)
        self.bounds[5 * self.pixels :] = (-np.inf, np.inf)

    def start(self) -> NDArray[np.float64]:
        """Albedo from the mean picture, constant roughness and metallic, best lights for them."""
        albedo = START_MEAN_ALBEDO / MEAN_RADIANCE * self._mean_image
        albedo = np.clip(albedo, *START_ALBEDO_RANGE)
        grey = np.ones(self.pixels)
        x = np.concatenate([albedo.T.ravel(), START_ROUGHNESS * grey, START_METALLIC * grey])
        return x if self._known_lighting is not None else self.with_best_lights(x)

    def with_best_lights(self, maps: NDArray[np.float64]) -> NDArray[np.float64]:
        """X with these maps (the first 5 P entries) and the lights that fit them best.

        Radiance is linear in the light, so this is a linear least-squares problem a channel.
        """
        lights = np.zeros((self._pictures, 16, 3))
        x = np.concatenate([maps[: 5 * self.pixels], lights.ravel()])
        gram, right = self._problem.light_equations(x)
        ridge = LIGHT_RIDGE * np.trace(gram, axis1=1, axis2=2) / 16
        gram += ridge[:, None, None] * np.eye(16)
        for c in range(3):
            lights[..., c] = np.linalg.solve(gram[c], right[c].T).T
        x[5 * self.pixels :] = lights.ravel()
        return x

    def value_and_grad(self, x: NDArray[np.float64]) -> tuple[float, NDArray[np.float64]]:
        """Loss at x and its gradient: (float, (size,) float64). x is not changed.

        Raises
        ------
        InputError
            If x has another length, is not finite, or leaves its bounds.
        """
        value, gradient = self._problem.value_and_grad(self._whole(x))
        return value, gradient[: self.size]

    def residual_rmse(self, loss: float) -> float:
        """Root mean square residual in picture units of a value of the loss."""
        return float(np.sqrt(loss) * self.scale)

    def pack(
        self,
        albedo: NDArray[Any],
        roughness: NDArray[Any],
        metallic: NDArray[Any],
        lighting: NDArray[Any] | None = None,
    ) -> NDArray[np.float64]:
        """X from maps (H, W, ...) and lights (N, 16, 3) in picture units.

        Without `lighting` the lights that fit the maps best are taken.
        """
        maps = []
        for name, values, end in (
            ("albedo", albedo, (3,)),
            ("roughness", roughness, ()),
            ("metallic", metallic, ()),
        ):
            values = np.asarray(values, dtype=np.float64)
            if values.shape != self._valid.shape + end:
                raise InputError(
                    f"{name}: expected shape {self._valid.shape + end}, found {values.shape}"
                )
            if not np.isfinite(values[self._valid]).all():
                raise InputError(f"{name}: expected finite values at all valid pixels, found NaN")
            maps.append(values[self._valid].T.ravel())
        x = np.concatenate(maps)
        if self._known_lighting is not None:
            return x
        if lighting is None:
            return self.with_best_lights(x)
        lighting = np.asarray(lighting, dtype=np.float64)
        if lighting.shape != (self._pictures, 16, 3):
            raise InputError(
                f"lighting: expected shape {(self._pictures, 16, 3)}, found {lighting.shape}"
            )
        return np.concatenate([x, (lighting / self.scale).ravel()])

    def unpack(self, x: NDArray[np.float64]) -> tuple[Materials, NDArray[np.float64]]:
        """Maps (NaN outside the mask) and lights (N, 16, 3) in picture units."""
        x = np.asarray(x)
        p = self.pixels
        if x.shape != (self.size,):
            raise InputError(f"x: expected shape {(self.size,)}, found {x.shape}")
        materials = Materials(
            self._map(x[: 3 * p].reshape(3, p).T),
            self._map(x[3 * p : 4 * p]),
            self._map(x[4 * p : 5 * p]),
        )
        if self._known_lighting is not None:
            return materials, self._known_lighting.copy()
        return materials, x[5 * p :].reshape(-1, 16, 3) * self.scale

    def _map(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        whole = np.full(self._valid.shape + values.shape[1:], np.nan)
        whole[self._valid] = values
        return whole

    def _whole(self, x: ArrayLike) -> NDArray[np.float64]:
        """X as the core takes it: with the known lights appended."""
        try:
            if np.iscomplexobj(x):
                raise TypeError("complex numbers")
            x = np.asarray(x, dtype=np.float64)
        except (TypeError, ValueError) as error:
            raise InputError(f"x: expected real numbers, found {error}") from None
        if x.shape != (self.size,):
            raise InputError(f"x: expected shape {(self.size,)}, found {x.shape}")
        if self._known_lighting is None:
            return x
        return np.concatenate([x, (self._known_lighting / self.scale).ravel()])


def _scene_scale(scene: Scene, valid: NDArray[np.bool_]) -> float:
    mean = float(np.mean([image[valid].mean(dtype=np.float64) for image in scene.images]))
    if not 0 < mean < np.inf:
        raise InputError(
            f"images: expected a positive mean radiance over the valid pixels, found {mean:g}"
        )
    return mean / MEAN_RADIANCE
