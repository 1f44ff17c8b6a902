"""The system of what pixels share, these solved for, against a dense and slow one by numpy."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
import pytest

from pbrfit._core import InputError
from random_pixels import Array, Example, Kind, Pixels

PIXELS, PICTURES = 170, 8
"""More pixels than are worked on side by side."""

REACH = 0.3
"""Tilts move no further at once."""


@dataclass(frozen=True)
class System(Kind):
    """How it is damped, and whether some materials are on bounds and some unknowns have a prior;
    with clusters, of which the last is empty, the prior has offsets."""

    damping: float = 0.0
    prior: bool = False
    clusters: int = 0
    bounds: bool = False

    @property
    def light_channels(self) -> int:
        return 1 if self.mono else self.channels


KINDS = {
    "plain": System(),
    "damped": System(damping=0.3),
    "held at bounds": System(bounds=True),
    "held at bounds, with prior and damped": System(bounds=True, prior=True, damping=1e-3),
    "with prior": System(prior=True),
    "with prior, known metallic": System(prior=True, metallic=0.3),
    "clusters": System(prior=True, clusters=5),
    "one cluster, damped, known metallic, mono": System(
        prior=True, clusters=2, damping=0.3, metallic=0.3, mono=True
    ),
    "clusters, held at bounds, weighted, grey": System(
        prior=True, clusters=9, bounds=True, weights=3, channels=1
    ),
    "clusters, free normals": System(prior=True, clusters=4, free_normals=True, damping=1e-3),
    "clusters, known lights": System(prior=True, clusters=3, known_lights=True),
    "mono": System(mono=True),
    "mono, damped, weighted": System(mono=True, damping=1e-2, weights=2),
    "known metallic": System(metallic=0.0, damping=0.1),
    "grey": System(channels=1, damping=1e-3),
    "grey, order 2, known metallic, weighted": System(
        channels=1, sh_order=2, metallic=0.6, weights=2, prior=True
    ),
    "order 2": System(sh_order=2, damping=1e-3),
    "weights of pixels": System(weights=2),
    "weights of samples": System(weights=3, bounds=True),
    "known lights": System(known_lights=True),
    "free normals": System(free_normals=True, damping=1e-3),
    "free normals, with prior": System(free_normals=True, prior=True),
    "free normals, held at bounds, mono": System(
        free_normals=True, bounds=True, mono=True, damping=1e-2
    ),
    "free normals, known metallic, weighted": System(
        free_normals=True, metallic=0.3, weights=3, damping=1e-3
    ),
    "free normals, grey, with prior, known metallic": System(
        free_normals=True, channels=1, sh_order=2, metallic=0.6, weights=2, prior=True
    ),
    "free normals, grey": System(free_normals=True, channels=1, damping=1e-2),
}


class Seen(Example):
    """Random pixels, and pictures that these do not explain; some samples count nothing."""

    kind: System

    def __init__(self, kind: System = KINDS["plain"]) -> None:
        rng = np.random.default_rng(3)

        def to_bounds(materials: Array) -> None:
            drawn = rng.random(materials.shape)
            materials[drawn < 0.15 * kind.bounds] = 0.0
            materials[drawn > 1 - 0.15 * kind.bounds] = 1.0

        super().__init__(kind, PIXELS, PICTURES, noise=0.5, change=to_bounds)
        if self.weights is not None:
            self.weights[rng.random(self.weights.shape) < 0.1] = 0
        shared = (PIXELS, kind.unknowns - kind.channels)
        self.precision = rng.uniform(0, 30, shared) if kind.prior else None
        self.off = rng.uniform(-0.5, 0.5, shared) if kind.prior else None
        self.chosen = rng.permutation(PIXELS)[:150].astype(np.uint64)
        self.cluster = rng.integers(max(kind.clusters - 1, 1), size=PIXELS).astype(np.uint64)

    @property
    def of_lights(self) -> int:
        """Unknowns of the lights."""
        return self.kind.light_channels * PICTURES * self.kind.coefficients

    @property
    def size(self) -> int:
        """And those of the clusters' offsets."""
        return self.of_lights + self.kind.clusters * (self.kind.unknowns - self.kind.channels)

    def options(self, rows: Pixels) -> dict[str, Any]:
        found: dict[str, Any] = {"damping": self.kind.damping, "mono": self.kind.mono}
        if self.precision is not None and self.off is not None:
            found |= {"precision": self.precision[rows], "deviation": self.off[rows]}
        if self.kind.clusters:
            found["cluster"] = self.cluster[rows], self.kind.clusters
        return found

    def ask(self, name: str, *moves: Array, pixels: Pixels | None = None) -> Any:
        """What a method of the problem says of these pixels."""
        rows = self.chosen if pixels is None else pixels
        return getattr(self.problem(), name)(self.x(), rows, *moves, **self.options(rows))

    def moves(self) -> Array:
        """Of the lights."""
        return np.random.default_rng(5).normal(size=self.size) * 0.05


@dataclass(frozen=True)
class Dense:
    """The whole normal equations of some pixels and what they share, with pixels eliminated.

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


def dense(example: Seen, pixels: Pixels) -> Dense:
    """S = G − Σ Bᵀ A⁻¹ B and s = g_L − Σ Bᵀ A⁻¹ g, from a Jacobian by the reference."""
    kind = example.kind
    c, k, d = kind.channels, kind.coefficients, kind.unknowns
    by_unknowns, weights = (part[pixels] for part in example.jacobian())
    residuals = (example.radiance(example.truth) - example.targets)[pixels]
    omegas, values = example.omega[pixels], example.unknowns(example.truth)[pixels]

    matrix, gradient = np.zeros((example.size,) * 2), np.zeros(example.size)
    forward, follow = np.zeros((len(pixels), d)), np.zeros((len(pixels), d, example.size))
    curvature = np.zeros((len(pixels), d, d))
    for i, pixel in enumerate(pixels):
        # (picture, channel) by (light channel, picture, coefficient)
        by_light = np.zeros((PICTURES, c, kind.light_channels, PICTURES, k))
        for n, channel in np.ndindex(PICTURES, c):
            by_light[n, channel, channel % kind.light_channels, n] = weights[i, channel]
        j = by_unknowns[i].reshape(-1, d)
        w = np.zeros((PICTURES * c, example.size))
        w[:, : example.of_lights] = by_light.reshape(-1, example.of_lights)
        omega, left = omegas[i].ravel(), residuals[i].ravel()
        a, g, b = j.T @ (omega[:, None] * j), j.T @ (omega * left), j.T @ (omega[:, None] * w)
        if example.precision is not None and example.off is not None:
            a[np.arange(c, d), np.arange(c, d)] += example.precision[pixel]
            g[c:] += example.precision[pixel] * example.off[pixel]
            if kind.clusters:  # the rows √a (v − c − o) of the prior
                own = example.of_lights + int(example.cluster[pixel]) * (d - c) + np.arange(d - c)
                b[np.arange(c, d), own] -= example.precision[pixel]
                matrix[own, own] += example.precision[pixel]
                gradient[own] -= example.precision[pixel] * example.off[pixel]
        a += kind.damping * np.diag(np.diag(a))
        held = ((values[i] <= 0) & (g > 0)) | ((values[i] >= 1) & (g < 0))
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
def expected_of(kind: str) -> tuple[Seen, Dense]:
    """An example of a kind, and the system of its pixels."""
    example = Seen(KINDS[kind])
    return example, dense(example, example.chosen)


def close(found: Array, expected: Array, share: float) -> None:
    np.testing.assert_allclose(found, expected, rtol=0, atol=share * np.abs(expected).max())


def accuracy(kind: System) -> float:
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
def test_a_kept_system_multiplies_as_if_made_anew(kind: str) -> None:
    example, _ = expected_of(kind)
    kept, moves = example.ask("kept_system"), example.moves()
    product, gradient = example.ask("schur_product", moves)
    np.testing.assert_array_equal(kept.gradient, gradient)
    close(kept.product(moves), product, 1e-5)
    np.testing.assert_array_equal(kept.product(0 * moves), 0 * moves)


def test_a_kept_system_is_symmetric_and_of_its_size() -> None:
    example = Seen(KINDS["weights of samples"])
    kept = example.ask("kept_system")
    one, other = (np.random.default_rng(seed).normal(size=example.size) for seed in (1, 2))
    there, back = other @ kept.product(one), one @ kept.product(other)
    assert abs(there - back) < 1e-5 * np.linalg.norm(one) * np.linalg.norm(kept.product(other))
    for v in (one[1:], np.append(one, 1.0), np.full_like(one, np.nan)):
        with pytest.raises(InputError, match="v"):
            kept.product(v)


@pytest.mark.parametrize("kind", KINDS)
def test_pixels_follow_the_lights_as_the_whole_system_says(kind: str) -> None:
    example, expected = expected_of(kind)
    moves = example.moves()
    found = example.ask("back_substitute", moves)
    of_material = example.kind.of_material
    before = example.unknowns(example.truth)[example.chosen]
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
    example = Seen(KINDS["free normals"])
    longest = np.sqrt(3)
    angles = np.random.default_rng(1).uniform(0, 2 * np.pi, PIXELS)
    lengths = np.where(np.arange(PIXELS) % 2, longest - 0.1, longest + 0.5)
    example.offsets = lengths[:, None] * np.column_stack([np.cos(angles), np.sin(angles)])
    pixels = np.arange(PIXELS, dtype=np.uint64)
    # Moves that are large for the lights, so that all steps are as long as they may be.
    moves = 1e3 * example.moves()
    found = example.problem().back_substitute(example.x(), pixels, moves, damping=1e-3)[:, -2:]
    after = np.linalg.norm(found, axis=1)
    assert (after <= np.maximum(longest, lengths) * (1 + 1e-12)).all()
    assert np.count_nonzero(after > np.maximum(longest, lengths) * (1 - 1e-12)) > PIXELS / 5
    assert np.linalg.norm(found - example.offsets, axis=1).max() < REACH * (1 + 1e-12)


@pytest.mark.parametrize("kind", KINDS)
def test_the_order_of_pixels_changes_rounding_alone(kind: str) -> None:
    example = Seen(KINDS[kind])
    order = np.random.default_rng(6).permutation(len(example.chosen))
    other, moves = example.chosen[order], example.moves()
    for asked in (("schur_complement",), ("schur_product", moves)):
        for a, b in zip(example.ask(*asked), example.ask(*asked, pixels=other), strict=True):
            close(a, b, 1e-12)
    shuffled = example.ask("back_substitute", moves, pixels=other)
    np.testing.assert_array_equal(example.ask("back_substitute", moves)[order], shuffled)


def test_pixels_that_nothing_is_known_about_stay() -> None:
    """Black ones, dark lights, a material without a slope, a pixel without weight: no NaN."""
    example = Seen(System(weights=2))
    assert example.weights is not None
    example.targets[0] = 0
    example.weights[:, 1] = 0
    example.truth[2:4] = 0, 0, 0, 0, 0
    example.truth[4:6] = 1, 1, 1, 1, 1
    example.truth[6] = 0.5, 0.5, 0.5, 0.0, 1.0
    pixels = np.arange(8, dtype=np.uint64)
    expected = dense(example, pixels)
    matrix, gradient = example.problem().schur_complement(example.x(), pixels)
    close(matrix, expected.matrix, 1e-8)
    close(gradient, expected.gradient, 1e-8)
    moves = example.moves()
    product, _ = example.problem().schur_product(example.x(), pixels, moves)
    close(product, expected.matrix @ moves, 1e-8)
    followed = example.problem().back_substitute(example.x(), pixels, moves)
    np.testing.assert_array_equal(followed[1], example.truth[1])
    assert followed[6, 3] == 0  # the slope by roughness is r³

    example.lights[:] = 0
    problem = example.problem()
    matrix, gradient = problem.schur_complement(example.x(), pixels)
    assert np.isfinite(matrix).all()
    assert np.isfinite(gradient).all()
    np.testing.assert_array_equal(
        problem.back_substitute(example.x(), pixels, np.zeros(example.size)), example.truth[:8]
    )


def test_no_pixels_know_nothing() -> None:
    example = Seen()
    none = np.empty(0, dtype=np.uint64)
    matrix, gradient = example.problem().schur_complement(example.x(), none)
    assert not matrix.any()
    assert not gradient.any()
    assert example.problem().back_substitute(example.x(), none, example.moves()).shape == (0, 5)


PRIOR = {"precision": np.ones((150, 2)), "deviation": np.ones((150, 2))}
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
        ({"cluster": (np.zeros(150, np.uint64), 1)}, r"^precision: expected .* cluster"),
        (PRIOR | {"cluster": (np.zeros(149, np.uint64), 1)}, r"^cluster: expected 150 numbers"),
        (PRIOR | {"cluster": (np.full(150, 2, np.uint64), 2)}, r"^cluster: expected .* below 2"),
        (PRIOR | {"cluster": (np.zeros(150, np.uint64), 1)}, r"^v: expected"),
        ({"v": np.zeros(7)}, r"^v: expected"),
        ({"v": NAN}, r"^v: expected"),
        ({"mono": True, "v": np.zeros(PICTURES * 48)}, r"^v: expected"),
    ],
)
def test_unusable_input_is_refused_in_one_line(changes: dict[str, Any], message: str) -> None:
    example = Seen()
    given: dict[str, Any] = {"x": example.x(), "pixels": example.chosen, "v": example.moves()}
    given |= changes
    of_moves = "v" in changes or message == r"^v: expected"
    calls = ["schur_product", "back_substitute"] + ([] if of_moves else ["schur_complement"])
    for name in calls:
        options = {
            key: value for key, value in given.items() if key != "v" or name != "schur_complement"
        }
        with pytest.raises(InputError, match=message) as caught:
            getattr(example.problem(), name)(**options)
        assert "\n" not in str(caught.value)
