"""The lights' system with pixels solved for, against the whole one, dense and slow, by numpy."""

from __future__ import annotations

import dataclasses
from functools import cache
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

PIXELS, PICTURES = 170, 8
"""More pixels than are worked on side by side."""

REACH = 0.3
"""Tilts move no further at once."""


@dataclasses.dataclass(frozen=True)
class Kind:
    """A kind of problem; weights of each pixel of a picture (2), of each sample (3), or none."""

    channels: int = 3
    sh_order: int = 3
    metallic: float | None = None
    mono: bool = False
    weights: int | None = None
    damping: float = 0.0
    prior: bool = False
    bounds: bool = False
    known_lights: bool = False
    free_normals: bool = False

    @property
    def of_material(self) -> int:
        return self.channels + (2 if self.metallic is None else 1)

    @property
    def unknowns(self) -> int:
        return self.of_material + (2 if self.free_normals else 0)

    @property
    def coefficients(self) -> int:
        return (self.sh_order + 1) ** 2

    @property
    def light_channels(self) -> int:
        return 1 if self.mono else self.channels


KINDS = {
    "plain": Kind(),
    "damped": Kind(damping=0.3),
    "held at bounds": Kind(bounds=True),
    "held at bounds, with prior and damped": Kind(bounds=True, prior=True, damping=1e-3),
    "with prior": Kind(prior=True),
    "with prior, known metallic": Kind(prior=True, metallic=0.3),
    "mono": Kind(mono=True),
    "mono, damped, weighted": Kind(mono=True, damping=1e-2, weights=2),
    "known metallic": Kind(metallic=0.0, damping=0.1),
    "grey": Kind(channels=1, damping=1e-3),
    "grey, order 2, known metallic, weighted": Kind(
        channels=1, sh_order=2, metallic=0.6, weights=2, prior=True
    ),
    "order 2": Kind(sh_order=2, damping=1e-3),
    "weights of pixels": Kind(weights=2),
    "weights of samples": Kind(weights=3, bounds=True),
    "known lights": Kind(known_lights=True),
    "free normals": Kind(free_normals=True, damping=1e-3),
    "free normals, with prior": Kind(free_normals=True, prior=True),
    "free normals, held at bounds, mono": Kind(
        free_normals=True, bounds=True, mono=True, damping=1e-2
    ),
    "free normals, known metallic, weighted": Kind(
        free_normals=True, metallic=0.3, weights=3, damping=1e-3
    ),
    "free normals, grey, with prior, known metallic": Kind(
        free_normals=True, channels=1, sh_order=2, metallic=0.6, weights=2, prior=True
    ),
    "free normals, grey": Kind(free_normals=True, channels=1, damping=1e-3),
}


class Example:
    """Random pixels under random lights, and pictures that these do not explain."""

    def __init__(self, kind: Kind = KINDS["plain"], seed: int = 3) -> None:
        self.kind = kind
        rng = np.random.default_rng(seed)
        n, c, k = PICTURES, kind.channels, kind.coefficients
        self.given = reference.unit(rng.normal(size=(PIXELS, 3)) * 0.5 + (0, 0, 1))
        self.views = reference.unit(rng.normal(size=(PIXELS, 3)) * 0.1 + (0, 0, 1))
        self.materials = rng.uniform(0.05, 0.95, (PIXELS, c + 2))
        if kind.bounds:
            drawn = rng.random(self.materials.shape)
            self.materials[drawn < 0.15] = 0.0
            self.materials[drawn > 0.85] = 1.0
        if kind.metallic is not None:
            self.materials[:, -1] = kind.metallic
        self.lights = rng.normal(size=(n, k, c)) * 0.4
        self.lights[:, 0] = rng.uniform(1, 3, (n, c))
        if kind.mono:
            self.lights[:] = self.lights[..., :1]
        self.weights = None
        self.omega = np.ones((PIXELS, n, c))
        if kind.weights is not None:
            weights = rng.uniform(0.2, 1, (n, PIXELS, c)[: kind.weights]).astype(np.float32)
            weights[rng.random(weights.shape) < 0.1] = 0
            self.weights = weights
            self.omega[:] = (weights if weights.ndim == 3 else weights[..., None]).swapaxes(0, 1)
        self.images = rng.uniform(0, 2, (n, PIXELS, c)).astype(np.float32)
        self.precision = rng.uniform(0, 30, (PIXELS, kind.unknowns - c)) if kind.prior else None
        self.off = rng.uniform(-0.5, 0.5, (PIXELS, kind.unknowns - c)) if kind.prior else None
        self.pixels = rng.permutation(PIXELS)[:150].astype(np.uint64)
        self.offsets, self.normals = np.zeros((PIXELS, 2)), self.given
        if kind.free_normals:
            self.offsets = 0.2 * rng.normal(size=(PIXELS, 2))
            self.normals = tangent_offsets.changed(self.given, self.offsets)

    def problem(self, threads: int = 1) -> _core.Problem:
        return _core.Problem(
            self.images,
            self.given,
            self.views,
            threads,
            weights=self.weights,
            sh_order=self.kind.sh_order,
            metallic=self.kind.metallic,
            lighting=self.lights if self.kind.known_lights else None,
            free_normals=self.kind.free_normals,
        )

    @property
    def values(self) -> Array:
        """All unknowns of the pixels, (P, D)."""
        materials = self.materials[:, : self.kind.of_material]
        return np.hstack([materials, self.offsets]) if self.kind.free_normals else materials

    @property
    def x(self) -> Array:
        maps = self.values.T.ravel()
        return maps if self.kind.known_lights else np.concatenate([maps, self.lights.ravel()])

    @property
    def size(self) -> int:
        return self.kind.light_channels * PICTURES * self.kind.coefficients

    def options(self, rows: Pixels) -> dict[str, Any]:
        found: dict[str, Any] = {"damping": self.kind.damping, "mono": self.kind.mono}
        if self.precision is not None and self.off is not None:
            found |= {"precision": self.precision[rows], "deviation": self.off[rows]}
        return found

    def ask(self, name: str, *moves: Array, pixels: Pixels | None = None, threads: int = 1) -> Any:
        """What a method of the problem says of these pixels."""
        rows = self.pixels if pixels is None else pixels
        return getattr(self.problem(threads), name)(self.x, rows, *moves, **self.options(rows))

    def moves(self) -> Array:
        """Of the lights."""
        return np.random.default_rng(5).normal(size=self.size) * 0.05


@dataclasses.dataclass(frozen=True)
class Dense:
    """The whole normal equations of some pixels and the lights, with pixels eliminated.

    `forward` (P', D) is A⁻¹ g and `follow` (P', D, M) is A⁻¹ B, 0 for unknowns that are held, and
    `curvature` (P', D, D) is A with 0 in their rows.
    """

    matrix: Array
    gradient: Array
    forward: Array
    follow: Array
    curvature: Array

    def steps(self, moves: Array, of_material: int) -> Array:
        """Of the pixels (P', D) when lights move; with offsets within reach, the best others."""
        steps = -self.forward - self.follow @ moves
        for a, step in zip(self.curvature, steps, strict=True):
            length = np.linalg.norm(step[of_material:])
            if length > REACH:
                free = np.flatnonzero(np.diag(a)[:of_material])
                cut = (REACH / length - 1) * step[of_material:]
                step[of_material:] += cut
                moved = a[free, of_material:] @ cut
                step[free] -= np.linalg.solve(a[np.ix_(free, free)], moved)
        return steps


def dense(example: Example, pixels: Pixels) -> Dense:
    """S = G − Σ Bᵀ A⁻¹ B and s = g_L − Σ Bᵀ A⁻¹ g, from a Jacobian by the reference."""
    kind = example.kind
    c, k, d = kind.channels, kind.coefficients, kind.unknowns
    materials = example.materials[pixels]
    colour = np.broadcast_to(materials[:, :c], (len(pixels), 3))
    where = example.normals[pixels], example.views[pixels]
    at = colour, materials[:, c], materials[:, c + 1]
    weights = reference.shade(*where, *at)[:, :c, :k]
    slopes = [*reference.shade_derivatives(*where, *at)]
    if kind.metallic is not None:
        del slopes[2]
    if kind.free_normals:
        given = example.given[pixels], example.views[pixels], example.offsets[pixels]
        slopes += tangent_offsets.weights_by_offsets(*given, *at)
    of_unknowns = [np.einsum("pck,nkc->pnc", s[:, :c, :k], example.lights) for s in slopes]
    targets = example.images[:, pixels].astype(np.float64).swapaxes(0, 1)
    residuals = np.einsum("pck,nkc->pnc", weights, example.lights) - targets

    matrix, gradient = np.zeros((example.size,) * 2), np.zeros(example.size)
    forward, follow = np.zeros((len(pixels), d)), np.zeros((len(pixels), d, example.size))
    curvature = np.zeros((len(pixels), d, d))
    for i, pixel in enumerate(pixels):
        by_material = np.zeros((PICTURES, c, d))
        for channel in range(c):
            by_material[:, channel, channel] = of_unknowns[0][i, :, channel]
        for unknown in range(c, d):
            by_material[:, :, unknown] = of_unknowns[1 + unknown - c][i]
        # (picture, channel) by (light channel, picture, coefficient)
        by_light = np.zeros((PICTURES, c, kind.light_channels, PICTURES, k))
        for n in range(PICTURES):
            for channel in range(c):
                by_light[n, channel, channel % kind.light_channels, n] = weights[i, channel]
        j = by_material.reshape(-1, d)
        w = by_light.reshape(-1, example.size)
        omega, left = example.omega[pixel].ravel(), residuals[i].ravel()
        a, g, b = j.T @ (omega[:, None] * j), j.T @ (omega * left), j.T @ (omega[:, None] * w)
        if example.precision is not None and example.off is not None:
            a[np.arange(c, d), np.arange(c, d)] += example.precision[pixel]
            g[c:] += example.precision[pixel] * example.off[pixel]
        a += kind.damping * np.diag(np.diag(a))
        values = example.values[pixel]
        held = ((values <= 0) & (g > 0)) | ((values >= 1) & (g < 0))
        held[kind.of_material :] = False
        held |= np.diag(a) == 0
        free = np.flatnonzero(~held)
        solved = np.linalg.solve(a[np.ix_(free, free)], np.column_stack([g, b])[free])
        forward[i, free], follow[i, free] = solved[:, 0], solved[:, 1:]
        curvature[i][np.ix_(free, free)] = a[np.ix_(free, free)]
        matrix += w.T @ (omega[:, None] * w) - b[free].T @ solved[:, 1:]
        gradient += w.T @ (omega * left) - b[free].T @ solved[:, 0]
    return Dense(matrix, gradient, forward, follow, curvature)


@cache
def expected_of(kind: str) -> tuple[Example, Dense]:
    """An example of a kind, and the system of its pixels."""
    example = Example(KINDS[kind])
    return example, dense(example, example.pixels)


def close(found: Array, expected: Array, share: float) -> None:
    np.testing.assert_allclose(found, expected, rtol=0, atol=share * np.abs(expected).max())


def accuracy(kind: Kind) -> float:
    """Of pixels that are nearly singular the core's ridge shows: 1e-12 of their diagonal."""
    return 1e-10 if kind.damping > 0 or kind.prior else 1e-8


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_the_system_of_the_lights_is_what_is_left_of_the_whole_one(kind: str) -> None:
    example, expected = expected_of(kind)
    matrix, gradient = example.ask("schur_complement")
    assert matrix.shape == (example.size, example.size)
    close(matrix, expected.matrix, accuracy(example.kind))
    close(gradient, expected.gradient, accuracy(example.kind))
    np.testing.assert_array_equal(matrix, matrix.T)


@pytest.mark.parametrize("kind", KINDS)
def test_products_are_those_of_the_whole_system(kind: str) -> None:
    example, expected = expected_of(kind)
    moves = example.moves()
    product, gradient = example.ask("schur_product", moves)
    close(product, expected.matrix @ moves, accuracy(example.kind))
    close(gradient, expected.gradient, accuracy(example.kind))


@pytest.mark.parametrize("kind", KINDS)
def test_pixels_follow_the_lights_as_the_whole_system_says(kind: str) -> None:
    example, expected = expected_of(kind)
    moves = example.moves()
    found = example.ask("back_substitute", moves)
    of_material = example.kind.of_material
    before = example.values[example.pixels]
    steps = expected.steps(moves, of_material)
    if example.kind.free_normals:
        lengths = np.linalg.norm(steps[:, of_material:], axis=1)
        assert 0.02 < np.mean(lengths > REACH - 1e-9) < 0.98
    after = before + steps
    if example.kind.bounds:
        held = (expected.forward == 0) & ~expected.follow.any(axis=2)
        assert 10 < np.count_nonzero(held) < held.size / 4
        np.testing.assert_array_equal(found[held], before[held])
    assert (found[:, :of_material] >= 0).all()
    assert (found[:, :of_material] <= 1).all()
    # What leaves its bounds far behind comes of a nearly singular pixel; it is clipped.
    after[:, :of_material] = np.clip(after[:, :of_material], 0, 1)
    np.testing.assert_allclose(found, after, rtol=0, atol=1e-7)


def test_offsets_grow_no_longer_than_tan_60_degrees() -> None:
    example = Example(KINDS["free normals"])
    longest = np.sqrt(3)
    angles = np.random.default_rng(1).uniform(0, 2 * np.pi, PIXELS)
    lengths = np.where(np.arange(PIXELS) % 2, longest - 0.1, longest + 0.5)
    example.offsets = lengths[:, None] * np.column_stack([np.cos(angles), np.sin(angles)])
    pixels = np.arange(PIXELS, dtype=np.uint64)
    # Moves that are large for the lights, so that all steps are as long as they may be.
    moves = 1e3 * example.moves()
    found = example.problem().back_substitute(example.x, pixels, moves, damping=1e-3)[:, -2:]
    after = np.linalg.norm(found, axis=1)
    assert (after <= np.maximum(longest, lengths) * (1 + 1e-12)).all()
    assert np.count_nonzero(after > np.maximum(longest, lengths) * (1 - 1e-12)) > PIXELS / 5
    assert np.linalg.norm(found - example.offsets, axis=1).max() < REACH * (1 + 1e-12)


def test_a_step_solves_the_whole_system() -> None:
    """The lights' step, and what pixels do with it, is the step of all unknowns at once."""
    step_lowers_squares(Example(KINDS["damped"]))
    step_lowers_squares(Example(KINDS["free normals"]))


def step_lowers_squares(example: Example) -> None:
    problem, x, pixels = example.problem(), example.x, example.pixels
    how = example.options(pixels)
    matrix, gradient = problem.schur_complement(x, pixels, **how)
    # Not all directions of the lights are told by these pixels.
    damped = matrix + 1e-2 * np.diag(np.diag(matrix))
    moves = np.asarray(-np.linalg.solve(damped, gradient), dtype=np.float64)
    before = problem.normal_equations(x, pixels)[2].sum()
    moved = x.copy()
    maps = moved[: example.kind.unknowns * PIXELS].reshape(-1, PIXELS)
    for share in (0.01, 0.03):
        maps[:, pixels] = problem.back_substitute(x, pixels, share * moves, **how).T
        step = (share * moves).reshape(3, PICTURES, 16).transpose(1, 2, 0)
        moved[example.kind.unknowns * PIXELS :] = (example.lights + step).ravel()
        assert problem.normal_equations(moved, pixels)[2].sum() < before


@pytest.mark.parametrize("kind", KINDS)
def test_the_order_of_pixels_changes_rounding_alone(kind: str) -> None:
    example = Example(KINDS[kind])
    order = np.random.default_rng(6).permutation(len(example.pixels))
    other, moves = example.pixels[order], example.moves()
    for asked in (("schur_complement",), ("schur_product", moves)):
        for a, b in zip(example.ask(*asked), example.ask(*asked, pixels=other), strict=True):
            close(a, b, 1e-12)
    shuffled = example.ask("back_substitute", moves, pixels=other)
    np.testing.assert_array_equal(example.ask("back_substitute", moves)[order], shuffled)


@pytest.mark.parametrize(
    "kind",
    [
        "held at bounds, with prior and damped",
        "mono, damped, weighted",
        "free normals, with prior",
        "free normals, known metallic, weighted",
    ],
)
def test_the_same_bits_at_any_number_of_threads(kind: str) -> None:
    example = Example(KINDS[kind])
    # So many that there is work for several threads.
    pixels = np.tile(example.pixels, 30)
    moves = example.moves()

    def answers(threads: int) -> list[Array]:
        return [
            *example.ask("schur_complement", pixels=pixels, threads=threads),
            *example.ask("schur_product", moves, pixels=pixels, threads=threads),
            example.ask("back_substitute", moves, pixels=pixels, threads=threads),
        ]

    expected = answers(1)
    for threads in (2, 3, 4):
        for a, b in zip(answers(threads), expected, strict=True):
            np.testing.assert_array_equal(a, b)


def test_pixels_that_nothing_is_known_about_stay() -> None:
    """Black ones, dark lights, a material without a slope, a pixel without weight: no NaN."""
    example = Example(Kind(weights=2))
    assert example.weights is not None
    example.images[:, 0] = 0
    example.weights[:, 1] = 0
    example.omega[1] = 0
    example.materials[2:4] = 0, 0, 0, 0, 0
    example.materials[4:6] = 1, 1, 1, 1, 1
    example.materials[6] = 0.5, 0.5, 0.5, 0.0, 1.0
    pixels = np.arange(8, dtype=np.uint64)
    expected = dense(example, pixels)
    matrix, gradient = example.problem().schur_complement(example.x, pixels)
    close(matrix, expected.matrix, 1e-8)
    close(gradient, expected.gradient, 1e-8)
    moves = example.moves()
    product, _ = example.problem().schur_product(example.x, pixels, moves)
    close(product, expected.matrix @ moves, 1e-8)
    followed = example.problem().back_substitute(example.x, pixels, moves)
    np.testing.assert_array_equal(followed[1], example.materials[1])
    assert followed[6, 3] == 0  # the slope by roughness is r³

    example.lights[:] = 0
    problem = example.problem()
    matrix, gradient = problem.schur_complement(example.x, pixels)
    assert np.isfinite(matrix).all()
    assert np.isfinite(gradient).all()
    np.testing.assert_array_equal(
        problem.back_substitute(example.x, pixels, np.zeros(example.size)), example.materials[:8]
    )


def test_no_pixels_know_nothing() -> None:
    example = Example()
    none = np.empty(0, dtype=np.uint64)
    matrix, gradient = example.problem().schur_complement(example.x, none)
    assert not matrix.any()
    assert not gradient.any()
    assert example.problem().back_substitute(example.x, none, example.moves()).shape == (0, 5)


NAN = np.full(PICTURES * 16 * 3, np.nan)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"damping": -1e-3}, r"^damping: expected a share, 0 or more, found -0.001$"),
        ({"damping": np.nan}, r"^damping: expected a share, 0 or more"),
        ({"damping": np.inf}, r"^damping: expected a share, 0 or more"),
        ({"pixels": np.array([0, PIXELS], dtype=np.uint64)}, r"^pixels: expected .* found 170"),
        ({"x": np.zeros(3)}, r"^x: expected"),
        ({"x": np.full(PIXELS * 5 + PICTURES * 48, 1.5)}, r"^x .*expected"),
        ({"precision": np.ones((150, 2))}, r"^deviation: expected"),
        ({"deviation": np.ones((150, 2))}, r"^precision: expected"),
        ({"precision": np.ones((150, 1)), "deviation": np.ones((150, 2))}, r"^precision: expected"),
        ({"precision": np.ones((150, 2)), "deviation": np.ones((149, 2))}, r"^deviation: expected"),
        ({"precision": np.full((150, 2), np.nan), "deviation": np.ones((150, 2))}, r"^precision:"),
        ({"precision": np.full((150, 2), -1.0), "deviation": np.ones((150, 2))}, r"^precision:"),
        ({"precision": np.ones((150, 2)), "deviation": np.full((150, 2), np.inf)}, r"^deviation:"),
        ({"v": np.zeros(7)}, r"^v: expected"),
        ({"v": NAN}, r"^v: expected"),
        ({"mono": True, "v": np.zeros(PICTURES * 48)}, r"^v: expected"),
    ],
)
def test_unusable_input_is_refused_in_one_line(changes: dict[str, Any], message: str) -> None:
    example = Example()
    given: dict[str, Any] = {"x": example.x, "pixels": example.pixels, "v": example.moves()}
    given |= changes
    calls = ["schur_product", "back_substitute"] + (
        ["schur_complement"] if "v" not in changes else []
    )
    for name in calls:
        options = {
            key: value for key, value in given.items() if key != "v" or name != "schur_complement"
        }
        with pytest.raises(InputError, match=message) as caught:
            getattr(example.problem(), name)(**options)
        assert "\n" not in str(caught.value)
