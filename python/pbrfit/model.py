"""The forward model on arrays: checked wrappers around the Rust core.

Camera space throughout: X right, Y up, Z towards the viewer. Radiance is linear Rec.709. Source of
the formulas: the paper's equations 1-12; `rust/shade.rs` derives them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pbrfit import _core
from pbrfit._core import InputError
from pbrfit.geometry import view_directions


@dataclass(frozen=True)
class Materials:
    """Material maps of one view; pixels outside the mask are NaN in all three.

    Attributes
    ----------
    albedo
        (H, W, 3), base colour, linear Rec.709, in [0, 1]; of a metal it is F0.
    roughness
        (H, W), perceptual roughness r in [0, 1]; the GGX width is alpha = r².
    metallic
        (H, W), in [0, 1].
    """

    albedo: NDArray[np.floating[Any]]
    roughness: NDArray[np.floating[Any]]
    metallic: NDArray[np.floating[Any]]


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
        If the last axis is not 3 long or a vector's length differs from 1 by more than 1e-3.
    """
    d = _array("directions", directions, (3,))
    return _core.sh_basis(d.reshape(-1, 3)).reshape(*d.shape[:-1], 16)


def ggx_band_weights(roughness: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Zonal weights of the GGX distribution (eqs. 8-11) and their derivative by roughness.

    Parameters
    ----------
    roughness
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
    r = _array("roughness", roughness, ())
    h, slope = _core.ggx_band_weights(r.reshape(-1))
    return h.reshape(*r.shape, 4), slope.reshape(*r.shape, 4)


def shade(
    normal: ArrayLike,
    view: ArrayLike,
    albedo: ArrayLike,
    roughness: ArrayLike,
    metallic: ArrayLike,
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

    Returns
    -------
    (..., 3, 16) float64: radiance of channel c is the sum over k of weights[c, k] lighting[k, c].

    Raises
    ------
    InputError
        If shapes do not fit together, a vector is not of unit length or a value is out of range.
    """
    shape, pixels = _pixels(normal, view, albedo, roughness, metallic)
    return _core.shade(*pixels).reshape(*shape, 3, 16)


def shade_vjp(
    normal: ArrayLike,
    view: ArrayLike,
    albedo: ArrayLike,
    roughness: ArrayLike,
    metallic: ArrayLike,
    cotangent: ArrayLike,
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Adjoint of `shade`: derivatives of a scalar by the material from those by the weights.

    Parameters
    ----------
    normal, view, albedo, roughness, metallic
        As for `shade`.
    cotangent
        (..., 3, 16), derivatives of the scalar by the weights.

    Returns
    -------
    d_albedo, d_roughness, d_metallic
        (..., 3), (...,) and (...,) float64, one entry for each pixel after broadcasting.

    Raises
    ------
    InputError
        As `shade`.
    """
    g = _array("cotangent", cotangent, (3, 16))
    shape, pixels = _pixels(normal, view, albedo, roughness, metallic, leading=g.shape[:-2])
    g = np.broadcast_to(g, (*shape, 3, 16)).reshape(-1, 3, 16)
    d_albedo, d_roughness, d_metallic = _core.shade_vjp(*pixels, g)
    return d_albedo.reshape(*shape, 3), d_roughness.reshape(shape), d_metallic.reshape(shape)


def render(
    materials: Materials, normals: ArrayLike, lighting: ArrayLike, fov: float, threads: int = 0
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

    Returns
    -------
    (H, W, 3) or (N, H, W, 3) float64, linear Rec.709.

    Raises
    ------
    InputError
        If shapes do not fit together or a value is out of range.
    """
    albedo = _array("albedo", materials.albedo, (3,))
    if albedo.ndim != 3:
        raise InputError(f"albedo: expected shape (H, W, 3), found {albedo.shape}")
    height, width = albedo.shape[:2]
    roughness = _array("roughness", materials.roughness, (height, width))
    metallic = _array("metallic", materials.metallic, (height, width))
    n = _array("normals", normals, (height, width, 3))
    light = _array("lighting", lighting, (16, 3))
    if light.ndim > 3:
        raise InputError(f"lighting: expected shape (16, 3) or (N, 16, 3), found {light.shape}")
    used = np.isfinite(albedo).all(-1) & np.isfinite(roughness + metallic) & np.isfinite(n).all(-1)
    rendered = _core.render(
        n[used],
        view_directions(height, width, fov)[used],
        albedo[used],
        roughness[used],
        metallic[used],
        light.reshape(-1, 16, 3),
        threads,
    )
    images = np.full((len(rendered), height, width, 3), np.nan)
    images[:, used] = rendered
    return images[0] if light.ndim == 2 else images


def _array(name: str, values: ArrayLike, trailing: tuple[int, ...]) -> NDArray[np.float64]:
    """As a float64 array whose last dimensions are `trailing`, or InputError naming it."""
    try:
        array = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InputError(f"{name}: expected an array of numbers, found {error}") from None
    if array.shape[max(array.ndim - len(trailing), 0) :] != trailing:
        wanted = ", ".join(["...", *map(str, trailing)])
        raise InputError(f"{name}: expected shape ({wanted}), found {array.shape}")
    return array


def _pixels(
    normal: ArrayLike,
    view: ArrayLike,
    albedo: ArrayLike,
    roughness: ArrayLike,
    metallic: ArrayLike,
    leading: tuple[int, ...] = (),
) -> tuple[tuple[int, ...], tuple[NDArray[np.float64], ...]]:
    """Broadcast the leading dimensions against each other; (that shape, flattened arrays)."""
    trailing = {"normal": (3,), "view": (3,), "albedo": (3,), "roughness": (), "metallic": ()}
    values = (normal, view, albedo, roughness, metallic)
    arrays = [
        _array(name, value, end)
        for (name, end), value in zip(trailing.items(), values, strict=True)
    ]
    own = [a.shape[: a.ndim - len(end)] for a, end in zip(arrays, trailing.values(), strict=True)]
    try:
        shape = np.broadcast_shapes(leading, *own)
    except ValueError:
        found = ", ".join(
            f"{name} {a.shape}" for name, a in zip(trailing, arrays, strict=True)
        )
        raise InputError(
            f"pixels: expected leading dimensions that broadcast, found {found}"
        ) from None
    flat = tuple(
        np.broadcast_to(a, shape + end).reshape(-1, *end)
        for a, end in zip(arrays, trailing.values(), strict=True)
    )
    return shape, flat
