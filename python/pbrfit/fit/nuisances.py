"""Numbers of the camera that are the same for all pixels, fitted with lights and materials.

Each of them, θ_j, is a direction d_j = ∂r/∂θ_j of the residuals r of a level's pixels at the same
x. With J, B, S, s and Q as in `pbrfit.fit.joint` and P = 1 − J (JᵀJ)⁻¹ Jᵀ, pixels and lights are
solved for, which leaves

    s_j  = Σ_p Bᵀ P d_j
    g_j  = Σ_p d_jᵀ P r − s_jᵀ S⁻¹ s
    H_jk = Σ_p d_jᵀ P d_k − s_jᵀ S⁻¹ s_k

and with a normal distribution of θ around μ as prior, of precision Λ,

    δθ = −(H + W Λ)⁻¹ (g + W Λ (θ − μ))        δL = −S⁻¹ Σ_j δθ_j s_j

beside what joint steps move the lights by. W = max(κ, 1) s², times what pictures share, is the
variance that what is left of the pixels stands for (`pbrfit.fit.misfit`), and W (H + W Λ)⁻¹ the
covariance of θ.
As all else is solved for, a wrong camera that materials and lights have bent to is seen as well as
one that they have not.
"""

from __future__ import annotations

import copy
import math
from dataclasses import dataclass, field, replace

import numpy as np

from pbrfit.fit import settings
from pbrfit.fit.joint import JointFit
from pbrfit.fit.misfit import Misfit
from pbrfit.fit.normal_equations import as_in_x, by_unknowns, products, whitening
from pbrfit.fit.objective import Objective
from pbrfit.result.camera import Camera
from pbrfit.scene.arrays import FIRST_FOV
from pbrfit.scene.correction import Correction
from pbrfit.scene.scene import Scene
from pbrfit.values.arrays import Array


def log_tangent(fov: float) -> float:
    """θ of a field of view in degrees: its tangent is as the focal length, of which factors count.

    Ln tan(fov/2); finite, because orthographic cameras are only ever given.
    """
    return math.log(math.tan(math.radians(max(fov, settings.FOV_MIN)) / 2))


def degrees(theta: float) -> float:
    """Undo `log_tangent`."""
    return math.degrees(2 * math.atan(math.exp(theta)))


@dataclass(eq=False)
class Nuisances:
    """Those of a level, from round to round: the field of view, then numbers of the response."""

    scene: Scene
    """With the numbers as they are now."""
    fov: bool = True
    response: bool = False
    """Which of them are fitted."""
    information: Array = field(default_factory=lambda: np.zeros((0, 0)))
    covariance: Array = field(default_factory=lambda: np.zeros((0, 0)))
    step: Array = field(default_factory=lambda: np.zeros(0))
    """(J, J), and δθ (J,) of the last step, before it was shortened."""
    sum_gain: float = math.inf
    """By how much that lowers the sum, over s²."""
    _noise: float = field(default=math.inf, init=False)
    _misfit: float = field(default=math.inf, init=False)
    _gain_before: float = field(default=math.inf, init=False)

    def __post_init__(self) -> None:
        if self.response and self.scene.correction is None:
            none = Correction(self.scene.mean_brightness())
            self.scene = self.scene.through(self.scene.fov, none)

    @property
    def values(self) -> Array:
        """(J,): θ."""
        of_response: tuple[float, ...] = ()
        if self.response:
            assert self.scene.correction is not None
            of_response = self.scene.correction.numbers
        return np.array([*[log_tangent(self.scene.fov)] * self.fov, *of_response])

    @property
    def prior(self) -> Array:
        """(2, J): means of their prior, and standard deviations."""
        of_fov = [(log_tangent(FIRST_FOV), settings.LOG_FOCAL_LENGTH_SIGMA)]
        of_response = [(0.0, sigma) for sigma in settings.RESPONSE_SIGMAS]
        return np.transpose(of_fov * self.fov + of_response * self.response)

    @property
    def fov_sigma(self) -> float:
        """Standard deviation of the field of view, the first of them, in degrees.

        dφ = sin φ d ln tan(φ/2); no larger than the prior's.
        """
        sigma = min(math.sqrt(self.covariance[0, 0]), settings.LOG_FOCAL_LENGTH_SIGMA)
        return math.degrees(math.sin(math.radians(self.scene.fov)) * sigma)

    def camera(self, before: Camera) -> Camera:
        """As it was fitted, beside what is known of it."""
        found = replace(before, correction=self.scene.correction)
        if self.fov:
            fov, sigma = self.scene.fov, self.fov_sigma
            found = replace(found, fov_degrees=fov, how="fitted", fov_sigma=sigma)
        return found

    def moved(self, by: Array) -> Scene:
        """The scene with all numbers moved by (J,)."""
        values, correction = (self.values + by).tolist(), self.scene.correction
        fov = degrees(values.pop(0)) if self.fov else self.scene.fov
        for index, value in enumerate(values):
            assert correction is not None
            correction = correction.changed(index, value)
        return self.scene.through(fov, correction)

    @property
    def is_settled(self) -> bool:
        """Whether nothing was left to gain by the last two steps.

        By the first of them pixels and lights are not yet where the misfit can be told.
        """
        return max(self.sum_gain, self._gain_before) <= settings.NUISANCE_GAIN_MIN

    def estimate(
        self, objective: Objective, x: Array, fit: JointFit | None, left: Misfit
    ) -> Array | None:
        """Find the step and its covariance; returned is how the lights go with it, (M, 1 + J).

        Columns are S⁻¹ s and S⁻¹ s_j; None where lights are known. `fit` is of this x.
        """
        directions = self._directions(objective, x)
        gram, by_light = _eliminated(objective, x, directions, fit)
        sizes, moves = np.sqrt(np.maximum(np.diag(gram), np.finfo(np.float64).tiny)), None
        if fit is not None:
            gradient, solve = fit.inverse()
            by_light[:, 0] = gradient
            moves = np.stack([solve(column) for column in by_light.T], axis=-1)
            gram = np.asarray(gram - by_light.T @ moves)
        # What a round begins with, before its joint steps, can be far above what there is.
        self._noise = min(self._noise, left.variance)
        self._misfit = min(self._misfit, left.of_camera)
        variance = self._misfit
        means, sigmas = self.prior
        precision = variance / sigmas**2
        gradient, information = _resolved(gram[1:, 0], gram[1:, 1:], sizes[1:])
        slope = gradient + precision * (self.values - means)
        self.information = information + np.diag(precision)
        inverse = np.linalg.inv(self.information)
        self.step, self.covariance = -(inverse @ slope), np.asarray(variance * inverse)
        gain = float(slope @ inverse @ slope)
        self._gain_before = self.sum_gain
        self.sum_gain = gain / self._noise
        return moves

    def judge(self, left: Misfit) -> None:
        """Take the covariance by what is left in the end: weights of samples change in between."""
        self.covariance = np.asarray(left.of_camera * np.linalg.inv(self.information))

    def advance(self, objective: Objective, x: Array, fit: JointFit | None, left: Misfit) -> None:
        """Take a step: scene, pictures and camera of the objective, and lights of x change."""
        moves = self.estimate(objective, x, fit, left)
        largest = float(np.abs(self.step).max())
        taken = self.step * min(1.0, settings.NUISANCE_STEP_MAX / max(largest, 1e-300))
        self.scene = self.moved(taken)
        if moves is not None:
            by_light = -moves[:, 1:] @ taken
            count = x[objective.layout.lighting].size
            x[objective.layout.lighting] += as_in_x(by_light[:count], objective.layout)
        objective.see(self.scene)

    def _directions(self, objective: Objective, x: Array) -> list[Array]:
        """d_j, (P, N, C) each: by central differences; of a correction at what the model shows."""
        found = []
        if self.fov:
            step, sides = settings.NUISANCE_DIFFERENCE * np.eye(len(self.values))[0], []
            for by in (step, -step):
                other = copy.copy(objective)
                other.see(self.moved(by))
                sides.append(other.problem.residuals(objective.for_core(x), objective.everything))
            change = sides[0].astype(np.float64) - sides[1]
            found.append(change.transpose(1, 0, 2) / (2 * settings.NUISANCE_DIFFERENCE))
        if self.response:
            assert self.scene.correction is not None
            found += [-one for one in objective.correction_directions(x, self.scene.correction)]
        return found


def _resolved(gradient: Array, information: Array, sizes: Array) -> tuple[Array, Array]:
    """Both without the directions in which lights take all but rounding.

    `sizes` (J,) are the roots of the information before lights are solved for.
    """
    shares, directions = np.linalg.eigh(information / np.outer(sizes, sizes))
    told = shares > settings.NUISANCE_INFORMATION_MIN
    kept = directions[:, told]
    scaled = (kept * shares[told]) @ kept.T
    return sizes * (kept @ (kept.T @ (gradient / sizes))), scaled * np.outer(sizes, sizes)


def _eliminated(
    objective: Objective, x: Array, directions: list[Array], fit: JointFit | None
) -> tuple[Array, Array]:
    """Σ vᵀ P v' of r and the directions, (1 + J, 1 + J), and Σ Bᵀ P v of each, (M, 1 + J).

    Unknowns on a bound that the slope by r pushes against are held.
    """
    layout, count, everything = objective.layout, objective.pixels, objective.everything
    for_core = objective.for_core(x)
    by_material, by_light, weights = objective.problem.derivatives(for_core, everything)
    residuals = objective.problem.residuals(for_core, everything).transpose(1, 0, 2)
    columns = np.stack([residuals.astype(np.float64), *directions], axis=-1)
    weighted = columns * weights[..., None]
    jacobian = by_unknowns(by_material, layout).reshape(count, -1, layout.maps.stop // count)
    of_core = {} if fit is None else fit.options(objective, x, everything, everything)
    slopes = jacobian.transpose(0, 2, 1) @ weighted.reshape(count, -1, columns.shape[-1])
    matrices = products(jacobian.reshape(*weights.shape, -1), weights)
    c = layout.channels
    if "precision" in of_core:
        slopes[:, c:, 0] += of_core["precision"] * of_core["deviation"]
        np.einsum("pii->pi", matrices)[:, c:] += of_core["precision"]
    held = np.zeros(matrices.shape[:2], bool)
    materials = x[layout.materials].reshape(-1, count).T
    bounded = slopes[:, : materials.shape[1], 0]
    below, above = (materials <= 0) & (bounded > 0), (materials >= 1) & (bounded < 0)
    held[:, : materials.shape[1]] = below | above
    whiten = whitening(matrices, held)
    solved = whiten @ slopes
    gram: Array = np.einsum("pnci,pncj->ij", columns, weighted)
    gram -= np.einsum("pdi,pdj->ij", solved, solved)
    moved = whiten.transpose(0, 2, 1) @ solved
    left = weighted - weights[..., None] * (jacobian @ moved).reshape(columns.shape)
    of_lights = np.einsum("pck,pnci->cnki", by_light, left, optimize=True)
    if layout.light_channels < c:
        of_lights = of_lights.sum(axis=0, keepdims=True)
    parts = [of_lights.reshape(-1, columns.shape[-1])]
    if "cluster" in of_core:
        cluster, clusters = of_core["cluster"]
        of_offsets = np.zeros((clusters, *of_core["precision"].shape[1:], columns.shape[-1]))
        of_pixels = of_core["precision"][..., None] * moved[:, c:]
        np.add.at(of_offsets, cluster.astype(np.intp), of_pixels)
        parts.append(of_offsets.reshape(-1, columns.shape[-1]))
    return gram, np.concatenate(parts)
