"""The forward model on arrays: checked wrappers around the Rust core.

Camera space throughout: X right, Y up, Z towards the viewer. Radiance is linear Rec.709. There are
two reflection models, and docs/model.md has both with their sources.
"""

from __future__ import annotations

import operator
from dataclasses import dataclass, replace
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pbrfit import _core
from pbrfit._core import InputError
from pbrfit.model.geometry import positions, view_directions
from pbrfit.model.lamps import Lamps
from pbrfit.model.materials import Materials
from pbrfit.values.arrays import Array, Floats, Mask
from pbrfit.values.checks import of_what, real_array

Model = Literal["paper", "principled"]
"""How surfaces reflect light: "paper", its eqs. 1-12 with eq. 12 for the mirror-like part;
"principled", the microfacet BRDF that path tracers have, integrated over the light exactly."""

MODELS: tuple[Model, ...] = get_args(Model)

DEFAULT_MODEL: Model = "paper"
"""Where nobody says which, and nobody knows what the pictures were rendered with."""


def checked_model(name: Any) -> Model:
    """Return the name of a model as it is; InputError that says which there are otherwise."""
    if isinstance(name, str) and name in MODELS:
        return name
    raise InputError(f"model: expected {' or '.join(MODELS)}, found {of_what(name)}")


def chosen_model(asked: Model | None, of_pictures: Model | None) -> Model:
    """Return what is asked for, else what the pictures were rendered with, else the default.

    Raises InputError if it is the name of no model.
    """
    return checked_model(asked if asked is not None else of_pictures or DEFAULT_MODEL)


def sh_basis(directions: ArrayLike) -> NDArray[np.float64]:
    """Real spherical harmonics up to l = 3, without Condon-Shortley phase.

    Parameters
    ----------
    directions
        (..., 3) unit vectors.

    Returns
    -------
    (..., 16) float64; index k = l(l+1)+m, so that Y_1-1 ∝ y, Y_10 ∝ z, Y_11 ∝ x.

    Raises
    ------
    InputError
        If the last axis is not 3 long or a vector's length differs from 1 by more than 1e-5.
    """
    d = _array("directions", directions, (3,))
    return _core.sh_basis(d.reshape(-1, 3)).reshape(*d.shape[:-1], 16)


def ggx_band_weights(r: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Zonal weights of the GGX distribution (eqs. 8-11) and their derivative by roughness.

    Parameters
    ----------
    r
        (...,) perceptual roughness in [0, 1].

    Returns
    -------
    h, dh_dr
        Both (..., 4) float64, bands l = 0 to 3; errors at most 1e-14 and 5e-14.

    Raises
    ------
    InputError
        If a roughness lies outside [0, 1] or is NaN.
    """
    roughness = _array("r", r, ())
    h, slope = _core.ggx_band_weights(roughness.reshape(-1))
    return h.reshape(*roughness.shape, 4), slope.reshape(*roughness.shape, 4)


def shade(
    normal: ArrayLike,
    view: ArrayLike,
    albedo: ArrayLike,
    roughness: ArrayLike,
    metallic: ArrayLike,
    *,
    model: Model = DEFAULT_MODEL,
) -> NDArray[np.float64]:
    """Weights of the 16 SH light coefficients for one or many pixels, in double precision.

    Parameters
    ----------
    normal, view
        (..., 3) unit vectors; `view` points from the surface to the camera.
    albedo
        (..., 3) in [0, 1].
    roughness, metallic
        (...,) in [0, 1]. Leading dimensions broadcast.
    model
        "paper" or "principled": how surfaces reflect light.

    Returns
    -------
    (..., 3, 16) float64: radiance of channel c is the sum over k of weights[c, k] lighting[k, c].

    Raises
    ------
    InputError
        If shapes do not fit together, a vector is not of unit length or a value is out of range.
    """
    shape, (n, v, rho, r, m) = _pixels(
        normal=normal, view=view, albedo=albedo, roughness=roughness, metallic=metallic
    )
    return _core.shade(n, v, rho, r, m, checked_model(model)).reshape(*shape, 3, 16)


def shade_vjp(
    normal: ArrayLike,
    view: ArrayLike,
    albedo: ArrayLike,
    roughness: ArrayLike,
    metallic: ArrayLike,
    cotangent: ArrayLike,
    *,
    model: Model = DEFAULT_MODEL,
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Adjoint of `shade`: derivatives of a scalar by material and normal from those by the weights.

    Parameters
    ----------
    normal, view, albedo, roughness, metallic
        As for `shade`.
    cotangent
        (..., 3, 16), derivatives of the scalar by the weights.
    model
        As for `shade`.

    Returns
    -------
    d_albedo, d_roughness, d_metallic, d_normal
        (..., 3), (...,), (...,) and (..., 3) float64, one entry for each pixel after broadcasting.
        `d_normal` is orthogonal to the normal: its product with a small turn of the normal is how
        much the scalar changes. Where n·v ≤ 1e-4, Fresnel and masking stand still.

    Raises
    ------
    InputError
        As `shade`.
    """
    shape, (n, v, rho, r, m, g) = _pixels(
        normal=normal,
        view=view,
        albedo=albedo,
        roughness=roughness,
        metallic=metallic,
        cotangent=cotangent,
    )
    d_albedo, d_roughness, d_metallic, d_normal = _core.shade_vjp(
        *(n, v, rho, r, m, g), checked_model(model)
    )
    return (
        d_albedo.reshape(*shape, 3),
        d_roughness.reshape(shape),
        d_metallic.reshape(shape),
        d_normal.reshape(*shape, 3),
    )


def render(
    materials: Materials,
    normals: ArrayLike,
    lighting: ArrayLike,
    fov: float,
    threads: int = 0,
    *,
    model: Model = DEFAULT_MODEL,
) -> NDArray[np.float64]:
    """Radiance of a view under one or several SH lights.

    Parameters
    ----------
    materials
        Maps of (H, W) pixels. Pixels that are NaN in any map stay NaN.
    normals
        (H, W, 3) unit vectors in camera space; NaN outside the mask.
    lighting
        (16, 3) or (N, 16, 3), linear Rec.709.
    fov
        Horizontal field of view in degrees, 0 = orthographic.
    threads
        0 = one for each processor; the result does not depend on it.
    model
        "paper" or "principled": how surfaces reflect light.

    Returns
    -------
    (H, W, 3) or (N, H, W, 3) float64, linear Rec.709.

    Raises
    ------
    InputError
        If shapes do not fit together or a value is out of range.
    """
    model = checked_model(model)
    light = checked_lighting(lighting)
    view = View.of_maps(materials, normals, fov)
    images = view.pictures(
        _core.render(
            *view.pixels, light.reshape(-1, 16, 3), whole_number("threads", threads), model
        )
    )
    return images[0] if light.ndim == 2 else images


def checked_lighting(lighting: ArrayLike) -> Array:
    """SH lights (16, 3) or (N, 16, 3) in float64; InputError if they are something else."""
    light = _array("lighting", lighting, (16, 3))
    if light.ndim > 3:
        raise InputError(f"lighting: expected shape (16, 3) or (N, 16, 3), found {light.shape}")
    return light


def render_rows(
    materials: Materials,
    normals: Floats,
    lighting: Array,
    fov: float,
    rows: slice,
    threads: int,
    model: Model,
) -> Array:
    """Some rows of what `render` gives for lights (N, 16, 3): (N, rows, W, 3)."""
    part = materials.each(lambda plane: plane[rows])
    height, width = materials.roughness.shape
    views = view_directions(height, width, fov, rows)
    view = View.of_maps(part, normals[rows], fov, views)
    return view.pictures(_core.render(*view.pixels, lighting, threads, model))


def render_directional(
    materials: Materials,
    normals: ArrayLike,
    directions: ArrayLike,
    colors: ArrayLike,
    fov: float,
    threads: int = 0,
    *,
    model: Model = DEFAULT_MODEL,
    extents: ArrayLike | None = None,
) -> Array:
    """Radiance of a view under light from single directions, with the full reflection model.

    For "paper" its eqs. 1 and 3-5 without the approximations that SH light needs; for "principled"
    the BRDF whose integral over SH light `render` has. A light of colour 1 gives a white diffuse
    surface that faces it radiance 1, less what its Fresnel term takes from the diffuse part.
    Nothing casts a shadow. A mirror (roughness 0) does not show a light without extent.

    `directions` (3,) or (N, 3) are unit vectors from the surface to the lights, `colors` likewise,
    linear Rec.709; `extents` () or (N,) angular radii of disks, radians, up to π/4, which widen
    lobes; None = points. All else, and what is returned and raised, is as for `render`.
    """
    model = checked_model(model)
    to_lights = _array("directions", directions, (3,))
    if to_lights.ndim > 2:
        raise InputError(f"directions: expected shape (3,) or (N, 3), found {to_lights.shape}")
    of_lights = _array("colors", colors, to_lights.shape)
    if of_lights.ndim > to_lights.ndim:
        raise InputError(f"colors: expected shape {to_lights.shape}, found {of_lights.shape}")
    if not (np.abs(of_lights) <= 1e260).all():  # a surface reflects at most 10³⁵ times as much
        raise InputError("colors: expected finite numbers up to 1e260")
    view, threads = View.of_maps(materials, normals, fov), whole_number("threads", threads)
    lights, colors = to_lights.reshape(-1, 3), of_lights.reshape(-1, 3)
    radii = _array("extents", 0.0 if extents is None else extents, ())
    if radii.size not in (1, len(lights)):
        raise InputError(f"extents: expected shape ({len(lights)},), found {radii.shape}")
    each = zip(lights, colors, np.broadcast_to(radii, len(lights)), strict=True)
    images = view.pictures(np.array([view.lit(*one, threads, model) for one in each]))
    return images[0] if to_lights.ndim == 1 else images


def render_lamps(
    materials: Materials,
    normals: ArrayLike,
    lamps: Lamps,
    ambient: ArrayLike | None,
    fov: float,
    depth: ArrayLike | None = None,
    threads: int = 0,
    *,
    model: Model = DEFAULT_MODEL,
    visibility: ArrayLike | None = None,
    radius: float = 0.0,
) -> Array:
    """Radiance (N, H, W, 3) of a view under the lamps of each picture, and ambient light.

    Of a lamp, what reaches a pixel, times π f_r (n·l); of ambient light what `render` gives, as
    which all else is.

    `ambient` (N, 16, 3) is SH light of the pictures, linear Rec.709; None = nothing, and N is as
    many as lamps are of. `depth` (H, W) is as of `geometry.positions`, in the unit of near lamps;
    None = all lamps are far. Pixels without are NaN in pictures of near lamps. `visibility` (K, H,
    W), 0 to 1, is how much of each of the K lamps reaches each pixel; None = all. `radius` is that
    of near lamps, as spheres, in the unit of the depth; from nearer than √2 radii they are seen as
    from there.

    Raises InputError if shapes do not fit together, a value is out of range, a colour is unknown or
    lamps are near and there is no depth.
    """
    model, threads = checked_model(model), whole_number("threads", threads)
    if not lamps.colored:
        raise InputError("lamps: expected known colors, found NaN")
    view = View.of_maps(materials, normals, fov)
    count = int(lamps.pictures[-1]) + 1 if len(lamps) else 0
    if ambient is None:
        found = np.zeros((count, len(view.pixels[0]), 3))
    else:
        light = _array("ambient", ambient, (16, 3))
        if light.ndim != 3:
            raise InputError(f"ambient: expected shape (N, 16, 3), found {light.shape}")
        lamps.check_pictures(len(light))
        found = _core.render(*view.pixels, light, threads, model)
    shape = (view.height, view.width)
    reaching = None
    if visibility is not None:
        reaching = _array("visibility", visibility, shape)
        if reaching.shape != (len(lamps), *shape):
            raise InputError(
                f"visibility: expected shape {(len(lamps), *shape)}, found {reaching.shape}"
            )
        reaching = reaching.reshape(len(lamps), view.height * view.width)[:, view.of]
    points = None
    if lamps.near.any():
        if depth is None:
            raise InputError("lamps: expected depth for near lamps, found none")
        points = positions(_array("depth", depth, shape), fov).reshape(-1, 3)[view.of]
    for k, picture in enumerate(lamps.pictures.tolist()):
        radiance = view.under_lamp(lamps.only(k), points, threads, model, radius)
        if reaching is not None:
            radiance *= reaching[k][:, None]
        found[picture] += radiance
    return view.pictures(found)


@dataclass(frozen=True, eq=False)
class View:
    """The pixels of a view that are rendered, and their places in the picture."""

    height: int
    width: int
    pixels: tuple[Array, Array, Array, Array, Array]
    """Normals, views, albedo, roughness and metallic of these pixels, in rows."""
    of: slice | Mask
    """Which of the picture's pixels they are."""

    @classmethod
    def of_maps(
        cls, materials: Materials, normals: ArrayLike, fov: float, views: Array | None = None
    ) -> View:
        """Leave out the pixels that are NaN or infinite in any map.

        `views` (H, W, 3) are for a part of a larger picture; None = the maps are all of it.
        """
        albedo = _array("albedo", materials.albedo, (3,))
        if albedo.ndim != 3:
            raise InputError(f"albedo: expected shape (H, W, 3), found {albedo.shape}")
        height, width = albedo.shape[:2]
        roughness = _array("roughness", materials.roughness, (height, width))
        metallic = _array("metallic", materials.metallic, (height, width))
        n = _array("normals", normals, (height, width, 3))
        of: slice | Mask = slice(None)
        if not all(np.isfinite(given).all() for given in (albedo, roughness, metallic, n)):
            used = np.isfinite(albedo).all(-1) & np.isfinite(n).all(-1)
            of = (used & np.isfinite(roughness) & np.isfinite(metallic)).reshape(-1)
        if views is None:
            views = view_directions(height, width, fov)
        n, v, rho = (vectors.reshape(-1, 3)[of] for vectors in (n, views, albedo))
        r, m = (numbers.reshape(-1)[of] for numbers in (roughness, metallic))
        return cls(height, width, (n, v, rho, r, m), of)

    def under_lamp(
        self, lamp: Lamps, points: Array | None, threads: int, model: Model, radius: float = 0.0
    ) -> Array:
        """(P, 3) radiance of the pixels under one lamp; NaN where a near one needs their points."""
        if not lamp.near[0]:
            return self.lit(lamp.places[0], lamp.colors[0], 0.0, threads, model)
        assert points is not None
        known = np.isfinite(points).all(axis=-1)
        directions, strengths = lamp.at(points[known])
        found = np.full((len(points), 3), np.nan)
        n, v, rho, r, m = (np.ascontiguousarray(of[known]) for of in self.pixels)
        few = replace(self, pixels=(n, v, rho, r, m))
        distances = np.linalg.norm(lamp.places - points[known], axis=-1)
        extents = np.arcsin(np.minimum(radius / np.maximum(distances, 1e-300), np.sqrt(0.5)))
        found[known] = few.lit(directions[:, 0], strengths * lamp.colors, extents, threads, model)
        return found

    def lit(
        self, direction: Array, color: Array, extent: Array | float, threads: int, model: Model
    ) -> Array:
        """(P, 3) radiance under one light, the same for all pixels or for each its own."""
        toward = np.ascontiguousarray(np.broadcast_to(direction, self.pixels[0].shape)[:, None])
        extents = np.full(len(toward), extent) if np.any(extent) else None
        return _core.lamp_radiance(*self.pixels, toward, threads, model, extents)[:, 0] * color

    def pictures(self, rendered: Array) -> Array:
        """(N, H, W, 3) from (N, P, 3) radiance of the pixels; NaN elsewhere."""
        images = rendered = rendered.reshape(len(rendered), len(self.pixels[0]), 3)
        if not isinstance(self.of, slice):
            images = np.full((len(rendered), self.height * self.width, 3), np.nan)
            images[:, self.of] = rendered
        return images.reshape(-1, self.height, self.width, 3)


def whole_number(name: str, value: int) -> int:
    """Return value as an int, 0 or more; InputError that names it otherwise."""
    try:
        number = operator.index(value)
    except TypeError:
        number = -1
    if not 0 <= number < 2**31:
        raise InputError(f"{name}: expected a whole number, 0 or more, found {of_what(value)}")
    return number


_TRAILING: dict[str, tuple[int, ...]] = {
    "normal": (3,),
    "view": (3,),
    "albedo": (3,),
    "roughness": (),
    "metallic": (),
    "cotangent": (3, 16),
}
"""Last dimensions of each argument that is given per pixel."""


def _array(name: str, values: ArrayLike, trailing: tuple[int, ...]) -> Array:
    """As a float64 array whose last dimensions are `trailing`, or InputError naming it."""
    array = real_array(name, values)
    if array.shape[max(array.ndim - len(trailing), 0) :] != trailing:
        wanted = ", ".join(["...", *map(str, trailing)])
        raise InputError(f"{name}: expected shape ({wanted}), found {array.shape}")
    return array


def _pixels(**arguments: ArrayLike) -> tuple[tuple[int, ...], list[Array]]:
    """Broadcast the leading dimensions against each other: that shape, and the arrays flattened."""
    arrays = {name: _array(name, values, _TRAILING[name]) for name, values in arguments.items()}
    leading = [a.shape[: a.ndim - len(_TRAILING[name])] for name, a in arrays.items()]
    try:
        shape = np.broadcast_shapes(*leading)
    except ValueError:
        found = ", ".join(f"{name} {a.shape}" for name, a in arrays.items())
        raise InputError(
            f"pixels: expected leading dimensions that broadcast, found {found}"
        ) from None
    return shape, [
        np.broadcast_to(a, shape + _TRAILING[name]).reshape(-1, *_TRAILING[name])
        for name, a in arrays.items()
    ]
