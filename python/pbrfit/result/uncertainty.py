"""Uncertainty: standard deviations of the maps of a result, as data."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pbrfit.io.json_files import flag, number, whole
from pbrfit.model.materials import Materials

PARAMETERS = ("albedo", "roughness", "metallic")
"""In the order of the flags."""


@dataclass(frozen=True, eq=False)
class Uncertainty:
    """Standard deviations of the materials of a fit, as far as noise in the pictures explains them.

    Two kinds: *conditional*, if the lights were known to be those of the fit, from a pixel's own
    samples; and *marginal*, with the lights and the scale between them and albedo as uncertain as
    they are. They are equal where the lights are known. Neither knows of errors in the model or the
    normals, nor of priors. Normals that were refined are held as they were found, so their own
    uncertainty is in neither.
    """

    conditional: Materials
    marginal: Materials
    """Standard deviations in place of values, at most 1; 0 for what is held (on a bound, or a known
    metallic); NaN outside the mask."""
    undetermined: NDArray[np.bool_]
    """(H, W, 3) bool: albedo (in any channel), roughness, metallic: the pictures do not tell it,
    because its marginal deviation is above 1/√12 or the equations are singular."""
    on_bound: NDArray[np.bool_]
    """(H, W, 3) bool, likewise: at 0 or 1, held there, and without a deviation of its own."""
    noise: float | None
    """Standard deviation of a sample of the largest weight, in picture units, from the residual and
    its degrees of freedom; None where there are no more samples than unknowns, and then nothing is
    determined."""
    albedo_scale: tuple[float, float, float]
    """Relative standard deviation, by channel, of the scale of the lights, which albedo undoes; 0
    where they are known. It holds what segments and patches of the picture disagree about beside
    noise, and errors of the prior."""
    priors: bool
    """Whether the fit had priors. The deviations are those of the data alone, so they are too large
    then where priors help."""
    light_pixels: int
    light_modes: int
    """How many pixels the lights' covariance is from, and how many of its modes were used; 0 where
    they are known."""
    omitted: float
    """Largest share of a marginal deviation that the modes left out would add, as found in some of
    these pixels."""

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
