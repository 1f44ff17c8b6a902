"""The lobe functions of the principled model: their table against quadrature, everywhere."""

from __future__ import annotations

import json
import math
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pbrfit import _core
from pbrfit.model.reflection import sh_basis
from pbrfit.values.arrays import Array
from principled_reference import EVEN, ORDER
from reference import glass

COUNT = 22
"""Functions: ten a_j, ten b_j, Ebar and kappa."""
MEAN, KAPPA = 20, 21
SINE_POWERS = np.concatenate((ORDER, ORDER, [0, 0]))
LEAST_COSINE = 1e-4
RESOLVED = 0.02


def functions(r: Array | float, cosine: Array | float) -> tuple[Array, Array, Array]:
    """Values and derivatives by r and by n·v at all pairs of broadcast places, (..., 22)."""
    rs, cosines = (a.astype(np.float64) for a in np.broadcast_arrays(r, cosine))
    parts = _core.lobe_functions(rs.ravel(), cosines.ravel())
    value, by_r, by_cosine = (part.reshape(*rs.shape, COUNT) for part in parts)
    return value, by_r, by_cosine


def reflectance(value: Array) -> Array:
    """E, the part of uniform light that a white lobe reflects once."""
    return np.asarray(2 * math.sqrt(math.pi) * (value[..., 0] + value[..., 10]))


def dielectric_reflectance(value: Array) -> Array:
    """E_d, of uniform light, with what is reflected several times."""
    once = 2 * math.sqrt(math.pi) * (0.04 * value[..., 0] + value[..., 10])
    mean_fresnel, e, mean = 0.04 + 0.96 / 21, reflectance(value), value[..., MEAN]
    again = mean_fresnel * mean / (1 - mean_fresnel * (1 - mean))
    return np.asarray((1 + again * (1 - e) / e) * value[..., KAPPA] * once)


class Samples:
    """tests/data/lobe_samples.json: quadrature in half-vector coordinates, to 1e-9."""

    def __init__(self) -> None:
        path = Path(__file__).parents[2] / "data" / "lobe_samples.json"
        rows = json.loads(path.read_text(encoding="utf-8"))["rows"]
        self.r, self.cosine = (np.array([row[key] for row in rows]) for key in ("r", "cosine"))
        self.value, self.by_r, self.by_cosine = (
            np.array([row[key] for row in rows]) for key in ("value", "by_r", "by_cosine")
        )
        self.sine = np.sqrt(1 - self.cosine**2)[:, None] ** SINE_POWERS

    def where(self, chosen: Any) -> tuple[Array, Array, Array]:
        """Errors of value and derivatives, with their sinᵐ, at some of the rows."""
        found = functions(self.r[chosen], self.cosine[chosen])
        exact = (self.value, self.by_r, self.by_cosine)
        value, by_r, by_cosine = (
            np.abs(f - e[chosen]) * self.sine[chosen] for f, e in zip(found, exact, strict=True)
        )
        return value, by_r, by_cosine


SAMPLES = Samples()


def test_values_and_slopes_are_those_of_the_integrals() -> None:
    value, by_r, by_cosine = SAMPLES.where((SAMPLES.r >= RESOLVED) & (SAMPLES.cosine >= RESOLVED))
    assert value[:, :KAPPA].max() <= 3e-6
    assert value[:, KAPPA].max() <= 1e-5
    assert by_r.max() <= 5e-4
    assert by_cosine.max() <= 2e-3


def test_mean_reflectance_is_the_mean_of_the_reflectance() -> None:
    nodes, weights = np.polynomial.legendre.leggauss(60)
    root = (1 + nodes) / 2  # n·v = root²
    r = np.linspace(0, 1, 41)
    value, by_r, by_cosine = functions(r[:, None], np.maximum(root**2, LEAST_COSINE))
    mean = reflectance(value) @ (2 * weights * root**3)
    np.testing.assert_allclose(value[:, 0, MEAN], mean, rtol=0, atol=1e-5)
    assert (np.ptp(value[..., MEAN], axis=1) < 1e-14).all()
    assert (np.abs(by_cosine[..., MEAN]) < 1e-9).all()
    assert (by_r[1:, 0, MEAN] < 0).all()


def knots(first: int) -> Array:
    """Inner knots by r (first = 0) or n·v (1), from the head of the table's file.

    The coordinate w (1+c) x/(x+c) + (1−w) x is a whole number of cells there.
    """
    path = Path(__file__).parents[3] / "rust" / "reflectance" / "lobe_table.bin"
    head = struct.unpack_from("<8s2I4f", path.read_bytes())
    cells, c, w = head[1 + first], head[3 + 2 * first], head[4 + 2 * first]
    at = np.arange(1, cells) / cells
    linear = w * (1 + c) + (1 - w) * c - at
    return np.asarray(2 * at * c / (linear + np.sqrt(linear**2 + 4 * (1 - w) * at * c)))


@pytest.mark.parametrize("first", [0, 1])
def test_values_and_slopes_pass_knots_without_a_jump(first: int) -> None:
    at = knots(first)
    others = np.array([0.004, 0.03, 0.2, 0.55, 0.9])[:, None]
    below, above = (
        functions(*((place, others) if first == 0 else (others, np.maximum(place, LEAST_COSINE))))
        for place in (at * (1 - 1e-12), at * (1 + 1e-12))
    )
    for left, right in zip(below, above, strict=True):
        np.testing.assert_allclose(left, right, rtol=1e-7, atol=1e-8)
    # The third derivative does jump there, or these are no knots.
    along = 1 + first
    step = 1e-4 * at

    def curvature(inside: float) -> Array:
        places = [at + sign * inside * step for sign in (1, 2, 3)]
        slopes = [
            functions(*((place, others) if first == 0 else (others, place)))[along]
            for place in places
        ]
        return np.asarray((slopes[0] - 2 * slopes[1] + slopes[2]) / step[:, None] ** 2)

    left, right = curvature(-1), curvature(1)
    jumps = np.abs(left - right).max(axis=(0, 2)) / np.abs(left).max(axis=(0, 2))
    assert np.median(jumps) > 0.01


def test_reflectance_lies_between_nothing_and_all() -> None:
    r = np.concatenate((np.linspace(0, 0.05, 101), np.linspace(0.05, 1, 200)))
    cosine = np.concatenate((np.geomspace(LEAST_COSINE, 0.05, 101), np.linspace(0.05, 1, 200)))
    value, _, _ = functions(r[:, None], cosine)
    reflected = reflectance(value)
    assert (reflected > 0.3).all()
    assert (reflected <= 1 + 1e-7).all()
    assert (value[..., [0, 10]] >= -1e-8).all()  # each lobe's own part too
    assert (value[..., MEAN] > 0.4).all()
    assert (value[..., MEAN] <= 1 + 1e-6).all()
    # So the ground of a dielectric always gets some.
    of_dielectric = dielectric_reflectance(value)
    assert (of_dielectric > 0.01).all()
    assert (of_dielectric <= 1 - 5e-4).all()


def test_a_mirror_shows_the_harmonics_of_its_direction() -> None:
    cosine = np.concatenate((np.geomspace(LEAST_COSINE, 0.1, 200), np.linspace(0.1, 0.9999, 400)))
    value, by_r, _ = functions(0.0, cosine)
    sine = np.sqrt(1 - cosine**2)
    mirror = np.stack([sine, np.zeros_like(sine), cosine], axis=-1)
    grazing = (1 - cosine[:, None]) ** 5
    basis = sh_basis(mirror)[:, EVEN]
    expected = np.concatenate(((1 - grazing) * basis, grazing * basis), axis=1)
    found = value[:, :20] * sine[:, None] ** SINE_POWERS[:20]
    np.testing.assert_allclose(found, expected, rtol=0, atol=6e-6)
    np.testing.assert_allclose(value[:, MEAN], 1, rtol=0, atol=1e-7)
    schlick = 0.04 + 0.96 * grazing[:, 0]
    expected = glass(cosine) / schlick
    np.testing.assert_allclose(value[:, KAPPA], expected, rtol=0, atol=4e-5)
    assert not by_r.any()


def test_functions_leave_the_mirror_as_the_fourth_power_of_roughness() -> None:
    cosine = np.linspace(0.1, 1, 50)
    at_mirror = functions(0.0, cosine)[0]
    for r in (0.002, 0.005, 0.01, 0.02, 0.04):
        away = np.abs(functions(r, cosine)[0] - at_mirror)
        assert away.max() <= 400 * r**4 + 2e-6
