"""Light from single directions with the principled model: other forms of it, physics, SH light."""

from __future__ import annotations

import math

import numpy as np
import pytest
from test_directional import UP, WHITE, lights_over, reflected, reflected_of_uniform, under_all

from pbrfit.model.reflection import sh_basis, shade
from pbrfit.values.arrays import Array
from pbrfit_evaluation.gap.brute_force import view as seen_at
from principled_reference import Lights, lobe, mean_reflectance, multiple_scattering, schlick
from reference import frames, glass, unit

ALBEDO = np.array([0.9, 0.5, 0.1])
TABLE = 2e-5
"""Largest error of the table of lobe functions."""


@pytest.mark.parametrize(
    ("r", "cosine", "metallic"),
    [(0.4, 0.9, 1.0), (0.5, 0.5, 0.0), (0.8, 0.2, 0.3), (1.0, 1.0, 0.7)],
)
def test_agrees_with_the_brdf_by_brute_force(r: float, cosine: float, metallic: float) -> None:
    view = seen_at(cosine)
    around = Lights.about_mirror(UP, view, r)
    response, v_dot_h = lobe(UP, view, around.directions, r)
    energy = float(response @ around.area), mean_reflectance(r)
    gloss = multiple_scattering(np.array(0.04), *energy)
    ground = (1 - metallic) * (1 - gloss * ((response * glass(v_dot_h)) @ around.area)) * ALBEDO
    _, _, lights = frames(200, 11, 3)  # on both sides
    response, v_dot_h = lobe(UP, view, lights, r)
    fresnel = (1 - metallic) * gloss * glass(v_dot_h)[:, None]
    fresnel = fresnel + metallic * multiple_scattering(ALBEDO, *energy) * schlick(
        ALBEDO, v_dot_h[:, None]
    )
    expected = np.maximum(lights[:, 2:], 0) * ground + math.pi * response[:, None] * fresnel
    found = reflected(UP, view, ALBEDO, r, metallic, lights, "principled")
    np.testing.assert_allclose(found, expected, rtol=2e-5, atol=1e-5)
    assert (found[lights[:, 2] <= 0] == 0).all()


def test_the_lobe_is_reciprocal() -> None:
    normal, view, light = frames(500, 2, 3)
    r = np.random.default_rng(3).random(500)
    n_v, n_l = (np.sum(normal * a, axis=-1) for a in (view, light))
    sound = np.minimum(n_v, n_l) > 1e-3
    there = reflected(normal, view, WHITE, r, 1.0, light, "principled")[:, 0] / n_l
    back = reflected(normal, light, WHITE, r, 1.0, view, "principled")[:, 0] / n_v
    # What is scattered more than once goes by the view alone.
    there, back = there * reflected_of_uniform(r, n_v), back * reflected_of_uniform(r, n_l)
    np.testing.assert_allclose(there[sound], back[sound], rtol=1e-10)


@pytest.mark.parametrize(
    ("r", "metallic"), [(0.3, 1.0), (0.4, 0.0), (0.6, 0.3), (0.8, 1.0), (1.0, 0.0)]
)
def test_all_lights_of_an_sh_light_together_give_its_weights(r: float, metallic: float) -> None:
    """But for the dielectric's lobe: Fresnel's equations here, Schlick's fit, scaled, there."""
    rng = np.random.default_rng(int(100 * r))
    for cosine in (0.1, 0.3, 0.6, 1.0):
        turn = unit_frame(rng)
        normal, view = turn[2], seen_at(cosine) @ turn
        directions, solid_angles = lights_over()
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
