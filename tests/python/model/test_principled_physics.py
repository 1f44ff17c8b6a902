"""The principled model against brute force, and facts about it, each under its own name."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

import principled_reference
from finite_differences import ridders
from pbrfit import _core
from pbrfit.model.reflection import sh_basis
from principled_reference import EVEN, ORDER, Lights
from reference import glass, unit

Array = NDArray[np.floating[Any]]
Doubles = NDArray[np.float64]
Pixels = tuple[Doubles, Doubles, Doubles, Doubles, Doubles]
"""Normals, views and albedo (P, 3), roughness and metallic (P,)."""

# The light whose radiance is 1 from everywhere: Y_00 = 1/(2√π).
CONSTANT_LIGHT = 2 * math.sqrt(math.pi)
COSINE_TRANSFER = np.array([math.pi, 2 * math.pi / 3, math.pi / 4, 0.0])
DEGREE = np.array([0, 1, 1, 1, 2, 2, 2, 2, 2, 3, 3, 3, 3, 3, 3, 3])


def pixels(*parts: Array | float) -> Pixels:
    """From arrays with leading dimensions that broadcast against each other."""
    arrays = [np.asarray(part, dtype=np.float64) for part in parts]
    trailing = [(3,), (3,), (3,), (), ()]
    count = np.broadcast_shapes(
        (1,), *(a.shape[: a.ndim - len(t)] for a, t in zip(arrays, trailing, strict=True))
    )
    normal, view, albedo, r, metallic = (
        np.broadcast_to(a, count + t).copy() for a, t in zip(arrays, trailing, strict=True)
    )
    return normal, view, albedo, r, metallic


def shade(*parts: Array | float) -> Doubles:
    """Weights (P, 3, 16)."""
    return _core.shade(*pixels(*parts), "principled").reshape(-1, 3, 16)


def random_pixels(count: int, seed: int) -> Pixels:
    """Frames with n·v > 0, and materials."""
    rng = np.random.default_rng(seed)
    normal, view = unit(rng.normal(size=(2, count, 3)))
    view *= np.sign(np.sum(normal * view, axis=-1, keepdims=True))
    return normal, view, rng.random((count, 3)), rng.random(count), rng.random(count)


def seen_at(cosine: float | Array, seed: int = 0) -> tuple[Array, Array]:
    """Normals in random directions, and views with these n·v."""
    cosine = np.atleast_1d(cosine)[:, None]
    normal, other = unit(np.random.default_rng(seed).normal(size=(2, len(cosine), 3)))
    aside = unit(np.cross(normal, other))
    return normal, unit(cosine * normal + np.sqrt(1 - cosine**2) * aside)


def lobes(r: Array, normal: Array, view: Array) -> tuple[Array, Array, Array, Array]:
    """The table's a_j and b_j with their sinᵐ, (P, 10) each, Ebar and kappa, (P,) each."""
    cosine = np.clip(np.sum(normal * view, axis=-1), 1e-4, 1)
    value, _, _ = _core.lobe_functions(r.astype(np.float64), cosine.astype(np.float64))
    sine = np.linalg.norm(np.cross(normal, view), axis=-1)[:, None] ** ORDER
    return value[:, :10] * sine, value[:, 10:20] * sine, value[:, 20], value[:, 21]


# --- Against brute force ---


@pytest.mark.parametrize("seed", range(4))
def test_weights_are_integrals_over_light_directions(seed: int) -> None:
    """Of the BRDF as it is written down, in world space, without the table or a local frame."""
    _, _, albedo, r, metallic = random_pixels(7, seed)
    r = 0.12 + 0.88 * r  # narrower lobes at grazing angles are too much for the reference
    grazing = 0.04 + 0.02 * seed
    normal, view = seen_at(np.array([grazing, 1, 0.1, 0.3, 0.5, 0.7, 0.9]), seed)
    view[1] = normal[1]
    albedo[2], metallic[2:4] = 1, (0, 1)
    found = shade(normal, view, albedo, r, metallic)
    for i in range(len(r)):
        expected = principled_reference.shade(normal[i], view[i], albedo[i], r[i], metallic[i])
        np.testing.assert_allclose(found[i], expected, rtol=0, atol=6e-6)


def test_weights_are_lobes_rotated_to_the_world() -> None:
    # The formulas on the table's own functions, so that narrow lobes are tested as sharply.
    normal, view, albedo, r, metallic = random_pixels(200, 11)
    r[:40] *= 0.05
    view[40:60] = normal[40:60]
    view[60:80] = unit(normal[60:80] + 1e-6 * view[60:80])
    a, b, mean, kappa = lobes(r, normal, view)
    e = CONSTANT_LIGHT * (a + b)[:, 0]
    m, rho = metallic[:, None], albedo

    def gain(f0: Array) -> Array:
        return np.asarray(
            principled_reference.multiple_scattering(f0, e[:, None], mean[:, None])  # type: ignore[arg-type]
        )

    ground = gain(np.full((1, 1), 0.04)) * kappa[:, None]
    e_d = CONSTANT_LIGHT * ground * (0.04 * a + b)[:, :1]
    dielectric, metal = (1 - m) * ground, m * gain(rho)
    kd = (1 - m) * rho * (1 - e_d) / math.pi
    by_row = (0.04 * dielectric + rho * metal)[..., None] * a[:, None]
    by_row = by_row + (dielectric + metal)[..., None] * b[:, None]
    found = shade(normal, view, albedo, r, metallic)
    for i in range(len(r)):
        rows = principled_reference.rotation_rows(normal[i], view[i])
        diffuse = kd[i][:, None] * COSINE_TRANSFER[DEGREE] * sh_basis(normal[i])
        np.testing.assert_allclose(found[i], diffuse + by_row[i] @ rows, rtol=0, atol=1e-12)


@pytest.mark.parametrize(
    ("r", "metallic", "cosine"), [(0.3, 0.0, 0.2), (0.5, 1.0, 0.9), (0.8, 0.4, 1.0)]
)
def test_light_from_all_directions_is_light_of_harmonics(
    r: float, metallic: float, cosine: float
) -> None:
    # ∫ f_r n·l Y_k dl with f_r as hard lights see it: there a dielectric has Fresnel's equations,
    # and here Schlick's fit times kappa, which is as much but elsewhere.
    normal, view = (a[0] for a in seen_at(cosine, 3))
    lights = Lights.about_mirror(normal, view, r)
    albedo = np.array([0.9, 0.4, 0.0])
    pixel = pixels(normal, view, albedo, r, metallic)
    count = len(lights.area)
    color = np.ones((count, 3))
    response = _core.render_directional(
        *pixel, unit(lights.directions), color, 1, "principled"
    ).reshape(count, 3)
    basis = sh_basis(unit(lights.directions))
    integral = (response * lights.area[:, None]).T @ basis / math.pi
    a, b, mean, kappa = lobes(*(part[:1] for part in (pixel[3], normal[None], view[None])))
    e = float(CONSTANT_LIGHT * (a + b)[0, 0])
    gain = principled_reference.multiple_scattering(np.array(0.04), e, float(mean[0]))
    values, v_h = principled_reference.lobe(normal, view, lights.directions, r)
    elsewhere = kappa[0] * principled_reference.schlick(0.04, v_h) - glass(v_h)
    moved = (1 - metallic) * gain * (values * lights.area * elsewhere) @ basis
    np.testing.assert_allclose(shade(*pixel)[0], integral + moved, rtol=0, atol=1e-5)
    assert abs(moved[0]) < 1e-5
    assert metallic == 1 or np.abs(moved).max() > 2e-5


# --- Reciprocity and energy ---


def test_specular_reflection_is_reciprocal() -> None:
    """With light and camera exchanged, f_r is the same, but for the gain, which knows n·v alone."""
    normal, view, albedo, r, _ = random_pixels(60, 5)
    light = unit(np.random.default_rng(6).normal(size=(60, 3)))
    light *= np.sign(np.sum(normal * light, axis=-1, keepdims=True))
    r = np.maximum(r, 0.05)

    def single(view: Doubles, light: Doubles) -> Array:
        pixel = pixels(normal, view, albedo, r, 1.0)
        seen = _core.render_directional(*pixel, light.copy(), np.ones((60, 3)), 1, "principled")
        a, b, mean, _ = lobes(r, normal, view)
        e = CONSTANT_LIGHT * (a + b)[:, 0]
        gains = [
            principled_reference.multiple_scattering(rho, e[i], mean[i])
            for i, rho in enumerate(albedo)
        ]
        n_l = np.sum(normal * light, axis=-1)[:, None]
        return np.asarray(np.einsum("ppc->pc", seen) / (math.pi * n_l * np.array(gains)))

    forth, back = single(view, light), single(light, view)
    np.testing.assert_allclose(forth, back, rtol=1e-9, atol=1e-15)
    assert forth.max() > 0.1


FURNACE_R = np.concatenate((np.linspace(0, 0.05, 26), np.linspace(0.05, 1, 40)))
FURNACE_COSINE = np.concatenate((np.geomspace(1e-4, 0.05, 30), np.linspace(0.05, 1, 40)))


def furnace(albedo: float, metallic: float) -> Array:
    """What comes back of light that is 1 from everywhere, at all roughness and angles (R, X)."""
    normal, view = seen_at(np.tile(FURNACE_COSINE, len(FURNACE_R)))
    r = np.repeat(FURNACE_R, len(FURNACE_COSINE))
    weights = shade(normal, view, np.full(3, albedo), r, metallic)
    return np.asarray(CONSTANT_LIGHT * weights[:, 0, 0].reshape(len(FURNACE_R), -1))


@pytest.mark.parametrize("metallic", [0.0, 0.3, 1.0])
def test_a_white_surface_reflects_all_light(metallic: float) -> None:
    # A metal by M, a dielectric because its ground gets what its lobe leaves.
    np.testing.assert_allclose(furnace(1.0, metallic), 1, rtol=0, atol=1e-12)


def test_metals_reflect_less_than_all_and_more_with_albedo() -> None:
    darker = furnace(0.0, 1.0)
    assert darker.min() >= -1e-6
    for albedo in (0.1, 0.5, 0.9, 1.0):
        lighter = furnace(albedo, 1.0)
        assert (lighter >= darker - 1e-12).all()
        assert (lighter <= 1 + 1e-6).all()
        darker = lighter


def test_dielectrics_reflect_less_than_all_and_more_with_albedo() -> None:
    black = furnace(0.0, 0.0)
    assert (black > 0.01).all()
    assert (black < 1).all()
    for albedo in (0.1, 0.5, 0.9):
        # What the lobe leaves, times the albedo.
        expected = black + albedo * (1 - black)
        np.testing.assert_allclose(furnace(albedo, 0.0), expected, rtol=0, atol=1e-12)


def test_a_perfect_mirror_shows_the_light() -> None:
    normal, view, *_ = random_pixels(200, 8)
    mirror = unit(2 * np.sum(normal * view, axis=-1, keepdims=True) * normal - view)
    expected = np.broadcast_to(sh_basis(mirror)[:, None], (200, 3, 16))
    np.testing.assert_allclose(
        shade(normal, view, np.ones(3), 0.0, 1.0), expected, rtol=0, atol=1e-5
    )


def test_weights_turn_with_the_scene() -> None:
    # Turn normal, view and light together: nothing changes.
    turn = Rotation.from_euler("zyx", [0.7, -1.1, 2.3]).as_matrix()
    lights = Lights.about_mirror(*principled_reference.at_cosine(1.0), 1.0, 40, 40)
    all_around = np.concatenate([lights.directions, -lights.directions])
    harmonics = sh_basis(unit(all_around))
    rotated, *_ = np.linalg.lstsq(harmonics, sh_basis(unit(all_around @ turn.T)), rcond=None)
    normal, view, *material = random_pixels(200, 9)
    view[:20] = normal[:20]
    before = shade(normal, view, *material)
    after = shade(unit(normal @ turn.T), unit(view @ turn.T), *material)
    np.testing.assert_allclose(after @ rotated.T, before, rtol=0, atol=1e-11)


def test_only_functions_even_across_the_plane_of_view_answer() -> None:
    # Light that is odd across the plane of normal and view gives nothing.
    normal, view = np.array([0.0, 0, 1]), np.array([-0.6, 0, 0.8])
    odd = np.setdiff1d(np.arange(16), EVEN)
    assert np.abs(shade(normal, view, np.full(3, 0.5), 0.3, 0.5)[0][:, odd]).max() < 1e-15


# --- Derivatives ---


def check_derivatives(pixel: Pixels, seed: int, tolerance: float) -> None:
    """shade_vjp against differences of shade, into the interval where a value is at its end."""
    rng = np.random.default_rng(seed)
    cotangent = rng.normal(size=(1, 3, 16))
    found = _core.shade_vjp(*pixel, cotangent, "principled")

    def along(which: int, direction: Array, at: float | None) -> None:
        inward, one_sided = (-1.0 if at == 1 else 1.0), at in (0.0, 1.0)

        def moved(step: float) -> float:
            changed = list(pixel)
            changed[which] = pixel[which] + inward * step * direction
            if which == 0:
                changed[0] = unit(changed[0])
            return float(np.sum(cotangent * shade(*changed)))

        slope, error = ridders(moved, 2e-4, one_sided=one_sided)
        gradient = found[3 if which == 0 else which - 2]
        expected = inward * float(slope)
        got = float(np.sum(gradient * direction))
        assert got == pytest.approx(expected, rel=tolerance, abs=tolerance + 20 * float(error)), (
            which,
            [part.tolist() for part in pixel],
        )

    normal, _, albedo, r, metallic = pixel
    for channel in range(3):
        along(2, np.eye(3)[channel], float(albedo[0, channel]))
    along(3, np.ones(1), float(r[0]))
    along(4, np.ones(1), float(metallic[0]))
    for _ in range(2):
        turn = rng.normal(size=3)
        along(0, unit(turn - (turn @ normal[0]) * normal[0]), None)
    assert abs(found[3][0] @ normal[0]) < 1e-12  # in the tangent plane


def test_derivatives_are_those_of_the_weights() -> None:
    parts = random_pixels(12, 21)
    for i in range(12):
        check_derivatives(pixels(*(part[i] for part in parts)), i, 1e-6)


@pytest.mark.parametrize("cosine", [0.02, 0.3, 1.0])
@pytest.mark.parametrize("r", [0.0, 0.03, 1.0])
@pytest.mark.parametrize("metallic", [0.0, 1.0])
def test_derivatives_hold_at_the_ends_of_every_input(
    cosine: float, r: float, metallic: float
) -> None:
    normal, view = seen_at(cosine, 4)
    if cosine == 1:
        view = normal
    pixel = pixels(normal, view, np.array([[0.0, 0.5, 1.0]]), r, metallic)
    check_derivatives(pixel, 5, 1e-5)


@pytest.mark.parametrize("cosine", [1e-4, 5e-5, 0.0, -0.4])
def test_beyond_the_least_cosine_lobes_stand_still_and_all_is_finite(cosine: float) -> None:
    for r in (0.0, 0.01, 0.5, 1.0):
        pixel = pixels(*seen_at(cosine, 5), np.full((1, 3), 0.5), r, 0.5)
        weights = shade(*pixel)
        assert np.isfinite(weights).all()
        assert CONSTANT_LIGHT * np.abs(weights[0, :, 0]).max() <= 1 + 1e-6
        if cosine < 1e-4:  # there on either side, lobes are the same
            check_derivatives(pixel, 6, 1e-6)
