"""A result under other light: SH light, or a lamp far away."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pbrfit._core import InputError
from pbrfit.io.checks import of_what, real_number
from pbrfit.model import lighting
from pbrfit.model.reflection import (
    Model,
    checked_lighting,
    checked_model,
    render,
    render_directional,
)

if TYPE_CHECKING:
    from pbrfit.result.data import ResultData


@dataclass(frozen=True)
class DirectionalLight:
    """Light from one direction, infinitely far away, such as the sun's.

    Attributes
    ----------
    azimuth, elevation
        Where the light comes from, in degrees: azimuth 0 is +Z, where the viewer is, and 90 is +X,
        to the right; elevation 90 is +Y, up.
    color
        Radiance of a white diffuse surface that faces the light, linear Rec.709, 0 or more: its
        irradiance over π.

    Raises
    ------
    InputError
        If a number is not finite or a colour is below 0.
    """

    azimuth: float
    elevation: float
    color: tuple[float, float, float] = (1.0, 1.0, 1.0)

    def __post_init__(self) -> None:
        for name in ("azimuth", "elevation"):
            object.__setattr__(self, name, _degrees(name, getattr(self, name)))
        expected = "three finite numbers, 0 or more"
        try:
            color = tuple(real_number("color", channel, expected) for channel in self.color)
        except TypeError:
            color = ()
        if len(color) != 3 or not all(0 <= channel < math.inf for channel in color):
            raise InputError(f"color: expected {expected}, found {of_what(self.color)}")
        object.__setattr__(self, "color", color)

    @property
    def direction(self) -> NDArray[np.float64]:
        """(3,) unit vector in camera space from the surface to the light."""
        # In whole turns first: sines of huge angles would be taken after rounding.
        azimuth, elevation = (
            math.radians(math.remainder(angle, 360)) for angle in (self.azimuth, self.elevation)
        )
        level = math.cos(elevation)
        return np.array([math.sin(azimuth) * level, math.sin(elevation), math.cos(azimuth) * level])

    def turned(self, degrees: float) -> DirectionalLight:
        """The light turned about +Y: so much is added to its azimuth."""
        return dataclasses.replace(self, azimuth=self.azimuth + _degrees("degrees", degrees))


def relight(
    result: ResultData,
    light: ArrayLike | DirectionalLight,
    threads: int = 0,
    *,
    model: Model | None = None,
    shadows: bool = True,
) -> NDArray[np.float64]:
    """Radiance of the recovered surfaces under other light.

    SH light goes through the model that the materials were fitted with (docs/model.md), and gives
    with the result's own lights the reconstructions of its pictures. A `DirectionalLight` goes
    through the model's full reflection, because its highlights are beyond what SH light holds.
    Where the fit decided for surroundings (`Result.transport`), they block light; and SH light is
    reflected between surfaces if the pictures told that. Light that surfaces reflect is left out
    under a `DirectionalLight`. Elsewhere nothing casts a shadow.

    Parameters
    ----------
    result
        What `decompose` found.
    light
        SH light (16, 3), or (N, 16, 3) for N pictures, linear Rec.709; or a `DirectionalLight`.
    threads
        0 = one for each processor; the result does not depend on it.
    model
        Which model the result is expected to be of; None = whichever it is.
    shadows
        Whether surroundings do to light what the fit decided; without any it makes no difference.

    Returns
    -------
    (H, W, 3) or (N, H, W, 3) float64, linear Rec.709; NaN outside the mask.

    Raises
    ------
    InputError
        If the light has another shape or numbers that are not finite, or the result is of another
        model.
    """
    if model is not None and checked_model(model) != result.model:
        raise InputError(
            f"model: expected {result.model}, with which the result was fitted, found {model}"
        )
    scenery = result.scenery if shadows else None
    if isinstance(light, DirectionalLight):
        picture = render_directional(
            *(result.materials, result.normals, light.direction, light.color, result.fov, threads),
            model=result.model,
        )
        if scenery is not None:
            picture[result.mask] *= scenery.open_to(light.direction)[:, None]
        return picture
    if scenery is not None:
        return _among_surroundings(result, light)
    return render(result.materials, result.normals, light, result.fov, threads, model=result.model)


def _among_surroundings(result: ResultData, light: ArrayLike) -> NDArray[np.float64]:
    """Pictures under SH light by those under each SH function."""
    lights = checked_lighting(light)
    if not np.isfinite(lights).all():
        raise InputError("lighting: expected finite numbers, found NaN or infinity")
    pictures = result.basis_pictures
    assert pictures is not None
    found = np.empty((*lights.shape[:-2], *result.mask.shape, 3))
    for index in np.ndindex(lights.shape[:-2]):
        np.einsum("kc,khwc->hwc", lights[index], pictures, out=found[index])
    return found


@overload
def turned(light: NDArray[np.float64], degrees: float) -> NDArray[np.float64]: ...
@overload
def turned(light: DirectionalLight, degrees: float) -> DirectionalLight: ...
def turned(
    light: NDArray[np.float64] | DirectionalLight, degrees: float
) -> NDArray[np.float64] | DirectionalLight:
    """SH light (..., 16, 3) or a `DirectionalLight`, turned about +Y from +Z towards +X."""
    if isinstance(light, DirectionalLight):
        return light.turned(degrees)
    return lighting.rotated(light, degrees)


def _degrees(name: str, value: float) -> float:
    expected = "a finite number of degrees"
    degrees = real_number(name, value, expected)
    if not math.isfinite(degrees):
        raise InputError(f"{name}: expected {expected}, found {value!r}")
    return degrees
