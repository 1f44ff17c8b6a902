"""`shade`, its adjoint and the forward model on arrays, against the slow reference."""

from __future__ import annotations

import math
from functools import partial
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import pbrfit
import reference
from finite_differences import ridders
from pbrfit.model.reflection import MODELS, Model
from reference import seen_at, unit

# Whatever the default is.
render = partial(pbrfit.kernel.render, model="paper")
shade = partial(pbrfit.kernel.shade, model="paper")
shade_vjp = partial(pbrfit.kernel.shade_vjp, model="paper")

Array = NDArray[np.floating[Any]]


def random_pixels(count: int, seed: int) -> dict[str, Any]:
    """Pixels of every kind, one in five seen from behind."""
    rng = np.random.default_rng(seed)
    normal, view = unit(rng.normal(size=(2, count, 3)))
    facing = np.where(np.arange(count) % 5 == 0, -1, 1)[:, None]
    view *= facing * np.sign(np.sum(normal * view, axis=-1, keepdims=True))
    return {
        "normal": normal,
        "view": view,
        "albedo": rng.random((count, 3)),
        "roughness": rng.random(count),
        "metallic": rng.random(count),
    }


def assert_close(found: Array, expected: Array, bar: float, what: str) -> None:
    """|found − expected| <= bar · max(1, |expected|) everywhere; says by how much it missed."""
    missed = np.abs(found - expected) / np.maximum(1, np.abs(expected))
    worst = np.unravel_index(np.argmax(missed), missed.shape)
    assert missed.max() <= bar, (
        f"{what} misses by {missed.max():.3g} (bar {bar:.0e}) at {tuple(map(int, worst))}: "
        f"{found[worst]} instead of {expected[worst]}"
    )


def test_shade() -> None:
    pixels = random_pixels(3000, 1)
    assert_close(shade(**pixels), reference.shade(**pixels), 1e-13, "shade")


def test_shade_vjp() -> None:
    pixels = random_pixels(3000, 2)
    cotangent = np.random.default_rng(3).normal(size=(3000, 3, 16))
    d_albedo, d_roughness, d_metallic = reference.shade_derivatives(**pixels)
    expected = (
        np.sum(cotangent * d_albedo, axis=-1),
        np.sum(cotangent * d_roughness, axis=(-1, -2)),
        np.sum(cotangent * d_metallic, axis=(-1, -2)),
    )
    *found, d_normal = shade_vjp(**pixels, cotangent=cotangent)
    for a, b, what in zip(found, expected, ("albedo", "roughness", "metallic"), strict=True):
        assert_close(a, b, 1e-12, f"derivative by {what}")
    # By the normal: the change while it turns, in any direction of its tangent plane.
    assert_close(np.sum(d_normal * pixels["normal"], axis=-1), np.zeros(3000), 1e-13, "along n")
    turn = unit(np.cross(pixels["normal"], np.random.default_rng(4).normal(size=(3000, 3))))
    changed = np.sum(cotangent * reference.by_turning(**pixels, direction=turn), axis=(-1, -2))
    scale = np.maximum(1, np.linalg.norm(d_normal, axis=-1))
    assert_close(
        np.sum(d_normal * turn, axis=-1) / scale, changed / scale, 1e-12, "derivative by normal"
    )


NEXT_TO = [math.nextafter(0.4, 0), 0.4, math.nextafter(0.4, 1)]
# The paper's switch: 1 − r⁴ = 10⁻³.
PAPER_SWITCH = (1 - 1e-3) ** 0.25

PLACES = [
    # roughness, metallic, albedo, n·v
    *((r, 0.4, 0.6, 0.7) for r in (0.0, 1e-8, 1e-3, *NEXT_TO, PAPER_SWITCH, 1 - 1e-9, 1.0)),
    *((0.45, m, rho, 0.6) for m in (0.0, 1.0) for rho in (0.0, 1.0)),
    *((r, 0.3, 0.5, c) for r in (0.12, 0.5, 1.0) for c in (1.0, 0.01)),
    # At the clamp of n·v, beside it, beyond it.
    *((0.5, 0.3, 0.5, c) for c in (1.0001e-4, 1e-4, 0.9999e-4, 0.0, -0.5, -1.0)),
    (0.12, 1.0, 1.0, 1e-4),
    (0.0, 1.0, 1.0, 1.0),
    (1.0, 0.0, 0.0, 1e-4),
    # Where the principled model's table has its finest cells.
    *((r, m, 0.5, c) for r in (0.0, 0.03) for m in (0.0, 1.0) for c in (0.02, 0.3, 1.0)),
]


def material_of(roughness: float, metallic: float, albedo: float) -> dict[str, Array]:
    return {
        "albedo": np.full(3, albedo),
        "roughness": np.array(roughness),
        "metallic": np.array(metallic),
    }


def adjoint(
    normal: Array, view: Array, material: dict[str, Array], model: Model
) -> tuple[NDArray[np.float64], ...]:
    """Derivatives of every weight by albedo, roughness, metallic and normal, (3, 16, ...) each."""
    unit_cotangents = np.eye(48).reshape(3, 16, 3, 16)
    return pbrfit.kernel.shade_vjp(normal, view, **material, cotangent=unit_cotangents, model=model)


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("name", ["albedo", "roughness", "metallic"])
@pytest.mark.parametrize(("roughness", "metallic", "albedo", "cosine"), PLACES)
def test_adjoint_against_finite_differences(
    name: str, roughness: float, metallic: float, albedo: float, cosine: float, model: Model
) -> None:
    normal, view = seen_at(cosine)
    material = material_of(roughness, metallic, albedo)

    def weights(change: float) -> Array:
        moved = material | {name: material[name] + change}
        return pbrfit.kernel.shade(normal, view, **moved, model=model)

    # Values are good to 4e-15 or so and the last steps are 1e-5: noise of 1e-10 at the very most.
    step = 2e-3 if model == "paper" else 2e-4
    value = float(np.max(material[name]))
    if step <= value <= 1 - step:
        numerical, error = ridders(weights, step)
    else:
        numerical, error = ridders(weights, step if value < 0.5 else -step, one_sided=True)
    by = adjoint(normal, view, material, model)[("albedo", "roughness", "metallic").index(name)]
    found = by.sum(axis=-1) if name == "albedo" else by
    bar = 1e-10 if model == "paper" else 1e-6 + 20 * float(error.max())
    assert_close(found, numerical, bar, f"d weights/d {name}")


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize(("roughness", "metallic", "albedo", "cosine"), PLACES)
def test_adjoint_by_the_normal_against_finite_differences(
    axis: int, roughness: float, metallic: float, albedo: float, cosine: float, model: Model
) -> None:
    """On both sides of the clamp of n·v and beyond it; at it, from the side that is clamped."""
    normal, view = seen_at(cosine)
    material = material_of(roughness, metallic, albedo)

    def weights(change: float) -> Array:
        turned = unit(normal + change * np.eye(3)[axis])  # in the tangent plane of a normal along z
        return pbrfit.kernel.shade(turned, view, **material, model=model)

    # Steps that stay on one side of the clamp: n·v changes by at most as much as the normal.
    room = abs(cosine - 1e-4)
    if room > 0:
        numerical, _ = ridders(weights, min(2e-3, room / 2))
    else:  # n·v falls where the normal turns away from the view
        numerical, _ = ridders(weights, -1e-4 if axis == 0 else 1e-4, one_sided=True)
    d_normal = adjoint(normal, view, material, model)[3]
    assert np.abs(d_normal[..., 2]).max() < 1e-12
    scale = max(1.0, float(np.abs(numerical).max()))
    assert_close(d_normal[..., axis] / scale, numerical / scale, 1e-6, "d weights/d normal")


@pytest.mark.parametrize(
    ("normal", "view", "albedo", "roughness", "metallic", "shape"),
    [
        ((), (), (), (), (), ()),
        ((4, 5), (4, 5), (4, 5), (4, 5), (4, 5), (4, 5)),
        ((4, 5), (), (), (), (), (4, 5)),
        ((), (4, 1), (5,), (1, 5), (), (4, 5)),
        ((2, 1, 1), (3, 1), (4,), (), (2, 3, 4), (2, 3, 4)),
    ],
)
def test_leading_dimensions_broadcast(
    normal: tuple[int, ...],
    view: tuple[int, ...],
    albedo: tuple[int, ...],
    roughness: tuple[int, ...],
    metallic: tuple[int, ...],
    shape: tuple[int, ...],
) -> None:
    rng = np.random.default_rng(6)
    pixels: dict[str, Any] = {
        "normal": unit(rng.normal(size=(*normal, 3))),
        "view": unit(rng.normal(size=(*view, 3))),
        "albedo": rng.random((*albedo, 3)),
        "roughness": np.asarray(rng.random(roughness)),
        "metallic": np.asarray(rng.random(metallic)),
    }
    full: dict[str, Any] = {
        name: np.broadcast_to(array, shape if name in ("roughness", "metallic") else (*shape, 3))
        for name, array in pixels.items()
    }
    weights = shade(**pixels)
    assert weights.shape == (*shape, 3, 16)
    assert weights.dtype == np.float64
    np.testing.assert_allclose(weights, reference.shade(**full), rtol=0, atol=1e-13)
    # The adjoint answers for every broadcast pixel, and its cotangent broadcasts too.
    cotangent = rng.normal(size=(3, 16))
    found = shade_vjp(**pixels, cotangent=cotangent)
    expected = shade_vjp(**full, cotangent=np.tile(cotangent, (*shape, 1, 1)))
    assert [d.shape for d in found] == [(*shape, 3), shape, shape, (*shape, 3)]
    for a, b in zip(found, expected, strict=True):
        np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize(("height", "width", "fov"), [(3, 5, 60.0), (4, 4, 90.0), (7, 2, 20.0)])
def test_view_directions_follow_the_pinhole(height: int, width: int, fov: float) -> None:
    view = pbrfit.kernel.view_directions(height, width, fov)
    # A pixel is a square of side 1 at distance (width/2)/tan(fov/2) from the pinhole. Its centre
    # lies right (+x) and up (+y) of the axis, its view vector points the other way, and to +z.
    distance = width / 2 / math.tan(math.radians(fov / 2))
    for row in range(height):
        for column in range(width):
            right = column + 0.5 - width / 2
            up = height / 2 - row - 0.5
            expected = unit(np.array([-right, -up, distance]))
            np.testing.assert_allclose(view[row, column], expected, rtol=0, atol=1e-15)


def test_view_directions_of_an_orthographic_camera() -> None:
    np.testing.assert_array_equal(
        pbrfit.kernel.view_directions(3, 4, 0.0), np.broadcast_to([0.0, 0, 1], (3, 4, 3))
    )


@pytest.mark.parametrize("fov", [0.0, 60.0])
def test_render(fov: float) -> None:
    rng = np.random.default_rng(8)
    height, width = 20, 30  # blocks of 128 pixels, and a part of one
    materials = pbrfit.Materials(
        rng.random((height, width, 3)), rng.random((height, width)), rng.random((height, width))
    )
    normals = unit(rng.normal(size=(height, width, 3)) + np.array([0, 0, 1]))
    lighting = rng.normal(size=(4, 16, 3))
    view = pbrfit.kernel.view_directions(height, width, fov)
    weights = reference.shade(
        normals, view, materials.albedo, materials.roughness, materials.metallic
    )
    expected = np.einsum("hwck,nkc->nhwc", weights, lighting)
    several = render(materials, normals, lighting, fov)
    assert several.shape == (4, height, width, 3)
    assert_close(several, expected, 1e-13, "render")
    np.testing.assert_array_equal(render(materials, normals, lighting, fov, threads=3), several)
    one = render(materials, normals, lighting[2], fov)
    assert one.shape == (height, width, 3)
    np.testing.assert_array_equal(one, several[2])


def test_render_leaves_pixels_outside_the_mask_nan() -> None:
    albedo, roughness, metallic = np.full((2, 3, 3), 0.5), np.full((2, 3), 0.5), np.zeros((2, 3))
    normals = np.broadcast_to([0.0, 0, 1], (2, 3, 3)).copy()
    albedo[0, 1] = roughness[0, 1] = metallic[0, 1] = np.nan
    normals[1, 2] = np.nan
    picture = render(pbrfit.Materials(albedo, roughness, metallic), normals, np.ones((16, 3)), 60.0)
    outside = np.zeros((2, 3), dtype=bool)
    outside[0, 1] = outside[1, 2] = True
    np.testing.assert_array_equal(np.isnan(picture).all(axis=-1), outside)
    np.testing.assert_array_equal(np.isnan(picture).any(axis=-1), outside)


@pytest.mark.parametrize(
    ("change", "name"),
    [
        ({"albedo": np.full((4, 3), 0.5)}, "albedo"),
        ({"albedo": np.full((4, 5, 3), 1.5)}, "albedo"),
        ({"roughness": np.full((4, 6), 0.5)}, "roughness"),
        ({"roughness": np.full((4, 5), -0.5)}, "roughness"),
        ({"metallic": np.full((5, 4), 0.5)}, "metallic"),
        ({"normals": np.zeros((4, 5, 3))}, "normals"),
        ({"normals": np.ones((4, 6, 3))}, "normals"),
        ({"lighting": np.ones((3, 16))}, "lighting"),
        ({"lighting": np.ones((2, 2, 16, 3))}, "lighting"),
        ({"fov": 200.0}, "fov"),
    ],
)
def test_render_refuses_and_names_the_array(change: dict[str, Any], name: str) -> None:
    good: dict[str, Any] = {
        "albedo": np.full((4, 5, 3), 0.5),
        "roughness": np.full((4, 5), 0.5),
        "metallic": np.full((4, 5), 0.5),
        "normals": np.tile([0.0, 0, 1], (4, 5, 1)),
        "lighting": np.ones((16, 3)),
        "fov": 60.0,
    }
    albedo, roughness, metallic, *rest = (good | change).values()
    with pytest.raises(pbrfit.InputError, match=name):
        render(pbrfit.Materials(albedo, roughness, metallic), *rest)
