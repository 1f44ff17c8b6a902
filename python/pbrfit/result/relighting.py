"""A result under other light, SH light, lamps or a panorama, and under that of its pictures."""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pbrfit._core import InputError
from pbrfit.model import lighting
from pbrfit.model.environment import Environment, render_environment
from pbrfit.model.lamps import Lamps
from pbrfit.model.materials import Materials
from pbrfit.model.reflection import checked_lighting, render, render_directional, render_lamps
from pbrfit.values.checks import finite, of_what
from pbrfit.values.quoting import listed, quoted

if TYPE_CHECKING:
    from pbrfit.result.data import ResultData
    from pbrfit.transport.scenery import Scenery

LampLight = tuple[Lamps, NDArray[np.float64]]
"""Lamps of one picture, and the ambient light (16, 3) beside them."""


OF_COLOR = "three finite numbers, 0 or more", 0.0
"""What a colour has to be, and the least of its numbers."""

SOFTEST = 45.0
"""Largest angular radius of a lamp, degrees: beyond, it is a sky, which a panorama holds."""


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
    softness
        Angular radius of the lamp, a disk, in degrees, 0 to 45: 0 is a point, the sun has 0.27.

    Raises
    ------
    InputError
        If a number is not finite, a colour is below 0 or the softness is out of range.
    """

    azimuth: float
    elevation: float
    color: tuple[float, float, float] = (1.0, 1.0, 1.0)
    softness: float = 0.0

    def __post_init__(self) -> None:
        for name in ("azimuth", "elevation"):
            object.__setattr__(self, name, _degrees(name, getattr(self, name)))
        object.__setattr__(self, "color", _three_numbers("color", self.color, *OF_COLOR))
        softness = finite("softness", self.softness, f"0 to {SOFTEST:g} degrees", 0.0, SOFTEST)
        object.__setattr__(self, "softness", softness)

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
        return replace(self, azimuth=self.azimuth + _degrees("degrees", degrees))


@dataclass(frozen=True)
class PointLight:
    """A lamp near the surface, for results with depth.

    Attributes
    ----------
    position
        (x, y, z) in camera space, in the unit of the depth: the camera is at 0, and what it sees
        has z below 0.
    color
        Radiance of a white diffuse surface that faces the lamp at the distance 1, linear Rec.709,
        0 or more.
    radius
        Of the lamp, a sphere, in the unit of the depth: the larger, the softer. 0 = a point.

    Raises
    ------
    InputError
        If a number is not finite, or a colour or the radius is below 0.
    """

    position: tuple[float, float, float]
    color: tuple[float, float, float] = (1.0, 1.0, 1.0)
    radius: float = 0.0

    def __post_init__(self) -> None:
        position = _three_numbers("position", self.position, "three finite numbers")
        object.__setattr__(self, "position", position)
        object.__setattr__(self, "color", _three_numbers("color", self.color, *OF_COLOR))
        radius = finite("radius", self.radius, "a finite number, 0 or more", 0.0)
        object.__setattr__(self, "radius", radius)

    @property
    def lamps(self) -> Lamps:
        """The lamp as that of one picture."""
        place, color = np.array([self.position]), np.array([self.color])
        return Lamps(np.zeros(1, np.intp), place, np.ones(1, bool), color)


Light = NDArray[np.float64] | DirectionalLight | PointLight | Environment | Lamps | LampLight
"""SH light (16, 3) or (N, 16, 3), lamps far or near, a panorama, or lamps of a picture with or
without SH light beside them."""

L = TypeVar("L", bound=Light)
R = TypeVar("R", bound="ResultData")

GLOSS_ROUGHNESS, GLOSS_METALLIC = 0.3, 0.5
"""Of surfaces whose highlights are to be seen: as sharp as a tool mark is wide, half of the light
without them."""


def relight(
    result: ResultData,
    light: ArrayLike | Light | str | Path | None = None,
    threads: int = 0,
    *,
    picture: int | str | None = None,
    shadows: bool = True,
) -> NDArray[np.float64]:
    """Radiance of the recovered surfaces under other light.

    SH light goes through the model that the materials were fitted with (docs/model.md), and gives
    with the result's own lights the reconstructions of its pictures. All others go through the
    model's full reflection, because their highlights are beyond what SH light holds: a
    `DirectionalLight`, a `PointLight`, an `Environment`, `Lamps`. Where the fit decided for
    surroundings (`Result.transport`), they block light; and SH light and panoramas are reflected
    between surfaces if the pictures told that. What surfaces reflect of lamps is left out.
    Elsewhere nothing casts a shadow.

    Parameters
    ----------
    result
        What `decompose` found.
    light
        SH light (16, 3), or (N, 16, 3) for N pictures, linear Rec.709; or a `DirectionalLight`,
        `PointLight` or `Environment`, or the file of a panorama (.hdr, .exr); or `Lamps` of one
        picture, alone or in a tuple with ambient SH light (16, 3), such as `result.lights[i]`.
    threads
        0 = one for each processor; the result does not depend on it.
    picture
        In place of `light`, that of a picture of the result, by its index or name: gives its
        reconstruction.
    shadows
        Whether surroundings do to light what the fit decided; without any it makes no difference.

    Returns
    -------
    (H, W, 3) or (N, H, W, 3) float64, linear Rec.709; NaN outside the mask.

    Raises
    ------
    InputError
        If the light has another shape or numbers that are not finite, a lamp is near and the result
        has no depth, or there is no such picture.
    OSError
        If the file of a panorama cannot be read.
    """
    asked: Any = _asked(result, light, picture)
    scenery = result.scenery if shadows else None
    if isinstance(asked, DirectionalLight):
        rendered = render_directional(
            *(result.materials, result.normals, asked.direction, asked.color, result.fov, threads),
            model=result.model,
            extents=math.radians(asked.softness),
        )
        if scenery is not None:
            rendered[result.mask] *= scenery.open_to(asked.direction)[:, None]
        return rendered
    if isinstance(asked, Environment):
        return _under_panorama(result, asked, threads, shadows=scenery is not None)
    if isinstance(asked, PointLight):
        return _under_lamps(result, asked.lamps, None, threads, scenery, asked.radius)
    if isinstance(asked, Lamps):
        return _under_lamps(result, asked, None, threads, scenery)
    if isinstance(asked, tuple) and len(asked) == 2 and isinstance(asked[0], Lamps):
        return _under_lamps(result, asked[0], asked[1], threads, scenery)
    if scenery is not None:
        return _among_surroundings(result, asked)
    return render(result.materials, result.normals, asked, result.fov, threads, model=result.model)


def specular_enhanced(result: R) -> R:
    """A result with glossy surfaces of its own colours, for `relight`.

    Highlights tell shape that paint hides (T. Malzbender, D. Gelb and H. Wolters, "Polynomial
    texture maps", SIGGRAPH 2001). Nothing else of the result changes.
    """
    inside = np.where(result.mask, 1.0, np.nan)
    glossy = Materials(result.albedo, GLOSS_ROUGHNESS * inside, GLOSS_METALLIC * inside)
    return replace(result, materials=glossy)


def _asked(
    result: ResultData, light: ArrayLike | Light | str | Path | None, picture: int | str | None
) -> Any:
    """The light that is given, in a file or as a picture's."""
    if picture is None:
        if light is None:
            raise InputError("light: expected a light, or picture=, found neither")
        return Environment.read(light) if isinstance(light, (str, Path)) else light
    if light is not None:
        raise InputError("light: expected a light, or picture=, found both")
    names = result.pictures
    if picture in names:
        picture = names.index(str(picture))
    if not isinstance(picture, int) or not -len(names) <= picture < len(names):
        expected = f"an index below {len(names)} or one of {listed(names)}"
        raise InputError(f"picture: expected {expected}, found {quoted(picture)}")
    return result.lights[picture]


def _under_lamps(
    result: ResultData,
    lamps: Lamps,
    ambient: ArrayLike | None,
    threads: int,
    scenery: Scenery | None,
    radius: float = 0.0,
) -> NDArray[np.float64]:
    """A picture under lamps and SH light."""
    lamps.check_pictures(1)
    sky = np.zeros((16, 3)) if ambient is None else checked_lighting(ambient)
    if sky.ndim != 2 or not np.isfinite(sky).all():
        raise InputError(f"ambient: expected finite (16, 3), found {of_what(sky)}")
    visibility = None
    if scenery is not None:
        visibility = np.ones((len(lamps), *result.mask.shape))
        for k, (place, near) in enumerate(zip(lamps.places, lamps.near, strict=True)):
            visibility[k, result.mask] = scenery.open_to(place, near=bool(near))
    [picture] = render_lamps(
        result.materials,
        result.normals,
        lamps,
        (sky if scenery is None else np.zeros((16, 3)))[None],
        result.fov,
        result.depth,
        threads,
        model=result.model,
        visibility=visibility,
        radius=radius,
    )
    if scenery is not None and sky.any():
        picture += _among_surroundings(result, sky)
    return np.asarray(picture)


def _under_panorama(
    result: ResultData, light: Environment, threads: int, *, shadows: bool
) -> NDArray[np.float64]:
    """A picture under a panorama; surroundings dim it as they dim matt surfaces.

    The share of the light that reaches a white matt surface, under the panorama as harmonics, is
    taken for all of the reflection: surroundings are known as harmonics, which hold no sharper
    shadow.
    """
    given = (result.materials, result.normals)
    picture = render_environment(*given, light, result.fov, threads, model=result.model)
    if not shadows:
        return picture
    assert result.open_share is not None
    harmonics = light.harmonics
    reached = np.einsum("kc,khw->hwc", harmonics, result.open_share)
    whole = render(result.white, result.normals, harmonics, result.fov, threads, model="principled")
    picture *= np.clip(reached / np.maximum(whole, np.finfo(np.float64).tiny), 0.0, 1.0)
    if result.reflected_pictures is not None:
        brought = np.einsum("kc,khwc->hwc", harmonics, result.reflected_pictures)
        picture += np.maximum(brought, 0.0)
    return picture


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


def turned(light: L, degrees: float) -> L:
    """Light as `relight` takes it, turned about +Y from +Z towards +X.

    Raises InputError if lamps are near: that would move them, and nobody knows about which point.
    """
    found: Any = light.lamps if isinstance(light, PointLight) else light
    if isinstance(found, (DirectionalLight, Environment)):
        found = found.turned(degrees)
    elif isinstance(found, tuple):
        found = turned(found[0], degrees), lighting.rotated(found[1], degrees)
    elif isinstance(found, Lamps):
        if found.near.any():
            raise InputError("lamps: expected far ones to be turned, found near ones")
        angle = math.radians(math.remainder(_degrees("degrees", degrees), 360))
        x, y, z = found.places.T
        cosine, sine = math.cos(angle), math.sin(angle)
        places = np.stack([cosine * x + sine * z, y, cosine * z - sine * x], axis=-1)
        found = replace(found, places=places)
    else:
        found = lighting.rotated(found, degrees)
    return cast("L", found)


def _three_numbers(
    name: str, given: Any, expected: str, least: float = -math.inf
) -> tuple[float, float, float]:
    """Finite ones, `least` or more; InputError otherwise."""
    with suppress(TypeError, InputError):
        numbers = tuple(finite(name, number, expected, least) for number in given)
        if len(numbers) == 3:
            return numbers
    raise InputError(f"{name}: expected {expected}, found {of_what(given)}")


def _degrees(name: str, value: float) -> float:
    return finite(name, value, "a finite number of degrees")
