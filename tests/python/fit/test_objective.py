"""The fast objective, `_core.Problem`: float32 inside, against the float64 reference."""

from __future__ import annotations

import dataclasses
import math
import multiprocessing
import os
import signal
import time
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import reference
from finite_differences import ridders
from pbrfit import InputError
from pbrfit._core import Problem, render
from reference import unit

Array = NDArray[Any]


@dataclass(frozen=True)
class Planted:
    """Pictures made from `truth`, and another place `x` to evaluate at."""

    images: NDArray[np.float32]  # (N, P, C)
    normals: NDArray[np.float64]  # (P, 3)
    views: NDArray[np.float64]  # (P, 3)
    weights: NDArray[np.float32] | None  # (N, P) or (N, P, C)
    unknowns: reference.Unknowns
    truth: NDArray[np.float64]
    x: NDArray[np.float64]

    def problem(self, threads: int = 1, **changes: Any) -> Problem:
        arguments: dict[str, Any] = {
            "images": self.images,
            "weights": self.weights,
            "sh_order": self.unknowns.sh_order,
            "metallic": self.unknowns.metallic,
            "lighting": self.unknowns.lighting,
            "free_normals": self.unknowns.free_normals,
        }
        arguments |= changes
        return Problem(arguments.pop("images"), self.normals, self.views, threads, **arguments)

    def expected(self, x: Array) -> tuple[float, Array]:
        """Loss and gradient by the reference."""
        weights = self.weights
        if weights is not None and weights.ndim == 2:
            weights = weights[..., None]
        loss, gradient = reference.value_and_grad(
            self.images.astype(np.float64),
            self.normals,
            self.views,
            self.unknowns.expand(x),
            None if weights is None else weights.astype(np.float64),
            tilts=self.unknowns.tilts(x),
        )
        return loss, self.unknowns.restrict(gradient)

    def render(self, x: Array, threads: int = 1) -> Array:
        """(N, P, C), by the core's float64 renderer."""
        albedo, r, m, lighting = reference.unpack(self.unknowns.expand(x), self.unknowns.pixels)
        tilts = self.unknowns.tilts(x)
        normals = self.normals if tilts is None else reference.turned(self.normals, tilts)
        images = render(normals, self.views, albedo, r, m, lighting, threads)
        return images[..., : self.unknowns.channels]

    def inside(self) -> NDArray[np.float64]:
        """X with materials in [0.2, 0.8]: room for steps on both sides."""
        x = self.x.copy()
        materials = x[: self.unknowns.materials]
        materials[:] = 0.2 + 0.6 * materials
        return x


def planted(
    pixels: int,
    pictures: int,
    *,
    channels: int = 3,
    sh_order: int = 3,
    weights: str = "none",
    lights: str = "free",
    metallic: float | None = None,
    normals: str = "known",
) -> Planted:
    """Random pixels, one in ten seen from behind; materials on the bounds here and there.

    `weights` are of "none", each "sample", or each "channel" of a sample, some of them 0; `lights`
    are "free" or "known"; normals are "known", "free", or free and "in front": then none is seen at
    a grazing angle, where finite steps lead across the clamp of n·v.
    """
    rng = np.random.default_rng([pixels, pictures])
    given, views = unit(rng.normal(size=(2, pixels, 3)))
    facing = np.where(np.arange(pixels) % 10 == 9, -1, 1)[:, None]
    views *= facing * np.sign(np.sum(given * views, axis=-1, keepdims=True))
    if normals == "in front":
        views = unit(views + 2 * given)
    coefficients = (sh_order + 1) ** 2

    def lighting() -> NDArray[np.float64]:
        values = 0.5 * rng.normal(size=(pictures, coefficients, channels))
        values[:, 0] = 1 + rng.random((pictures, channels))
        return values

    def materials(unknowns: reference.Unknowns) -> NDArray[np.float64]:
        values = rng.random(unknowns.materials)
        values[rng.random(values.size) < 0.05] = 0
        values[rng.random(values.size) < 0.05] = 1
        return values

    kind: dict[str, Any] = {"channels": channels, "sh_order": sh_order, "metallic": metallic}
    free = reference.Unknowns(pixels, pictures, **kind)
    truth, x = (np.concatenate([materials(free), lighting().ravel()]) for _ in range(2))
    turned = given
    if normals != "known":
        tilts = 0.2 * np.random.default_rng([pixels, pictures, 1]).normal(size=(2, 2, pixels))
        turned = reference.turned(given, tilts[0])
        truth, x = (
            np.insert(place, free.materials, tilt.ravel())
            for place, tilt in zip((truth, x), tilts, strict=True)
        )
        free = dataclasses.replace(free, free_normals=True)
    images = reference.render(turned, views, free.expand(truth))[..., :channels]
    unknowns = free
    if lights == "known":
        known = x[free.maps :].reshape(pictures, coefficients, channels)
        unknowns = dataclasses.replace(free, lighting=known)
        truth, x = truth[: free.maps], x[: free.maps]
    shape = {"none": None, "sample": (pictures, pixels), "channel": images.shape}[weights]
    of_samples = None
    if shape is not None:
        of_samples = rng.random(shape, dtype=np.float32)
        of_samples[rng.random(shape) < 0.1] = 0
        of_samples[0] = np.maximum(of_samples[0], 0.01)  # no picture of one pixel without any
    return Planted(images.astype(np.float32), given, views, of_samples, unknowns, truth, x)


def assert_agrees(
    found: tuple[float, Array],
    expected: tuple[float, Array],
    case: Planted,
    bars: Mapping[str, float] = MappingProxyType({}),
) -> None:
    """Loss within 1e-6 of itself, and each part of the gradient within 1e-5 of its norm.

    `bars` has other parts of the norm, by name.
    """
    (loss, gradient), (expected_loss, expected_gradient) = found, expected
    assert gradient.shape == expected_gradient.shape
    assert gradient.dtype == np.float64
    missed = abs(loss - expected_loss) / expected_loss
    assert missed <= 1e-6, f"loss misses by {missed:.3g} of itself"
    for name, block in case.unknowns.blocks.items():
        error = np.linalg.norm(gradient[block] - expected_gradient[block])
        norm = np.linalg.norm(expected_gradient[block])
        within = bars.get(name, 1e-5) * norm
        assert error <= within, f"gradient by {name} misses by {error:.3g}, norm {norm:.3g}"


# --- Against the reference ---

SIZES = [
    # pixels, pictures: around a vector, around one and more blocks of 128
    *((pixels, 3) for pixels in (1, 15, 16, 17, 127, 128, 129, 255, 256, 257, 300, 513)),
    # around a rectangle of 4 pictures, around one and more groups of 16
    *((130, pictures) for pictures in (1, 2, 3, 4, 5, 15, 16, 17, 25, 33)),
    *((17, pictures) for pictures in (1, 2, 16, 25)),
    (5000, 3),
    (5000, 16),
    (20000, 2),
]


@pytest.mark.parametrize(("pixels", "pictures"), SIZES)
def test_loss_and_gradient(pixels: int, pictures: int) -> None:
    case = planted(pixels, pictures)
    problem = case.problem()
    assert problem.size == case.x.size == 5 * pixels + 48 * pictures
    assert (problem.pixels, problem.pictures) == (pixels, pictures)
    assert_agrees(problem.value_and_grad(case.x), case.expected(case.x), case)


KINDS: list[dict[str, Any]] = [
    {"channels": channels, "sh_order": order, "weights": weights, "lights": lights, "metallic": m}
    | {"normals": normals}
    for channels in (1, 3)
    for order in (2, 3)
    for weights in ("none", "sample", "channel")
    for lights in ("free", "known")
    for m in (None, 0.0, 0.3)
    for normals in ("known", "free")
]


def label(kind: dict[str, Any]) -> str:
    metallic = "free" if kind["metallic"] is None else kind["metallic"]
    return (
        f"{kind['channels']} channels, order {kind['sh_order']}, weights {kind['weights']}, "
        f"lights {kind['lights']}, normals {kind['normals']}, metallic {metallic}"
    )


@pytest.mark.parametrize(("pixels", "pictures"), [(1, 2), (301, 5), (129, 19)])
@pytest.mark.parametrize("kind", KINDS, ids=label)
def test_every_kind_of_problem(kind: dict[str, Any], pixels: int, pictures: int) -> None:
    case = planted(pixels, pictures, **kind)
    problem = case.problem()
    assert problem.size == case.x.size == case.unknowns.size
    assert (problem.channels, problem.coefficients) == (
        kind["channels"],
        case.unknowns.coefficients,
    )
    assert_agrees(problem.value_and_grad(case.x), case.expected(case.x), case)


@pytest.mark.parametrize(
    ("pixels", "pictures"), [(1, 1), (17, 2), (128, 3), (129, 1), (300, 5), (1025, 3)]
)
def test_render(pixels: int, pictures: int) -> None:
    case = planted(pixels, pictures)
    images = case.render(case.x)
    assert images.shape == (pictures, pixels, 3)
    assert images.dtype == np.float64
    expected = reference.render(case.normals, case.views, case.x)
    missed = np.abs(images - expected).max() / np.abs(expected).max()
    assert missed <= 1e-13, f"render misses by {missed:.3g} of the brightest"


@pytest.mark.parametrize("pictures", [1, 3, 16])
def test_loss_vanishes_at_the_truth(pictures: int) -> None:
    # The pictures are rounded to float32 and so is every product: errors of about 1e-7 of the
    # radiance, whose squares are 1e-14.
    case = planted(700, pictures)
    loss, _ = case.problem().value_and_grad(case.truth)
    assert loss <= 1e-13 * np.mean(case.images.astype(np.float64) ** 2)


@pytest.mark.parametrize("weights", ["none", "sample", "channel"])
@pytest.mark.parametrize("sh_order", [2, 3])
@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize(("pixels", "pictures"), [(1, 1), (300, 3), (5000, 4)])
def test_light_equations(
    pixels: int, pictures: int, channels: int, sh_order: int, weights: str
) -> None:
    # Per channel Wᵀ Ω W, for each picture if it has an Ω of its own, and Wᵀ Ω T for each.
    case = planted(pixels, pictures, channels=channels, sh_order=sh_order, weights=weights)
    gram, right = case.problem(2).light_equations(case.x[: case.unknowns.maps])
    albedo, roughness, metallic, _ = reference.unpack(case.unknowns.expand(case.x), pixels)
    w = reference.shade(case.normals, case.views, albedo, roughness, metallic)
    w = w[:, :channels, : case.unknowns.coefficients]
    omega = np.ones((pictures, pixels, channels))
    if case.weights is not None:
        omega *= case.weights if weights == "channel" else case.weights[..., None]
    expected_gram = np.einsum("npc,pcj,pck->cnjk", omega, w, w)
    if case.weights is None:
        expected_gram = expected_gram[:, :1]
    expected_right = np.einsum("npc,npc,pck->cnk", omega, case.images.astype(np.float64), w)
    for found, expected in ((gram, expected_gram), (right, expected_right)):
        assert found.shape == expected.shape
        missed = np.abs(found - expected).max() / np.abs(expected).max()
        assert missed <= 1e-6, f"light equations miss by {missed:.3g} of the largest entry"


# --- A part that is not used changes nothing ---


@pytest.mark.parametrize("weights", ["sample", "channel"])
@pytest.mark.parametrize("value", [1.0, 0.37])
def test_equal_weights_are_no_weights(value: float, weights: str) -> None:
    case = planted(300, 5)
    shape = case.images.shape[: 2 if weights == "sample" else 3]
    weighted = case.problem(weights=np.full(shape, value, np.float32))
    assert_agrees(weighted.value_and_grad(case.x), case.problem().value_and_grad(case.x), case)


@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize("weights", ["sample", "channel"])
def test_samples_of_weight_zero_have_no_say(channels: int, weights: str) -> None:
    case = planted(300, 5, channels=channels, weights=weights)
    assert case.weights is not None
    images = case.images.copy()
    images[case.weights == 0] += 1e3
    assert np.count_nonzero(images != case.images) > 50
    loss, gradient = case.problem(images=images).value_and_grad(case.x)
    expected_loss, expected_gradient = case.problem().value_and_grad(case.x)
    assert loss == expected_loss
    np.testing.assert_array_equal(gradient, expected_gradient)


def test_a_pixel_or_picture_of_weight_zero_is_as_if_left_out() -> None:
    case = planted(257, 4, weights="sample")
    assert case.weights is not None
    weights = case.weights.copy()
    pixels, pictures = np.arange(257) % 3 != 0, np.array([0, 1, 3])
    weights[:, ~pixels] = weights[2] = 0
    loss, gradient = case.problem(weights=weights).value_and_grad(case.x)
    fewer = dataclasses.replace(
        case,
        images=case.images[pictures][:, pixels],
        normals=case.normals[pixels],
        views=case.views[pixels],
        weights=case.weights[pictures][:, pixels],
        unknowns=reference.Unknowns(int(pixels.sum()), 3),
    )

    def part(x: Array, pixels: Array, pictures: Array) -> Array:
        maps, lights = x[: 5 * 257].reshape(5, 257), x[5 * 257 :].reshape(4, 48)
        return np.concatenate([maps[:, pixels].ravel(), lights[pictures].ravel()])

    assert not part(gradient, ~pixels, np.array([2])).any()
    expected = fewer.problem().value_and_grad(part(case.x, pixels, pictures))
    assert_agrees((loss, part(gradient, pixels, pictures)), expected, fewer)


@pytest.mark.parametrize("weights", ["none", "sample"])
def test_order_two_is_order_three_without_band_three(weights: str) -> None:
    case = planted(300, 5, sh_order=2, weights=weights)
    lights = np.zeros((5, 16, 3))
    lights[:, :9] = case.x[case.unknowns.maps :].reshape(5, 9, 3)
    x = np.concatenate([case.x[: case.unknowns.maps], lights.ravel()])
    loss, gradient = case.problem(sh_order=3).value_and_grad(x)
    by_lights = gradient[case.unknowns.maps :].reshape(5, 16, 3)
    assert by_lights[:, 9:].any()
    gradient = np.concatenate([gradient[: case.unknowns.maps], by_lights[:, :9].ravel()])
    assert_agrees(case.problem().value_and_grad(case.x), (loss, gradient), case)


@pytest.mark.parametrize("weights", ["none", "sample", "channel"])
@pytest.mark.parametrize("sh_order", [2, 3])
@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize(("pixels", "pictures"), [(1, 1), (300, 5), (3000, 17)])
def test_known_lights_give_the_same_bits(
    pixels: int, pictures: int, channels: int, sh_order: int, weights: str
) -> None:
    kind: dict[str, Any] = {"channels": channels, "sh_order": sh_order, "weights": weights}
    free = planted(pixels, pictures, **kind)
    known = planted(pixels, pictures, **kind, lights="known")
    loss, gradient = free.problem().value_and_grad(free.x)
    loss_known, gradient_known = known.problem().value_and_grad(known.x)
    assert loss_known == loss
    np.testing.assert_array_equal(gradient_known, gradient[: free.unknowns.maps])


@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize("metallic", [0.0, 0.3, 1.0])
def test_known_metallic_gives_the_same_bits(metallic: float, channels: int) -> None:
    known = planted(300, 5, channels=channels, metallic=metallic)
    free = planted(300, 5, channels=channels)
    where = known.unknowns.blocks["roughness"].stop
    x = np.insert(known.x, where, np.full(300, metallic))
    loss, gradient = known.problem().value_and_grad(known.x)
    free_loss, free_gradient = free.problem(images=known.images).value_and_grad(x)
    assert loss == free_loss
    np.testing.assert_array_equal(gradient, np.delete(free_gradient, np.s_[where : where + 300]))


def test_a_grey_problem_is_a_colour_problem_of_equal_channels() -> None:
    grey = planted(300, 5, channels=1)
    images = np.repeat(grey.images, 3, axis=-1)
    problem = grey.problem(images=images)
    loss, gradient = problem.value_and_grad(grey.unknowns.expand(grey.x))
    found = grey.problem().value_and_grad(grey.x)
    assert_agrees(found, (loss, grey.unknowns.restrict(gradient)), grey)


# --- The gradient against the loss itself ---

SLOPES: list[dict[str, Any]] = [
    {"pixels": 40, "pictures": 3},
    {"pixels": 900, "pictures": 5},
    {"pixels": 300, "pictures": 17, "sh_order": 2, "weights": "sample"},
    {"pixels": 300, "pictures": 5, "channels": 1, "weights": "channel"},
    {"pixels": 300, "pictures": 5, "lights": "known", "metallic": 0.0},
    {"pixels": 300, "pictures": 5, "normals": "in front"},
    {"pixels": 300, "pictures": 17, "sh_order": 2, "weights": "sample", "normals": "in front"},
    {"pixels": 300, "pictures": 5, "channels": 1, "lights": "known", "normals": "in front"},
]


@pytest.mark.parametrize(
    ("kind", "block"),
    [(kind, block) for kind in SLOPES for block in [*planted(**kind).unknowns.blocks, "all"]],
    ids=str,
)
def test_gradient_against_finite_differences(kind: dict[str, Any], block: str) -> None:
    case = planted(**kind)
    problem = case.problem()
    rng = np.random.default_rng(7)
    x = case.inside()
    # Along the signs of the gradient, half of them turned at random: a direction in which the
    # loss changes by much more than its noise, yet not a steepest one.
    loss, gradient = problem.value_and_grad(x)
    direction = np.sign(gradient) * rng.choice([1, 1, 1, -1], size=x.size) * rng.random(x.size)
    if block != "all":
        inside = np.zeros(x.size)
        inside[case.unknowns.blocks[block]] = 1
        direction *= inside
    numerical, estimate = ridders(lambda t: problem.value_and_grad(x + t * direction)[0], 0.1)
    predicted = float(gradient @ direction)
    # Each of the P·N·3 residuals carries a rounding error of some 2⁻²⁴ of the radiance, so the
    # loss is noisy by about 2·2⁻²⁴·√loss·rms/√(P·N·3) at random, and a difference quotient over
    # h by that over h. At h = 0.025 that is below 1e-5 of the slopes here; Ridders' scheme
    # takes the step at which this and the truncation error are balanced, and says how well.
    assert float(estimate) <= 1e-4 * abs(predicted), "the comparison itself is too noisy"
    missed = abs(float(numerical) - predicted) / abs(predicted)
    assert missed <= 1e-4, f"slope misses by {missed:.3g} (loss {loss:.3g}, slope {predicted:.3g})"


@pytest.mark.parametrize("kind", SLOPES, ids=str)
def test_gradient_is_the_adjoint_of_render(kind: dict[str, Any]) -> None:
    # Pictures that differ from the render by w make the gradient 2/Σω · Jᵀ Ω w. Jv is taken from
    # differences of the float64 renderer; w is Jv and as much noise, so that ⟨Jv, Ω w⟩ is no
    # near-zero.
    case = planted(**kind)
    rng = np.random.default_rng(8)
    x = case.inside()
    v = rng.uniform(-1, 1, size=x.size)
    rendered = case.render(x)
    forward, _ = ridders(lambda t: case.render(x + t * v), 0.1)  # Jv
    noise = rng.normal(size=rendered.shape)
    images = (rendered - forward - noise * np.std(forward)).astype(np.float32)
    omega = np.ones_like(rendered)
    if case.weights is not None:
        omega *= case.weights[..., None] if case.weights.ndim == 2 else case.weights
    w = omega * (rendered - images)
    _, gradient = case.problem(images=images).value_and_grad(x)
    left, right = float(np.sum(forward * w)), float(v @ gradient) * omega.sum() / 2
    # Residuals are rounded at 2⁻²⁴ of the radiance, each at random.
    missed = abs(left - right) / (np.linalg.norm(forward) * np.linalg.norm(w))
    assert missed <= 1e-6, f"⟨Jv, w⟩ = {left:.9g}, ⟨v, Jᵀw⟩ = {right:.9g}: {missed:.3g} apart"


# --- Same bits ---

MANY: list[dict[str, Any]] = [
    {"pixels": 1, "pictures": 1},
    {"pixels": 300, "pictures": 3},
    {"pixels": 5000, "pictures": 5},
    {"pixels": 5000, "pictures": 17, "weights": "sample", "sh_order": 2, "channels": 1},
    {"pixels": 5000, "pictures": 5, "normals": "free"},
]


@pytest.mark.parametrize("kind", MANY, ids=str)
def test_thread_count_does_not_change_a_bit(kind: dict[str, Any]) -> None:
    case = planted(**kind)
    maps = case.x[: case.unknowns.maps]
    loss, gradient = case.problem(1).value_and_grad(case.x)
    equations = case.problem(1).light_equations(maps)
    images = case.render(case.x)
    for threads in (2, 3, 5, 8):
        problem = case.problem(threads)
        for _ in range(3):
            other_loss, other_gradient = problem.value_and_grad(case.x)
            assert other_loss == loss
            np.testing.assert_array_equal(other_gradient, gradient)
        for found, expected in zip(problem.light_equations(maps), equations, strict=True):
            np.testing.assert_array_equal(found, expected)
        np.testing.assert_array_equal(case.render(case.x, threads), images)


def test_calls_from_several_python_threads() -> None:
    case = planted(2000, 4)
    problem = case.problem(2)
    places = [case.x, case.truth, 0.5 * (case.x + case.truth)] * 4
    expected = [problem.value_and_grad(x) for x in places]
    with ThreadPoolExecutor(4) as pool:
        found = list(pool.map(problem.value_and_grad, places))
    for (loss, gradient), (expected_loss, expected_gradient) in zip(found, expected, strict=True):
        assert loss == expected_loss
        np.testing.assert_array_equal(gradient, expected_gradient)


def test_arrays_of_the_caller_stay_the_callers() -> None:
    case = planted(300, 3)
    images, x = case.images.copy(), case.x.copy()
    normals, views = case.normals.copy(), case.views.copy()
    problem = Problem(images, normals, views, 2)
    before = problem.value_and_grad(x)
    np.testing.assert_array_equal(x, case.x)
    np.testing.assert_array_equal(images, case.images)
    # What the caller does with his arrays afterwards changes nothing, nor does what he does with
    # an answer.
    images[:], normals[:], views[:] = 7, np.nan, 0
    after = problem.value_and_grad(x)
    assert after[0] == before[0]
    np.testing.assert_array_equal(after[1], before[1])
    kept = before[1].copy()
    before[1][:] = 0
    np.testing.assert_array_equal(problem.value_and_grad(x)[1], kept)


def test_strided_input_is_read_as_what_it_is() -> None:
    case = planted(300, 3)
    expected = case.problem().value_and_grad(case.x)
    problem = Problem(
        np.asfortranarray(case.images),
        np.repeat(case.normals, 2, axis=0)[::2],
        case.views[::-1].copy()[::-1],
        1,
    )
    found = problem.value_and_grad(np.repeat(case.x, 3)[::3])
    assert found[0] == expected[0]
    np.testing.assert_array_equal(found[1], expected[1])


# --- Refusals ---


def with_entry(array: Array, value: float) -> Any:
    changed = array.copy()
    changed.reshape(-1)[-1] = value
    return changed


GOOD = planted(20, 2)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("images", GOOD.images[:, :19]),
        ("images", GOOD.images[..., :2]),
        ("images", GOOD.images[:0]),
        ("images", with_entry(GOOD.images, math.nan)),
        ("images", with_entry(GOOD.images, math.inf)),
        ("normals", GOOD.normals[:, :2]),
        ("normals", with_entry(GOOD.normals, math.nan)),
        ("normals", np.zeros((20, 3))),
        ("normals", 3 * GOOD.normals),
        ("views", GOOD.views[:19]),
        ("views", GOOD.views[:, :2]),
        ("views", with_entry(GOOD.views, math.nan)),
        ("views", np.zeros((20, 3))),
    ],
)
def test_bad_arrays_are_refused_by_name(name: str, value: Any) -> None:
    arrays: dict[str, Any] = {
        "images": GOOD.images,
        "normals": GOOD.normals,
        "views": GOOD.views,
    }
    with pytest.raises(InputError, match=name) as refusal:
        Problem(**(arrays | {name: value}), threads=1)
    assert "\n" not in str(refusal.value)


@pytest.mark.parametrize(
    "x",
    [
        GOOD.x[:-1],
        np.concatenate([GOOD.x, [0.0]]),
        np.empty(0),
        with_entry(GOOD.x, math.nan),
        with_entry(GOOD.x, -math.inf),
        np.concatenate([GOOD.x[:79], [1 + 1e-9], GOOD.x[80:]]),  # a roughness above 1
        np.concatenate([[-1e-9], GOOD.x[1:]]),  # an albedo below 0
    ],
)
def test_a_bad_x_is_refused(x: Array) -> None:
    with pytest.raises(InputError, match=r"^x\b"):
        GOOD.problem().value_and_grad(x)


@pytest.mark.parametrize(
    "maps",
    [
        GOOD.x,
        GOOD.x[:99],
        np.empty(0),
        with_entry(GOOD.x[:100], math.nan),
        with_entry(GOOD.x[:100], 1 + 1e-9),
        np.concatenate([[-1e-9], GOOD.x[1:100]]),
    ],
)
def test_bad_maps_are_refused(maps: Array) -> None:
    with pytest.raises(InputError, match=r"^maps\b"):
        GOOD.problem().light_equations(maps)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("weights", np.ones((2, 19), np.float32)),
        ("weights", np.ones((2, 20, 1), np.float32)),
        ("weights", np.ones(40, np.float32)),
        ("weights", np.ones((2, 20), np.float64)),
        ("weights", np.zeros((2, 20), np.float32)),
        ("weights", with_entry(np.ones((2, 20), np.float32), -1e-9)),
        ("weights", with_entry(np.ones((2, 20), np.float32), math.nan)),
        ("weights", with_entry(np.ones((2, 20), np.float32), math.inf)),
        ("sh_order", 1),
        ("sh_order", 4),
        ("metallic", -1e-9),
        ("metallic", 1 + 1e-9),
        ("metallic", math.nan),
        ("lighting", np.ones((2, 9, 3))),
        ("lighting", np.ones((2, 16, 1))),
        ("lighting", np.ones((3, 16, 3))),
        ("lighting", np.ones((2, 16, 3), np.float32)),
        ("lighting", with_entry(np.ones((2, 16, 3)), math.nan)),
    ],
)
def test_bad_options_are_refused_by_name(name: str, value: Any) -> None:
    with pytest.raises(InputError, match=f"^{name}: expected") as refusal:
        GOOD.problem(**{name: value})
    assert "\n" not in str(refusal.value)


@pytest.mark.parametrize("name", ["images", "normals", "views"])
def test_wrong_kinds_of_array_are_refused_by_name(name: str) -> None:
    arrays: dict[str, Any] = {
        "images": GOOD.images,
        "normals": GOOD.normals,
        "views": GOOD.views,
    }
    for value in (arrays[name][0], arrays[name].astype(np.int64), "bunny"):
        with pytest.raises(InputError, match=f"^{name}: expected an array"):
            Problem(**(arrays | {name: value}), threads=1)


# --- Fork: a child never hangs, whatever its parent did before ---

TIME_LIMIT = 60.0
multithreaded_fork = pytest.mark.filterwarnings(
    "ignore:This process .* is multi-threaded:DeprecationWarning"
)


def evaluate_in_child(problem: Problem | None, case: Planted, expected: float) -> bool:
    """An inherited problem and a new one, two threads each, give the parent's loss."""
    problems = [case.problem(2)] if problem is None else [problem, case.problem(2), problem]
    return all(p.value_and_grad(case.x)[0] == expected for p in problems)


def child_process(case: Planted, expected: float) -> None:
    """Entry point of a multiprocessing child; a false answer is exit code 1."""
    if not evaluate_in_child(None, case, expected):
        raise SystemExit(1)


@multithreaded_fork
@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork on this system")
def test_forked_child_computes_and_ends() -> None:
    case = planted(3000, 4)
    problem = case.problem(2)
    expected, _ = problem.value_and_grad(case.x)  # the parent's threads exist from here on
    child = os.fork()
    if child == 0:
        code = 2
        try:
            code = 0 if evaluate_in_child(problem, case, expected) else 1
        finally:
            os._exit(code)
    deadline = time.monotonic() + TIME_LIMIT
    ended, status = os.waitpid(child, os.WNOHANG)
    while not ended and time.monotonic() < deadline:
        time.sleep(0.01)
        ended, status = os.waitpid(child, os.WNOHANG)
    if not ended:
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)
        pytest.fail(f"the forked child hung for {TIME_LIMIT:.0f} s")
    assert os.waitstatus_to_exitcode(status) == 0, "1: other loss than the parent, 2: exception"
    # The parent is none the worse for it.
    assert problem.value_and_grad(case.x)[0] == expected


@multithreaded_fork
@pytest.mark.parametrize("method", multiprocessing.get_all_start_methods())
def test_multiprocessing_child_computes_and_ends(method: str) -> None:
    case = planted(3000, 4)
    expected, _ = case.problem(2).value_and_grad(case.x)
    context: Any = multiprocessing.get_context(method)
    process = context.Process(target=child_process, args=(case, expected))
    process.start()
    process.join(TIME_LIMIT)
    hung = process.is_alive()
    if hung:
        process.kill()
        process.join()
    assert not hung, f"the {method} child hung for {TIME_LIMIT:.0f} s"
    assert process.exitcode == 0
