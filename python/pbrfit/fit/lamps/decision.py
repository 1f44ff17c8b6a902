"""Whether pictures are lit by lamps, or from all around.

As for surroundings (`pbrfit.fit.transport`), two sets of pixels decide: lights of both kinds are
fitted to the first with their materials; pixels of the second find their best materials under
these, and the score is the mean over them of ln(Σ residual²/Σ radiance²). Normals are the same for
both and held, so that a pixel has five unknowns either way, and the lights know nothing of it.

What harmonics leave of a lamp cannot be small. Of the clamped cosine, what bands above 2 hold has
0.9 % of the energy (R. Ramamoorthi and P. Hanrahan, "On the relationship between radiance and
irradiance", JOSA A 18, 2001), a tenth of the radiance, and the surfaces that a picture shows see
part of it. Where harmonics leave less than `HARMONICS_LEFT_MIN`, lamps are not tried.

Noise is left by any light, and does not count (`light_share`). Light is much the same on surfaces
that face alike and are beside each other, and so is what a wrong light leaves of them. Noise of two
pixels has nothing in common, whatever their materials take up of it: with m the mean, over such
pairs, of the cosine of the angle between their residuals, averaged over the channels, a share of
about m is no noise. Of the squares before averaging, which leaves a third of noise's and all of a
lamp's shading, that is m/(3 − 2 m). Where this share is so small that lamps cannot leave less by
`TRANSPORT_GAIN_MIN`, or that the rest is less than `HARMONICS_LEFT_MIN`, they are not tried.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from pbrfit.fit import misfit, settings
from pbrfit.fit.coarse import fit_level
from pbrfit.fit.lamps.estimator import FirstShape, LampFit
from pbrfit.fit.lamps.joint import SurfacePrior, fit_surfaces
from pbrfit.fit.lamps.problem import LampPixels, radiance
from pbrfit.fit.sampling import evenly_spaced
from pbrfit.fit.tiles.windows import SceneCutter, strided_window
from pbrfit.fit.transport import find_lights
from pbrfit.fit.whole_picture import FitSetup
from pbrfit.scene.scene import Scene
from pbrfit.threads import one_blas_thread

Array = NDArray[np.float64]

HARMONICS_LEFT_MIN = 0.02
"""Relative root mean square that harmonics have to leave of left-out pixels before lamps are tried:
a fifth of what they cannot show of a lamp's shading on surfaces that face all ways."""

PAIRS_IN_COMMON = 1 / 3
"""Least share of what a wrong light leaves that pairs among 400 pixels have in common: of lamps it
was 0.35 on waves and 0.75 on a ball."""

PICTURES_MIN = 3
"""With fewer, almost any lamp explains them."""

VALID_PIXELS_MIN = 32
"""Valid pixels from which on pictures can decide: half of them find the lights, three unknowns of
lamps or 16 coefficients of harmonics for each picture and channel, which fewer than 16 pixels would
leave free; and of fewer than the other 16 a mean score has an error that no gain exceeds."""


@dataclass(frozen=True)
class Choice:
    """What lights the pictures, and why."""

    lamps: bool
    why: str
    figures: dict[str, float] = field(default_factory=dict)
    """`left_out_sh`, `left_out_lamps`: scores; `left_out_pixels`; `left_out_light`: the share of
    what harmonics leave that is no noise, at most."""


@dataclass(frozen=True, eq=False)
class _Left:
    """What harmonics leave of Q pixels."""

    scores: Array
    """(Q,)."""
    places: NDArray[np.intp]
    """(2 Q,) among all pixels of the picture; these Q are every second one."""
    residuals: Array
    """(Q, N, channels), samples weighed."""


@one_blas_thread()
def choose(scene: Scene, setup: FitSetup, start: FirstShape | None = None) -> Choice:
    """What `auto` takes."""
    if scene.lighting is not None:
        return Choice(False, "lights are known")
    if scene.lamps is not None:
        return Choice(True, "lamps are given")
    if setup.options.mono_light:
        return Choice(False, "one light for all channels was asked for")
    if len(scene.images) < PICTURES_MIN:
        return Choice(False, f"fewer than {PICTURES_MIN} pictures")
    if int(scene.valid.sum()) < VALID_PIXELS_MIN:
        return Choice(False, "too few pixels")
    if start is not None:
        scene = replace(scene, normals=start.normals, normals_known=True)
    left_by_sh = _left_by_harmonics(scene, setup)
    by_sh, places = left_by_sh.scores, left_by_sh.places
    shown = np.isfinite(by_sh)
    if np.count_nonzero(shown) < VALID_PIXELS_MIN // 2:
        return Choice(False, "too few pixels")  # the others are black or have no weight
    mean = float(by_sh[shown].mean())
    figures = {"left_out_sh": mean, "left_out_pixels": float(shown.sum())}
    left = float(np.exp(mean / 2))
    if left < HARMONICS_LEFT_MIN:
        return Choice(
            False,
            f"light from all around leaves only {100 * left:.2g} % of left-out pixels",
            figures,
        )
    residuals = left_by_sh.residuals[shown]
    if residuals.shape[-1] == 3:
        share = light_share(residuals, _alike(scene, places[1::2][shown]))
        figures["left_out_light"] = share
        no_gain = share < 1 - np.exp(-settings.TRANSPORT_GAIN_MIN)
        if no_gain or np.sqrt(share) * left < HARMONICS_LEFT_MIN:
            told = f"light from all around leaves {100 * left:.2g} % of left-out pixels"
            return Choice(False, f"{told}, mostly noise", figures)
    by_lamps = _left_by_lamps(scene, setup, start, places)
    shown &= np.isfinite(by_lamps)
    by_lamps = by_lamps[shown]
    figures["left_out_lamps"] = float(by_lamps.mean())
    difference = by_lamps - by_sh[shown]
    error = float(difference.std(ddof=1)) / np.sqrt(len(difference))
    gain = -float(difference.mean())
    clear = gain > max(settings.TRANSPORT_ERRORS_MIN * error, settings.TRANSPORT_GAIN_MIN)
    of_lamps = float(np.exp(by_lamps.mean() / 2))
    return Choice(
        clear,
        f"of left-out pixels lamps leave {100 * of_lamps:.2g} %, light from all around "
        f"{100 * left:.2g} %",
        figures,
    )


def _left_by_harmonics(scene: Scene, setup: FitSetup) -> _Left:
    """Rounds end where little enough is left: others would only leave less."""
    small, count = scene, 2 * settings.TRANSPORT_PIXELS
    if int(scene.valid.sum()) > settings.STRIDED_SUBSET_EXCESS * 4 * count:
        window = strided_window(scene.valid, count, 4 * count)
        small = SceneCutter(scene).cut(window)
    objective = setup.objective(small)
    chosen = evenly_spaced(objective.pixels, count)
    fitted, left_out = chosen[::2], chosen[1::2]
    x = objective.start()
    few, other = objective.restricted(fitted), objective.restricted(left_out)
    part = few.with_best_lights(objective.part_of(x, fitted))
    size = np.square(objective.pictures(left_out)).sum(axis=(0, 2))
    rest, scores = x, np.empty(0)

    def measure() -> float:
        nonlocal rest, scores
        rest = objective.part_of(x, left_out)
        rest[other.layout.maps.stop :] = part[few.layout.maps.stop :]
        scores = _scores(fit_level(other, rest), size)
        shown = scores[np.isfinite(scores)]
        return float(np.exp(shown.mean() / 2)) if len(shown) else np.inf

    find_lights(few, part, lambda: False, is_enough=lambda: measure() < HARMONICS_LEFT_MIN)
    if not len(scores):
        measure()
    residuals = misfit.residuals(other, rest).reshape(len(size), other.layout.pictures, -1)
    return _Left(scores, objective.places_in(scene, chosen), residuals)


def light_share(residuals: Array, alike: NDArray[np.intp]) -> float:
    """Share of the squares of residuals (Q, N, 3) that another light could explain, at most.

    By what pixels have in common with those alike, and two standard errors more.
    """
    means = residuals.mean(axis=-1)
    size = np.sqrt(np.square(means).sum(axis=1, keepdims=True))
    means = means / np.maximum(size, np.finfo(np.float64).tiny)
    cosines = np.einsum("qn,qn->q", means, means[alike])
    error = float(cosines.std(ddof=1)) / np.sqrt(len(cosines))
    most = (float(cosines.mean()) + settings.TRANSPORT_ERRORS_MIN * error) / PAIRS_IN_COMMON
    share = min(max(most, 0.0), 1.0)
    return float(share / (3 - 2 * share))


def _alike(scene: Scene, places: NDArray[np.intp]) -> NDArray[np.intp]:
    """(Q,): of each place in the picture another of them, beside it and facing alike."""
    # Here and not above: scipy would double the time of `import pbrfit`.
    from scipy.spatial import cKDTree

    height, width = scene.valid.shape
    beside = np.stack(np.divmod(places, width), axis=-1) / (0.5 * max(height, width))
    seen = np.concatenate([scene.normals.reshape(-1, 3)[places], beside], axis=1)
    nearest = np.asarray(cKDTree(seen).query(seen, k=2)[1])
    return np.where(nearest[:, 0] == np.arange(len(places)), nearest[:, 1], nearest[:, 0])


def _left_by_lamps(
    scene: Scene, setup: FitSetup, start: FirstShape | None, places: NDArray[np.intp]
) -> Array:
    held = replace(setup, progress=None, options=replace(setup.options, refine_normals="off"))
    trial = LampFit(scene, held, start)
    fit = trial.joint(places[::2])
    normals = np.asarray(scene.normals if start is None else start.normals, np.float64)
    other = LampPixels.of(scene, normals, trial.model, setup.threads, places[1::2])
    count = len(other)
    prior = SurfacePrior(np.zeros((count, 7)), np.zeros((count, 7)))
    left = np.full(count, np.inf)
    kinds = (0.0, 1.0) if setup.options.metallic is None else (setup.options.metallic,)
    for kind in kinds:
        for roughness in (0.2, 0.5):
            state = replace(
                fit.state,
                normals=other.normals,
                albedo=np.full((count, 3), 0.3 if kind < 0.5 else 0.6),
                roughness=np.full(count, roughness),
                metallic=np.full(count, kind),
                seen=None,
            )
            state, _, _ = fit_surfaces(
                other, state, other.weights, prior, iterations=25, free_normals=False
            )
            residual = other.residuals(radiance(other, state))
            left = np.minimum(left, (other.weights * residual**2).sum(axis=(1, 2)))
    return _scores(left, (other.weights * other.samples**2).sum(axis=(1, 2)))


def _scores(squares: Array, size: Array) -> Array:
    """(Q,): NaN where pictures show nothing."""
    left = np.divide(squares, size, out=np.full(len(size), np.nan), where=size > 0)
    return np.asarray(np.log(np.maximum(left, settings.NOISE_VARIANCE_MIN)))
