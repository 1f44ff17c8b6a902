"""The fast objective, `_core.Problem`: float32 inside, against the float64 reference."""

from __future__ import annotations

import math
import multiprocessing
import os
import signal
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import reference
from finite_differences import ridders
from pbrfit import InputError
from pbrfit._core import Problem
from reference import unit

Array = NDArray[np.floating[Any]]

BLOCKS = ("albedo", "roughness", "metallic", "lighting")


@dataclass(frozen=True)
class Planted:
    """Pictures made from `truth`, and another place `x` to evaluate at."""

    images: NDArray[np.float32]  # (N, P, 3)
    normals: NDArray[np.float64]  # (P, 3)
    views: NDArray[np.float64]  # (P, 3)
    truth: NDArray[np.float64]
    x: NDArray[np.float64]

    def problem(self, threads: int = 1) -> Problem:
        return Problem(self.images, self.normals, self.views, threads)

    def blocks(self) -> dict[str, slice]:
        pixels = len(self.normals)
        ends = [0, 3 * pixels, 4 * pixels, 5 * pixels, self.x.size]
        return {name: slice(*ends[i : i + 2]) for i, name in enumerate(BLOCKS)}


def planted(pixels: int, pictures: int, seed: int = 0) -> Planted:
    """Random pixels, one in ten seen from behind; materials on the bounds here and there."""
    rng = np.random.default_rng([seed, pixels, pictures])
    normals, views = unit(rng.normal(size=(2, pixels, 3)))
    facing = np.where(np.arange(pixels) % 10 == 9, -1, 1)[:, None]
    views *= facing * np.sign(np.sum(normals * views, axis=-1, keepdims=True))

    def unknowns() -> NDArray[np.float64]:
        materials = rng.random(5 * pixels)
        materials[rng.random(5 * pixels) < 0.05] = 0
        materials[rng.random(5 * pixels) < 0.05] = 1
        lighting = 0.5 * rng.normal(size=(pictures, 16, 3))
        lighting[:, 0] = 1 + rng.random((pictures, 3))
        return np.concatenate([materials, lighting.ravel()])

    truth, x = unknowns(), unknowns()
    images = reference.render(normals, views, truth).astype(np.float32)
    return Planted(images, normals, views, truth, x)


# --- Against the reference ---

SIZES = [
    # pixels, pictures: alone, around the tile of 16, around the block of 256, many
    *((pixels, 3) for pixels in (1, 15, 16, 17, 255, 256, 257, 300)),
    *((300, pictures) for pictures in (1, 2, 4, 5, 16)),
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
    loss, gradient = problem.value_and_grad(case.x)
    expected_loss, expected = reference.value_and_grad(
        case.images.astype(np.float64), case.normals, case.views, case.x
    )
    assert gradient.shape == (problem.size,)
    assert gradient.dtype == np.float64
    missed = abs(loss - expected_loss) / expected_loss
    assert missed <= 1e-6, f"loss misses by {missed:.3g} of itself"
    for name, block in case.blocks().items():
        error = np.linalg.norm(gradient[block] - expected[block])
        missed = float(error / np.linalg.norm(expected[block]))
        assert missed <= 1e-5, f"gradient by {name} misses by {missed:.3g} of its norm"


@pytest.mark.parametrize(("pixels", "pictures"), [(1, 1), (17, 2), (300, 5), (5000, 3)])
def test_render(pixels: int, pictures: int) -> None:
    case = planted(pixels, pictures)
    images = case.problem().render(case.x)
    assert images.shape == (pictures, pixels, 3)
    assert images.dtype == np.float32
    expected = reference.render(case.normals, case.views, case.x)
    # Each radiance is a sum of 16 products: a few float32 spacings of the largest of them.
    missed = np.abs(images - expected).max() / np.abs(expected).max()
    assert missed <= 1e-6, f"render misses by {missed:.3g} of the brightest"


@pytest.mark.parametrize("pictures", [1, 3, 16])
def test_loss_vanishes_at_the_truth(pictures: int) -> None:
    # The pictures are rounded to float32 and so is every product: errors of about 1e-7 of the
    # radiance, whose squares are 1e-14.
    case = planted(700, pictures)
    loss, _ = case.problem().value_and_grad(case.truth)
    assert loss <= 1e-13 * np.mean(case.images.astype(np.float64) ** 2)


@pytest.mark.parametrize(("pixels", "pictures"), [(1, 1), (300, 3), (5000, 4)])
def test_light_equations(pixels: int, pictures: int) -> None:
    # Per channel Wᵀ W and, for each picture, Tᵀ W.
    case = planted(pixels, pictures)
    gram, right = case.problem(2).light_equations(case.x)
    albedo, roughness, metallic, _ = reference.unpack(case.x, pixels)
    weights = reference.shade(case.normals, case.views, albedo, roughness, metallic)
    expected_gram = np.einsum("pcj,pck->cjk", weights, weights)
    expected_right = np.einsum("npc,pck->cnk", case.images.astype(np.float64), weights)
    for found, expected in ((gram, expected_gram), (right, expected_right)):
        assert found.shape == expected.shape
        missed = np.abs(found - expected).max() / np.abs(expected).max()
        assert missed <= 1e-6, f"light equations miss by {missed:.3g} of the largest entry"


# --- The gradient against the loss itself ---


@pytest.mark.parametrize("block", [*BLOCKS, "all"])
@pytest.mark.parametrize(("pixels", "pictures"), [(40, 3), (900, 5)])
def test_gradient_against_finite_differences(block: str, pixels: int, pictures: int) -> None:
    case = planted(pixels, pictures)
    problem = case.problem()
    rng = np.random.default_rng(7)
    x = case.x.copy()
    x[: 5 * pixels] = 0.2 + 0.6 * x[: 5 * pixels]  # room for steps on both sides
    # Along the signs of the gradient, half of them turned at random: a direction in which the
    # loss changes by much more than its noise, yet not a steepest one.
    loss, gradient = problem.value_and_grad(x)
    direction = np.sign(gradient) * rng.choice([1, 1, 1, -1], size=x.size) * rng.random(x.size)
    if block != "all":
        inside = np.zeros(x.size)
        inside[case.blocks()[block]] = 1
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


@pytest.mark.parametrize(("pixels", "pictures"), [(40, 3), (900, 5)])
def test_gradient_is_the_adjoint_of_render(pixels: int, pictures: int) -> None:
    # Pictures that differ from the render by w make the gradient 2/(P·N·3) · Jᵀw. Jv is taken
    # from differences of render; w is Jv and as much noise, so that ⟨Jv, w⟩ is no near-zero.
    case = planted(pixels, pictures)
    rng = np.random.default_rng(8)
    x = case.x.copy()
    x[: 5 * pixels] = 0.2 + 0.6 * x[: 5 * pixels]
    v = rng.uniform(-1, 1, size=x.size)
    problem = case.problem()
    rendered = problem.render(x)
    forward, _ = ridders(lambda t: problem.render(x + t * v).astype(np.float64), 0.1)  # Jv
    noise = rng.normal(size=rendered.shape)
    images = (rendered - forward - noise * np.std(forward)).astype(np.float32)
    w = rendered.astype(np.float64) - images
    _, gradient = Problem(images, case.normals, case.views, 1).value_and_grad(x)
    left, right = float(np.sum(forward * w)), float(v @ gradient) * w.size / 2
    # Jv from float32 pictures is good to 2⁻²⁴ of the radiance over a step of 0.05, at random.
    missed = abs(left - right) / (np.linalg.norm(forward) * np.linalg.norm(w))
    assert missed <= 5e-6, f"⟨Jv, w⟩ = {left:.9g}, ⟨v, Jᵀw⟩ = {right:.9g}: {missed:.3g} apart"


# --- Same bits ---


@pytest.mark.parametrize(("pixels", "pictures"), [(1, 1), (300, 3), (5000, 5)])
def test_thread_count_does_not_change_a_bit(pixels: int, pictures: int) -> None:
    case = planted(pixels, pictures)
    loss, gradient = case.problem(1).value_and_grad(case.x)
    images = case.problem(1).render(case.x)
    for threads in (2, 3, 5):
        problem = case.problem(threads)
        for _ in range(3):
            other_loss, other_gradient = problem.value_and_grad(case.x)
            assert other_loss == loss
            np.testing.assert_array_equal(other_gradient, gradient)
        np.testing.assert_array_equal(problem.render(case.x), images)


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


@pytest.mark.parametrize("method", ["value_and_grad", "render", "light_equations"])
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
def test_a_bad_x_is_refused(method: str, x: Array) -> None:
    problem = GOOD.problem()
    with pytest.raises(InputError, match=r"\bx\b"):
        getattr(problem, method)(x)


@pytest.mark.parametrize("name", ["images", "normals", "views"])
def test_wrong_kinds_of_array_are_refused_by_name(name: str) -> None:
    # Number of dimensions and dtype are the signature's business: TypeError.
    arrays: dict[str, Any] = {
        "images": GOOD.images,
        "normals": GOOD.normals,
        "views": GOOD.views,
    }
    for value in (arrays[name][0], arrays[name].astype(np.int64), "bunny"):
        with pytest.raises((InputError, TypeError), match=name):
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
