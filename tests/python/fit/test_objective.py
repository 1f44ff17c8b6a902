"""The fast objective, `_core.Problem`: float32 inside, against float64 references.

With the paper's model the reference is the tests' own; with the principled one it is `_core.shade`
and `_core.shade_vjp`, pixel by pixel, which have tests of their own.
"""

from __future__ import annotations

import itertools
import math
import os
import signal
import time
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import reference
from pbrfit import InputError, _core
from pbrfit._core import Problem
from pbrfit.model.reflection import MODELS, Model
from random_pixels import Example, Kind
from reference import unit
from scene_kinds import with_entry

Array = NDArray[Any]

Pixel = tuple[Array, Array, Array, Array, Array]
"""Normal, view, albedo, roughness and metallic."""

PLAIN = Kind()

both_models = pytest.mark.parametrize("model", MODELS)


class Seen(Example):
    """Pixels all around, one in ten seen from behind, materials on the bounds here and there.

    A tenth of the samples, where those have weights, counts nothing.
    """

    def __init__(self, kind: Kind = PLAIN, pixels: int = 300, pictures: int = 5) -> None:
        rng = np.random.default_rng([pixels, pictures])

        def to_bounds(truth: Array) -> None:
            truth[rng.random(truth.shape) < 0.05] = 0
            truth[rng.random(truth.shape) < 0.05] = 1

        super().__init__(kind, pixels, pictures, change=to_bounds)
        self.given, self.views = unit(rng.normal(size=(2, pixels, 3)))
        facing = np.where(np.arange(pixels) % 10 == 9, -1, 1)[:, None]
        self.views *= facing * np.sign(np.sum(self.given * self.views, axis=-1, keepdims=True))
        if self.weights is not None:
            self.weights[rng.random(self.weights.shape) < 0.1] = 0
            self.weights[0] = np.maximum(self.weights[0], 0.01)  # one of each pixel counts
        self.take(self.radiance(self.truth) + 0.3 * rng.normal(size=self.targets.shape))

    def take(self, targets: Array) -> None:
        """Other pictures, as float32 has them."""
        self.targets = targets.astype(np.float32).astype(np.float64)

    @property
    def images(self) -> NDArray[np.float32]:
        """(N, P, C)."""
        return self.targets.swapaxes(0, 1).astype(np.float32)

    def fast(self, threads: int = 1, **options: Any) -> Problem:
        """The problem of these images, all at once."""
        return self.problem(threads, **({"images": self.images} | options))

    @property
    def blocks(self) -> dict[str, slice]:
        """Where each kind of unknown lies in x."""
        kind, p = self.kind, self.pixels
        lengths = {
            "albedo": kind.channels * p,
            "roughness": p,
            "metallic": p * (kind.metallic is None),
            "offsets": 2 * p * kind.free_normals,
            "lights": 0 if kind.known_lights else self.lights.size,
        }
        ends = np.cumsum([0, *lengths.values()])
        blocks = zip(lengths, ends[:-1], ends[1:], strict=True)
        return {name: slice(int(a), int(b)) for name, a, b in blocks if a < b}

    def expected(self, model: Model = "paper") -> tuple[float, Array]:
        """Loss and gradient by the reference."""
        kind, at = self.kind, self.material(self.truth)
        albedo, r, m = (np.ascontiguousarray(part) for part in at)
        pixel = (self.normals, self.views, albedo, r, m)
        weights = reference.shade(*pixel) if model == "paper" else _core.shade(*pixel, model)
        weights = weights[:, : kind.channels, : kind.coefficients]
        residual = np.einsum("pck,nkc->pnc", weights, self.lights) - self.targets
        value, slope = reference.squares(residual)
        omega = self.omega
        scaled = omega * slope / omega.sum()
        if model == "paper":
            by_unknowns = np.einsum("pnc,pncd->dp", scaled, self.jacobian()[0])
        else:
            by_unknowns = self.principled_slopes(pixel, scaled)
        parts = [by_unknowns.ravel()]
        if not kind.known_lights:
            parts.append(np.einsum("pnc,pck->nkc", scaled, weights).ravel())
        return float(np.sum(omega * value) / omega.sum()), np.concatenate(parts)

    def principled_slopes(self, pixel: Pixel, scaled: Array) -> Array:
        """Derivatives (D, P) of a sum over samples whose slopes by radiance are `scaled`."""
        kind = self.kind
        by_weight = np.zeros((self.pixels, 3, 16))
        by_weight[:, : kind.channels, : kind.coefficients] = np.einsum(
            "pnc,nkc->pck", scaled, self.lights
        )
        by_albedo, by_r, by_m, by_normal = _core.shade_vjp(*pixel, by_weight, "principled")
        rows = [*by_albedo.T[: kind.channels], by_r]
        if kind.metallic is None:
            rows.append(by_m)
        if kind.free_normals:
            directions = reference.turned_by(self.given, self.offsets.T)
            rows += [np.sum(by_normal * direction, axis=-1) for direction in directions]
        return np.stack(rows)

    def check(self, model: Model = "paper") -> None:
        """Loss within 1e-6 of itself, and each part of the gradient within 1e-5 of its norm.

        Slopes of the principled model's table by roughness lose 3e-5 in float32, a tenth of their
        own error, which shows where little light comes by the lobe.
        """
        loss, gradient = self.fast(model=model).value_and_grad(self.x())
        expected_loss, expected = self.expected(model)
        assert gradient.shape == expected.shape
        assert gradient.dtype == np.float64
        assert np.isfinite(gradient).all()
        missed = abs(loss - expected_loss) / expected_loss
        assert missed <= 1e-6, f"loss misses by {missed:.3g} of itself"
        for name, block in self.blocks.items():
            share = 5e-5 if (model, name) == ("principled", "roughness") else 1e-5
            error = np.linalg.norm(gradient[block] - expected[block])
            norm = np.linalg.norm(expected[block])
            assert error <= share * norm, f"{name} misses by {error:.3g}, norm {norm:.3g}"


SIZES = [
    # pixels, pictures: around a vector, around one and more blocks of 128
    *((pixels, 3) for pixels in (1, 15, 16, 17, 127, 128, 129, 255, 256, 257, 300, 513)),
    # around a rectangle of 4 pictures, around one and more groups of 16
    *((130, pictures) for pictures in (1, 2, 3, 4, 5, 15, 16, 17, 25, 33)),
    *((17, pictures) for pictures in (1, 2, 16, 25)),
    (5000, 3),
]


@both_models
@pytest.mark.parametrize(("pixels", "pictures"), SIZES)
def test_loss_and_gradient(pixels: int, pictures: int, model: Model) -> None:
    case = Seen(Kind(), pixels, pictures)
    problem = case.fast()
    assert problem.size == case.x().size == 5 * pixels + 48 * pictures
    assert (problem.pixels, problem.pictures) == (pixels, pictures)
    case.check(model)


KINDS = [
    Kind(channels, order, metallic, False, weights, known_lights, free_normals)
    for channels, order, weights, known_lights, metallic, free_normals in itertools.product(
        (1, 3), (2, 3), (None, 2, 3), (False, True), (None, 0.0, 0.3), (False, True)
    )
]


@pytest.mark.parametrize("kind", KINDS, ids=str)
def test_every_kind_of_problem(kind: Kind) -> None:
    """Of the principled model; tests/rust/objective.rs has every kind of the paper's."""
    # Of few pixels, slopes of the table's splines may all but cancel.
    case = Seen(kind, 301, 5)
    problem = case.fast()
    assert (problem.channels, problem.coefficients) == (kind.channels, kind.coefficients)
    case.check("principled")


@pytest.mark.parametrize("free_normals", [False, True])
def test_extreme_pixels(free_normals: bool) -> None:
    """All pairs of extreme materials and angles, among them lobes that only mirror."""
    roughness = [0.0, 1e-9, 1e-3, 0.0199, 0.3, 1.0]
    # Not at n·v = 1e-4 itself, where lobes stop changing and a rounding decides.
    angles = [1.0, 0.5, 0.02, 1e-3, 1.2e-4, 8e-5, 0.0, -0.3]
    grid = np.meshgrid(roughness, angles, [0.0, 1e-6, 1.0], [0.0, 1.0], indexing="ij")
    r, cosine, albedo, metallic = (part.ravel() for part in grid)
    case = Seen(Kind(free_normals=free_normals), len(r), 3)
    case.given, other = unit(np.random.default_rng(5).normal(size=(2, len(r), 3)))
    aside = unit(np.cross(case.given, other))
    case.views = unit(cosine[:, None] * case.given + np.sqrt(1 - cosine**2)[:, None] * aside)
    case.truth = np.stack([albedo, albedo, albedo, r, metallic], axis=1)
    case.offsets[:] = 0
    case.check("principled")


@pytest.mark.parametrize("weights", [None, 2, 3])
@pytest.mark.parametrize("sh_order", [2, 3])
@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize(("pixels", "pictures"), [(1, 1), (1300, 3)])
def test_light_equations(
    pixels: int, pictures: int, channels: int, sh_order: int, weights: int | None
) -> None:
    # Per channel Wᵀ Ω W, for each picture if it has an Ω of its own, and Wᵀ Ω T for each.
    case = Seen(Kind(channels, sh_order, weights=weights, known_lights=True), pixels, pictures)
    found = case.fast(2, lighting=None).light_equations(case.x())
    _, w = case.slopes()
    gram = np.einsum("pnc,pcj,pck->cnjk", case.omega, w, w)
    right = np.einsum("pnc,pnc,pck->cnk", case.omega, case.targets, w)
    for one, expected in zip(found, (gram if weights else gram[:, :1], right), strict=True):
        assert one.shape == expected.shape
        missed = np.abs(one - expected).max() / np.abs(expected).max()
        assert missed <= 1e-6, f"light equations miss by {missed:.3g} of the largest entry"


def test_calls_from_several_python_threads() -> None:
    case = Seen(pixels=2000)
    problem = case.fast(2)
    places = [case.x(), 0.5 * case.x(), 0.9 * case.x()] * 4
    expected = [problem.value_and_grad(x) for x in places]
    with ThreadPoolExecutor(4) as pool:
        found = list(pool.map(problem.value_and_grad, places))
    for (loss, gradient), (expected_loss, expected_gradient) in zip(found, expected, strict=True):
        assert loss == expected_loss
        np.testing.assert_array_equal(gradient, expected_gradient)


def test_arrays_of_the_caller_stay_the_callers() -> None:
    case = Seen()
    images, normals, views, x = case.images.copy(), case.given.copy(), case.views.copy(), case.x()
    problem = Problem(images, normals, views, 2)
    before = problem.value_and_grad(x)
    np.testing.assert_array_equal(x, case.x())
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


GOOD = Seen(Kind(), 20, 2)
X = GOOD.x()


HALVES = np.full((2, 20), 0.5, np.float32)

UNUSABLE: list[tuple[str, Any, str]] = [
    ("images", GOOD.images[..., :2], "1 or 3 channels"),
    ("images", GOOD.images[:0], "at least one picture and one pixel"),
    ("images", with_entry(GOOD.images, math.nan), "finite numbers, found NaN at 119"),
    ("normals", np.zeros((20, 3)), r"unit vectors, found \[0, 0, 0\]"),
    ("normals", 3 * GOOD.given, "unit vectors"),
    ("views", np.zeros((20, 3)), r"unit vectors, found \[0, 0, 0\]"),
    ("weights", 0 * HALVES, "some weight above 0"),
    ("weights", with_entry(HALVES, -1), r"numbers in \[0, 1\], found -1 at 39"),
    ("sh_order", 1, "2 or 3"),
    ("sh_order", 4, "2 or 3"),
    ("metallic", -1e-9, r"numbers in \[0, 1\]"),
    ("metallic", 1 + 1e-9, r"numbers in \[0, 1\]"),
    ("metallic", math.nan, r"numbers in \[0, 1\]"),
]
"""An argument, a value, and what the message expects."""


@pytest.mark.parametrize(("name", "value", "expected"), UNUSABLE)
def test_unusable_arguments_are_refused_by_name(name: str, value: Any, expected: str) -> None:
    with pytest.raises(InputError, match=f"^{name}: expected {expected}") as refusal:
        GOOD.fast(**{name: value})
    assert "\n" not in str(refusal.value)


def at(index: int, value: float) -> Array:
    x = X.copy()
    x[index] = value
    return x


MATERIALS = r" \(albedo, roughness, metallic\): expected numbers in \[0, 1\]"
BAD_X = [
    (X[:-1], ": expected"),
    (np.concatenate([X, [0.0]]), ": expected"),
    (np.empty(0), ": expected"),
    (at(79, 1 + 1e-9), f"{MATERIALS}, found .* at 79$"),
    (at(0, -1e-9), f"{MATERIALS}, found .* at 0$"),
    (at(60, -0.01), f"{MATERIALS}, found -0.01 at 60$"),
    (at(99, math.nan), f"{MATERIALS}, found NaN at 99$"),
    (at(100, math.nan), r" \(lighting\): expected finite numbers"),
    (at(-1, -math.inf), r" \(lighting\): expected finite numbers"),
    (at(100, 1e17), r" \(lighting\): expected numbers up to 1e16 in size"),
]


@both_models
@pytest.mark.parametrize(("x", "message"), BAD_X)
def test_a_bad_x_is_refused(x: Array, message: str, model: Model) -> None:
    chosen = np.arange(3, dtype=np.uint64)
    problem = GOOD.fast(model=model)
    for call in (problem.value_and_grad, lambda x: problem.residuals(x, chosen)):
        with pytest.raises(InputError, match=f"^x{message}"):
            call(x)
    if "lighting" not in message:
        maps = x if len(x) != X.size else x[:100]
        with pytest.raises(InputError, match=f"^maps{message}"):
            problem.light_equations(maps)


# --- Fork: a child never hangs, whatever its parent did before ---

TIME_LIMIT = 60.0


@pytest.mark.filterwarnings("ignore:This process .* is multi-threaded:DeprecationWarning")
@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork on this system")
def test_forked_child_computes_and_ends() -> None:
    """With the problem that it inherited and with a new one."""
    case = Seen(Kind(), 3000, 4)
    problem = case.fast(2)
    expected, _ = problem.value_and_grad(case.x())  # the parent's threads exist from here on
    child = os.fork()
    if child == 0:
        code = 2
        try:
            problems = (problem, case.fast(2), problem)
            code = int(any(p.value_and_grad(case.x())[0] != expected for p in problems))
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
    assert problem.value_and_grad(case.x())[0] == expected
