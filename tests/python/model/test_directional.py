"""Light from single directions: the full reflection model against slow references and physics."""

from __future__ import annotations

import itertools
import math
from functools import cache

import numpy as np
import pytest

import reference
from pbrfit import InputError, Materials, _core
from pbrfit.model.reflection import MODELS, Model, render_directional, sh_basis
from pbrfit.values.arrays import Array
from pbrfit_evaluation.gap.brute_force import respond
from pbrfit_evaluation.gap.brute_force import view as seen_at
from reference import frames, unit

UP = np.array([0.0, 0.0, 1.0])
WHITE = np.ones(3)


def reflected(
    normal: Array,
    view: Array,
    albedo: Array,
    roughness: float | Array,
    metallic: float | Array,
    light: Array,
    model: str = "paper",
) -> Array:
    """Of each pixel under its own light of colour 1; all (P, 3) or (P,), or one for all."""
    count = max(np.atleast_2d(a).shape[0] for a in (normal, view, albedo, light))
    count = max(count, np.size(roughness), np.size(metallic))
    n, v, rho, l = (  # noqa: E741
        np.broadcast_to(a, (count, 3)).copy() for a in (normal, view, albedo, light)
    )
    r, m = (np.broadcast_to(a, count).astype(np.float64) for a in (roughness, metallic))
    return np.asarray(_core.lamp_radiance(n, v, rho, r, m, l[:, None], 1, model)[:, 0])


@cache
def lights_over(polar: int = 120, around: int = 120) -> tuple[Array, Array]:
    """A rule over the half sphere about +Z, for views in the xz-plane; directions, solid angles.

    It is dense at the horizon, where masking falls to 0, and about −X, where mirror directions are:
    seen at a grazing angle a lobe is a hundred times as long as wide.
    """
    nodes, weights = np.polynomial.legendre.leggauss(polar)
    n_l = ((1 + nodes) / 2) ** 3
    of_n_l = weights / 2 * 3 * ((1 + nodes) / 2) ** 2
    nodes, weights = np.polynomial.legendre.leggauss(around)
    azimuth = np.pi * (1 + nodes**3)
    of_azimuth = weights * np.pi * 3 * nodes**2
    sine = np.sqrt(1 - n_l**2)[:, None]
    up = np.broadcast_to(n_l[:, None], (polar, around))
    directions = np.stack([sine * np.cos(azimuth), sine * np.sin(azimuth), up], axis=-1)
    return unit(directions.reshape(-1, 3)), np.outer(of_n_l, of_azimuth).reshape(-1)


def test_agrees_with_the_equations_as_printed() -> None:
    normal, view, light = frames(400, 0, 3)
    view[::10] *= -1  # seen from behind, and
    light[::7] *= -1  # lit from behind
    rng = np.random.default_rng(1)
    albedo, metallic = rng.random((400, 3)), rng.random(400)
    roughness = rng.uniform(0.1, 1, 400)
    found = reflected(normal, view, albedo, roughness, metallic, light)
    expected = reference.directional(normal, view, albedo, roughness, metallic, light)
    np.testing.assert_allclose(found, expected, rtol=1e-10, atol=1e-13)
    assert (found[::7] == 0).all()


def reflected_of_uniform(r: float | Array, cosine: float | Array) -> Array:
    """E of the principled model as the core has it: a white metal's lobe is divided by it."""
    r, cosine = np.broadcast_arrays(np.atleast_1d(r), cosine)
    values = _core.lobe_functions(r.astype(float), cosine.astype(float))[0]
    return np.asarray(2 * math.sqrt(math.pi) * (values[:, 0] + values[:, 10]))


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("r", [0.3, 0.1, 1e-2, 1e-3, 1e-4, 1e-6])
def test_narrow_lobes_keep_their_digits(r: float, model: Model) -> None:
    # Seen straight on, D cosθ dh is uniform in u = tan²θ/(α² + tan²θ), and with x = tanθ
    # D = α² (1 + x²)² / (π (α² + x²)²) has nothing to cancel. A white metal has F = 1.
    alpha = r * r
    x = np.array([0.0, 1e-3, 0.1, 0.5, 1, 3, 100]) * alpha
    theta = np.arctan(x)
    light = np.stack([np.sin(2 * theta), 0 * theta, np.cos(2 * theta)], axis=-1)
    lit = light[:, 2] > 0
    d = alpha**2 * (1 + x**2) ** 2 / (np.pi * (alpha**2 + x**2) ** 2)
    if model == "paper":
        masked = reference.smith_g1(light[:, 2], np.array(r)).real
    else:  # 1 at the view, and at the light
        masked = 2 / (1 + np.sqrt(1 + alpha**2 * np.tan(2 * theta) ** 2))
        masked /= reflected_of_uniform(r, 1.0)
    found = reflected(UP, UP, WHITE, r, 1.0, light, model)[:, 0]
    rtol = 1e-5 if r < 1e-5 else 1e-12
    np.testing.assert_allclose(found[lit], (np.pi * d * masked / 4)[lit], rtol=rtol)


def test_reflection_is_reciprocal() -> None:
    normal, view, light = frames(500, 2, 3)
    rng = np.random.default_rng(3)
    material = rng.random((500, 3)), rng.random(500), rng.random(500)
    n_v, n_l = (np.sum(normal * a, axis=-1, keepdims=True) for a in (view, light))
    sound = (np.minimum(n_v, n_l) > 1e-3)[:, 0]
    there = reflected(normal, view, *material, light) / n_l
    back = reflected(normal, light, *material, view) / n_v
    np.testing.assert_allclose(there[sound], back[sound], rtol=1e-11)


def test_a_white_matt_surface_that_faces_the_light_has_radiance_one_less_fresnel() -> None:
    # F = 0.04 head on, and what albedo adds is 1 − F. A metal has no such part.
    white, black = (reflected(UP, UP, np.full(3, rho), 1.0, 0.0, UP)[0] for rho in (1.0, 0.0))
    np.testing.assert_allclose(white - black, 0.96, rtol=1e-14)
    np.testing.assert_allclose(black, 0.04 / 4, rtol=1e-14)  # D = 1/π, G1 = 1
    oblique = np.array([math.sin(1.0), 0, math.cos(1.0)])
    white, black = (reflected(oblique, UP, np.full(3, rho), 0.7, 0.0, UP)[0] for rho in (1.0, 0.0))
    np.testing.assert_allclose(white - black, 0.96 * math.cos(1.0), rtol=1e-13)


@pytest.mark.parametrize("cosine", [0.5, 0.8, 1.0])
@pytest.mark.parametrize("r", [0.3, 0.5, 0.8, 1.0])
def test_metals_return_no_more_than_they_get(r: float, cosine: float) -> None:
    directions, solid_angles = lights_over()
    found = under_all(directions, WHITE, r, 1.0, seen_at(cosine))[:, 0]
    albedo_of_white = float(found @ solid_angles) / math.pi
    assert 0.3 < albedo_of_white <= 1 + 1e-6


@pytest.mark.parametrize(
    ("r", "metallic", "cosine", "returned"),
    [(0.4, 1.0, 0.1, 1.193), (0.5, 1.0, 0.1, 1.297), (0.5, 0.0, 0.1, 1.193), (0.5, 0, 0.5, 1.015)],
)
def test_at_grazing_angles_the_papers_masking_returns_too_much(
    r: float, metallic: float, cosine: float, returned: float
) -> None:
    """With k = α²/2 masking is weak: the equations as printed break the conservation of energy."""
    directions, solid_angles = lights_over()
    found = under_all(directions, WHITE, r, metallic, seen_at(cosine))[:, 0]
    assert float(found @ solid_angles) / math.pi == pytest.approx(returned, abs=2e-3)


def under_all(
    directions: Array,
    albedo: Array,
    r: float,
    metallic: float,
    view: Array,
    normal: Array = UP,
    model: Model = "paper",
) -> Array:
    """(N, 3) radiance under each light alone."""
    material = albedo[None], np.array([r]), np.array([float(metallic)])
    lit = _core.lamp_radiance(normal[None], unit(view)[None], *material, directions[None], 2, model)
    return np.asarray(lit[0])


@pytest.mark.parametrize(
    ("r", "metallic", "cosine"), [(0.4, 1.0, 0.9), (0.6, 0.0, 0.4), (1.0, 0.3, 0.2)]
)
def test_all_lights_of_an_sh_light_together_give_the_integral(
    r: float, metallic: float, cosine: float
) -> None:
    directions, solid_angles = lights_over()
    lit = under_all(directions, np.array([0.9, 0.5, 0.1]), r, metallic, seen_at(cosine))
    # Radiance L arriving from dω is an irradiance L dω, which is π times a colour.
    found = np.einsum("lc,lk,l->ck", lit, sh_basis(directions), solid_angles / math.pi)
    expected = respond(r, cosine).weights(np.array([0.9, 0.5, 0.1]), np.array(metallic))
    np.testing.assert_allclose(found, expected, rtol=0, atol=2e-5)


@pytest.mark.parametrize("model", MODELS)
def test_a_mirror_does_not_show_a_light_without_extent(model: Model) -> None:
    normal, view, _ = frames(50, 4, 3)
    mirror = unit(2 * np.sum(normal * view, axis=-1, keepdims=True) * normal - view)
    for r in (0.0, 1e-170, 1e-80, 1e-30):
        assert reflected(normal, view, WHITE, r, 1.0, mirror, model).max() < 1e-20
        matt = reflected(normal, view, WHITE, r, 0.0, mirror, model)
        n_l = np.sum(normal * mirror, axis=-1)
        # v·h is n·v is n·l
        fresnel = 0.04 + 0.96 * (1 - n_l) ** 5 if model == "paper" else reference.glass(n_l)
        rtol = 1e-12 if model == "paper" else 5e-5  # the table's
        np.testing.assert_allclose(matt, np.tile((1 - fresnel) * n_l, (3, 1)).T, rtol=rtol)


EXTREMES = (0.0, 5e-324, 1e-200, 1e-80, 1e-40, 1e-8, 1e-4, 0.5, 1.0)


@pytest.mark.parametrize("model", MODELS)
def test_extremes_are_finite_and_not_negative(model: Model) -> None:
    tilts = (0.0, 1e-300, 1e-12, 1e-7, 1e-3, 1.0, math.pi / 2 - 1e-9, math.pi / 2, 3.0, math.pi)
    around = [np.array([math.sin(t) * s, 0, math.cos(t)]) for t in tilts for s in (1, -1)]
    pairs = list(itertools.product(around, around))
    view, light = (unit(np.array(side)) for side in zip(*pairs, strict=True))
    view[0] = -light[0]
    for r, m, rho in itertools.product(EXTREMES, (0.0, 1e-300, 1.0), (0.0, 1.0)):
        found = reflected(UP, view, np.full(3, rho), r, m, light, model)
        assert np.isfinite(found).all(), (r, m, rho)
        assert (found >= 0).all(), (r, m, rho)


def maps(height: int, width: int, seed: int) -> tuple[Materials, Array]:
    rng = np.random.default_rng(seed)
    materials = Materials(
        rng.random((height, width, 3)), rng.random((height, width)), rng.random((height, width))
    )
    return materials, unit(rng.normal(size=(height, width, 3)) + 2 * UP)


@pytest.mark.parametrize(
    ("directions", "colors", "message"),
    [
        (2 * UP, WHITE, "directions: expected unit vectors"),
        (np.full(3, np.nan), WHITE, "directions: expected unit vectors"),
        (UP, np.array([1, np.inf, 1]), r"colors: expected finite numbers up to 1e260"),
        (UP, np.array([1, 1e300, 1]), r"colors: expected finite numbers up to 1e260"),
        (UP, np.ones((1, 3)), r"colors: expected shape \(3,\)"),
        (np.array([UP, UP]), WHITE, r"colors: expected shape \(..., 2, 3\)"),
        (np.ones((1, 1, 3)), np.ones((1, 1, 3)), r"directions: expected shape \(3,\) or \(N, 3\)"),
    ],
)
def test_unusable_lights_are_refused(directions: Array, colors: Array, message: str) -> None:
    materials, normals = maps(2, 3, 9)
    with pytest.raises(InputError, match=message):
        render_directional(materials, normals, directions, colors, 60.0)
