"""Pixels whose normals are free: derivatives, normal matrices, best materials with normals."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import reference
import tangent_offsets
from pbrfit import _core
from pbrfit._core import InputError

Array = NDArray[np.float64]
Pixels = NDArray[np.uint64]

ROUGHNESS = np.linspace(0.05, 1, 12)
METALLIC = np.linspace(0, 1, 6)
CLAMP = reference.CLAMP


@dataclasses.dataclass(frozen=True)
class Kind:
    """A kind of problem; weights of each pixel of a picture (2), of each sample (3), or none."""

    channels: int = 3
    sh_order: int = 3
    metallic: float | None = None
    weights: int | None = None

    @property
    def of_material(self) -> int:
        return self.channels + (2 if self.metallic is None else 1)


KINDS = (
    Kind(),
    Kind(weights=3),
    Kind(metallic=0.3, weights=2),
    Kind(channels=1, sh_order=2),
    Kind(channels=1, metallic=0.0),
)


class Example:
    """Random pixels under known lights, with normals changed from the given ones.

    Half of the pixels are seen at grazing angles, on both sides of the clamp of n·v.
    """

    def __init__(
        self,
        kind: Kind = KINDS[0],
        pixels: int = 300,
        pictures: int = 12,
        *,
        grazing: bool = True,
        degrees: float = 12.0,
        noise: float = 0.0,
    ) -> None:
        rng = np.random.default_rng(11)
        self.kind, self.pixels, self.pictures = kind, pixels, pictures
        p, n, c, k = pixels, pictures, kind.channels, (kind.sh_order + 1) ** 2
        self.views = reference.unit(rng.normal(size=(p, 3)) * 0.1 + (0, 0, 1))
        self.offsets = rng.normal(size=(p, 2))
        self.offsets *= np.tan(np.radians(degrees)) / np.linalg.norm(self.offsets, axis=1)[:, None]
        self.given = reference.unit(rng.normal(size=(p, 3)) * 0.4 + (0, 0, 1))
        if grazing:
            # v·n from -0.2 to 0.2 at the given normal, some within the clamp when changed.
            side = reference.unit(np.cross(self.views, rng.normal(size=(p, 3))))
            cosine = rng.uniform(-0.2, 0.2, (p, 1))
            graze = cosine * self.views + np.sqrt(1 - cosine**2) * side
            self.given[::2] = reference.unit(graze)[::2]
        self.normals = tangent_offsets.changed(self.given, self.offsets)
        self.truth = rng.uniform(0.1, 0.9, (p, c + 2))
        if kind.metallic is not None:
            self.truth[:, -1] = kind.metallic
        self.lights = rng.normal(size=(n, k, c)) * 0.4
        self.lights[:, 0] = rng.uniform(1, 3, (n, c))
        self.omega = np.ones((p, n, c))
        self.weights = None
        if kind.weights is not None:
            weights = rng.uniform(0.2, 1, (n, p, c)[: kind.weights]).astype(np.float32)
            self.weights = weights
            self.omega[:] = (weights if weights.ndim == 3 else weights[..., None]).swapaxes(0, 1)
        self.targets = self.radiance(self.truth, self.normals)
        self.targets += noise * rng.normal(size=self.targets.shape)

    def material(self, values: Array) -> tuple[Array, Array, Array]:
        c = self.kind.channels
        colour = np.broadcast_to(values[:, :c], (len(values), 3))
        return colour, values[:, c], values[:, c + 1]

    def radiance(self, values: Array, normals: Array) -> Array:
        """(P, N, C) by the reference; `values` (P, C + 2)."""
        c, k = self.kind.channels, (self.kind.sh_order + 1) ** 2
        weights = reference.shade(normals, self.views, *self.material(values))
        return np.asarray(np.einsum("pck,nkc->pnc", weights[:, :c, :k], self.lights))

    def problem(self, threads: int = 1, **options: Any) -> _core.Problem:
        given: dict[str, Any] = {
            "weights": self.weights,
            "sh_order": self.kind.sh_order,
            "metallic": self.kind.metallic,
            "lighting": self.lights,
            "free_normals": True,
        }
        targets = list(np.ascontiguousarray(self.targets.swapaxes(0, 1)))
        normals = options.pop("normals", self.given)
        return _core.Problem(targets, normals, self.views, threads, **(given | options))

    def x(self, values: Array, offsets: Array | None = None) -> Array:
        """X with materials (P, C + 2) and tangent offsets (P, 2), those of the truth by default."""
        offsets = self.offsets if offsets is None else offsets
        return np.hstack([values[:, : self.kind.of_material], offsets]).T.ravel()

    @property
    def everything(self) -> Pixels:
        return np.arange(self.pixels, dtype=np.uint64)

    def total(self, found: Array) -> Array:
        """Σ ω (I − T)² of each pixel at unknowns (P, D), by the reference."""
        material = found[:, : self.kind.of_material]
        if self.kind.metallic is not None:
            material = np.column_stack([material, np.full(len(found), self.kind.metallic)])
        residuals = (
            self.radiance(material, tangent_offsets.changed(self.given, found[:, -2:]))
            - self.targets
        )
        return np.asarray((self.omega * residuals**2).sum(axis=(1, 2)))

    def away(self, degrees: float) -> Array:
        """Tangent offsets at which normals are so far from the true ones."""
        rng = np.random.default_rng(1)
        first, second = tangent_offsets.tangents(self.normals)
        angle = rng.uniform(0, 2 * np.pi, (self.pixels, 1))
        aside = np.cos(angle) * first + np.sin(angle) * second
        wrong = self.normals + np.tan(np.radians(degrees)) * aside
        first, second = tangent_offsets.tangents(self.given)
        along = np.sum(wrong * self.given, axis=1)
        return np.column_stack(
            [np.sum(wrong * first, axis=1) / along, np.sum(wrong * second, axis=1) / along]
        )

    def degrees(self, found: Array) -> Array:
        """Between normals of unknowns (P, D) and the true ones."""
        apart = np.linalg.norm(
            tangent_offsets.changed(self.given, found[:, -2:]) - self.normals, axis=1
        )
        return np.asarray(np.degrees(2 * np.arcsin(apart / 2)))


@pytest.mark.parametrize("kind", KINDS, ids=str)
def test_derivatives_by_tangent_offsets_are_those_of_the_slow_model(kind: Kind) -> None:
    example = Example(kind)
    cosine = np.sum(example.normals * example.views, axis=1)
    assert np.count_nonzero(cosine < CLAMP) > 20
    assert np.count_nonzero(np.abs(cosine - CLAMP) < 0.1) > 20
    by_unknowns, by_light, _ = example.problem().derivatives(
        example.x(example.truth), example.everything
    )
    c, k = kind.channels, (kind.sh_order + 1) ** 2
    assert by_unknowns.shape == (300, 12, c, 5)
    material = example.material(example.truth)
    weights = reference.shade(example.normals, example.views, *material)[:, :c, :k]
    np.testing.assert_allclose(by_light, weights, rtol=0, atol=1e-13)
    slopes = tangent_offsets.weights_by_offsets(
        example.given, example.views, example.offsets, *material
    )
    for axis, slope in enumerate(slopes):
        expected = np.einsum("pck,nkc->pnc", slope[:, :c, :k], example.lights)
        found = by_unknowns[..., 3 + axis]
        scale = np.abs(expected).max(axis=(1, 2), keepdims=True)
        assert (np.abs(found - expected) <= 1e-8 * scale).all()


def test_derivatives_by_tangent_offsets_are_those_of_residuals() -> None:
    """Differences of residuals, which are rounded to float32, far enough from the clamp."""
    example = Example(pictures=6)
    problem, step = example.problem(), 2e-3
    by_unknowns, _, _ = problem.derivatives(example.x(example.truth), example.everything)
    clear = np.abs(np.sum(example.normals * example.views, axis=1) - CLAMP) > 0.15
    assert np.count_nonzero(clear) > 150
    for axis in range(2):

        def at(steps: int, axis: int = axis) -> Array:
            moved = example.offsets.copy()
            moved[:, axis] += steps * step
            found = problem.residuals(example.x(example.truth, moved), example.everything)
            return found.astype(np.float64).swapaxes(0, 1)

        slope = (8 * (at(1) - at(-1)) - (at(2) - at(-2))) / (12 * step)
        # Residuals are about 1e-2 here, and float32 knows them to 6e-8 of that.
        found = by_unknowns[..., 3 + axis]
        np.testing.assert_allclose(found[clear], slope[clear], rtol=0, atol=1e-6)


def test_slopes_at_the_clamp_are_those_of_one_side() -> None:
    """The clamped cosine does not move below the clamp, and moves above; the mirror always does."""
    example = Example(pixels=2, grazing=False)
    example.views[:] = 0, 0, 1
    offsets = np.zeros((2, 2))
    for p, cosine in enumerate((CLAMP * 0.9, CLAMP * 1.1)):
        example.given[p] = np.sqrt(1 - cosine**2), 0, cosine
    by_unknowns, _, _ = example.problem().derivatives(
        example.x(example.truth, offsets), example.everything
    )
    step = 1e-7
    material = example.material(example.truth)
    for t in range(2):
        moved = [offsets.copy(), offsets.copy()]
        moved[0][:, t] -= step
        moved[1][:, t] += step
        low, high = (
            reference.shade(tangent_offsets.changed(example.given, m), example.views, *material)
            for m in moved
        )
        slope = np.einsum("pck,nkc->pnc", (high - low) / (2 * step), example.lights)
        scale = np.abs(slope).max()
        np.testing.assert_allclose(by_unknowns[..., 3 + t], slope, rtol=0, atol=1e-5 * scale)


def jacobian(kind: Kind, by_unknowns: Array) -> Array:
    """Derivatives (P, N, C, 5) by all unknowns of a pixel: (P, N, C, D)."""
    c = kind.channels
    own = by_unknowns[..., :1] * np.eye(c)
    shared = by_unknowns[..., 1:] if kind.metallic is None else by_unknowns[..., [1, 3, 4]]
    return np.concatenate([own, shared], axis=-1)


@pytest.mark.parametrize("kind", KINDS, ids=str)
def test_normal_equations_are_products_of_derivatives(kind: Kind) -> None:
    example = Example(kind, noise=0.05)
    problem, x = example.problem(), example.x(example.truth)
    matrices, gradient, squares = problem.normal_equations(x, example.everything)
    by_unknowns, _, weights = problem.derivatives(x, example.everything)
    np.testing.assert_array_equal(weights, example.omega)
    j = jacobian(kind, by_unknowns)
    residuals = example.radiance(example.truth, example.normals) - example.targets
    expected = np.einsum("pncd,pnc,pnce->pde", j, weights, j)
    assert matrices.shape == expected.shape
    np.testing.assert_allclose(matrices, expected, rtol=0, atol=1e-12 * np.abs(expected).max())
    right = np.einsum("pncd,pnc,pnc->pd", j, weights, residuals)
    np.testing.assert_allclose(gradient, right, rtol=0, atol=1e-11 * np.abs(right).max())
    np.testing.assert_allclose(squares, (weights * residuals**2).sum(axis=(1, 2)), rtol=1e-10)


@pytest.mark.parametrize("kind", KINDS, ids=str)
def test_pixels_move_with_the_lights(kind: Kind) -> None:
    example = Example(kind, pixels=140)
    problem, x = example.problem(), example.x(example.truth)
    d, k = kind.of_material + 2, (kind.sh_order + 1) ** 2
    rng = np.random.default_rng(2)
    covariances = rng.normal(size=(140, d, d))
    covariances += covariances.swapaxes(1, 2)
    modes = rng.normal(size=(3, example.pictures, k, kind.channels))
    by_unknowns, by_light, weights = problem.derivatives(x, example.everything)
    moved = np.einsum("pck,mnkc->mpnc", by_light, modes)
    tied = np.einsum("pncd,pnc,mpnc->mpd", jacobian(kind, by_unknowns), weights, moved)
    expected = (np.einsum("pde,mpe->mpd", covariances, tied) ** 2).sum(axis=0)
    found = problem.moves_with_lights(x, example.everything, covariances, modes)
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-9 * np.abs(expected).max())


def fit(example: Example, x: Array, threads: int = 1, **options: Any) -> tuple[Array, Array]:
    given: dict[str, Any] = {"starts": 2, "steps": 20, "exact_steps": 40}
    pixels = options.pop("pixels", example.everything)
    return example.problem(threads).fit_materials(
        x, pixels, ROUGHNESS, METALLIC, **(given | options)
    )


@pytest.mark.parametrize("kind", KINDS, ids=str)
def test_materials_and_normals_are_found_from_normals_5_degrees_off(kind: Kind) -> None:
    example = Example(kind, grazing=False)
    start = example.away(5)
    np.testing.assert_allclose(example.degrees(start), 5, atol=1e-9)
    x = example.x(np.full_like(example.truth, 0.5), start)
    found, squares = fit(example, x)
    assert found.shape == (300, kind.of_material + 2)
    np.testing.assert_allclose(squares, example.total(found), rtol=1e-6, atol=1e-24)
    error = np.abs(found - np.hstack([example.truth[:, : kind.of_material], example.offsets]))
    assert np.mean(error.max(axis=1) < 1e-7) > 0.95
    assert np.median(example.degrees(found)) < 1e-9


@pytest.mark.parametrize("held", [False, True])
@pytest.mark.parametrize("kind", KINDS, ids=str)
def test_it_ends_no_worse_than_it_began(kind: Kind, held: bool) -> None:
    """Squared residuals and prior, from any materials and normals, however few steps."""
    example = Example(kind, noise=0.05)
    rng = np.random.default_rng(3)
    values = np.clip(rng.uniform(-0.2, 1.2, example.truth.shape), 0, 1)
    start = rng.normal(size=(300, 2)) * rng.choice([0.0, 0.1, 1.0, 30.0], (300, 1))
    x = example.x(values, start)
    began = np.hstack([values[:, : kind.of_material], start])
    shape = 300, kind.of_material + 2 - kind.channels
    centre, precision = rng.uniform(-0.5, 1, shape), rng.uniform(0, 1, shape)

    def prior(unknowns: Array) -> Array:
        offset = unknowns[:, kind.channels :] - centre
        return np.asarray((precision * offset**2).sum(axis=1))

    before = example.problem().normal_equations(x, example.everything)[2]
    for options in ({}, {"starts": 0, "exact_steps": 1}, {"steps": 0}):
        found, squares = fit(example, x, held_normals=held, **options)
        assert (squares <= before).all()
        again = example.problem().normal_equations(found.T.ravel(), example.everything)[2]
        np.testing.assert_array_equal(squares, again)
        found, squares = fit(
            example, x, held_normals=held, mean=centre, precision=precision, **options
        )
        assert (squares + prior(found) <= (before + prior(began)) * (1 + 1e-12)).all()
        lengths = np.linalg.norm(found[:, -2:], axis=1)
        longest = np.maximum(np.sqrt(3), np.linalg.norm(start, axis=1))
        assert (lengths <= longest * (1 + 1e-12)).all()
        assert ((found[:, :-2] >= 0) & (found[:, :-2] <= 1)).all()
        if held:
            np.testing.assert_array_equal(found[:, -2:], start)


@pytest.mark.parametrize("kind", KINDS, ids=str)
def test_held_normals_leave_the_fit_of_materials(kind: Kind) -> None:
    """To the rounding of normals, of a problem that was given the changed ones."""
    example = Example(kind, grazing=False, noise=0.02)
    x = example.x(np.full_like(example.truth, 0.5))
    found, squares = fit(example, x, held_normals=True, exact_steps=3)
    held = example.problem(normals=example.normals, free_normals=False)
    maps = np.full(kind.of_material * example.pixels, 0.5)
    expected, least = held.fit_materials(
        maps, example.everything, ROUGHNESS, METALLIC, starts=2, steps=20, exact_steps=3
    )
    np.testing.assert_allclose(squares, least, rtol=1e-8)
    same = np.abs(found[:, :-2] - expected).max(axis=1) < 1e-6
    assert np.mean(same) > 0.98
    # Without steps on residuals normals stay as well.
    found, _ = fit(example, x, exact_steps=0)
    np.testing.assert_array_equal(found[:, -2:], example.offsets)


def test_a_stiff_prior_draws_tangent_offsets_to_its_mean() -> None:
    example = Example(grazing=False, noise=0.02)
    centre = np.hstack([np.zeros((300, 2)), 0.5 * example.offsets])
    precision = np.hstack([np.zeros((300, 2)), np.full((300, 2), 1e12)])
    found, _ = fit(example, example.x(example.truth), mean=centre, precision=precision)
    # A decrease of 1e-14 of what there was to begin with is taken for rounding.
    np.testing.assert_allclose(found[:, -2:], 0.5 * example.offsets, atol=1e-7)


@pytest.mark.parametrize("kind", [KINDS[0], KINDS[2]], ids=str)
def test_bits_do_not_depend_on_threads_or_other_pixels(kind: Kind) -> None:
    example = Example(kind, pixels=700, pictures=5, noise=0.02)
    rng = np.random.default_rng(4)
    shape = 700, kind.of_material + 2 - kind.channels
    pull = {"mean": rng.uniform(0, 1, shape), "precision": rng.uniform(0, 0.1, shape)}
    x = example.x(np.clip(example.truth + rng.normal(0, 0.1, example.truth.shape), 0, 1))

    def answers(threads: int, pixels: Pixels) -> list[Array]:
        problem = example.problem(threads)
        of_pixels = {name: values[pixels] for name, values in pull.items()}
        return [
            *fit(example, x, threads, pixels=pixels, exact_steps=6, **of_pixels),
            *problem.normal_equations(x, pixels),
            *problem.derivatives(x, pixels),
        ]

    expected = answers(1, example.everything)
    for threads in (2, 3, 4):
        for one, other in zip(answers(threads, example.everything), expected, strict=True):
            np.testing.assert_array_equal(one, other)
    order = rng.permutation(700).astype(np.uint64)
    for pixels in (order, order[:1], np.repeat(order[:2], 200)):
        for one, other in zip(answers(2, pixels), expected, strict=True):
            np.testing.assert_array_equal(one, other[pixels])


def test_a_prior_without_tangent_offsets_is_refused() -> None:
    example = Example(pixels=3)
    two = np.full((3, 2), 0.5)
    message = r"^mean: expected shape \[3, 4\], found shape \[3, 2\]$"
    with pytest.raises(InputError, match=message):
        fit(example, example.x(example.truth), mean=two, precision=two)
