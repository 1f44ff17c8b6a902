"""The fast objective with the principled model: float32 blocks against float64 pixel by pixel.

The reference is `_core.shade` and `_core.shade_vjp`, which have tests of their own.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from test_objective import Planted, label, planted
from test_objective import assert_agrees as assert_agrees_within

import reference
from pbrfit import _core
from reference import unit

Array = NDArray[Any]


def value_and_grad(case: Planted, x: Array | None = None, threads: int = 1) -> tuple[float, Array]:
    """Of the fast objective."""
    problem = case.problem(threads, model="principled")
    return problem.value_and_grad(case.x if x is None else x)


def expected(case: Planted) -> tuple[float, Array]:
    """Loss and gradient: the mean of ω (I − T)², through the weights of each pixel."""
    unknowns, pixels = case.unknowns, case.unknowns.pixels
    albedo, r, m, lighting = reference.unpack(unknowns.expand(case.x), pixels)
    tilts = unknowns.tilts(case.x)
    normals = case.normals if tilts is None else reference.turned(case.normals, tilts)
    pixel = (normals, case.views, albedo.copy(), r, m)
    w = _core.shade(*pixel, "principled")
    residual = np.einsum("pck,nkc->npc", w, lighting) - case.images
    omega = np.ones_like(residual)
    if case.weights is not None:
        omega *= case.weights if case.weights.ndim == 3 else case.weights[..., None]
    scaled = 2 * omega * residual / omega.sum()
    by_weight = np.einsum("npc,nkc->pck", scaled, lighting)
    by_albedo, by_r, by_m, by_normal = _core.shade_vjp(*pixel, by_weight, "principled")
    gradient = [by_albedo.T, by_r, by_m]
    for tilt in range(0 if tilts is None else 2):
        step = 1j * reference.STEP * (np.arange(2) == tilt)[:, None]
        direction = reference.turned(case.normals, tilts + step).imag / reference.STEP
        gradient.append(np.sum(by_normal * direction, axis=-1))
    gradient.append(np.einsum("npc,pck->nkc", scaled, w))
    flat = np.concatenate([np.ravel(part) for part in gradient])
    return float(np.sum(omega * residual**2) / omega.sum()), unknowns.restrict(flat)


def assert_agrees(found: tuple[float, Array], case: Planted) -> None:
    """As with the paper's model, but for roughness.

    Slopes of the table's splines lose 3e-5 in float32, a tenth of their own error, which shows
    where little light comes by the lobe.
    """
    assert_agrees_within(found, expected(case), case, {"roughness": 5e-5})


# Around a vector, around blocks of 128 pixels and groups of 16 pictures.
SIZES = [(1, 3), (15, 3), (17, 2), (127, 3), (128, 1), (129, 5), (257, 17), (300, 33), (5000, 4)]


@pytest.mark.parametrize(("pixels", "pictures"), SIZES)
@pytest.mark.parametrize("normals", ["known", "free"])
def test_loss_and_gradient(normals: str, pixels: int, pictures: int) -> None:
    case = planted(pixels, pictures, normals=normals)
    assert_agrees(value_and_grad(case), case)


KINDS: list[dict[str, Any]] = [
    {"channels": channels, "sh_order": order, "weights": weights, "lights": lights, "metallic": m}
    | {"normals": normals}
    for channels in (1, 3)
    for order in (2, 3)
    for weights in ("none", "sample", "channel")
    for lights, m in (("free", None), ("free", 0.3), ("known", None), ("known", 0.0))
    for normals in ("known", "free")
]


@pytest.mark.parametrize("kind", KINDS, ids=label)
def test_every_kind_of_problem(kind: dict[str, Any]) -> None:
    case = planted(301, 5, **kind)
    assert_agrees(value_and_grad(case), case)


def extreme(normals: str) -> Planted:
    """All pairs of extreme materials and angles, among them lobes that only mirror."""
    roughness = [0.0, 1e-9, 1e-3, 0.0199, 0.3, 1.0]
    # Not at n·v = 1e-4 itself, where lobes stop changing and a rounding decides.
    angles = [1.0, 0.5, 0.02, 1e-3, 1.2e-4, 8e-5, 0.0, -0.3]
    grid = np.meshgrid(roughness, angles, [0.0, 1e-6, 1.0], [0.0, 1.0], indexing="ij")
    r, cosine, albedo, metallic = (part.ravel() for part in grid)
    pixels, pictures = len(r), 3
    rng = np.random.default_rng(5)
    up, other = unit(rng.normal(size=(2, pixels, 3)))
    aside = unit(np.cross(up, other))
    views = unit(cosine[:, None] * up + np.sqrt(1 - cosine**2)[:, None] * aside)
    case = planted(pixels, pictures, normals=normals)
    x = case.x.copy()
    materials = np.concatenate([np.tile(albedo, 3), r, metallic])
    x[: materials.size] = materials
    if normals == "free":
        x[case.unknowns.blocks["tilts"]] = 0
    return dataclasses.replace(case, normals=up, views=views, x=x)


@pytest.mark.parametrize("normals", ["known", "free"])
def test_extreme_pixels_agree_and_are_finite(normals: str) -> None:
    case = extreme(normals)
    found = value_and_grad(case)
    assert np.isfinite(found[0])
    assert np.isfinite(found[1]).all()
    assert_agrees(found, case)


@pytest.mark.slow
@pytest.mark.parametrize("normals", ["known", "free"])
def test_the_number_of_threads_changes_no_bit(normals: str) -> None:
    case = planted(5000, 5, normals=normals)
    loss, gradient = value_and_grad(case)
    for threads in (2, 3):
        again, other = value_and_grad(case, threads=threads)
        assert again == loss
        np.testing.assert_array_equal(other, gradient)
