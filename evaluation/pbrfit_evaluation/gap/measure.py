"""Models beside integrals of BRDFs at points of a table, and on spheres under random lights.

A model, integrated or in closed form, gives at one (r, n·v) the weights of the 16 SH light
coefficients for any material.

**Responses.** The weights of band l at one (r, n·v) are reduced to one number,

    R_l = √(mean over channels of Σ_m w_lm²) · √(4π/(2l+1)).

A perfect mirror has R_l = 1 in every band, because Σ_m Y_lm² = (2l+1)/4π in any direction. R_0 is
the directional albedo: the share of light that comes back under light of one radiance from all
around. A ratio of responses says how much too bright a model is.

**Random lights.** Let a light be turned in every way. Cross terms between coefficients vanish then,
and the mean square of Σ_k d_k L_k is Σ_l Σ_m d_lm² · P_l with P_l = Σ_m L_lm²/(2l+1). Together with
a mean over the pixels of a sphere seen from far away, on which (n·v)² is uniform in [0, 1], that is
the error of pictures of spheres under random lights, without any sampling noise.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, Protocol

import numpy as np

from pbrfit.model.lighting import BAND_OF
from pbrfit.model.reflection import Model as ModelName
from pbrfit.model.reflection import shade
from pbrfit.synthetic.lights import random_lights
from pbrfit_evaluation.arrays import Array
from pbrfit_evaluation.gap import brute_force, principled
from pbrfit_evaluation.gap.brute_force import view
from pbrfit_evaluation.suite import Options


class Response(Protocol):
    """What a model gives at one roughness and n·v, and how far it is from exact."""

    @property
    def error(self) -> float:
        """Largest change of any integral when the number of nodes is doubled."""

    def weights(self, albedo: Array, metallic: Array) -> Array:
        """(M, 3, 16) in the pixel's own frame, of albedo (M, 3) and metallic (M,)."""


Model = Callable[[float, float], Response]
"""Of r and n·v."""


@dataclass(frozen=True)
class Closed:
    """What the package fits, by the name it has everywhere."""

    model: ModelName
    r: float
    n_dot_v: float
    error: float = 0.0

    def weights(self, albedo: Array, metallic: Array) -> Array:
        """As of `Response`."""
        normals = np.broadcast_to(np.array([0.0, 0.0, 1.0]), albedo.shape)
        views = np.broadcast_to(view(self.n_dot_v), albedo.shape)
        roughness = np.full(metallic.shape, self.r)
        return shade(normals, views, albedo, roughness, metallic, model=self.model)


INTEGRATED = "paper, integrated"
"""Name of the paper's BRDF itself, where it is compared as a model."""

COMPARED: Mapping[str, Model] = {
    "paper": partial(Closed, "paper"),
    INTEGRATED: brute_force.respond,
    "principled": partial(Closed, "principled"),
}
"""All models that are compared with the principled BRDF."""


@dataclass(frozen=True)
class Material:
    """A material without its roughness; albedo in linear Rec.709, metallic in [0, 1]."""

    key: str
    name: str
    albedo: tuple[float, float, float]
    metallic: float


MATERIALS = (
    Material("lobe", "lobe alone (F = 1)", (1.0, 1.0, 1.0), 1.0),
    Material("gold", "gold (metal)", (1.0, 0.77, 0.34), 1.0),
    Material("dark", "dielectric, albedo 0.05", (0.05, 0.05, 0.05), 0.0),
    Material("light", "dielectric, albedo 0.5", (0.5, 0.5, 0.5), 0.0),
)
"""A metal of albedo 1 has F = 1 at every angle and no diffuse term: its response is the lobe's."""

ALBEDO = np.array([material.albedo for material in MATERIALS])
METALLIC = np.array([material.metallic for material in MATERIALS])


@dataclass(frozen=True)
class Case:
    """A roughness r, compared at values of n·v and on spheres of `rings` values of n·v.

    The spheres are under `lights` random lights of a seed.
    """

    r: float
    n_dot_v: tuple[float, ...]
    rings: int
    lights: int
    seed: int = 0

    @property
    def key(self) -> str:
        """Name of the record."""
        return f"r_{self.r:g}"


def run(
    case: Case,
    _: int = 1,
    reference: Model = principled.respond,
    models: Mapping[str, Model] = COMPARED,
) -> dict[str, Any]:
    """Compare models with brute-force integration of one BRDF. M materials, V values of n·v.

    "true": (M, V, 4) responses by brute force. "signal": (M,) root mean square radiance of a
    sphere. "models": by name "found", (M, V, 4) responses, and "error", (M,) root mean square
    error of a sphere's radiance. "quadrature_error": largest change of any integral of the table
    when the number of nodes is doubled, or of the root mean square over a sphere, whichever is
    larger.
    """
    rings, shares = brute_force.rings(case.rings)
    power = band_power(random_lights(case.lights, np.random.default_rng(case.seed)))
    true, changes = _weights(reference, case.r, case.n_dot_v)
    on_sphere, on_rings = _weights(reference, case.r, rings)
    found = {}
    for name, model in models.items():
        off = _weights(model, case.r, rings)[0] - on_sphere
        found[name] = {
            "found": response(_weights(model, case.r, case.n_dot_v)[0]).tolist(),
            "error": rms_radiance(off, shares, power).tolist(),
        }
    return {
        "true": response(true).tolist(),
        "signal": rms_radiance(on_sphere, shares, power).tolist(),
        "models": found,
        "quadrature_error": max(changes.max(), math.sqrt(np.square(on_rings) @ shares)),
    }


def response(weights: Array) -> Array:
    """R_l above: (..., 3, 16) weights to (..., 4)."""
    power = np.mean(np.square(weights), axis=-2)
    bands = np.stack([power[..., band == BAND_OF].sum(axis=-1) for band in range(4)], axis=-1)
    return np.sqrt(bands * 4 * np.pi / (2 * np.arange(4) + 1))


def band_power(lights: Array) -> Array:
    """(3, 16): mean over lights of P_l by channel, repeated for each coefficient of its band."""
    power = np.mean(np.square(lights), axis=0).T
    of_band = [power[:, band == BAND_OF].mean(axis=-1) for band in range(4)]
    return np.stack(of_band, axis=-1)[:, BAND_OF]


def rms_radiance(weights: Array, shares: Array, power: Array) -> Array:
    """Root mean square radiance of a sphere: weights (M, V, 3, 16), shares (V,) of its pixels."""
    mean_square = np.einsum("mvck,ck->mvc", np.square(weights), power).mean(axis=-1)
    return np.asarray(np.sqrt(mean_square @ shares))


def _weights(model: Model, r: float, n_dot_v: Sequence[float]) -> tuple[Array, Array]:
    """(M, V, 3, 16) of a model, and (V,) how much they change with the number of nodes."""
    found = [model(r, x) for x in n_dot_v]
    weights = [one.weights(ALBEDO, METALLIC) for one in found]
    return np.stack(weights, axis=1), np.array([one.error for one in found])


def cases(options: Options) -> list[Case]:
    """A case for each roughness of the table."""
    return [
        Case(r, options.n_dot_v, options.rings, options.lights, options.seed) for r in options.r
    ]
