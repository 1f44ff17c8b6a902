"""The gap between reflection models and the integrals of BRDFs, and Cycles.

A model is a function with the signature of `pbrfit.shade`: material, normal and view in, weights of
the 16 SH light coefficients out. Here models are compared with brute-force integration of a BRDF,
so what is measured is the model alone: no fit, no pictures, no noise. Against the integral of its
own BRDF (`brute_force.py` has the paper's, `principled.py` the other) that is what the model's
approximations cost; against the BRDF that renderers use it is what the model is worth to them.
`spheres.py` compares with pictures by one such renderer.

**Responses.** The weights of band l at one (r, n·v) are reduced to one number,

    R_l = √(mean over channels of Σ_m w_lm²) · √(4π/(2l+1)).

A perfect mirror has R_l = 1 in every band, because Σ_m Y_lm² = (2l+1)/4π in any direction. R_0 is
the directional albedo: the share of light that comes back under light of one radiance from all
around. A ratio of responses says how much too bright a model is; the distance, the same norm of the
difference of two sets of weights, counts errors of direction too.

**Random lights.** Let a light be turned in every way. Cross terms between coefficients vanish then,
and the mean square of Σ_k d_k L_k is Σ_l Σ_m d_lm² · P_l with P_l = Σ_m L_lm²/(2l+1). Together with
a mean over the pixels of a sphere seen from far away, on which (n·v)² is uniform in [0, 1], that is
the error of pictures of spheres under random lights, without any sampling noise.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from pbrfit.model.reflection import MODELS as MODEL_NAMES
from pbrfit.model.reflection import shade
from pbrfit.synthetic.lights import random_lights
from pbrfit_evaluation.gap import brute_force, principled
from pbrfit_evaluation.gap.brute_force import view

__all__ = [
    "FULL",
    "INTEGRATED",
    "MATERIALS",
    "MODELS",
    "PAPER",
    "PRINCIPLED",
    "QUICK",
    "TABULATED",
    "Effort",
    "Gap",
    "Material",
    "Reference",
    "measure",
    "measure_all",
]

Array = NDArray[np.float64]

Model = Callable[[Array, Array, Array, Array, Array], Array]
"""normal (..., 3), view (..., 3), albedo (..., 3), r (...,), m (...,) -> weights (..., 3, 16)."""

MODELS: Mapping[str, Model] = {name: partial(shade, model=name) for name in MODEL_NAMES}
"""What the package fits, by the names it has everywhere."""


class Response(Protocol):
    """Reflection of one (r, n·v) by brute force."""

    @property
    def error(self) -> float:
        """Largest change of any integral when the number of nodes is doubled."""

    def weights(self, albedo: Array, metallic: Array) -> Array:
        """(..., 3, 16) in the pixel's own frame, as `pbrfit.shade` gives."""


@dataclass(frozen=True)
class Reference:
    """A BRDF that is integrated by brute force.

    Attributes
    ----------
    name
        In reports; that of the model that stands for it.
    respond
        Its response at r and n·v.
    """

    name: str
    respond: Callable[[float, float], Response]


PAPER = Reference("paper", brute_force.respond)
PRINCIPLED = Reference("principled", principled.respond)
TABULATED = Reference("tabulated", principled.respond_as_tabulated)
"""Not a BRDF, but what the principled model's table stands for: its Fresnel term is simpler."""

INTEGRATED = "paper, integrated"
"""Name of the paper's BRDF itself, where it is compared as a model."""

BANDS = 4
BAND_OF = np.repeat(np.arange(BANDS), 2 * np.arange(BANDS) + 1)
"""(16,): l of each coefficient."""


@dataclass(frozen=True)
class Material:
    """A material without its roughness.

    Attributes
    ----------
    key
        In files.
    name
        In words.
    albedo
        Linear Rec.709.
    metallic
        In [0, 1].
    """

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


@dataclass(frozen=True)
class Effort:
    """Where the gap is measured.

    Attributes
    ----------
    name
        In reports.
    r, n_dot_v
        Of the table.
    rings
        Values of n·v that make up a sphere.
    lights
        Random lights.
    """

    name: str
    r: tuple[float, ...]
    n_dot_v: tuple[float, ...]
    rings: int
    lights: int


_TENTHS = tuple(round(0.1 * i, 1) for i in range(1, 11))
FULL = Effort("full", (0.05, *_TENTHS), (0.05, *_TENTHS), rings=20, lights=64)
QUICK = Effort("quick", (0.1, 0.3, 0.5, 0.8, 1.0), (0.1, 0.2, 0.5, 0.8, 1.0), rings=10, lights=16)


@dataclass(frozen=True, eq=False)
class Gap:
    """Responses of models beside the true ones. M materials, R roughnesses, V view angles.

    Attributes
    ----------
    effort, seed, reference
        What was asked for.
    materials
        The M materials.
    true
        (M, R, V, 3, 16): weights by brute force.
    models
        By name, (M, R, V, 3, 16): weights by the models.
    quadrature_error
        Largest change of any integral of the table when the number of nodes is doubled, or of the
        root mean square over a sphere, whichever is larger.
    sphere_signal
        (M, R): root mean square radiance of a sphere under the random lights, by brute force.
    sphere_error
        By name, (M, R): root mean square error of the models' radiance there.
    """

    effort: Effort
    seed: int
    reference: Reference
    materials: tuple[Material, ...]
    true: Array
    models: Mapping[str, Array]
    quadrature_error: float
    sphere_signal: Array
    sphere_error: Mapping[str, Array]

    @property
    def true_response(self) -> Array:
        """(M, R, V, 4): R_l by brute force."""
        return response(self.true)

    def model_response(self, model: str) -> Array:
        """(M, R, V, 4): R_l of a model."""
        return response(self.models[model])

    def ratio(self, model: str) -> Array:
        """(M, R, V, 4): response of a model over the true one."""
        return np.asarray(self.model_response(model) / self.true_response)

    def distance(self, model: str) -> Array:
        """(M, R, V, 4): response of the difference; a mirror's response is 1."""
        return response(self.models[model] - self.true)

    def relative_rmse(self, model: str) -> Array:
        """(M, R): error of a sphere under random lights, relative to its signal."""
        return np.asarray(self.sphere_error[model] / self.sphere_signal)

    def overall_rmse(self, model: str) -> Array:
        """(M,): the same over spheres of all roughnesses together."""
        error = np.mean(np.square(self.sphere_error[model]), axis=-1)
        return np.asarray(np.sqrt(error / np.mean(np.square(self.sphere_signal), axis=-1)))


def measure(
    effort: Effort = FULL,
    *,
    reference: Reference = PRINCIPLED,
    models: Mapping[str, Model] = MODELS,
    materials: tuple[Material, ...] = MATERIALS,
    seed: int = 0,
    progress: Callable[[float], None] = lambda _: None,
) -> Gap:
    """Compare models with brute-force integration of one BRDF.

    Parameters
    ----------
    effort
        `FULL` or `QUICK`.
    reference
        The BRDF.
    models
        By name; default: those of `pbrfit.shade`.
    materials
        What reflects.
    seed
        Of the random lights.
    progress
        Called with the roughness before it is worked on.

    Raises
    ------
    InputError
        If `effort` holds a roughness or n·v outside (0, 1].
    """
    albedo = np.array([material.albedo for material in materials])
    metallic = np.array([material.metallic for material in materials])
    rings, shares = _rings(effort.rings)

    power = _band_power(random_lights(effort.lights, np.random.default_rng(seed)))
    shape = (len(materials), len(effort.r))
    true = np.empty((*shape, len(effort.n_dot_v), 3, 16))
    found = {name: np.empty_like(true) for name in models}
    signal = np.empty(shape)
    error = {name: np.empty(shape) for name in models}
    worst = 0.0
    for i, r in enumerate(effort.r):
        progress(r)
        true[:, i], changes = _true_weights(reference, r, effort.n_dot_v, albedo, metallic)
        on_sphere, on_rings = _true_weights(reference, r, rings, albedo, metallic)
        worst = max(worst, changes.max(), math.sqrt(np.square(on_rings) @ shares))
        signal[:, i] = _rms_radiance(on_sphere, shares, power)
        for name, model in models.items():
            found[name][:, i] = _weights(model, r, effort.n_dot_v, albedo, metallic)
            difference = _weights(model, r, rings, albedo, metallic) - on_sphere
            error[name][:, i] = _rms_radiance(difference, shares, power)
    return Gap(effort, seed, reference, materials, true, found, worst, signal, error)


def measure_all(
    effort: Effort = FULL, *, seed: int = 0, progress: Callable[[float], None] = lambda _: None
) -> tuple[Gap, ...]:
    """Measure all models against the principled BRDF, and each against what it stands for.

    Parameters
    ----------
    effort, seed, progress
        As for `measure`; `progress` is called for all three.

    Returns
    -------
    tuple of Gap
        By reference, the principled one first.
    """
    of_all = {"paper": MODELS["paper"], INTEGRATED: integrated(PAPER), **MODELS}
    return tuple(
        measure(effort, reference=reference, models=models, seed=seed, progress=progress)
        for reference, models in (
            (PRINCIPLED, of_all),
            (PAPER, {"paper": MODELS["paper"]}),
            (TABULATED, {"principled": MODELS["principled"]}),
        )
    )


def integrated(reference: Reference) -> Model:
    """Return a BRDF's integral as a model, for pixels in their own frame alone."""

    def model(normal: Array, view: Array, albedo: Array, r: Array, m: Array) -> Array:
        found = np.empty((*r.shape, 3, 16))
        n_dot_v = np.einsum("...i,...i->...", normal, view)
        for i in np.ndindex(*r.shape):
            response = reference.respond(float(r[i]), float(n_dot_v[i]))
            found[i] = response.weights(albedo[i], m[i])
        return found

    return model


def response(weights: Array) -> Array:
    """R_l above: (..., 3, 16) weights to (..., 4)."""
    squares = np.mean(np.square(weights), axis=-2)
    bands = np.stack([squares[..., band == BAND_OF].sum(axis=-1) for band in range(BANDS)], axis=-1)
    return np.sqrt(bands * 4 * np.pi / (2 * np.arange(BANDS) + 1))


def _rings(count: int) -> tuple[tuple[float, ...], Array]:
    """Values of n·v, and their shares of a sphere's picture.

    A pixel's share is 2 (n·v) d(n·v). The error's square rises like 1/(n·v)² towards the rim, and
    only levels out where n·v falls below r⁴/2, so the nodes crowd there: n·v = t³, Gauss-Legendre
    in t.
    """
    nodes, weights = np.polynomial.legendre.leggauss(count)
    t = (1 + nodes) / 2
    return tuple(t**3), 3 * weights * t**5


def _true_weights(
    reference: Reference, r: float, n_dot_v: tuple[float, ...], albedo: Array, metallic: Array
) -> tuple[Array, Array]:
    """(M, V, 3, 16) by brute force, and (V,) how much they change with the number of nodes."""
    exact = [reference.respond(r, x) for x in n_dot_v]
    weights = np.stack([one.weights(albedo, metallic) for one in exact], axis=1)
    return weights, np.array([one.error for one in exact])


def _weights(
    model: Model, r: float, n_dot_v: tuple[float, ...], albedo: Array, metallic: Array
) -> Array:
    """(M, V, 3, 16) of a model, in the pixel's own frame."""
    shape = (len(albedo), len(n_dot_v))
    views = np.broadcast_to(np.stack([view(x) for x in n_dot_v]), (*shape, 3))
    normals = np.broadcast_to(np.array([0.0, 0.0, 1.0]), (*shape, 3))
    found: Array = model(
        normals,
        views,
        np.broadcast_to(albedo[:, None], (*shape, 3)),
        np.full(shape, r),
        np.broadcast_to(metallic[:, None], shape),
    )
    return found


def _band_power(lights: Array) -> Array:
    """(3, 16): mean over lights of P_l by channel, repeated for each coefficient of its band."""
    squares = np.mean(np.square(lights), axis=0).T
    of_band = [squares[:, band == BAND_OF].mean(axis=-1) for band in range(BANDS)]
    return np.stack(of_band, axis=-1)[:, BAND_OF]


def _rms_radiance(weights: Array, shares: Array, power: Array) -> Array:
    """Root mean square radiance of a sphere: weights (M, V, 3, 16), shares (V,) of its pixels."""
    squares = np.einsum("mvck,ck->mvc", np.square(weights), power).mean(axis=-1)
    return np.asarray(np.sqrt(squares @ shares))
