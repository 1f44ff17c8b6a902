"""Uncertainty: how far the numbers of a fit can be trusted, from its Gauss–Newton normal matrix.

docs/uncertainty.md derives the formulas and says when not to believe them.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pbrfit.fit.gauss_newton.light_spectrum import spectrum
from pbrfit.fit.gauss_newton.normal_equations import WORKING_SET, chunks, held_at_bounds, inverse
from pbrfit.fit.objective import Objective
from pbrfit.fit.parameters import ParameterLayout
from pbrfit.fit.sampling import evenly_spaced
from pbrfit.io.json_files import flag, number, whole
from pbrfit.model.materials import Materials

Array = NDArray[np.float64]

PARAMETERS = ("albedo", "roughness", "metallic")
"""In the order of the flags."""

UNDETERMINED = 1 / math.sqrt(12)
"""Deviation of a number about which nothing is known but that it lies in [0, 1]. From here on the
pictures say nothing about it."""

LARGEST = 1.0
"""Deviations are cut off here, the width of the range."""

LIGHT_PIXELS = 4096
"""At most so many pixels, evenly spread, tell how uncertain the lights are."""

OMITTED = 1e-3
"""Modes of the lights are left out while all of them together raise the pixels' variances by less
than this share in the mean."""

FREE = 1e-10
"""Share of its information that a direction of the light keeps when materials are fitted too. Below
this it is rounding: materials can make up for it completely."""

FREE_MOVE = 0.01
"""An unknown that moves by more than this when the light changes by as much as it is itself, in a
direction that materials can make up for, is not determined."""

PIECES = 16
"""At least so many pieces are the pixels taken in, so that their matrices take little memory beside
the pictures."""

CHECKED = 512
"""Pixels in which the modes that were used are compared with all."""


@dataclass(frozen=True, eq=False)
class Uncertainty:
    """Standard deviations of the materials of a fit, as far as noise in the pictures explains them.

    Two kinds: *conditional*, if the lights were known to be those of the fit, from a pixel's own
    samples; and *marginal*, with the lights and the scale between them and albedo as uncertain as
    they are. They are equal where the lights are known. Neither knows of errors in the model or the
    normals, nor of priors. Normals that were refined are held as they were found, so their own
    uncertainty is in neither.

    Attributes
    ----------
    conditional, marginal
        Standard deviations in place of values, at most 1; 0 for what is held (on a bound, or a
        known metallic); NaN outside the mask.
    undetermined
        (H, W, 3) bool: albedo (in any channel), roughness, metallic: the pictures do not tell it,
        because its marginal deviation is above 1/√12 or the equations are singular.
    on_bound
        (H, W, 3) bool, likewise: at 0 or 1, held there, and without a deviation of its own.
    noise
        Standard deviation of a sample of the largest weight, in picture units, from the residual
        and its degrees of freedom; None where there are no more samples than unknowns, and then
        nothing is determined.
    albedo_scale
        Relative standard deviation, by channel, of the scale of the lights, which albedo
        undoes; 0 where they are known.
    priors
        Whether the fit had priors. The deviations are those of the data alone, so they are too
        large then where priors help.
    light_pixels, light_modes
        How many pixels the lights' covariance is from, and how many of its modes were used; 0 where
        they are known.
    omitted
        Largest share of a marginal deviation that the modes left out would add, as found in some of
        these pixels.
    """

    conditional: Materials
    marginal: Materials
    undetermined: NDArray[np.bool_]
    on_bound: NDArray[np.bool_]
    noise: float | None
    albedo_scale: tuple[float, float, float]
    priors: bool
    light_pixels: int
    light_modes: int
    omitted: float

    def summary(self) -> dict[str, Any]:
        """What is no map, and the maps in a few numbers, for result.json."""
        valid = np.isfinite(self.marginal.roughness)

        def shares(flags: NDArray[np.bool_]) -> dict[str, float]:
            return dict(zip(PARAMETERS, flags[valid].mean(axis=0).tolist(), strict=True))

        def medians(deviations: Materials) -> dict[str, float]:
            # In float32, as in files: a result that is read and written again stays the same.
            of_maps = {name: getattr(deviations, name).astype(np.float32) for name in PARAMETERS}
            return {name: float(np.median(values[valid])) for name, values in of_maps.items()}

        return {
            "noise": self.noise,
            "albedo_scale": list(self.albedo_scale),
            "median_conditional": medians(self.conditional),
            "median_marginal": medians(self.marginal),
            "undetermined": shares(self.undetermined),
            "on_bound": shares(self.on_bound),
            "priors": self.priors,
            "light_pixels": self.light_pixels,
            "light_modes": self.light_modes,
            "omitted": self.omitted,
        }

    def layers(self) -> dict[str, NDArray[Any]]:
        """Maps (H, W) by channel name in `materials.exr`, in the order of `layer_names`."""
        maps: list[NDArray[Any]] = []
        for deviations in (self.marginal, self.conditional):
            maps += [*np.moveaxis(deviations.albedo, -1, 0)]
            maps += [deviations.roughness, deviations.metallic]
        for flags in (self.undetermined, self.on_bound):
            maps += [*np.moveaxis(flags, -1, 0)]
        return dict(zip(layer_names(), maps, strict=True))

    @classmethod
    def of(
        cls, layers: Mapping[str, NDArray[Any]], mask: NDArray[np.bool_], summary: Mapping[str, Any]
    ) -> Uncertainty:
        """From all that `layers` and `summary` gave, values outside the mask replaced by NaN.

        Raises one of `json_files.UNFIT` if they gave something else.
        """
        maps = np.stack([layers[name] for name in layer_names()], axis=-1).astype(np.float64)

        def deviations(first: int) -> Materials:
            inside = np.where(mask[..., None], maps[..., first : first + 5], np.nan)
            return Materials(inside[..., :3], inside[..., 3], inside[..., 4])

        def flags(first: int) -> NDArray[np.bool_]:
            return (maps[..., first : first + 3] > 0.5) & mask[..., None]

        red, green, blue = map(number, summary["albedo_scale"])
        if not np.isfinite(maps[mask]).all():
            raise ValueError("standard deviations that are NaN or infinite")
        return cls(
            marginal=deviations(0),
            conditional=deviations(5),
            undetermined=flags(10),
            on_bound=flags(13),
            noise=None if summary["noise"] is None else number(summary["noise"]),
            albedo_scale=(red, green, blue),
            priors=flag(summary["priors"]),
            light_pixels=whole(summary["light_pixels"]),
            light_modes=whole(summary["light_modes"]),
            omitted=number(summary["omitted"]),
        )


def layer_names() -> list[str]:
    """Channels of `materials.exr` that hold an uncertainty."""
    parts = [*(f"albedo.{channel}" for channel in "RGB"), "roughness.Y", "metallic.Y"]
    names = [f"uncertainty.{kind}.{part}" for kind in ("marginal", "conditional") for part in parts]
    for kind in ("undetermined", "on_bound"):
        names += [f"uncertainty.{kind}.{parameter}.Y" for parameter in PARAMETERS]
    return names


def estimate(
    objective: Objective, x: Array, *, priors: bool = False, light_pixels: int = LIGHT_PIXELS
) -> Uncertainty:
    """Uncertainty of a fit.

    Parameters
    ----------
    objective
        What was minimised.
    x
        Where its minimum was found.
    priors
        Whether priors took part in the fit; only told on.
    light_pixels
        The lights' covariance is taken from at most so many pixels.

    Returns
    -------
    Uncertainty
        The same to the last bit at any number of threads.
    """
    # Here and not above: only a fit needs it. One BLAS thread: sums split over threads would round
    # differently on a machine with another number of processors.
    from threadpoolctl import threadpool_limits

    with threadpool_limits(1, user_api="blas"):
        lights = light_modes(objective, x, light_pixels)
        found = variances(objective, x, lights)
        return of_variances(
            found,
            objective.layout,
            lights,
            samples=objective.samples,
            scale=objective.scale,
            priors=priors,
        )


@dataclass(frozen=True, eq=False)
class Variances:
    """Variances of the unknowns of pixels for noise of deviation 1, (P, D).

    Attributes
    ----------
    conditional, marginal
        With the lights held, and with their modes.
    singular
        Which are not determined.
    held
        Which are held at a bound.
    squares
        (P,): what is left of the pixels.
    """

    conditional: NDArray[np.floating[Any]]
    marginal: NDArray[np.floating[Any]]
    singular: NDArray[np.bool_]
    held: NDArray[np.bool_]
    squares: Array

    @classmethod
    def empty(cls, pixels: int, unknowns: int) -> Variances:
        """To be filled, in float32."""
        shape = pixels, unknowns
        return cls(
            np.zeros(shape, np.float32),
            np.zeros(shape, np.float32),
            np.zeros(shape, bool),
            np.zeros(shape, bool),
            np.zeros(pixels),
        )

    def put(self, pixels: NDArray[np.intp], other: Variances, of_other: NDArray[np.bool_]) -> None:
        """Give some pixels what some of another's have."""
        largest = np.finfo(np.float32).max
        for name in ("conditional", "marginal"):
            getattr(self, name)[pixels] = np.minimum(getattr(other, name)[of_other], largest)
        for name in ("singular", "held", "squares"):
            getattr(self, name)[pixels] = getattr(other, name)[of_other]


def variances(objective: Objective, x: Array, lights: LightModes | None) -> Variances:
    """Of all pixels of a fit, given how its lights may move."""
    problem, layout = objective.problem, objective.layout
    held = held_at_bounds(x, layout)
    for_core = objective.for_core(x)
    conditional = np.empty(held.shape)
    marginal = np.empty(held.shape)
    singular = np.empty(held.shape, dtype=bool)
    squares = np.empty(layout.pixels)
    bytes_each = max(8 * 4 * held.shape[1] ** 2, PIECES * WORKING_SET // layout.pixels)
    for chunk in chunks(layout.pixels, bytes_each):
        pixels = np.arange(chunk.start, chunk.stop, dtype=np.uint64)
        matrices, _, squares[chunk] = problem.normal_equations(for_core, pixels)
        found = inverse(matrices, held[chunk])
        conditional[chunk] = np.einsum("pii->pi", found.matrices)
        marginal[chunk] = conditional[chunk]
        singular[chunk] = found.singular
        if lights is not None:
            args = for_core, pixels, found.matrices
            marginal[chunk] += problem.moves_with_lights(*args, lights.modes)
            if len(lights.free):
                moves = problem.moves_with_lights(*args, lights.free)
                singular[chunk] |= moves > FREE_MOVE**2
    return Variances(conditional, marginal, singular, held, squares)


def of_variances(
    found: Variances,
    layout: ParameterLayout,
    lights: LightModes | None,
    *,
    samples: int,
    scale: float,
    priors: bool,
) -> Uncertainty:
    """The uncertainty with the noise that is left; the variances change.

    Parameters
    ----------
    found, layout
        Of all pixels of a scene.
    lights
        How they may move.
    samples, scale, priors
        How many samples have a weight, the scene scale, and whether priors took part.
    """
    held = found.held
    unknowns = np.count_nonzero(~held) + layout.size - layout.maps.stop
    degrees = samples - unknowns
    noise = math.sqrt(float(found.squares.sum()) / degrees) if degrees > 0 else None

    def deviations(variances: NDArray[np.floating[Any]]) -> NDArray[np.floating[Any]]:
        """In their place."""
        np.sqrt(variances, out=variances)
        variances *= noise or 0.0
        variances[found.singular | (not degrees > 0) & ~held] = LARGEST
        np.minimum(variances, LARGEST, out=variances)
        return variances

    albedo_scale = np.zeros(3)
    if lights is not None:
        albedo_scale[:] = (
            np.minimum(lights.scale * noise, LARGEST) if noise is not None else LARGEST
        )
    red, green, blue = albedo_scale.tolist()
    of_conditional = _materials(deviations(found.conditional), layout)
    marginal = deviations(found.marginal)
    return Uncertainty(
        conditional=of_conditional,
        marginal=_materials(marginal, layout),
        undetermined=_flags(marginal > UNDETERMINED, layout),
        on_bound=_flags(held, layout),
        noise=None if noise is None else noise * scale,
        albedo_scale=(red, green, blue),
        priors=priors,
        light_pixels=0 if lights is None else lights.pixels,
        light_modes=0 if lights is None else len(lights.modes),
        omitted=0.0 if lights is None else lights.omitted,
    )


@dataclass(frozen=True, eq=False)
class LightModes:
    """Covariance of the lights, of noise 1, as independent modes of deviation 1.

    Attributes
    ----------
    modes
        (R, N, K, C): those that matter to materials.
    free
        (F, N, K, C), as strong as the lights themselves: those that materials can make up for.
    scale
        (C,) or (1,): relative deviation of the scale of a channel's lights.
    pixels
        How many they are from.
    omitted
        As in `Uncertainty`.
    """

    modes: Array
    free: Array
    scale: Array
    pixels: int
    omitted: float


def light_modes(
    objective: Objective,
    x: Array,
    light_pixels: int = LIGHT_PIXELS,
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
    known = spectrum(objective.problem, for_core, layout, pixels, own_held)
    left, vectors = known.left, known.vectors
    lit, k = layout.light_channels, layout.coefficients
    blocks = layout.pictures * lit

    def in_x(of_units: Array) -> Array:
        """(modes, N, K, C) from modes in the columns."""
        modes = np.einsum("aki,aim->mak", known.from_units, of_units.reshape(blocks, k, -1))
        modes = modes.reshape(-1, layout.pictures, lit, k).transpose(0, 1, 3, 2)
        return np.ascontiguousarray(np.repeat(modes, layout.channels // lit, axis=-1))

    # What the other pixels know of the lights is taken to be like what these know.
    more = (of_pixels or layout.pixels) / len(pixels)
    is_free = left < FREE
    left = np.maximum(left, FREE)
    deviation = 1 / np.sqrt(more * left)
    adds = (1 - left) / left
    remaining = np.cumsum(adds[::-1])[::-1] + known.rest / left[-1]  # λ rises
    remaining /= more * max(1, int(np.count_nonzero(~own_held)))
    used = int(np.count_nonzero(~is_free & (remaining > OMITTED)))
    modes = in_x((vectors * deviation)[:, ~is_free])
    lights = for_core[layout.maps.stop :].reshape(layout.pictures, k, -1)[..., :lit]
    in_units = np.einsum("aik,ak->ai", known.to_units, lights.transpose(0, 2, 1).reshape(blocks, k))
    return LightModes(
        modes=modes[:used],
        free=in_x(vectors[:, is_free] * np.linalg.norm(in_units)),
        scale=_scale_deviation(in_units.reshape(layout.pictures, lit, k), vectors, deviation, more),
        pixels=len(pixels),
        omitted=_omitted(objective, for_core, pixels, own_held, modes, used),
    )


def _scale_deviation(in_units: Array, vectors: Array, deviation: Array, more: float) -> Array:
    """(light channels,): relative deviation of the lights' size in each channel.

    A change d of the lights l changes their size by the share lᵀd / lᵀl. In directions that were
    not computed λ is 1.
    """
    found = []
    for channel in range(in_units.shape[1]):
        lights = np.zeros_like(in_units)
        lights[:, channel] = in_units[:, channel]
        size = max(float(np.linalg.norm(lights)), np.finfo(np.float64).tiny)
        along = lights.ravel() @ vectors / size
        others = max(0.0, 1 - float(np.square(along).sum()))
        found.append(np.sqrt(np.square(along * deviation).sum() + others / more) / size)
    return np.array(found)


def _omitted(
    objective: Objective,
    for_core: Array,
    pixels: NDArray[np.uint64],
    held: NDArray[np.bool_],
    modes: Array,
    used: int,
) -> float:
    """Largest share of a deviation that the modes from `used` on would add, over some pixels."""
    some = evenly_spaced(len(pixels), CHECKED)
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
    flags = np.zeros((*layout.valid.shape, 3), dtype=bool)
    of_pixels = np.zeros((layout.pixels, 3), dtype=bool)
    of_pixels[:, 0] = values[:, :c].any(axis=1)
    of_pixels[:, 1 : 1 + values.shape[1] - c] = values[:, c:]
    flags[layout.valid] = of_pixels
    return flags
