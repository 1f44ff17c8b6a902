"""Light from single directions with the principled model: other forms of it, physics, SH light."""

from __future__ import annotations

import math
from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray
from test_directional import UP, WHITE, random_frames, reflected, under_all

from pbrfit import _core
from pbrfit.model.reflection import sh_basis, shade
from pbrfit_evaluation.gap.brute_force import view as seen_at
from reference import glass, unit

Array = NDArray[np.float64]

ALBEDO = np.array([0.9, 0.5, 0.1])
TABLE = 2e-5
"""Largest error of the table of lobe functions."""


@cache
def lights_about(polar: int = 120, around: int = 120) -> tuple[Array, Array]:
    """A rule over the half sphere about +Z, for views in the xz-plane; directions, solid angles.

    It is dense at the horizon, and about −X, where mirror directions are: seen at a grazing angle
    a lobe is a hundred times as long as wide.
    """
    nodes, weights = np.polynomial.legendre.leggauss(polar)
    n_l = ((1 + nodes) / 2) ** 3
    of_n_l = weights / 2 * 3 * ((1 + nodes) / 2) ** 2
    nodes, weights = np.polynomial.legendre.leggauss(around)
    azimuth = np.pi * (1 + nodes**3)
    of_azimuth = weights * np.pi * 3 * nodes**2
    sine = np.sqrt(1 - n_l**2)[:, None]
    directions = np.stack(
        [
            sine * np.cos(azimuth),
            sine * np.sin(azimuth),
            np.broadcast_to(n_l[:, None], (polar, around)),
        ],
        axis=-1,
    )
    return unit(directions.reshape(-1, 3)), np.outer(of_n_l, of_azimuth).reshape(-1)


def lobe(r: float, view: Array, lights: Array) -> tuple[Array, Array]:
    """D V (n·l) about +Z, 0 below the horizon, as Heitz 2014 has it, and v·h."""
    alpha2 = r**4
    half = unit(view + lights)
    d = alpha2 / (math.pi * (half[:, 2] ** 2 * (alpha2 - 1) + 1) ** 2)
    n_l = np.maximum(lights[:, 2], 1e-100)

    def slope(cosine: Array | float) -> Array:  # Λ of eq. 72
        return np.asarray((np.sqrt(1 + alpha2 * (1 / np.square(cosine) - 1)) - 1) / 2)

    masked = 1 / (1 + slope(view[2]) + slope(n_l))  # G of eq. 99
    found = d * masked / (4 * view[2])
    return np.where(lights[:, 2] > 0, found, 0.0), half @ view


def schlick(f0: Array | float, cosine: Array) -> Array:
    return np.asarray(f0 + (1 - f0) * (1 - cosine) ** 5)


@cache
def energy(r: float, cosine: float) -> tuple[float, float]:
    """Reflected of a uniform light with F = 1 and with that of glass."""
    directions, solid_angles = lights_about()
    values, v_dot_h = lobe(r, seen_at(cosine), directions)
    share = values * solid_angles
    return float(share.sum()), float(share @ glass(v_dot_h))


@cache
def mean_energy(r: float) -> float:
    nodes, weights = np.polynomial.legendre.leggauss(20)
    return sum(
        float(w * x * energy(r, float(x))[0]) for x, w in zip((1 + nodes) / 2, weights, strict=True)
    )


def multiplied(f0: Array | float, r: float, cosine: float) -> Array:
    average = np.asarray(f0) * 20 / 21 + 1 / 21
    e, mean = energy(r, cosine)[0], mean_energy(r)
    return np.asarray(1 + average * mean / (1 - average * (1 - mean)) * (1 - e) / e)


@pytest.mark.parametrize(
    ("r", "cosine", "metallic"),
    [(0.4, 0.9, 1.0), (0.5, 0.5, 0.0), (0.8, 0.2, 0.3), (1.0, 1.0, 0.7)],
)
def test_agrees_with_another_form_of_the_brdf(r: float, cosine: float, metallic: float) -> None:
    view = seen_at(cosine)
    _, _, lights = random_frames(200, 11)  # on both sides
    values, v_dot_h = lobe(r, view, lights)
    gloss = multiplied(0.04, r, cosine)
    expected = (
        np.maximum(lights[:, 2:], 0) * (1 - metallic) * (1 - gloss * energy(r, cosine)[1]) * ALBEDO
    )
    fresnel = (1 - metallic) * gloss * glass(v_dot_h)[:, None]
    fresnel = fresnel + metallic * multiplied(ALBEDO, r, cosine) * schlick(ALBEDO, v_dot_h[:, None])
    expected += math.pi * values[:, None] * fresnel
    found = reflected(UP, view, ALBEDO, r, metallic, lights, "principled")
    np.testing.assert_allclose(found, expected, rtol=2e-5, atol=1e-5)
    assert (found[lights[:, 2] <= 0] == 0).all()


@pytest.mark.parametrize("r", [0.3, 0.1, 1e-2, 1e-3, 1e-4, 1e-6])
def test_narrow_lobes_keep_their_digits(r: float) -> None:
    # As in test_directional; masking is 1 at the view, and at the light 2/(1 + √(1 + α² tan²)).
    alpha = r * r
    x = np.array([0.0, 1e-3, 0.1, 0.5, 1, 3, 100]) * alpha
    theta = np.arctan(x)
    light = np.stack([np.sin(2 * theta), 0 * theta, np.cos(2 * theta)], axis=-1)
    lit = light[:, 2] > 0
    d = alpha**2 * (1 + x**2) ** 2 / (np.pi * (alpha**2 + x**2) ** 2)
    masked = 2 / (1 + np.sqrt(1 + alpha**2 * np.tan(2 * theta) ** 2))
    found = reflected(UP, UP, WHITE, r, 1.0, light, "principled")[:, 0]
    expected = np.pi * d * masked / 4 / reflected_of_uniform(r, 1.0)
    np.testing.assert_allclose(found[lit], expected[lit], rtol=1e-5 if r < 1e-5 else 1e-12)


def reflected_of_uniform(r: float | Array, cosine: float | Array) -> Array:
    """E as the core has it. A white metal's lobe is divided by it."""
    r, cosine = np.broadcast_arrays(np.atleast_1d(r), cosine)
    values = _core.lobe_functions(r.astype(float), cosine.astype(float))[0]
    return np.asarray(2 * math.sqrt(math.pi) * (values[:, 0] + values[:, 10]))


def test_the_lobe_is_reciprocal() -> None:
    normal, view, light = random_frames(500, 2)
    r = np.random.default_rng(3).random(500)
    n_v, n_l = (np.sum(normal * a, axis=-1) for a in (view, light))
    sound = np.minimum(n_v, n_l) > 1e-3
    there = reflected(normal, view, WHITE, r, 1.0, light, "principled")[:, 0] / n_l
    back = reflected(normal, light, WHITE, r, 1.0, view, "principled")[:, 0] / n_v
    # What is scattered more than once goes by the view alone.
    there, back = there * reflected_of_uniform(r, n_v), back * reflected_of_uniform(r, n_l)
    np.testing.assert_allclose(there[sound], back[sound], rtol=1e-10)


@pytest.mark.parametrize("cosine", [0.02, 0.1, 0.5, 1.0])
@pytest.mark.parametrize("r", [0.3, 0.6, 0.8, 1.0])
def test_a_white_surface_returns_what_it_gets(r: float, cosine: float) -> None:
    directions, solid_angles = lights_about()
    for metallic in (1.0, 0.0) if cosine >= 0.1 else (1.0,):
        lit = under_all(directions, WHITE, r, metallic, seen_at(cosine), model="principled")
        assert lit[:, 0] @ solid_angles / math.pi == pytest.approx(1, abs=TABLE), metallic


@pytest.mark.parametrize(
    ("r", "metallic"), [(0.3, 1.0), (0.4, 0.0), (0.6, 0.3), (0.8, 1.0), (1.0, 0.0)]
)
def test_all_lights_of_an_sh_light_together_give_its_weights(r: float, metallic: float) -> None:
    """But for the dielectric's lobe, which has Fresnel's equations here, and there Schlick's fit
    scaled to reflect as much of a uniform light."""
    rng = np.random.default_rng(int(100 * r))
    for cosine in (0.1, 0.3, 0.6, 1.0):
        turn = unit_frame(rng)
        normal, view = turn[2], seen_at(cosine) @ turn
        directions, solid_angles = lights_about()
        directions = unit(directions @ turn)
        lit = under_all(directions, ALBEDO, r, metallic, view, normal, "principled")
        # Radiance L arriving from dω is an irradiance L dω, which is π times a colour.
        found = np.einsum("lc,lk,l->ck", lit, sh_basis(directions), solid_angles / math.pi)
        expected = shade(normal, unit(view), ALBEDO, r, metallic, model="principled")
        np.testing.assert_allclose(found[:, 0], expected[:, 0], rtol=0, atol=TABLE)
        apart = 0.005 * (1 - metallic)
        np.testing.assert_allclose(found, expected, rtol=0, atol=TABLE + apart)


def unit_frame(rng: np.random.Generator) -> Array:
    """(3, 3): axes x, y and z of a random frame in rows."""
    z, other = unit(rng.normal(size=(2, 3)))
    x = unit(np.cross(other, z))
    return np.stack([x, np.cross(z, x), z])
