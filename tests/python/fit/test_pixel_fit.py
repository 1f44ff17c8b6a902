"""Best materials with known lights: against scipy on a slow model, and at every extreme."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import least_squares

import reference
from pbrfit import _core
from pbrfit._core import InputError

Array = NDArray[np.float64]
Pixels = NDArray[np.uint64]

ROUGHNESS = np.linspace(0.05, 1, 12)
METALLIC = np.linspace(0, 1, 6)
NODES = ROUGHNESS, METALLIC
NONE = np.empty(0), np.empty(0)


@dataclasses.dataclass(frozen=True)
class Kind:
    """A kind of problem; weights of each sample, of each pixel of each picture, or none."""

    channels: int = 3
    sh_order: int = 3
    metallic: float | None = None
    weights: int | None = None
    free_lights: bool = False

    @property
    def unknowns(self) -> int:
        return self.channels + (2 if self.metallic is None else 1)


KINDS = (
    Kind(),
    Kind(free_lights=True),
    Kind(sh_order=2),
    Kind(channels=1),
    Kind(metallic=0.3, weights=2),
    Kind(channels=1, sh_order=2, metallic=0.0),
    Kind(weights=3),
)


class Example:
    """Random pixels under random lights, rendered by the reference; `truth` may be changed."""

    def __init__(
        self,
        kind: Kind = KINDS[0],
        pixels: int = 60,
        pictures: int = 16,
        noise: float = 0.0,
        change: Callable[[Array], None] | None = None,
        brightness: float = 1.0,
    ) -> None:
        rng = np.random.default_rng(3)
        self.kind, self.pixels = kind, pixels
        p, n, c, k = pixels, pictures, kind.channels, (kind.sh_order + 1) ** 2
        self.normals = reference.unit(rng.normal(size=(p, 3)) * 0.4 + (0, 0, 1))
        self.views = reference.unit(rng.normal(size=(p, 3)) * 0.1 + (0, 0, 1))
        self.truth = rng.uniform(0.1, 0.9, (p, 5))  # three albedos, roughness, metallic
        if change is not None:
            change(self.truth)
        if kind.metallic is not None:
            self.truth[:, 4] = kind.metallic
        self.truth = np.delete(self.truth, np.s_[c:3], axis=1)
        self.lights = brightness * rng.normal(size=(n, k, c)) * 0.4
        self.lights[:, 0] = brightness * rng.uniform(1, 3, (n, c))
        self.omega = np.ones((p, n, c))
        self.weights = None
        if kind.weights is not None:
            weights = rng.uniform(0.2, 1, (n, p, c)[: kind.weights]).astype(np.float32)
            self.weights = weights
            self.omega[:] = (weights if weights.ndim == 3 else weights[..., None]).swapaxes(0, 1)
        self.targets = self.radiance(self.truth, slice(None))
        self.targets += noise * rng.normal(size=self.targets.shape)

    def radiance(self, materials: Array, pixels: Any) -> Array:
        """(P, N, C) by the reference; `materials` (P, C + 2)."""
        c, k = self.kind.channels, (self.kind.sh_order + 1) ** 2
        colour = np.broadcast_to(materials[:, :c], (len(materials), 3))
        roughness_metallic = materials[:, c], materials[:, c + 1]
        weights = reference.shade(
            self.normals[pixels], self.views[pixels], colour, *roughness_metallic
        )
        return np.asarray(np.einsum("pck,nkc->pnc", weights[:, :c, :k], self.lights))

    def problem(self, threads: int = 1, *, exact: bool = True) -> _core.Problem:
        """With all digits of the targets, or those that float32 holds."""
        targets = np.ascontiguousarray(self.targets.swapaxes(0, 1))
        return _core.Problem(
            list(targets) if exact else targets.astype(np.float32),
            self.normals,
            self.views,
            threads,
            weights=self.weights,
            sh_order=self.kind.sh_order,
            metallic=self.kind.metallic,
            lighting=None if self.kind.free_lights else self.lights,
        )

    def x(self, materials: Array) -> Array:
        """X with materials (P, C + 2)."""
        maps = materials[:, : self.kind.unknowns].T.ravel()
        return np.concatenate([maps, self.lights.ravel()]) if self.kind.free_lights else maps

    def grey(self) -> Array:
        """X that knows nothing."""
        return self.x(np.broadcast_to([0.5] * (self.kind.channels + 2), self.truth.shape))

    def whole(self, found: Array) -> Array:
        """Materials with metallic, known or not."""
        if self.kind.metallic is None:
            return found
        return np.column_stack([found, np.full(len(found), self.kind.metallic)])

    def fit(
        self,
        x: Array | None = None,
        pixels: Pixels | None = None,
        nodes: tuple[Array, Array] | None = None,
        *,
        threads: int = 1,
        exact: bool = True,
        **options: Any,
    ) -> tuple[Array, Array]:
        """Best materials from x, or from nothing, of pixels, or all, and their sums of squares."""
        return self.problem(threads, exact=exact).fit_materials(
            self.grey() if x is None else x,
            self.everything if pixels is None else pixels,
            *(NODES if nodes is None else nodes),
            **options,
        )

    @property
    def everything(self) -> Pixels:
        return np.arange(self.pixels, dtype=np.uint64)

    def squares(self, materials: Array, pixels: Any = slice(None)) -> Array:
        """Σ ω (I − T)² of each pixel, by the reference."""
        residuals = self.radiance(self.whole(materials), pixels) - self.targets[pixels]
        return np.asarray((self.omega[pixels] * residuals**2).sum(axis=(1, 2)))


def explicit(example: Example, found: Array) -> Array:
    """Σ ω (I − T)² at materials of all pixels, by the core's other path."""
    x = example.x(example.whole(found))
    return example.problem().normal_equations(x, example.everything)[2]


@cache
def noisy(kind: Kind) -> Example:
    return Example(kind, pixels=8, pictures=8, noise=0.03)


def best_of_scipy(
    example: Example, p: int, mean: Array | None = None, precision: Array | None = None
) -> float:
    """Least Σ ω (I − T)² + Σ precision (v − mean)² of a pixel, from many starts."""
    kind = example.kind
    root = np.sqrt(example.omega[p])

    def residuals(v: Array) -> Array:
        materials = example.whole(v[None])
        parts = [root * (example.radiance(materials, slice(p, p + 1))[0] - example.targets[p])]
        if mean is not None and precision is not None:
            parts.append(np.sqrt(precision[p]) * (v[kind.channels :] - mean[p]))
        return np.concatenate([part.ravel() for part in parts])

    starts = [
        np.array([0.5] * kind.channels + [r, m])[: kind.unknowns]
        for r in (0.2, 0.5, 0.8)
        for m in ((0.1, 0.8) if kind.metallic is None else (0.0,))
    ]
    found = (least_squares(residuals, s, bounds=(0, 1), xtol=1e-12, ftol=1e-12) for s in starts)
    return min(2 * float(result.cost) for result in found)


@pytest.mark.parametrize("kind", KINDS, ids=str)
def test_no_start_of_scipys_ends_lower(kind: Kind) -> None:
    example = noisy(kind)
    found, squares = example.fit(starts=4, steps=40, exact_steps=5)
    assert found.shape == (8, kind.unknowns)
    np.testing.assert_allclose(squares, example.squares(found), rtol=1e-11)
    for p in range(8):
        assert squares[p] <= best_of_scipy(example, p) * (1 + 1e-7)


@pytest.mark.parametrize("kind", [KINDS[0], KINDS[4]], ids=str)
def test_a_prior_is_minimised_with_the_squares(kind: Kind) -> None:
    example = noisy(kind)
    rng = np.random.default_rng(0)
    shape = 8, kind.unknowns - kind.channels
    mean, precision = rng.uniform(0.1, 0.9, shape), rng.uniform(0, 0.3, shape)
    found, squares = example.fit(starts=4, steps=40, exact_steps=5, mean=mean, precision=precision)
    # What is handed out is without the prior, what is least is with it.
    np.testing.assert_allclose(squares, example.squares(found), rtol=1e-11)
    total = squares + (precision * (found[:, kind.channels :] - mean) ** 2).sum(axis=1)
    for p in range(8):
        assert total[p] <= best_of_scipy(example, p, mean, precision) * (1 + 1e-7)
    stiff, _ = example.fit(mean=mean, precision=np.full(shape, 1e12))
    np.testing.assert_allclose(stiff[:, kind.channels :], mean, atol=1e-9)


@pytest.mark.parametrize("kind", KINDS, ids=str)
def test_noise_free_materials_are_found_from_nothing(kind: Kind) -> None:
    example = Example(kind)
    truth = example.truth[:, : kind.unknowns]
    for exact, median, most in ((False, 1e-7, 2e-6), (True, 1e-14, 1e-12)):
        found, squares = example.fit(exact=exact, starts=2, exact_steps=2)
        error = np.abs(found - truth).max(axis=1)
        assert np.median(error) < median
        assert error.max() < most
        if exact:
            assert squares.max() < 1e-27


def test_rounded_targets_move_materials_as_far_as_they_say() -> None:
    """To first order by A⁻¹JᵀΩ times what was rounded away."""
    example = Example()
    problem, x = example.problem(), example.x(example.truth)
    by_material, _, _ = problem.derivatives(x, example.everything)
    matrices, _, _ = problem.normal_equations(x, example.everything)
    jacobian = np.zeros((60, 16, 3, 5))
    for c in range(3):
        jacobian[:, :, c, c] = by_material[:, :, c, 0]
    jacobian[..., 3:] = by_material[..., 1:]
    rounding = example.targets.astype(np.float32) - example.targets
    right = np.einsum("pncj,pnc->pj", jacobian, rounding)
    expected = np.linalg.solve(matrices, right[..., None])[..., 0]
    found, _ = example.fit(exact=False, starts=2, exact_steps=2)
    np.testing.assert_allclose(found - example.truth, expected, atol=1e-11)


@pytest.mark.parametrize(
    ("unknown", "value", "tolerance"),
    [
        (0, 0.0, 1e-10),
        (1, 1.0, 1e-10),
        (4, 0.0, 1e-10),
        (4, 1.0, 1e-10),
        (3, 1.0, 1e-10),
        # Radiance depends on r⁴ ln r: what is below is as good as 0.
        (3, 0.0, 2e-3),
        (3, 0.03, 2e-7),
    ],
)
def test_materials_on_bounds_are_found(unknown: int, value: float, tolerance: float) -> None:
    def change(truth: Array) -> None:
        truth[:, unknown] = value

    example = Example(change=change)
    found, squares = example.fit(starts=3, steps=40, exact_steps=6)
    assert (found >= 0).all()
    assert (found <= 1).all()
    assert np.abs(found[:, unknown] - value).max() < tolerance
    assert squares.max() < 1e-16


def test_roughness_0_is_left() -> None:
    """Nothing depends on roughness there, so no gradient says that the pixel should go."""
    example = Example()
    given = example.truth.copy()
    given[:, 3] = 0
    found, squares = example.fit(example.x(given), nodes=NONE, steps=60)
    before = example.squares(given)
    assert (squares < before).all()
    # Most get to the bottom; a few may end in another minimum.
    assert np.mean(np.abs(found - example.truth).max(axis=1) < 1e-9) > 0.9


def test_roughness_0_stays_where_it_is_best() -> None:
    def change(truth: Array) -> None:
        truth[:, 3] = 0

    example = Example(change=change)
    found, squares = example.fit(example.x(example.truth), nodes=NONE)
    assert squares.max() < 1e-27
    assert np.abs(found - example.truth).max() < 2e-3


def dark(example: Example) -> None:
    example.targets[:] = 0


def unlit(example: Example) -> None:
    example.lights[:] = 0


def blind(example: Example) -> None:
    """Half of the pixels count in no picture."""
    assert example.weights is not None
    example.weights[:, ::2] = 0
    example.omega[::2] = 0


@pytest.mark.parametrize("brightness", [1e-12, 1.0, 1e12])
@pytest.mark.parametrize("pictures", [1, 2, 16])
@pytest.mark.parametrize("change", [dark, unlit, blind, None])
def test_whatever_the_pictures_show_it_ends_no_worse(
    change: Callable[[Example], None] | None, pictures: int, brightness: float
) -> None:
    kind = KINDS[6] if change is blind else KINDS[0]
    noise = 0.05 * brightness
    example = Example(kind, pixels=40, pictures=pictures, noise=noise, brightness=brightness)
    if change is not None:
        change(example)
    rng = np.random.default_rng(1)
    given = rng.uniform(0, 1, (40, 5))
    given[rng.random((40, 5)) < 0.2] = 0
    given[rng.random((40, 5)) < 0.2] = 1
    before = explicit(example, given)
    x = example.x(given)
    every: tuple[dict[str, Any], ...] = (
        {},
        {"starts": 3, "exact_steps": 4},
        {"steps": 0},
        {"starts": 0},
    )
    for options in every:
        found, squares = example.fit(x, **options)
        assert ((found >= 0) & (found <= 1)).all()
        assert (squares <= before).all()
        # To the last bit what the normal equations say there.
        np.testing.assert_array_equal(squares, explicit(example, found))
        if change is unlit:
            np.testing.assert_array_equal(squares, before)
    scale = (example.omega * example.targets**2).sum(axis=(1, 2))
    found, squares = example.fit(x, nodes=NONE, exact_steps=0)
    assert (squares <= before + 1e-13 * scale + 1e-13 * before).all()
    np.testing.assert_allclose(squares, explicit(example, found), atol=1e-13 * scale.max())


def test_the_best_is_left_alone() -> None:
    example = Example()
    given = example.truth.copy()
    found, squares = example.fit(example.x(given))
    assert squares.max() < 1e-28
    assert np.abs(found - given).max() < 1e-12


def test_more_starts_never_end_higher() -> None:
    example = Example(pixels=300, pictures=4, noise=0.05)
    ends = [example.fit(starts=starts, exact_steps=0)[1] for starts in (0, 1, 2, 5)]
    for fewer, more in itertools.pairwise(ends):
        assert (more <= fewer).all()
    assert (ends[-1] < ends[0] * (1 - 1e-3)).any()


@pytest.mark.parametrize("kind", [KINDS[0], KINDS[4]], ids=str)
def test_bits_do_not_depend_on_threads_or_other_pixels(kind: Kind) -> None:
    example = Example(kind, pixels=700, pictures=5, noise=0.02)
    rng = np.random.default_rng(2)
    shape = 700, kind.unknowns - kind.channels
    mean, precision = rng.uniform(0, 1, shape), rng.uniform(0, 0.1, shape)
    given = np.clip(example.truth + rng.normal(0, 0.2, example.truth.shape), 0, 1)

    def fit(threads: int, pixels: Pixels) -> tuple[Array, Array]:
        prior: dict[str, Any] = {"mean": mean[pixels], "precision": precision[pixels]}
        return example.fit(
            example.x(given), pixels, threads=threads, starts=2, exact_steps=2, **prior
        )

    found, squares = fit(1, example.everything)
    for threads in (2, 3, 4):
        again, squares_again = fit(threads, example.everything)
        np.testing.assert_array_equal(again, found)
        np.testing.assert_array_equal(squares_again, squares)
    order = rng.permutation(700).astype(np.uint64)
    for pixels in (order, order[:37], order[:1], np.repeat(order[:2], 200)):
        again, squares_again = fit(2, pixels)
        np.testing.assert_array_equal(again, found[pixels])
        np.testing.assert_array_equal(squares_again, squares[pixels])


def test_no_pixels_give_no_materials() -> None:
    example = noisy(KINDS[0])
    found, squares = example.fit(pixels=np.empty(0, np.uint64))
    assert found.shape == (0, 5)
    assert squares.shape == (0,)


TWO = np.full((3, 2), 0.5)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"pixels": np.array([8], np.uint64)}, "pixels: expected indices below 8, found 8"),
        ({"roughness": np.array([0.5, 1.5])}, r"roughness: expected numbers in \[0, 1\]"),
        ({"metallic": np.array([np.nan])}, r"metallic: expected numbers in \[0, 1\]"),
        ({"x": np.full(3, 0.5)}, "x: expected shape"),
        ({"x": np.full(40, 1.5)}, "x .*: expected numbers in"),
        ({"mean": TWO}, "precision: expected an array beside mean, found None"),
        ({"precision": TWO}, "mean: expected an array beside precision, found None"),
        ({"mean": TWO[:2], "precision": TWO}, r"mean: expected shape \[3, 2\]"),
        ({"mean": TWO, "precision": TWO[:, :1]}, r"precision: expected shape \[3, 2\]"),
        ({"mean": TWO, "precision": -TWO}, "precision: expected numbers from 0, found -0.5 at 0"),
        ({"mean": TWO * np.nan, "precision": TWO}, "mean: expected finite numbers"),
        ({"mean": TWO, "precision": TWO * np.inf}, "precision: expected finite numbers"),
    ],
)
def test_bad_input_is_refused(change: dict[str, Any], message: str) -> None:
    example = noisy(KINDS[0])
    arguments: dict[str, Any] = {"x": example.grey(), "pixels": np.arange(3, dtype=np.uint64)}
    arguments |= {"roughness": ROUGHNESS, "metallic": METALLIC} | change
    with pytest.raises(InputError, match=message):
        example.problem().fit_materials(**arguments)
