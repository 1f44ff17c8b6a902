"""One joint step of lights, normals and materials against a dense least-squares solution."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from pbrfit import Materials, Scene, render
from pbrfit.fit.normals.joint_step import SubsetState, joint_step
from pbrfit.fit.normals.offset_prior import Neighbourhood, TangentOffsetPrior
from pbrfit.fit.objective import Objective
from pbrfit.fit.parameters import pixel_index
from pbrfit.fit.priors.gaussian import GaussianPrior
from pbrfit.fit.settings import NORMALS_OFFSET_STEP_MAX, NORMALS_ROUGHNESS_STEP_MAX

Array = NDArray[np.float64]

HEIGHT, WIDTH, PICTURES = 7, 8, 8
VARIANCE = 0.02
OFFSET_PRECISION = np.array([0.002, 0.7])
CLUSTERS = 3

KINDS: dict[str, dict[str, Any]] = {
    "colour": {},
    "grey": {"grey": True},
    "mono lights": {"mono_light": True},
    "known metallic": {"known": 0.3},
    "order 2": {"sh_order": 2},
    "weighted": {"weighted": True},
    "all": {
        "grey": True,
        "mono_light": True,
        "known": 0.3,
        "sh_order": 2,
        "weighted": True,
    },
}


@dataclass(frozen=True, eq=False)
class Case:
    """A state of some pixels, near what explains the pictures, and its priors."""

    subset: Objective
    state: SubsetState
    material_prior: GaussianPrior
    offset_prior: TangentOffsetPrior
    weights: Array


def case(
    *,
    grey: bool = False,
    weighted: bool = False,
    mono_light: bool = False,
    known: float | None = None,
    sh_order: int = 3,
    away: float = 1e-3,
) -> Case:
    rng = np.random.default_rng(0)
    # Normals all over the half that is seen, and a hole: else few pixels do not tell 16
    # coefficients apart.
    normals = rng.normal(size=(HEIGHT, WIDTH, 3)) * [1, 1, 0.4] + [0, 0, 1.0]
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    mask = np.ones((HEIGHT, WIDTH), bool)
    mask[3, 2:5] = False
    albedo = rng.uniform(0.2, 0.9, size=(HEIGHT, WIDTH, 3))
    roughness, metallic = rng.uniform(0.2, 0.8, size=(2, HEIGHT, WIDTH))
    # Some on their bounds, which the pictures push off or hold.
    for values, ends in ((albedo, (0, 1)), (roughness, (1,)), (metallic, (0, 1))):
        chosen = rng.choice(values.size, 10, replace=False)
        values.ravel()[chosen] = rng.choice(ends, 10)
    lights = 0.25 * rng.normal(size=(PICTURES, 16, 3))
    lights[:, 0] += 2
    if grey:
        albedo = albedo[..., :1].repeat(3, axis=-1)
    if grey or mono_light:
        lights = lights[..., :1].repeat(3, axis=-1)
    if known is not None:
        metallic[:] = known
    lights[:, (sh_order + 1) ** 2 :] = 0
    materials = Materials(albedo, roughness, metallic)
    images = np.stack([render(materials, normals, light, 0.9) for light in lights])
    assert images[:, mask].min() > 0
    scene = Scene(
        images=images,
        normals=normals,
        mask=mask,
        fov=0.9,
        weights=rng.uniform(0.2, 1, size=images.shape[:3]) if weighted else None,
    )
    subset = Objective(
        scene, free_normals=True, metallic=known, mono_light=mono_light, sh_order=sh_order
    )
    layout = subset.layout
    assert layout.channels == (1 if grey else 3)
    x = subset.pack(materials.albedo, materials.roughness, materials.metallic, lights)
    on_bound = np.zeros(len(x), bool)
    on_bound[layout.materials] = np.isin(x[layout.materials], (0, 1))
    x += np.where(on_bound, 0, away * rng.normal(size=len(x)))
    count, f_count = subset.pixels, len(layout.roughness_metallic)
    values = x[layout.materials].reshape(-1, count).T[:, layout.channels :]
    material_prior = GaussianPrior(
        values + away * rng.normal(size=(count, f_count)),
        rng.uniform(0.01, 1, size=(count, f_count)),
        rng.integers(CLUSTERS, size=count),
    )
    around = Neighbourhood.of(
        pixel_index(layout), np.asarray(scene.normals, dtype=np.float64)[mask], None
    )
    offset_prior = TangentOffsetPrior(
        around, sigma=0.5, robust_weights=rng.uniform(0.3, 1, size=len(around.pairs))
    )
    state = SubsetState(x, away * rng.normal(size=(CLUSTERS, f_count)))
    return Case(subset, state, material_prior, offset_prior, rng.uniform(0.1, 1, size=count))


def light_columns(subset: Objective) -> Array:
    """Where the light of a picture, coefficient and channel lies in x, (N, K, C)."""
    layout = subset.layout
    assert layout.lighting is not None
    columns = np.arange(layout.lighting.start, layout.lighting.stop)
    shape = (layout.pictures, layout.coefficients, layout.light_channels)
    return np.broadcast_to(
        columns.reshape(shape), (layout.pictures, layout.coefficients, layout.channels)
    )


def dense(case: Case) -> tuple[Array, Array]:
    """Jacobian and residuals of all that is squared; columns are those of x, then offsets."""
    subset, material, prior = case.subset, case.material_prior, case.offset_prior
    assert material.cluster is not None
    layout, x, count = subset.layout, case.state.x, subset.pixels
    pixels = np.arange(count, dtype=np.uint64)
    by_unknowns, by_light, omega = subset.problem.derivatives(subset.for_core(x), pixels)
    left = subset.problem.residuals(subset.for_core(x), pixels)
    f_count = len(layout.roughness_metallic)
    planes = np.arange(layout.maps.stop).reshape(-1, count)
    columns = light_columns(subset)
    size = len(x) + CLUSTERS * f_count
    rows: list[Array] = []
    residuals: list[float] = []

    def add(residual: float, entries: dict[int, Any]) -> None:
        row = np.zeros(size)
        for column, value in entries.items():
            row[column] += value
        rows.append(row)
        residuals.append(residual)

    for p, n, c in np.ndindex(count, layout.pictures, layout.channels):
        root = np.sqrt(omega[p, n, c] * case.weights[p])
        entries = {int(planes[c, p]): root * by_unknowns[p, n, c, 0]}
        for i in range(f_count):
            entries[int(planes[layout.channels + i, p])] = root * by_unknowns[p, n, c, 1 + i]
        for i in range(2):
            entries[int(planes[-2 + i, p])] = root * by_unknowns[p, n, c, 3 + i]
        for k in range(layout.coefficients):
            entries[int(columns[n, k, c])] = root * by_light[p, c, k]
        add(float(root * left[n, p, c]), entries)
    for p, f in np.ndindex(count, f_count):
        root = np.sqrt(material.precision[p, f] * case.weights[p])
        plane = int(planes[layout.channels + f, p])
        offset = len(x) + int(material.cluster[p]) * f_count + f
        off = x[plane] - material.mean[p, f] - case.state.cluster_offsets[material.cluster[p], f]
        add(root * off, {plane: root, offset: -root})
    for g, f in np.ndindex(CLUSTERS, f_count):
        of_cluster = material.cluster == g
        total = (material.precision[of_cluster, f] * case.weights[of_cluster]).sum()
        root = np.sqrt(OFFSET_PRECISION[f] * total)
        add(root * case.state.cluster_offsets[g, f], {len(x) + g * f_count + f: root})
    # The prior of the tangent offsets, read off its cost: what a pair adds, and what a pixel adds.
    for (first, second), coupling in zip(
        prior.neighbourhood.pairs, prior.coupling(VARIANCE), strict=True
    ):
        root = np.sqrt(-coupling)
        for plane in planes[-2:]:
            one, other = int(plane[first]), int(plane[second])
            add(root * (x[other] - x[one]), {other: root, one: -root})
    ends = np.concatenate([prior.coupling(VARIANCE)] * 2)
    alone = prior.diagonal(VARIANCE) + np.bincount(
        prior.neighbourhood.pairs.T.ravel(), ends, minlength=count
    )
    for p in range(count):
        for plane in planes[-2:]:
            add(np.sqrt(alone[p]) * x[plane[p]], {int(plane[p]): np.sqrt(alone[p])})
    return np.array(rows), np.array(residuals)


def solution(case: Case) -> tuple[Array, Array]:
    """The undamped Gauss-Newton step of x and of the offsets."""
    jacobian, residuals = dense(case)
    layout, x = case.subset.layout, case.state.x
    slope = (jacobian.T @ residuals)[: layout.materials.stop]
    values = x[layout.materials]
    held = ((values <= 0) & (slope > 0)) | ((values >= 1) & (slope < 0))
    assert held.any()
    assert (((values <= 0) | (values >= 1)) & ~held).any()
    free = np.ones(jacobian.shape[1], bool)
    free[: layout.materials.stop] = ~held
    step = np.zeros(len(free))
    # By QR and not by normal equations, whose condition is the square.
    q, r = np.linalg.qr(jacobian[:, free])
    step[free] = -solve_triangular(r, q.T @ residuals)
    return step[: len(x)], step[len(x) :].reshape(CLUSTERS, -1)


def taken(case: Case, damping: float = 0.0, share: float = 1.0) -> SubsetState:
    step = joint_step(
        case.subset,
        case.state,
        case.material_prior,
        case.offset_prior,
        VARIANCE,
        case.weights,
        OFFSET_PRECISION[: case.state.cluster_offsets.shape[1]],
        damping,
    )
    return step(share)


@pytest.fixture
def no_ridge(monkeypatch: pytest.MonkeyPatch) -> None:
    """What keeps singular systems solvable is 1e-8 of a step here."""
    monkeypatch.setattr("pbrfit.fit.normal_equations.RIDGE", 0.0)
    monkeypatch.setattr("pbrfit.fit.normal_equations.SCHUR_RIDGE", 0.0)


@pytest.mark.usefixtures("no_ridge")
@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_the_joint_step_solves_the_whole_system(kind: str) -> None:
    made = case(**KINDS[kind])
    layout = made.subset.layout
    step, offsets = solution(made)
    assert layout.tangent_offsets is not None
    assert layout.lighting is not None
    found = taken(made)
    expected = made.state.x + step
    expected[layout.materials] = expected[layout.materials].clip(0, 1)
    # Nothing is cut off, else the comparison would be of limits.
    roughness = step[layout.roughness]
    assert np.abs(roughness).max() < NORMALS_ROUGHNESS_STEP_MAX
    assert (
        np.linalg.norm(step[layout.tangent_offsets].reshape(2, -1), axis=0).max()
        < NORMALS_OFFSET_STEP_MAX
    )
    for name, block in {
        "materials": layout.materials,
        "tangent offsets": layout.tangent_offsets,
        "lights": layout.lighting,
    }.items():
        size = np.abs(step[block]).max()
        assert size > 1e-4
        np.testing.assert_allclose(
            found.x[block], expected[block], rtol=0, atol=1e-8 * size, err_msg=name
        )
    np.testing.assert_allclose(
        found.cluster_offsets,
        made.state.cluster_offsets + offsets,
        rtol=0,
        atol=1e-8 * np.abs(offsets).max(),
    )


@pytest.mark.parametrize("damping", [0.0, 1e-3, 1.0])
def test_a_step_from_far_away_stays_within_reach(damping: float) -> None:
    made = case(away=0.3, sh_order=2)
    x, layout = made.state.x, made.subset.layout
    x[layout.materials] = x[layout.materials].clip(0, 1)
    found = taken(made, damping)
    assert np.isfinite(found.x).all()
    materials = found.x[layout.materials]
    assert materials.min() >= 0
    assert materials.max() <= 1
    assert layout.tangent_offsets is not None
    lengths = np.linalg.norm((found.x - x)[layout.tangent_offsets].reshape(2, -1), axis=0)
    assert lengths.max() <= NORMALS_OFFSET_STEP_MAX * (1 + 1e-12)
    if damping == 0:
        assert lengths.max() == pytest.approx(NORMALS_OFFSET_STEP_MAX)
    assert np.abs((found.x - x)[layout.roughness]).max() <= NORMALS_ROUGHNESS_STEP_MAX + 1e-12


def test_pixels_that_no_picture_shows_stay_where_neighbours_are() -> None:
    """A pixel of no weight has no matrix of its own; its normal goes where its neighbours' do."""
    made = case(sh_order=2)
    made.weights[10] = 0.0
    layout = made.subset.layout
    found = taken(made)
    assert np.isfinite(found.x).all()
    assert np.isfinite(found.cluster_offsets).all()
    materials = (found.x - made.state.x)[layout.materials].reshape(-1, made.subset.pixels)
    np.testing.assert_array_equal(materials[:, 10], 0)
    assert layout.tangent_offsets is not None
    offsets = found.x[layout.tangent_offsets].reshape(2, -1).T
    centre, _ = made.offset_prior.conditional(offsets, VARIANCE)
    np.testing.assert_allclose(offsets[10], centre[10], rtol=0, atol=1e-12)
