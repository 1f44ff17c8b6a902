"""Uncertainty: how far the numbers of a fit can be trusted, from its Gauss–Newton normal matrix.

docs/uncertainty.md derives the formulas and says when not to believe them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pbrfit.fit.light_spectrum import of_objective
from pbrfit.fit.normal_equations import (
    WORKING_SET,
    chunks,
    held_at_bounds,
    inverse,
)
from pbrfit.fit.objective import Objective
from pbrfit.fit.parameters import ParameterLayout
from pbrfit.fit.sampling import evenly_spaced
from pbrfit.fit.settings import (
    FREE_MOVE_MAX,
    LIGHT_INFORMATION_MIN,
    LIGHT_PIXELS_MAX,
    OMITTED_CHECK_PIXELS,
    OMITTED_VARIANCE_SHARE_MAX,
    SIGMA_MAX,
    SIGMA_UNDETERMINED,
)
from pbrfit.model.materials import Materials
from pbrfit.result.uncertainty import Uncertainty
from pbrfit.result.verdict import Verdict, expected_errors, level_of
from pbrfit.threads import in_pieces, one_blas_thread

Array = NDArray[np.float64]

PIECES_MIN = 16
"""Pieces that the pixels are taken in, at least, so that their matrices take little memory beside
the pictures."""


@one_blas_thread()
def estimate(
    objective: Objective,
    x: Array,
    *,
    priors: bool = False,
    albedo_scale: Array | None = None,
    picture_effect: float = 1.0,
    light_pixels: int = LIGHT_PIXELS_MAX,
) -> Uncertainty:
    """Uncertainty of a fit that ended at x; the lights' covariance is from so many pixels at most.

    `priors`, whether priors took part in the fit, and the relative deviation of the scale, by
    `pbrfit.fit.scale`, are passed on to `Uncertainty`. Variances are `picture_effect` times those
    of independent samples (`pbrfit.fit.noise`).
    """
    lights = light_modes(objective, x, light_pixels)
    return of_variances(
        variances(objective, x, lights),
        objective.layout,
        lights,
        samples=objective.samples,
        scale=objective.scale,
        priors=priors,
        albedo_scale=albedo_scale,
        picture_effect=picture_effect,
    )


@dataclass(frozen=True, eq=False)
class Variances:
    """Variances of the unknowns of pixels for noise of deviation 1, (P, D)."""

    conditional: NDArray[np.floating[Any]]
    marginal: NDArray[np.floating[Any]]
    """With the lights held, and with their modes."""
    singular: NDArray[np.bool_]
    held: NDArray[np.bool_]
    """Which are not determined, and which are held at a bound."""
    sum_sq_residuals: Array
    """(P,): each pixel's sum of squared residuals."""

    @classmethod
    def empty(cls, pixels: int, unknowns: int) -> Variances:
        """To be filled, in float32."""
        shape = pixels, unknowns
        conditional, marginal = np.zeros((2, *shape), np.float32)
        singular, held = np.zeros((2, *shape), bool)
        return cls(conditional, marginal, singular, held, np.zeros(pixels))

    def put(self, pixels: NDArray[np.intp], other: Variances, of_other: NDArray[np.bool_]) -> None:
        """Give some pixels what some of another's have."""
        largest = np.finfo(np.float32).max
        for name in ("conditional", "marginal"):
            getattr(self, name)[pixels] = np.minimum(getattr(other, name)[of_other], largest)
        for name in ("singular", "held", "sum_sq_residuals"):
            getattr(self, name)[pixels] = getattr(other, name)[of_other]


def variances(objective: Objective, x: Array, lights: LightModes | None) -> Variances:
    """Of all pixels of a fit, given how its lights may move."""
    problem, layout = objective.problem, objective.layout
    held = held_at_bounds(x, layout)
    for_core = objective.for_core(x)
    conditional = np.empty(held.shape)
    marginal = np.empty(held.shape)
    singular = np.empty(held.shape, dtype=bool)
    sum_sq_residuals = np.empty(layout.pixels)
    bytes_each = max(8 * 4 * held.shape[1] ** 2, PIECES_MIN * WORKING_SET // layout.pixels)

    def fill(chunk: slice) -> None:
        pixels = np.arange(chunk.start, chunk.stop, dtype=np.uint64)
        matrices, _, sum_sq_residuals[chunk] = problem.normal_equations(for_core, pixels)
        found = inverse(matrices, held[chunk])
        conditional[chunk] = np.einsum("pii->pi", found.matrices)
        marginal[chunk] = conditional[chunk]
        singular[chunk] = found.singular
        if lights is not None:
            args = for_core, pixels, found.matrices
            marginal[chunk] += problem.moves_with_lights(*args, lights.modes)
            if len(lights.free):
                moves = problem.moves_with_lights(*args, lights.free)
                singular[chunk] |= moves > FREE_MOVE_MAX**2

    in_pieces(objective.threads, fill, chunks(layout.pixels, bytes_each))
    return Variances(conditional, marginal, singular, held, sum_sq_residuals)


def of_variances(
    found: Variances,
    layout: ParameterLayout,
    lights: LightModes | None,
    *,
    samples: int,
    scale: float,
    priors: bool,
    albedo_scale: Array | None,
    picture_effect: float,
) -> Uncertainty:
    """The uncertainty with the noise that is left, from those of all pixels, which change.

    Of the scene are the number of samples that have a weight, and its scale.
    """
    held = found.held
    unknowns = np.count_nonzero(~held) + layout.size - layout.maps.stop
    degrees = samples - unknowns
    noise = math.sqrt(float(found.sum_sq_residuals.sum()) / degrees) if degrees > 0 else None

    def deviations(variances: NDArray[np.floating[Any]]) -> NDArray[np.floating[Any]]:
        """In their place."""
        np.sqrt(variances, out=variances)
        variances *= (noise or 0.0) * math.sqrt(picture_effect)
        variances[found.singular | (not degrees > 0) & ~held] = SIGMA_MAX
        np.minimum(variances, SIGMA_MAX, out=variances)
        return variances

    if lights is None:
        albedo_scale = np.zeros(1)
    elif albedo_scale is None or noise is None:
        albedo_scale = np.full(1, SIGMA_MAX)
    deviation = np.minimum(albedo_scale, SIGMA_MAX)
    red, green, blue = np.broadcast_to(deviation, 3).tolist()
    marginal = _materials(deviations(found.marginal), layout)
    return Uncertainty(
        deviation=marginal,
        low=marginal,
        high=marginal,
        noise=None if noise is None else noise * scale,
        effective_share=1.0,
        albedo_scale=(red, green, blue),
        verdicts={
            name: Verdict(level_of(name, error), error)
            for name, error in expected_errors(marginal).items()
        },
    )


@dataclass(frozen=True, eq=False)
class LightModes:
    """Covariance of the lights, of noise 1, as independent modes of deviation 1."""

    modes: Array
    """(R, N, K, C): those that matter to materials."""
    free: Array
    """(F, N, K, C), as strong as the lights themselves: those that materials can make up for."""
    pixels: int
    """How many they are from."""
    omitted: float
    """As in `Uncertainty`."""


def light_modes(
    objective: Objective,
    x: Array,
    light_pixels: int = LIGHT_PIXELS_MAX,
    of_pixels: int | None = None,
) -> LightModes | None:
    """How the lights of a fit may move, from their spectrum over some of its pixels.

    None where they are known. `of_pixels` is how many pixels saw them, if not those of the
    objective alone.

    The mode of λ adds (1 − λ)/λ to the sum over pixels of their variances in units of A⁻¹. That
    ranks the modes and bounds what those left out would add.
    """
    if objective.lighting is None:
        return None
    held = held_at_bounds(x, objective.layout)
    layout, for_core = objective.layout, objective.for_core(x)
    pixels = evenly_spaced(layout.pixels, light_pixels)
    own_held = held[pixels]
    known = of_objective(objective, x, pixels, own_held)
    left, vectors = known.left, known.vectors
    light_channels, k = layout.light_channels, layout.coefficients
    blocks = layout.pictures * light_channels

    def in_x(of_units: Array) -> Array:
        """(modes, N, K, C) from modes in the columns."""
        modes = np.einsum("aki,aim->mak", known.from_units, of_units.reshape(blocks, k, -1))
        modes = modes.reshape(-1, layout.pictures, light_channels, k).transpose(0, 1, 3, 2)
        return np.ascontiguousarray(np.repeat(modes, layout.channels // light_channels, axis=-1))

    # What the other pixels know of the lights is taken to be like what these know.
    more = (of_pixels or layout.pixels) / len(pixels)
    is_free = left < LIGHT_INFORMATION_MIN
    left = np.maximum(left, LIGHT_INFORMATION_MIN)
    deviation = 1 / np.sqrt(more * left)
    adds = (1 - left) / left
    remaining = np.cumsum(adds[::-1])[::-1] + known.rest / left[-1]  # λ rises
    remaining /= more * max(1, int(np.count_nonzero(~own_held)))
    used = int(np.count_nonzero(~is_free & (remaining > OMITTED_VARIANCE_SHARE_MAX)))
    modes = in_x((vectors * deviation)[:, ~is_free])
    lights = for_core[layout.maps.stop :].reshape(layout.pictures, k, -1)[..., :light_channels]
    in_units = np.einsum("aik,ak->ai", known.to_units, lights.transpose(0, 2, 1).reshape(blocks, k))
    return LightModes(
        modes=modes[:used],
        free=in_x(vectors[:, is_free] * np.linalg.norm(in_units)),
        pixels=len(pixels),
        omitted=_omitted(objective, for_core, pixels, own_held, modes, used),
    )


def _omitted(
    objective: Objective,
    for_core: Array,
    pixels: NDArray[np.uint64],
    held: NDArray[np.bool_],
    modes: Array,
    used: int,
) -> float:
    """Largest share of a deviation that the modes from `used` on would add, over some pixels."""
    some = evenly_spaced(len(pixels), OMITTED_CHECK_PIXELS)
    matrices, _, _ = objective.problem.normal_equations(for_core, pixels[some])
    found = inverse(matrices, held[some])
    args = for_core, pixels[some], found.matrices
    kept = np.einsum("pii->pi", found.matrices) + objective.problem.moves_with_lights(
        *args, modes[:used]
    )
    rest = objective.problem.moves_with_lights(*args, modes[used:])
    known = (kept > 0) & ~found.singular
    return float(1 - np.sqrt((kept[known] / (kept + rest)[known]).min(initial=1.0)))


def _materials(values: NDArray[np.floating[Any]], layout: ParameterLayout) -> Materials:
    """Maps of (P, D); what is known has 0."""
    c = layout.channels
    metallic = np.zeros(layout.pixels) if layout.metallic_known else values[:, c + 1]
    return Materials(
        layout.whole(np.broadcast_to(values[:, :c], (layout.pixels, 3))),
        layout.whole(values[:, c]),
        layout.whole(metallic),
    )


def _flags(values: NDArray[np.bool_], layout: ParameterLayout) -> NDArray[np.bool_]:
    """(H, W, 3) of (P, D), False outside the mask."""
    c = layout.channels
    albedo = values[:, 0].copy()
    for channel in range(1, c):
        albedo |= values[:, channel]
    flags = np.zeros((*layout.valid.shape, 3), dtype=bool)
    for i, of_map in enumerate((albedo, *values[:, c:].T)):
        flags[layout.valid, i] = of_map
    return flags
