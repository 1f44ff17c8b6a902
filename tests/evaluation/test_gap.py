"""The gap suite: its quadrature against other rules and known facts, its figures, its command."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import pbrfit
import reference
from pbrfit_evaluation.gap import measure, principled
from pbrfit_evaluation.gap.brute_force import respond, view
from pbrfit_evaluation.gap.measure import Case, Model

Array = NDArray[np.float64]


def hemisphere() -> tuple[Array, Array]:
    """Directions and weights of a plain rule over n·l > 0: 500 × 500 nodes."""
    nodes, weights = np.polynomial.legendre.leggauss(500)
    # Denser at the horizon, where masking falls to 0.
    n_dot_l = ((1 + nodes) / 2) ** 3
    shares = weights / 2 * 3 * ((1 + nodes) / 2) ** 2
    azimuth = 2 * np.pi * (np.arange(500) + 0.5) / 500
    sine = np.sqrt(1 - n_dot_l**2)[:, None]
    up = np.repeat(n_dot_l[:, None], 500, axis=1)
    directions = np.stack([sine * np.cos(azimuth), sine * np.sin(azimuth), up], axis=-1)
    return directions, np.repeat(2 * np.pi / 500 * shares[:, None], 500, axis=1)


def reflected(rho: float, r: float, m: float, n_dot_v: float) -> Array:
    """(16,) weights of one channel: the paper's eqs. 1 and 3-5 as printed, summed over l."""
    l, shares = hemisphere()  # noqa: E741
    v = np.array([math.sqrt(1 - n_dot_v**2), 0, n_dot_v])
    h = reference.unit(v + l)
    alpha = r * r
    d = alpha**2 / (np.pi * (h[..., 2] ** 2 * (alpha**2 - 1) + 1) ** 2)
    k = alpha**2 / 2
    g = np.prod([x / (x * (1 - k) + k) for x in (l[..., 2], np.full(l.shape[:2], n_dot_v))], axis=0)
    f0 = 0.04 * (1 - m) + m * rho
    f = f0 + (1 - f0) * (1 - h @ v) ** 5
    specular = d * g * f / (4 * n_dot_v * l[..., 2])
    diffuse = (1 - f) * (1 - m) * rho / np.pi
    radiance = (specular + diffuse) * l[..., 2] * shares
    weights: Array = np.einsum("ij,ijk->k", radiance, reference.sh_basis(l))
    return weights


def lobe(r: float, n_dot_v: float) -> tuple[Array, Array, Array]:
    """Over the nodes of `hemisphere`: GGX with correlated masking times n·l and shares, v·h, l."""
    l, shares = hemisphere()  # noqa: E741
    v = np.array([math.sqrt(1 - n_dot_v**2), 0, n_dot_v])
    h = reference.unit(v + l)
    a2 = r**4
    d = a2 / (np.pi * (h[..., 2] ** 2 * (a2 - 1) + 1) ** 2)
    # Heitz: G = 1 / (1 + Λ(v) + Λ(l)), Λ = (√(1 + α² tan²θ) − 1) / 2.
    below = [(np.sqrt(1 + a2 * (1 / x**2 - 1)) - 1) / 2 for x in (l[..., 2], n_dot_v)]
    g = 1 / (1 + below[0] + below[1])
    return d * g / (4 * n_dot_v) * shares, h @ v, l


def reflected_principled(rho: float, r: float, m: float, n_dot_v: float) -> Array:
    """(16,) weights of one channel by the plain rule."""
    nodes, weights = np.polynomial.legendre.leggauss(24)
    x = (1 + nodes) / 2
    index = 1.5
    mean = float(np.dot(weights * x, [lobe(r, y)[0].sum() for y in x]))  # 2 ∫ E x dx
    share, v_dot_h, l = lobe(r, n_dot_v)  # noqa: E741
    albedo = share.sum()
    basis = reference.sh_basis(l)

    def scaled(f0: float, fresnel: Array) -> tuple[Array, float]:
        average = (1 + 20 * f0) / 21
        further = average * mean / (1 - average * (1 - mean)) * (1 - albedo) / albedo
        lit = (1 + further) * share * fresnel
        return np.einsum("ij,ijk->k", lit, basis), lit.sum()

    inside = np.sqrt(1 - (1 - v_dot_h**2) / index**2)  # Snell
    across = (v_dot_h - index * inside) / (v_dot_h + index * inside)
    along = (inside - index * v_dot_h) / (inside + index * v_dot_h)
    metal, _ = scaled(rho, rho + (1 - rho) * (1 - v_dot_h) ** 5)
    coat, held_back = scaled(0.04, (across**2 + along**2) / 2)
    cosine = hemisphere()[1] * l[..., 2]
    body = rho / np.pi * (1 - held_back) * np.einsum("ij,ijk->k", cosine, basis)
    found: Array = m * metal + (1 - m) * (coat + body)
    return found


@pytest.mark.parametrize(
    ("of", "plain", "tolerance"),
    [(respond, reflected, 2e-6), (principled.respond, reflected_principled, 5e-6)],
    ids=["paper", "principled"],
)
@pytest.mark.parametrize(
    ("rho", "r", "m", "n_dot_v"),
    [(0.5, 0.6, 0.0, 0.4), (0.3, 1.0, 0.3, 0.1)],
)
def test_quadrature_agrees_with_a_plain_rule(
    of: Any, plain: Any, tolerance: float, rho: float, r: float, m: float, n_dot_v: float
) -> None:
    found = of(r, n_dot_v).weights(np.full(3, rho), np.array(m))
    expected = np.tile(plain(rho, r, m, n_dot_v), (3, 1))
    np.testing.assert_allclose(found, expected, atol=tolerance)


@pytest.mark.parametrize("r", [0.02, 0.2, 0.5, 1.0])
@pytest.mark.parametrize("n_dot_v", [0.02, 0.3, 1.0])
def test_white_furnace_of_the_principled_integral(r: float, n_dot_v: float) -> None:
    exact = principled.respond(r, n_dot_v)
    for metallic in (0.0, 0.4, 1.0):
        weights = exact.weights(np.ones(3), np.array(metallic))
        assert 2 * math.sqrt(math.pi) * weights[0, 0] == pytest.approx(1, abs=1e-12)
    assert exact.albedo < 1 + 1e-6  # without light between facets


@pytest.mark.parametrize("n_dot_v", [0.1, 0.6, 1.0])
def test_white_furnace_of_a_mirror(n_dot_v: float) -> None:
    exact = respond(0.01, n_dot_v)
    assert 2 * math.sqrt(math.pi) * (exact.base + exact.grazing)[0] == pytest.approx(1, abs=1e-4)
    mirror = view(n_dot_v) * [-1, -1, 1]
    np.testing.assert_allclose(
        exact.base + exact.grazing, pbrfit.kernel.sh_basis(mirror), atol=1e-3
    )


@pytest.mark.parametrize("own", [respond, principled.respond])
def test_a_perfect_model_has_no_gap_and_a_brighter_one_its_own(own: Model) -> None:
    def brighter(r: float, n_dot_v: float) -> Any:
        weights = own(r, n_dot_v).weights
        return SimpleNamespace(error=0.0, weights=lambda *of: 1.5 * weights(*of))

    case, models = Case(0.5, (0.5,), rings=2, lights=2), {"exact": own, "brighter": brighter}
    found = measure.run(case, reference=own, models=models)
    signal, true = np.array(found["signal"]), np.array(found["true"])
    of = {name: {k: np.array(v) for k, v in one.items()} for name, one in found["models"].items()}
    assert (of["exact"]["error"] / signal).max() < 1e-14
    np.testing.assert_allclose(of["brighter"]["found"], 1.5 * true)
    np.testing.assert_allclose(of["brighter"]["error"], 0.5 * signal)


@pytest.mark.parametrize(("r", "n_dot_v"), [(0.0, 0.5), (0.5, 0.0), (1.1, 0.5), (math.nan, 0.5)])
def test_points_outside_the_range_are_named(r: float, n_dot_v: float) -> None:
    for of in (respond, principled.respond):
        with pytest.raises(pbrfit.InputError, match=r"^(roughness|n_dot_v): expected a number in"):
            of(r, n_dot_v)


def test_models_are_as_far_off_as_the_paper_says_and_the_table_allows() -> None:
    found = measure.run(Case(1.0, (0.5, 1.0), rings=4, lights=4))
    assert found["quadrature_error"] < 1e-6
    of = {name: np.array(one["error"]) / found["signal"] for name, one in found["models"].items()}
    assert of["principled"].max() < 0.02
    assert of["paper"].min() > 0.03
    straight = {name: np.array(one["found"])[0, 1, 0] for name, one in found["models"].items()}
    expected = {"paper": 0.5, measure.INTEGRATED: 1 - math.log(2), "principled": 1.0}
    assert straight == pytest.approx(expected, abs=1e-4)
    assert np.array(found["true"])[0, 1, 0] == pytest.approx(1.0, abs=1e-4)
