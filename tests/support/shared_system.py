"""The system of what pixels share, these solved for: pixels, and a dense and slow one by numpy."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

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


class Seen(Example):
    """Random pixels, and pictures that these do not explain; some samples count nothing."""

    kind: System

    def __init__(self, kind: System | None = None) -> None:
        kind = System() if kind is None else kind
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


def close(found: NDArray[Any], expected: NDArray[Any], share: float) -> None:
    """Within a share of the largest expected value."""
    np.testing.assert_allclose(found, expected, rtol=0, atol=share * np.abs(expected).max())


def accuracy(kind: System) -> float:
    """Of pixels that are nearly singular the core's ridge shows: 1e-12 of their diagonal."""
    return 1e-10 if kind.damping > 0 or kind.prior else 1e-8


def check_equations(example: Example, pixels: Pixels) -> None:
    """Derivatives of pixels, and what is made of them, are those of the slow model."""
    j, by_light = (part[pixels] for part in example.jacobian())
    omega = example.omega[pixels]
    residual = (example.radiance(example.truth) - example.targets)[pixels]
    problem = example.problem()
    by_unknowns, of_light, weights = problem.derivatives(example.x(), pixels)
    expected = example.slopes()[0][pixels]
    # Of each pixel on its own, unless it is dark beside the others.
    scale = np.abs(expected).max(axis=(1, 2), keepdims=True)
    scale = np.maximum(scale, 1e-4 * scale.max(axis=0))
    assert (np.abs(by_unknowns - expected) <= 1e-12 * scale).all()
    close(of_light, by_light, 1e-12)
    np.testing.assert_array_equal(weights, omega)
    matrices, gradient, squares = problem.normal_equations(example.x(), pixels)
    close(matrices, np.einsum("pnci,pnc,pncj->pij", j, omega, j), 1e-12)
    close(gradient, np.einsum("pnci,pnc->pi", j, omega * residual), 1e-12)
    close(squares, (omega * residual**2).sum(axis=(1, 2)), 1e-12)
    rng = np.random.default_rng(3)
    roots = rng.normal(size=(len(pixels), example.kind.unknowns, example.kind.unknowns))
    covariances = roots @ roots.transpose(0, 2, 1)
    modes = rng.normal(size=(6, *example.lights.shape))
    effects = np.einsum("pnci,pnc,pck,mnkc->pmi", j, omega, by_light, modes)
    moves, of_all = problem.moves_with_lights(example.x(), pixels, covariances, modes)
    close(of_all, np.einsum("pnci,pnc,pck,nkc->pi", j, omega, by_light, example.lights), 1e-11)
    close(moves, np.square(effects @ covariances).sum(axis=1), 1e-11)


def check_best_albedo(example: Example) -> None:
    """No other albedo leaves less, wherever it lies, and the grid has these sums at its nodes."""
    c, metallic = example.kind.channels, [0.0, 0.4, 1.0]
    roughness = np.array([0.0, 0.35, 1.0])
    if example.kind.metallic is not None:
        metallic = [example.kind.metallic]
    nodes = roughness, np.array(metallic)
    grid = example.problem().material_grid(example.x(), example.everything, *nodes)
    for i, j in np.ndindex(grid.shape[1:]):
        values = example.truth.copy()
        values[:, c], values[:, c + 1] = nodes[0][i], nodes[1][j]
        albedo, least = example.problem().best_albedo(example.x(values), example.everything)
        assert ((albedo >= 0) & (albedo <= 1)).all()

        def squares(of: Array, values: Array = values) -> Array:
            return example.squares(example.unknowns(np.hstack([of, values[:, c:]])))

        np.testing.assert_allclose(least, squares(albedo), 1e-9)
        np.testing.assert_allclose(grid[:, i, j], least, rtol=2e-4)
        for channel in range(c):
            near = [albedo[:, channel] + step for step in (-1e-3, 1e-3)]
            for other in (*near, *np.linspace(0, 1, 9)):
                changed = albedo.copy()
                changed[:, channel] = np.clip(other, 0, 1)
                assert (squares(changed) >= least * (1 - 1e-7)).all()
