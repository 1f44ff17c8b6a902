"""Lamps, ambient light and surfaces together: Levenberg–Marquardt with the pixels eliminated.

The unknowns that all pixels share, y, are each lamp's place and colour and each picture's ambient
light. Each pixel has its own z: two offsets of its normal, albedo, roughness. With their Jacobians,
the weights W of the samples and the precisions Q of the priors, a step solves

    [Σ J_yᵀ W J_y + Q_y   Σ_p B_pᵀ] [δy]      [g_y]
    [      B_p               A_p  ] [δz_p] = −[g_p],     A_p = J_pᵀ W J_p + Q_p,  B_p = J_pᵀ W J_y.

A_p is 6 × 6, so the pixels are eliminated one by one. What is shared moves along the columns of a
matrix E, mostly 0, δy = E v. With the damped A_p, G = B E and K = Eᵀ (Σ J_yᵀ W J_y + Q_y) E, damped
by D, a step solves

    S v + Cᵀ λ = Σ_p Gᵀ A_p⁻¹ g_p − Eᵀ g_y,    C v = 0,    S = K + D − Σ_p Gᵀ A_p⁻¹ G

where C has the slopes of what is held, such as the scale that lamps and albedo share. S takes the
square, and its solution the cube, of the number of unknowns.

Where an outline tells of it, the bas-relief is shared, too: 1 + Σ g_i G_i turns all normals n that
the pixels' own are offset from. So it moves offsets o by −D g, where D has t·G_i n for tangents t.
With their precision Q the prior is (o − D g)ᵀ Q (o − D g), beside the cues' likelihood (`Relief`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from pbrfit.fit.lamps.problem import LampPixels, LampState, by_place, surface_of, tangents
from pbrfit.fit.lamps.sample_noise import NOISE_MIN, Noise
from pbrfit.fit.lamps.samples import BAS_RELIEF
from pbrfit.fit.settings import MEAN_RADIANCE, PRIOR_ROUGHNESS_NODES
from pbrfit.model.geometry import unit
from pbrfit.model.lamps import Lamps
from pbrfit.values.arrays import Array

if TYPE_CHECKING:
    from pbrfit.fit.lamps.ambiguity import Relief


UNKNOWNS = 6
"""Number for each pixel in joint steps: two offsets of the normal, albedo, roughness. Metallic
waits."""

ROUGHNESS_MIN = PRIOR_ROUGHNESS_NODES[0]
"""Least roughness that a step leads to: below, a lobe shows in no sample."""

COSINE_MIN = 0.1
"""Least cosine of the angle between a normal and the one that its offsets are from: 84 degrees."""

AMBIENT_SHARE = 0.1
"""Prior standard deviation of each ambient coefficient, of the mean radiance: a lamp in a room
whose walls bring a tenth of the light."""

ALBEDO_MEAN, ALBEDO_SPREAD = 0.35, 0.5
"""What the mean albedo of a scene is before anything is known, and by how much its logarithm is
uncertain: only highlights tell the scale between lamps and albedo."""

TINT_SPREAD = 0.2
"""By how much the logarithm of the lamps' mean colour in a channel differs from grey in pictures
whose white was balanced: a colour temperature that is off by about 1,000 K at 5,000 K."""


@dataclass(frozen=True, eq=False)
class SurfacePrior:
    """Gaussian priors on the surface of each pixel: offsets, albedo, roughness, metallic."""

    mean: Array
    precision: Array
    """(P, 7) each."""

    def of_rows(self, rows: NDArray[np.intp] | slice) -> SurfacePrior:
        """Of some of the pixels."""
        return SurfacePrior(self.mean[rows], self.precision[rows])


@dataclass(frozen=True)
class Freedom:
    """What is unknown beside albedo and roughness."""

    normals: bool
    places: bool = True
    colors: bool = True
    same_lamp: bool = False
    """Whether all lamps have one colour."""
    shape: bool = False
    """Whether a matrix is that turns all normals which pixels' own are offset from."""
    scale: bool = False
    """Whether the colour that all lamps share is free in joint steps: weights that belong to a
    wrong scale hide the highlights that would tell a better one."""


def fit_surfaces(
    pixels: LampPixels,
    state: LampState,
    weights: Array,
    prior: SurfacePrior,
    *,
    iterations: int,
    free_normals: bool,
    free_roughness: bool = True,
) -> tuple[LampState, Array]:
    """The best surface of each pixel under the lights of a state, and their costs."""
    # Offsets are tangents: what is turned away by a right angle begins where they begin.
    turned = np.einsum("px,px->p", state.normals, pixels.normals) < COSINE_MIN
    begin = np.where(turned[:, None], pixels.normals, state.normals)

    *surface, cost = pixels.under(state).fit(
        weights,
        pixels.normals,
        (begin, state.albedo, state.roughness, state.metallic),
        (prior.mean, prior.precision),
        (free_normals, False, free_roughness),  # metallic waits
        iterations,
    )
    return state.with_surface(*surface), cost


def turned(normals: Array, matrix: Array) -> Array:
    """Unit vectors along M n."""
    return unit(normals @ matrix.T)


def offsets(base: Array, normals: Array) -> Array:
    """(P, 2): tangent offsets of normals from others, (P, 3) each."""
    cosine = np.maximum(np.einsum("px,px->p", normals, base), 1e-6)
    return np.asarray(np.einsum("px,ptx->pt", normals, tangents(base)) / cosine[:, None])


def unknowns_of(pixels: LampPixels, state: LampState) -> Array:
    """(P, 6): offsets of the normals, albedo, roughness."""
    away = offsets(pixels.normals, state.normals)
    return np.concatenate([away, state.albedo, state.roughness[:, None]], axis=-1)


class JointLamps:
    """The joint fit of some pixels; `state` is where it stands.

    `lit` tells by rays which samples (P, N) lamps reach; others are no data. None = nobody knows.
    """

    def __init__(
        self,
        pixels: LampPixels,
        state: LampState,
        noise: Noise,
        prior: SurfacePrior,
        freedom: Freedom,
        *,
        lit: Callable[[Lamps], Array] | None = None,
        relief: Relief | None = None,
    ) -> None:
        self.pixels, self.state, self.noise = pixels, state, noise
        self.prior, self.freedom = prior, freedom
        self.lit, self.relief = lit, relief
        # Of the cues a block of the picture counts as one observation, as in `ambiguity`.
        self.share = 1.0 if relief is None else relief.places.blocks / len(pixels)
        self.damping = 1e-3
        self.cost = np.inf
        self.matrix = np.eye(3)
        self.weights = np.zeros(pixels.samples.shape)
        self._log_brightness = float(
            np.log(np.maximum(pixels.samples.mean(), NOISE_MIN) / ALBEDO_MEAN)
        )

    def reweigh(self, *, renew: bool = True) -> None:
        """New noise and weights by what is left now."""
        if renew:
            samples = max(int(np.count_nonzero(self.pixels.weights)), 1)
            own = 6 if self.freedom.normals else 4
            free = float(max(1 - (own * len(self.pixels) + self._size()) / samples, 0.1))
            self.noise = self.noise.renewed(self.pixels, self.state, free)
        self.weights = self.noise.judged(self.pixels, self.state).weighed()
        if self.lit is not None:
            self.weights *= self.lit(self.state.lamps)[..., None]
        self.cost = self.fitted(self.state, 0)[1]

    def _size(self) -> int:
        return 6 * len(self.state.lamps) + 3 * self.pixels.pictures

    def scale_of(self, lamps: Lamps) -> Array:
        """(4,): what the lamps' strength and tint are off, in standard deviations of their prior.

        Mean and deviations from it of the mean logarithm of their colours.
        """
        directions, strengths = self.state.incident(self.pixels)
        cosines = np.einsum("px,pkx->pk", self.state.normals, directions)
        shading = np.maximum((np.maximum(cosines, 0) * strengths).mean(axis=0), 1e-9)
        colors = np.log(np.maximum(lamps.colors, 1e-12))
        level = float((colors.mean(axis=-1) + np.log(shading)).mean()) - self._log_brightness
        tint = colors.mean(axis=0)
        return np.concatenate([[level / ALBEDO_SPREAD], (tint - tint.mean()) / TINT_SPREAD])

    def fitted(self, state: LampState, iterations: int) -> tuple[LampState, float]:
        """A state with surfaces that took so many steps, and the cost of all."""
        given, free = (self.pixels, state, self.weights, self.prior), self.freedom.normals
        state, costs = fit_surfaces(*given, iterations=iterations, free_normals=free)
        scale, ambient = self.scale_of(state.lamps), state.ambient / (AMBIENT_SHARE * MEAN_RADIANCE)
        cost = float(costs.sum() + (scale**2).sum() + (ambient**2).sum())
        if self.relief is not None:
            cost += self.relief(self.matrix)[0] / self.share
        return state, cost

    def step(self) -> float:
        """One step; the relative decrease of the cost, 0 where none was found."""
        system = self.system()
        for _ in range(8):
            trial = self._moved(system)
            before = self.cost
            if trial is not None:
                moved, turn = trial
                shape = self.pixels, self.matrix
                if self.freedom.shape:
                    normals = turned(self.pixels.normals, turn)
                    self.pixels = replace(self.pixels, normals=normals)
                    self.matrix = turn @ self.matrix
                state, cost = self.fitted(moved, 3)
                if cost < before:
                    self.state, self.cost = state, cost
                    self.damping = max(self.damping * 0.2, 1e-7)
                    return (before - cost) / max(before, 1e-300)
                self.pixels, self.matrix = shape
            self.damping = min(self.damping * 8, 1e6)
        return 0.0

    def information(self) -> Array:
        """S (M, M) of the lights with pixels eliminated, undamped."""
        shared, _, own, mixed, _ = self.system()
        flat = mixed.reshape(-1, mixed.shape[-1])
        eliminated = flat.T @ np.matmul(np.linalg.inv(own), mixed).reshape(flat.shape)
        known, size = shared - eliminated, self._size()
        lights, matrix = known[:size, :size], known[size:, size:]
        across = known[:size, size:]
        return np.asarray(lights - across @ np.linalg.pinv(matrix, hermitian=True) @ across.T)

    def scores(self, direction: Array) -> tuple[Array, float]:
        """Half the slope of the cost along a direction (M,) of what is shared, pixels solved for.

        (P,) of each pixel, and of the priors.
        """
        own, mixed, of_pixels, pushes, _ = self._equations()
        solved = np.linalg.solve(own, of_pixels[..., None])[..., 0]
        of_priors = self._priors(len(direction))[1] @ direction
        each = (pushes - (mixed * solved[..., None]).sum(axis=1)) @ direction
        return each, float(of_priors)

    def system(self) -> tuple[Array, Array, Array, Array, Array]:
        """Matrix and gradient of what is shared, A, B and gradients of the pixels."""
        from scipy.linalg import block_diag

        own, mixed, gradients, pushes, shared = self._equations()
        assert shared is not None
        precision, gradient = self._priors(self._size())
        shared += precision
        gradient += pushes.sum(axis=0)
        if self.freedom.shape:
            by_matrix, pull, of_offsets = self._of_matrix()
            shared = block_diag(shared, by_matrix)
            gradient = np.concatenate([gradient, pull])
            mixed = np.concatenate([mixed, of_offsets], axis=2)
        return shared, gradient, own, mixed, gradients

    def _of_matrix(self) -> tuple[Array, Array, Array]:
        """Matrix (3, 3), gradient (3,) and B (P, 6, 3) of the bas-relief: of g, G = Σ g_i G_i."""
        base, precision = self.pixels.normals, self.prior.precision[:, :2, None]
        moves = np.einsum("pti,gij,pj->ptg", tangents(base), BAS_RELIEF, base)
        away = offsets(base, self.state.normals)[..., None]
        mixed = np.zeros((len(base), UNKNOWNS, 3))
        mixed[:, :2] = -precision * moves
        flat = moves.reshape(-1, 3)
        weighted = (precision * moves).reshape(-1, 3)
        assert self.relief is not None
        by_matrix = flat.T @ weighted + self.relief.curvature(self.matrix) / self.share
        slope = self.relief(self.matrix)[1] / self.share - weighted.T @ away.ravel()
        return by_matrix, slope, mixed

    def pixel_system(self) -> tuple[Array, Array]:
        """A (P, 6, 6) and B (P, 6, M) of the pixels alone."""
        own, mixed, *_ = self._equations(of_lights=False)
        return own, mixed

    def _equations(
        self, *, of_lights: bool = True
    ) -> tuple[Array, Array, Array, Array, Array | None]:
        """With the priors of pixels A, B, g; of samples J_yᵀ W e (P, M), Σ J_yᵀ W J_y if asked."""
        state, count = self.state, len(self.pixels)
        directions, strengths = state.incident(self.pixels)
        rows, mixed, shared = self.pixels.under(state).system(
            self.weights,
            surface_of(state),
            strengths,
            by_place(self.pixels, state.lamps, directions),
            of_lights,
        )
        own, gradients = rows[:, :UNKNOWNS], rows[:, UNKNOWNS]
        mixed, pushes = mixed[:, :UNKNOWNS], mixed[:, UNKNOWNS]
        prior = self.prior
        surface = unknowns_of(self.pixels, state)
        precision = prior.precision[:, :UNKNOWNS]
        gradients += precision * (surface - prior.mean[:, :UNKNOWNS])
        np.einsum("puu->pu", own)[:] += precision
        # What is held has a row of its own and no gradient.
        held = np.zeros((count, UNKNOWNS), bool)
        held[:, :2] = not self.freedom.normals
        at = surface[:, 2:]
        held[:, 2:] = ((at <= 0) & (gradients[:, 2:] > 0)) | ((at >= 1) & (gradients[:, 2:] < 0))
        diagonal = np.einsum("puu->pu", own)
        held |= diagonal <= 0
        own[held] = 0.0
        np.swapaxes(own, 1, 2)[held] = 0.0
        diagonal[held] = 1.0
        gradients[held] = 0.0
        mixed[held] = 0.0
        return own, mixed, gradients, pushes, shared

    def _priors(self, size: int) -> tuple[Array, Array]:
        """Matrix (M, M) and gradient (M,) of the priors of what is shared."""
        shared, gradient = np.zeros((size, size)), np.zeros(size)
        lamps, first = len(self.state.lamps), 6 * len(self.state.lamps)
        precision_of = 1 / (AMBIENT_SHARE * MEAN_RADIANCE) ** 2
        gradient[first:] += precision_of * self.state.ambient[:, 0].reshape(-1)
        np.einsum("mm->m", shared)[first:] += precision_of
        if self.freedom.colors:
            by_level = np.full((1, 3), 1 / 3) / ALBEDO_SPREAD
            by_log = np.concatenate([by_level, (np.eye(3) - 1 / 3) / TINT_SPREAD])
            by_color = by_log[:, None] / np.maximum(self.state.lamps.colors, 1e-12) / lamps
            slope = np.zeros((4, size))
            slope[:, 3 * lamps : first] = by_color.reshape(4, -1)
            shared += slope.T @ slope
            gradient += slope.T @ self.scale_of(self.state.lamps)
        return shared, gradient

    def _moved(
        self, system: tuple[Array, Array, Array, Array, Array]
    ) -> tuple[LampState, Array] | None:
        """The state after a step with the present damping, and what turns normals (3, 3).

        None if there is no step.
        """
        lamps = self.state.lamps
        found = step_of(*system, *self.directions(system[1]), self.damping)
        if found is None:
            return None
        change, of_pixels = found
        places = change[: 3 * len(lamps)].reshape(-1, 3)
        colors = change[3 * len(lamps) : 6 * len(lamps)].reshape(-1, 3)
        ambient = self.state.ambient.copy()
        ambient[:, 0] += change[6 * len(lamps) : self._size()].reshape(-1, 3)
        np.maximum(ambient[:, 0], 0.0, out=ambient[:, 0])
        matrix = np.eye(3)
        if self.freedom.shape:
            matrix += np.tensordot(change[self._size() :], BAS_RELIEF, 1)
        reach = np.where(lamps.near, np.linalg.norm(lamps.places, axis=-1), 1.0)
        # Half of the distance, or of a tangent, at most.
        longest = np.maximum(np.linalg.norm(places, axis=-1) / (0.5 * reach), 1.0)
        moved = lamps.places + places / longest[:, None]
        far = ~lamps.near
        moved[far] = unit(moved[far])
        tinted = np.clip(lamps.colors + colors, lamps.colors * 0.2, lamps.colors * 5)
        normals = self.state.normals
        if self.freedom.normals:
            offsets = of_pixels[:, :2]
            length = np.maximum(np.linalg.norm(offsets, axis=-1) / 0.3, 1.0)  # of a tangent
            offsets = offsets / length[:, None]
            moved_normals = unit(normals + np.einsum("pt,ptx->px", offsets, tangents(normals)))
            visible = np.einsum("px,px->p", moved_normals, self.pixels.views) > 0.02
            visible &= np.einsum("px,px->p", moved_normals, self.pixels.normals) > COSINE_MIN
            normals = np.where(visible[:, None], moved_normals, normals)
        state = replace(
            self.state,
            lamps=replace(lamps, places=moved, colors=tinted),
            ambient=ambient,
            normals=normals,
            albedo=np.clip(self.state.albedo + of_pixels[:, 2:5], 0, 1),
            roughness=np.clip(
                self.state.roughness + np.clip(of_pixels[:, 5], -0.2, 0.2), ROUGHNESS_MIN, 1
            ),
        )
        return state, matrix

    def directions(self, gradient: Array) -> tuple[Array, Array]:
        """In which what is shared may move, (M, columns), and slopes of what is held, (rows, M).

        Ambient light that is 0 stays where the gradient (M,) would have it negative.
        """
        from scipy.linalg import block_diag

        lamps, count = self.state.lamps, len(self.state.lamps)
        places = colors = np.zeros((3 * count, 0))
        held = np.zeros((0, self._size()))
        if self.freedom.places:
            frames = tangents(np.where(lamps.near[:, None], [0.0, 0.0, 1.0], lamps.places))
            each = zip(frames, lamps.near, strict=True)
            places = block_diag(*(np.eye(3) if near else frame.T for frame, near in each))
        if self.freedom.colors:
            colors = np.eye(3 * count)
            if self.freedom.same_lamp:
                colors = np.tile(np.eye(3), (count, 1))
            if not self.freedom.scale:
                # Changes leave the mean logarithm of each channel.
                held = np.zeros((3, self._size()))
                by_log = 1 / np.maximum(lamps.colors, 1e-12)
                for c in range(3):
                    held[c, 3 * count + c : 6 * count : 3] = by_log[:, c]
        ambient = self.state.ambient[:, 0].reshape(-1)
        held_dark = (ambient <= 0) & (gradient[6 * count : self._size()] > 0)
        free = block_diag(places, colors, np.eye(len(ambient))[:, ~held_dark])
        if self.freedom.shape:
            free = block_diag(free, np.eye(3))
            held = np.concatenate([held, np.zeros((len(held), 3))], axis=1)
        return free, held


def minimize(fit: JointLamps, *, steps: int, stop: Callable[[], bool] = lambda: False) -> int:
    """Joint steps by new weights, with the noise as it is; how many were made."""
    made = 0
    fit.reweigh(renew=False)
    while made < steps and not stop():
        made += 1
        if fit.step() < 1e-4:
            break
    return made


def step_of(
    shared: Array,
    gradient: Array,
    own: Array,
    mixed: Array,
    gradients: Array,
    directions: Array,
    held: Array,
    damping: float,
) -> tuple[Array, Array] | None:
    """The changes of what is shared, (M,), and of the pixels' unknowns, (P, U); None if singular.

    By the matrix (M, M) and gradient of what is shared, A (P, U, U), B (P, U, M) and gradients
    (P, U) of the pixels, and the `directions` E (M, columns) in which what is shared may move,
    without what the slopes `held` (rows, M) see. `damping` is the share of the diagonals that is
    added to them.
    """
    from scipy.sparse import csr_array

    own = own.copy()
    np.einsum("puu->pu", own)[:] *= 1 + damping
    try:
        inverse = np.linalg.inv(own)
        along = csr_array(directions)
        coupling = np.asarray(along.T @ mixed.reshape(-1, mixed.shape[-1]).T).T
        solved = np.matmul(inverse, coupling.reshape(*mixed.shape[:2], -1))
        eliminated = solved.reshape(coupling.shape)
        matrix = np.asarray(along.T @ shared @ along)
        np.einsum("uu->u", matrix)[:] += damping * np.maximum(np.diag(matrix), 1e-12)
        right = eliminated.T @ gradients.reshape(-1) - along.T @ gradient
        matrix -= coupling.T @ eliminated
        bound, none = held @ along, np.zeros((len(held), len(held)))
        bordered = np.block([[matrix, bound.T], [bound, none]])
        moved = np.linalg.solve(bordered, np.append(right, none[:, :1]))[: len(right)]
    except np.linalg.LinAlgError:
        return None
    if not np.isfinite(moved).all():
        return None
    of_pixels = -np.einsum("puv,pv->pu", inverse, gradients) - solved @ moved
    return np.asarray(along @ moved), of_pixels
