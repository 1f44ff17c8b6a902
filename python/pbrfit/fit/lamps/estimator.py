"""A fit under lamps: from a scene to surfaces, lamps and ambient light.

Stages: `first lamps`, normals and lamps by matt shading; `lamps`, the joint fit of pixels that
stand for all (`joint`), alternatives far and near where there is depth; `surfaces`, each pixel by
itself with shadows and metals (`surfaces`).
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from pbrfit._core import InputError
from pbrfit.fit.independent_lights import Shown
from pbrfit.fit.lamps import scale as scale_of_lamps
from pbrfit.fit.lamps import surfaces
from pbrfit.fit.lamps.given_normals import colored_by, far_lamps, near_lamps, of_usual_scale
from pbrfit.fit.lamps.joint import (
    ALBEDO_MEAN,
    ROUGHNESS_MIN,
    Freedom,
    JointLamps,
    SurfacePrior,
    minimize,
    offsets,
    turned,
)
from pbrfit.fit.lamps.problem import LampPixels, LampState, radiance
from pbrfit.fit.lamps.sample_noise import (
    RELATIVE_MIN,
    Noise,
    kept_and_judged,
    seen_error,
)
from pbrfit.fit.lamps.samples import FirstShape
from pbrfit.fit.lamps.scale import Reference
from pbrfit.fit.lamps.shape import FOV_MAX, FOV_MEAN, FOV_SPREAD, first_shape, height_of
from pbrfit.fit.priors.population import METALLIC_DEVIATION
from pbrfit.fit.run import FitSetup, Progress, Trace
from pbrfit.fit.sampling import drawn, evenly_spaced, evenly_spaced_over, placed
from pbrfit.fit.settings import (
    DEGREES_OF_FREEDOM_SHARE_MIN,
    EARLY_ROUNDS,
    LAMP_PIXELS,
    MEAN_RADIANCE,
    PIXELS_AT_ONCE,
    START_MIDDLE,
    UNIFORM_PRECISION,
)
from pbrfit.fit.whole_picture import FitOutput
from pbrfit.lazy import lazy
from pbrfit.model.geometry import views_at
from pbrfit.model.lamps import Lamps
from pbrfit.model.materials import Materials
from pbrfit.model.reflection import chosen_model, whole_number
from pbrfit.registration.placement import aligned
from pbrfit.result.camera import Camera
from pbrfit.result.options import FitOptions
from pbrfit.result.refinement import FROM_PICTURES, Refinement
from pbrfit.result.uncertainty import TWO_SIDED, Uncertainty
from pbrfit.result.verdict import by_deviations
from pbrfit.scene.scene import Scene
from pbrfit.threads import AT_ONCE_MAX, in_pieces, one_blas_thread, processors
from pbrfit.transport.scenery import Scenery
from pbrfit.values.arrays import Array, Mask

log = logging.getLogger("pbrfit")


ROUNDS, STEPS = 8, 3
"""Reweighting rounds; Levenberg-Marquardt steps in each."""

LOOKS: dict[int, tuple[tuple[float, ...], tuple[float, ...]]] = {
    0: ((2.0, 4.0, 8.0), ()),
    2: ((1.4, 2.0), (-15.0, -6.0, -2.0, 2.0, 6.0, 15.0)),
    4: ((1.15, 1.3), (-4.0, -2.0, 2.0, 4.0)),
}
"""Rounds before which the scale of all lamps is multiplied and divided by some factors, and fields
of view and roughnesses are tried, one after the other: wide first, then near the best. Steps from
the best are degrees; in the first round `FIELDS_OF_VIEW` are tried."""

ROUGHNESSES = 0.1, 0.18, 0.3, 0.45, 0.7
"""That are tried, about half an octave apart, less than what a lobe's width tells."""

LOOK_LAST = 4
"""From which round on normals are no longer sought at highlights, and roughness near what it is; a
compared fit ends before it."""

FIELDS_OF_VIEW = (0.0, 15.0, 30.0, 45.0, 60.0)
"""Degrees that are tried where nobody told it."""

SAMPLES_IN_LOBE, UNTOLD = 10, 3.0
"""Samples within a lobe from which on they tell it: of so many what it shows wrong is known to a
third, 1/√10. Lobes that hardly a sample is within seem right where they happen to meet none: they
have to excel the others by so much in the logarithm of the likelihood, one in twenty."""

INDEPENDENT_SHARE = 1 / 8
"""Share of the pixels looked at that counts: what a picture shows wrong it shows wrong around it,
too."""

ROUGHNESS_SPREAD = 0.25
"""Standard deviation of roughness around `START_MIDDLE` before anything is known; that of a uniform
distribution in [0, 1] is 0.29."""

UNIFORM_VARIANCE = 1 / UNIFORM_PRECISION
"""Largest variance of albedo and roughness."""


@dataclass(frozen=True, eq=False)
class Found:
    """What some pixels under lamps have found, for others to go on from."""

    lamps: Lamps
    """Far ones, in picture units."""
    roughness: dict[int, float]
    """Of each label."""
    fov: float
    """Horizontal field of view in degrees."""


def learnt_roughness(
    pixels: LampPixels, state: LampState, prior: SurfacePrior, spreads: tuple[float, float]
) -> SurfacePrior:
    """The prior with the spread that roughness has in each label, around what looks have found."""
    precision, (least, most) = prior.precision.copy(), spreads
    for label in np.unique(pixels.labels):
        of = pixels.labels == label
        away = np.abs(state.roughness[of] - prior.mean[of, 5])
        spread = float(np.clip(1.4826 * np.median(away), least, most))
        precision[of, 5] = spread**-2
    return SurfacePrior(prior.mean, precision)


def first_prior(pixels: LampPixels, offset_sigma: Array | float) -> SurfacePrior:
    """Before anything was fitted; `offset_sigma` of each tangent offset, radians."""
    count = len(pixels)
    mean, precision = np.zeros((count, 7)), np.zeros((count, 7))
    mean[:, 5], precision[:, 5] = START_MIDDLE, ROUGHNESS_SPREAD**-2
    precision[:, :2] = np.broadcast_to(np.asarray(offset_sigma, float) ** -2.0, (count,))[:, None]
    return SurfacePrior(mean, precision)


def of_labels(
    prior: SurfacePrior, few: LampPixels, pixels: LampPixels, sigma: Array | float
) -> SurfacePrior:
    """What was learnt by some pixels, for others."""
    found = first_prior(pixels, sigma)
    for label in np.unique(few.labels):
        one = int(np.flatnonzero(few.labels == label)[0])
        of = pixels.labels == label
        found.mean[of, 5], found.precision[of, 5] = prior.mean[one, 5], prior.precision[one, 5]
    return found


class LampFit:
    """A fit of a scene under lamps, stage by stage."""

    def __init__(
        self,
        scene: Scene,
        setup: FitSetup,
        start: FirstShape | None = None,
        begin: Found | None = None,
        rounds: int = ROUNDS,
    ) -> None:
        self.scene, self.setup, self.options = scene, setup, setup.options
        self.begin, self.rounds = begin, rounds
        self.trace = Trace(setup)
        self.model = setup.model
        self.start = start
        self.relief = None if start is None else start.relief
        """The cues on bas-reliefs, where one is open; normals are free then."""
        told = scene.normals_known and self.relief is None
        self.free_normals = not told or self.options.refine_normals == "on"
        self.fov = (scene.fov if scene.fov_known else FOV_MEAN) if begin is None else begin.fov

    @one_blas_thread()
    def solve(self) -> FitOutput:
        """Surfaces, lamps and ambient light: all stages."""
        fit = self.joint(self._places(LAMP_PIXELS))
        with self.trace.stage("surfaces") as notes:
            bands, known = self._bands(fit)
            metal = float(np.mean(np.concatenate([one.state.metallic for one in bands]) > 0.5))
            notes.append(f"{len(self.scene.places)} pixels, {100 * metal:.2g} % metal")
        return self._output(fit, bands, known)

    def _places(self, at_most: int) -> NDArray[np.intp]:
        """So many of the scene's places, evenly spread over each label."""
        places, labels = self.scene.places, self.scene.labels
        of = np.zeros(len(places), np.intp) if labels is None else labels[0]
        return np.asarray(places[evenly_spaced_over(of, at_most).astype(np.intp)])

    def joint(self, places: NDArray[np.intp]) -> JointLamps:
        """The joint fit of pixels at places that explains them best."""
        with self.trace.stage("first lamps") as notes:
            few, starts = self._starts(places)
            notes += [name for name, _, _ in starts]
        with self.trace.stage("lamps") as notes:
            fits = [(name, self._joint(few, lamps, albedo)) for name, lamps, albedo in starts]
            name, fit = min(
                fits, key=lambda one: float(seen_error(one[1].pixels, one[1].state).sum())
            )
            notes.append(self._said(name, fit))
        return fit

    @lazy
    def of_few(self) -> JointLamps:
        """The joint fit of as many pixels as find lamps, of eight numbers each."""
        places = self.scene.places
        return self.joint(np.asarray(places[evenly_spaced(len(places), 250).astype(np.intp)]))

    @property
    def settled(self) -> FirstShape:
        """The start, with the bas-relief that the fit of few pixels finds, if one is open."""
        assert self.start is not None
        if self.relief is None:
            return self.start
        lamps, matrix = self.of_few.state.lamps, self.of_few.matrix
        return replace(
            self.start,
            normals=turned(np.asarray(self.start.normals), matrix),
            directions=lamps.places,
            strengths=lamps.colors,
            relief=None,
        )

    def of_all_pixels(self) -> tuple[LampPixels, LampState, Found]:
        """All pixels of a small scene, fitted together and then each by itself."""
        fit = self.of_few
        [band] = self._surfaces(fit, self.scene.valid)
        pixels = self._pixels(fit.matrix, like=fit.pixels)
        lamps = replace(fit.state.lamps, colors=fit.state.lamps.colors * fit.pixels.scale)
        roughness = {
            int(label): float(np.median(fit.prior.mean[fit.pixels.labels == label, 5]))
            for label in np.unique(fit.pixels.labels)
        }
        return pixels, band.state, Found(lamps, roughness, self.fov)

    def normals(self, matrix: Array, places: NDArray[np.intp]) -> Array:
        """(P, 3): that pixels' own are offset from, turned by the matrix of a joint fit."""
        if self.start is None:
            return np.asarray(self.scene.normals, np.float64).reshape(-1, 3)[places]
        return turned(np.asarray(self.start.normals).reshape(-1, 3)[places], matrix)

    def _pixels(
        self,
        matrix: Array,
        places: NDArray[np.intp] | None = None,
        like: LampPixels | None = None,
        threads: int | None = None,
    ) -> LampPixels:
        """Pixels at places, or all, through the camera as it is; other arguments as above."""
        places = self.scene.places if places is None else places
        threads = self.setup.threads if threads is None else threads
        normals, scene = self.normals(matrix, places), self.scene.through(self.fov)
        return LampPixels.of(scene, normals, self.model, threads, places, like=like)

    def _starts(
        self, places: NDArray[np.intp]
    ) -> tuple[LampPixels, list[tuple[str, Lamps, Array]]]:
        """Pixels at places, and named lamps with their albedos (P, 3)."""
        known = self.scene.lamps
        few = self._pixels(np.eye(3), places)
        if known is not None and known.colored:
            usual = MEAN_RADIANCE / ALBEDO_MEAN / max(float(known.colors.mean()), 1e-12)
            lamps = replace(known, colors=known.colors * usual)
            albedo = albedo_under(few, lamps)
            start = of_usual_scale(lamps, np.maximum(lamps.colors, 1e-9), albedo)
            return few, [("known lamps and colours", *start)]
        if self.begin is not None:
            lamps = replace(self.begin.lamps, colors=self.begin.lamps.colors / few.scale)
            return few, [("lamps as compared", lamps, albedo_under(few, lamps))]
        if self.start is not None and (known is None or not known.near.any()):
            lamps = Lamps(
                np.arange(few.pictures), self.start.directions, colors=self.start.strengths
            )
            albedo = self.start.albedo.reshape(-1, 3)[places]
            return few, [(self.start.note, *balanced(few, lamps, albedo))]
        if known is not None:
            directions, strengths = known.at(few.points, len(few))
            cosines = np.maximum(np.einsum("px,pkx->pk", few.normals, directions), 0) * strengths
            start = colored_by(few, known, cosines, (cosines > 0).astype(np.float64))
            return few, [("known lamps", *start)]
        found: list[tuple[str, Lamps, Array]] = [("far lamps", *far_lamps(few))]
        if few.points is not None:
            found.append(("near lamps", *near_lamps(few)))
        return few, found

    def _offset_sigma(self, places: NDArray[np.intp]) -> Array:
        """(P,): prior standard deviation of each tangent offset, radians."""
        scene = self.scene
        if self.start is not None:
            return np.full(len(places), 0.09)  # 5 degrees, by which matt shading is off on gloss
        degrees = np.full(len(places), 5.0)  # where nobody told it
        if scene.normal_sigma is not None:
            degrees = np.maximum(scene.normal_sigma.reshape(-1)[places], 0.1)
        return np.asarray(np.radians(degrees) / np.sqrt(2))

    # Joint

    def _joint(self, few: LampPixels, lamps: Lamps, albedo: Array) -> JointLamps:
        state = LampState(
            lamps,
            np.zeros((few.pictures, 16, 3)),
            few.normals.copy(),
            np.clip(albedo, 0.01, 0.99),
            np.full(len(few), START_MIDDLE),
            np.full(len(few), self.options.metallic or 0.0),
        )
        known = self.scene.lamps
        same, free = self.options.same_lamp, self.free_normals
        freedom = Freedom(normals=free, places=False, colors=False, same_lamp=same)
        prior = first_prior(few, self._offset_sigma(few.places))
        if self.begin is not None:
            for label, value in self.begin.roughness.items():
                state.roughness[few.labels == label] = value
                prior.mean[few.labels == label, 5] = value
        near = bool(lamps.near.any())
        noise = Noise.first(few, proportional=near)
        lit = self.lit_at(few)
        fit = JointLamps(few, state, noise, prior, freedom, lit=lit, relief=self.relief)
        fit.reweigh(renew=False)
        fit.state, fit.cost = fit.fitted(fit.state, 10)
        if not self.trace.rows:
            self._record(fit)
        first = 0 if self.begin is None else EARLY_ROUNDS
        for number in range(first, self.rounds):
            if self.trace.left <= 0 or (number > first and self.trace.out_of_time()):
                break  # lamps as they began leave too much to be a result
            if number in LOOKS:
                factors, degrees = LOOKS[number]
                fields: tuple[float, ...] = FIELDS_OF_VIEW
                if self.scene.fov_known:
                    fields = (self.fov,)
                elif degrees:
                    around = np.clip(self.fov + np.array([*degrees, 0.0]), 0, FOV_MAX)
                    fields = tuple(np.unique(around).tolist())
                scales = tuple(sorted({1.0, *factors, *(1 / one for one in factors if one <= 2)}))
                self._look(fit, scales, fields, number)
                if freedom.normals and number < LOOK_LAST:
                    self._turn(fit)
            # Near lamps begin within centimetres; what weighs most here, the surfaces beside them,
            # is what pulls them away where a metal is not known yet.
            if number == EARLY_ROUNDS and not near:
                shape = self.relief is not None
                fit.freedom = replace(fit.freedom, places=known is None, colors=True, shape=shape)
            # All samples of pictures that obey the model tell the same scale.
            if number > LOOK_LAST and not fit.freedom.scale:
                residual = fit.pixels.residuals(radiance(fit.pixels, fit.state))
                size = float((fit.pixels.weights * fit.pixels.samples**2).sum())
                left = float((fit.pixels.weights * residual**2).sum())
                if np.sqrt(left / max(size, 1e-300)) < 0.02:
                    more = replace(fit.freedom, scale=True, places=known is None, colors=True)
                    fit.freedom = more
            made = minimize(fit, steps=STEPS, stop=lambda: not self.trace.goes_on)
            self.trace.iteration += made
            self.trace.evaluations += made
            fit.state, fit.cost = fit.fitted(fit.state, surfaces.STEPS)
            # Least and greatest: with normals that are known a highlight says how rough a surface
            # is; else pixels would take what few highlights are off for a roughness of their own.
            spreads = (0.02, 0.05) if freedom.normals else (0.03, 0.25)
            fit.prior = learnt_roughness(few, fit.state, fit.prior, spreads)
            if number == LOOK_LAST and not near:
                fit.noise = replace(fit.noise, relative_min=0.0)
            fit.reweigh()
            self._record(fit)
        # Surfaces, and how uncertain all is, are of a model that is off by some per cent again.
        relative = max(fit.noise.relative, RELATIVE_MIN)
        fit.noise = replace(fit.noise, relative=relative, relative_min=RELATIVE_MIN)
        fit.reweigh(renew=False)
        return fit

    def _record(self, fit: JointLamps) -> None:
        """A row of the history, and a call of `progress`."""
        trace, pixels, state = self.trace, fit.pixels, fit.state
        residual = pixels.residuals(radiance(pixels, state))
        rmse = float(np.sqrt(np.mean(residual**2))) * pixels.scale
        loss = fit.cost / max(int(np.count_nonzero(pixels.weights)), 1)
        trace.add_row(self.scene, None, loss, rmse)
        maps = Materials(state.albedo, state.roughness, state.metallic)
        trace.tell(rmse, lambda: (maps, state.ambient))

    def _look(
        self, fit: JointLamps, scales: tuple[float, ...], fields: tuple[float, ...], number: int
    ) -> None:
        """Choose kinds and roughnesses of labels, a scale of all lamps and a field of view.

        Of those that are tried, the ones with which some pixels look least wrong. Lamps that are
        brighter with albedos that are darker by as much leave what a dielectric reflects diffusely
        as it is. Highlights tell all three, and only together: where they are shown in wrong
        places, a rough surface without any is better.
        """
        few, given, prior, counts, angles = self._looked_at(fit)
        labels = np.unique(few.labels)
        # At last a quarter of an octave apart: a highlight is as bright as r⁻⁴, so that this asks
        # for lamps twice as bright.
        roughnesses = np.outer(ROUGHNESSES, np.ones(len(few)))
        if number >= LOOK_LAST:
            nearer = np.outer(2.0 ** np.linspace(-0.5, 0.5, 5), prior.mean[:, 5])
            roughnesses = np.clip(nearer, ROUGHNESS_MIN, 1)
        metallic = np.broadcast_to(given.metallic, roughnesses.shape)
        if number == EARLY_ROUNDS and self.options.metallic is None and labels.any():
            # From here on lamps would bend to metals that stay dielectrics.
            metals = (few.labels > 0).astype(float)
            metallic = np.repeat([np.zeros(len(few)), metals], len(roughnesses), axis=0)
            roughnesses = np.tile(roughnesses, (2, 1))
        # Free normals are off by their own deviation, which makes a lobe wider that samples are
        # within, and each of these less likely to be.
        lobes = roughnesses**4
        widths = lobes + fit.freedom.normals / prior.precision[:, 0]
        within = (angles**2 < widths[..., None]).sum(axis=2) * (lobes / widths)
        independent = INDEPENDENT_SHARE * counts.sum() ** 2 / np.square(counts).sum()

        def tried(fov: float, scale: float) -> tuple[float, dict[int, tuple[float, float]]]:
            """How unlikely it looks, with what looks likeliest of each label."""
            seen = replace(few, views=self._views(fov, few.places))
            lamps = replace(given.lamps, colors=given.lamps.colors * scale)
            left, turned = self._left_by_roughness(
                fit, seen, replace(given, lamps=lamps), scale, prior, roughnesses, metallic
            )
            total = offset = 0.0
            chosen = {}
            for label in labels:
                own = few.labels == label
                sums = left[:, own] @ counts[own]
                samples = independent * counts[own].sum() / counts.sum()
                likelihoods = -0.5 * samples * np.log(np.maximum(sums, 1e-12))
                values, kinds = (of[:, own][:, 0] for of in (roughnesses, metallic))
                told = within[:, own].sum(axis=1) >= SAMPLES_IN_LOBE
                told |= values == values.max()
                likelihoods[~told] -= UNTOLD
                best_of = int(np.argmax(likelihoods))
                shares = np.exp(likelihoods - likelihoods[best_of]) * (kinds == kinds[best_of])
                # The mean by likelihood: the middle one where none looks better than another.
                chosen[label] = float(shares @ values / shares.sum()), float(kinds[best_of])
                total += float(sums[best_of])
                offset += float(np.log1p(turned[best_of, own] / 2) @ counts[own])
            total = 0.5 * independent * float(np.log(max(total, 1e-12)))
            total += INDEPENDENT_SHARE * offset
            total += 0.5 * float((fit.scale_of(lamps) ** 2).sum())
            return total + 0.5 * ((fov - FOV_MEAN) / FOV_SPREAD) ** 2, chosen

        likely = FOV_MEAN if fields == FIELDS_OF_VIEW else self.fov
        fov = min(fields, key=lambda one: abs(one - likely))
        found = {scale: tried(fov, scale) for scale in scales}
        scale = min(found, key=lambda one: found[one][0])
        chosen = found[scale][1]
        if len(fields) > 1:
            of_fields = {one: tried(one, scale) for one in fields}
            fov = min(of_fields, key=lambda one: of_fields[one][0])
            chosen = of_fields[fov][1]
            self.fov = fov
            fit.pixels = replace(fit.pixels, views=self._views(fov, fit.pixels.places))
        state = fit.state
        roughness, metallic = state.roughness.copy(), state.metallic.copy()
        for label, (likely, kind) in chosen.items():
            roughness[fit.pixels.labels == label] = likely
            metallic[fit.pixels.labels == label] = kind
        state = replace(state, lamps=replace(state.lamps, colors=state.lamps.colors * scale))
        albedo = np.clip(state.albedo / scale, 0.01, 0.99)
        fit.state = state.with_surface(state.normals, albedo, roughness, metallic)
        mean = fit.prior.mean.copy()
        mean[:, 5] = roughness
        fit.prior = SurfacePrior(mean, fit.prior.precision)

    def _looked_at(
        self, fit: JointLamps
    ) -> tuple[LampPixels, LampState, SurfacePrior, Array, Array]:
        """Pixels of the scene that tell roughness, and how much each counts, (P,), 1 in the mean.

        Also the angles (P, K) between normals and those that mirror a lamp of a left-out picture
        (of any if none is): half of the pixels of each label are spread evenly, and half over the
        octaves of the least angle. Of evenly spread ones next to none is within a narrow lobe.
        """
        pixels = self._pixels(fit.matrix, self._places(2 * PIXELS_AT_ONCE), fit.pixels)
        directions, _ = fit.state.incident(pixels)
        judged = kept_and_judged(pixels.pictures)[1][fit.state.lamps.pictures]
        directions = directions[:, judged if judged.any() else ~judged]
        mirrors = surfaces.mirroring(directions, pixels.views[:, None])
        angles = np.arccos(np.clip(np.einsum("px,pkx->pk", pixels.normals, mirrors), -1, 1))
        sigma = self._offset_sigma(pixels.places)
        least = np.hypot(ROUGHNESSES[0] ** 2, sigma * fit.freedom.normals)
        octave = np.log2(np.maximum(angles.min(axis=1) / least, 1)).astype(np.intp)
        shares = np.zeros(len(pixels))
        for label in np.unique(pixels.labels):
            of = pixels.labels == label
            sizes = np.bincount(octave[of])
            shares[of] = 0.5 / of.sum() + 0.5 / (np.count_nonzero(sizes) * sizes[octave[of]])
        rows, counts = drawn(shares, 400)
        few = pixels.of_rows(rows)
        albedo, metallic = (
            _spread(of, fit.pixels.places, few.places, self.scene.width)
            for of in (fit.state.albedo, fit.state.metallic)
        )
        state = fit.state.with_surface(few.normals, albedo, np.zeros(len(few)), metallic)
        prior = of_labels(fit.prior, fit.pixels, few, sigma[rows])
        return few, state, prior, counts / counts.mean(), angles[rows]

    def _views(self, fov: float, places: NDArray[np.intp]) -> Array:
        """(P, 3): unit vectors to the camera at places of the picture."""
        rows, columns = np.divmod(places, self.scene.width)
        return views_at((self.scene.height, self.scene.width), fov, columns, rows)

    def _left_by_roughness(
        self,
        fit: JointLamps,
        few: LampPixels,
        given: LampState,
        scale: float,
        prior: SurfacePrior,
        roughnesses: Array,
        metallic: Array,
    ) -> tuple[Array, Array]:
        """(R, P) each: what looks wrong with both (R, P), and how unlikely the normals are.

        Surfaces are fitted to some pictures, and what they show in the others counts: with a normal
        and a narrow lobe of its own a pixel can show any one highlight, but not the next.
        """
        kept, judged = kept_and_judged(few.pictures)
        # All at once: each pixel with one roughness after the other.
        tries = np.tile(np.arange(len(few)), len(roughnesses))
        few, given, prior = few.of_rows(tries), given.of_rows(tries), prior.of_rows(tries)
        fitted = replace(few, weights=few.weights * kept[None, :, None])
        free, relative = fit.freedom.normals, fit.noise.proportional
        albedo = np.clip(given.albedo / scale, 0.01, 0.99)
        begin = given.with_surface(given.normals, albedo, roughnesses.ravel(), metallic.ravel())
        starts = [begin, surfaces.facing_highlights(few, begin)] if free else [begin]
        to_some = surfaces.SurfaceFit(fitted, fit.noise, prior, free)
        errors, shown, squares = [], [], []
        for start in starts:
            state, _ = to_some.robust(start, free_roughness=False)
            seen = seen_error(few, state, relative=relative)
            errors.append(seen @ kept)
            shown.append(seen @ judged)
            away = offsets(few.normals, state.normals)
            squares.append((prior.precision[:, :2] * away**2).sum(axis=1))
        best = np.argmin(errors, axis=0)[None]
        wrong, turned = (np.take_along_axis(np.array(of), best, 0) for of in (shown, squares))
        return wrong.reshape(roughnesses.shape), turned.reshape(roughnesses.shape)

    def _turn(self, fit: JointLamps) -> None:
        """Let pixels turn to their brightest lamp where that surprises less."""
        given = surfaces.SurfaceFit(fit.pixels, fit.noise, fit.prior, free_normals=True)
        state, _ = given.robust(fit.state, 2)
        turned, _ = given.robust(surfaces.facing_highlights(fit.pixels, state), 2)
        left, of_turned = given.surprise(state), given.surprise(turned)
        fit.state, _ = surfaces.better_of(state, left, turned, of_turned)

    def lit_at(self, pixels: LampPixels) -> Callable[[Lamps], Array] | None:
        """Which samples of some pixels lamps reach, by rays; None without surroundings."""
        scenery = self._scenery
        if scenery is None:
            return None

        def lit(lamps: Lamps) -> Array:
            reached = np.zeros((len(pixels), pixels.pictures), bool)
            seen = np.zeros(reached.shape[1], bool)
            for picture, place, near in zip(lamps.pictures, lamps.places, lamps.near, strict=True):
                reached[:, picture] |= scenery.open_to(place, pixels.places, near=bool(near))
                seen[picture] = True
            reached[:, ~seen] = True
            return reached.astype(np.float64)

        return lit

    @lazy
    def _scenery(self) -> Scenery | None:
        """What may cast shadows; None where there is no depth, or nobody wants it."""
        scene = self.scene
        if scene.depth is None or not scene.normals_known or self.options.transport == "none":
            return None
        try:
            return Scenery(scene.depth, scene.normals, scene.valid, scene.segments, scene.fov)
        except InputError as error:
            log.warning("lamps: cast shadows by rays are left out: %s", error)
            return None

    def _said(self, name: str, fit: JointLamps) -> str:
        strengths = fit.state.lamps.colors.mean(axis=-1)
        spread = float(np.std(np.log(np.maximum(strengths, 1e-12))))
        said = (
            f"{name}: {len(strengths)} lamps by {len(fit.pixels)} pixels; noise "
            f"{fit.noise.floor * fit.pixels.scale:.2g} and {100 * fit.noise.relative:.2g} % of the "
            f"radiance, {100 * float(fit.noise.shadows.mean()):.2g} % in cast shadows; strengths "
            f"differ by {100 * spread:.2g} %"
        )
        if spread < 0.05 and not self.options.same_lamp:
            said += ", as of one lamp (--same-lamp)"
        return said

    # Surfaces

    def _bands(self, fit: JointLamps) -> tuple[list[surfaces.Band], Reference | None]:
        """All pixels, under lights of the scale that a reference tells, if there is one."""
        valid, white = self.scene.valid, self.options.white
        if white is None:
            return self._surfaces(fit, valid), None
        bands, known = scale_of_lamps.refer(fit, valid, white, partial(self._surfaces, fit))
        if self.options.uncertainty:
            bands = self._surfaces(fit, valid, known)
        return bands, known

    def _surfaces(
        self, fit: JointLamps, mask: Mask, known: Reference | None = None
    ) -> list[surfaces.Band]:
        """Pixels of a mask under the lights of a fit, band by band."""
        scene, few = self.scene, fit.pixels
        uncertain = self._covariance(fit, known) if self.options.uncertainty else None
        places = np.flatnonzero(mask.ravel())
        albedo = _spread(fit.state.albedo, few.places, places, scene.width)
        bands = list(surfaces.bands(mask))
        threads = self.setup.threads or processors()
        # Each of so many bands at once has its share of the processors.
        of_band = max(threads // min(len(bands), AT_ONCE_MAX), 1)

        def fitted(band: slice) -> surfaces.Band:
            pixels = self._pixels(fit.matrix, places[band], few, of_band)
            sigma = self._offset_sigma(pixels.places)
            prior = of_labels(fit.prior, few, pixels, sigma)
            lit = self.lit_at(pixels)
            if lit is not None:
                weights = pixels.weights * lit(fit.state.lamps)[..., None]
                dark = ~weights.any(axis=(1, 2))
                weights[dark] = pixels.weights[dark]
                pixels = replace(pixels, weights=weights)
            state = replace(
                fit.state,
                normals=pixels.normals,
                albedo=albedo[band],
                roughness=np.clip(prior.mean[:, 5], 0.05, 1),
                metallic=np.full(len(pixels), self.options.metallic or 0.0),
            )
            return surfaces.fit_band(
                pixels,
                state,
                fit.noise,
                prior,
                fit.freedom,
                scene.width,
                metals=first_prior(pixels, sigma) if self.options.metallic is None else None,
                uncertain=uncertain,
                once=self.trace.out_of_time(),
            )

        return in_pieces(self.setup.threads, fitted, bands)

    def _covariance(self, fit: JointLamps, known: Reference | None) -> Array:
        """(M, M): of what all pixels share."""
        shared = fit.information()
        # Looks have found the scale where steps have not, and it is as uncertain.
        freedom = fit.freedom
        fit.freedom = replace(freedom, scale=True, shape=False)
        basis, _ = fit.directions(np.zeros(len(shared)))
        fit.freedom = freedom
        inner = np.linalg.pinv(basis.T @ shared @ basis, hermitian=True)
        found = basis @ inner @ basis.T
        if known is None:
            return scale_of_lamps.with_pulls(found, fit, self.scene.width)
        return scale_of_lamps.with_known_scale(found, fit, known.variance)

    # Output

    def _output(
        self, fit: JointLamps, bands: list[surfaces.Band], known: Reference | None
    ) -> FitOutput:
        scene, trace = self.scene, self.trace
        scale = fit.pixels.scale

        def whole(name: str) -> Array:
            return placed(np.concatenate([getattr(one.state, name) for one in bands]), scene.valid)

        squares = sum(one.squares for one in bands)
        total = sum(one.total for one in bands)
        rmse = float(np.sqrt(squares / max(total, 1e-300))) * scale
        maps = Materials(whole("albedo"), whole("roughness"), whole("metallic"))
        lamps = replace(fit.state.lamps, colors=fit.state.lamps.colors * scale)
        trace.add_row(scene, maps, trace.rows[-1].loss, rmse)
        once = "; the other pixels were fitted once, under the lamps found so far"
        status, reason = trace.ended("converged", once if trace.out_of_time() else "")
        shown = self._shown(fit.pixels, squares / max(total, 1e-300))
        refined = self.free_normals and scene.normals_known
        why = "asked for" if refined else FROM_PICTURES if self.free_normals else "held"
        by_highlights = "by the highlights of dielectrics, around a mean albedo of 0.35"
        return FitOutput(
            materials=maps,
            lighting=fit.state.ambient * scale,
            normals=whole("normals"),
            uncertainty=self._uncertainty(fit, bands, shown, known)
            if self.options.uncertainty
            else None,
            shown=shown,
            status=status,
            reason=reason,
            rows=tuple(trace.rows),
            evaluations=trace.evaluations,
            stages=tuple(trace.stages),
            seconds=trace.elapsed,
            refinement=Refinement(self.options.refine_normals, refined, why),
            camera=Camera(self.fov, "given" if scene.fov_known else "fitted"),
            exposures=None,
            scale=by_highlights if known is None else known.said,
            measured_lighting=None,
            recon_rmse=rmse,
            lamps=lamps,
            normal_sigma=self._normal_sigma(bands),
        )

    def _normal_sigma(self, bands: list[surfaces.Band]) -> Array | None:
        """(H, W), degrees, from the variances of both offsets; None where nobody asks."""
        if not (self.free_normals and self.options.uncertainty):
            return None
        variances = np.concatenate([one.marginal[:, :2].sum(axis=1) for one in bands])
        return placed(np.degrees(np.minimum(np.sqrt(variances), np.pi / 2)), self.scene.valid)

    def _shown(self, pixels: LampPixels, square: float) -> Shown:
        """By pixels that leave this mean square of samples."""
        unknowns = 4 + (self.options.metallic is None) + 2 * self.free_normals
        spare = max(1 - unknowns / (3 * pixels.pictures), DEGREES_OF_FREEDOM_SHARE_MIN)
        of_pictures = pixels.samples.swapaxes(0, 1), square / spare, pixels.weights.swapaxes(0, 1)
        return Shown.by(*of_pictures, unknowns)

    def _uncertainty(
        self,
        fit: JointLamps,
        bands: list[surfaces.Band],
        shown: Shown,
        known: Reference | None,
    ) -> Uncertainty:
        valid, scale = self.scene.valid, fit.pixels.scale
        if known is None:
            scales = np.full(3, scale_of_lamps.deviation(fit, self._covariance(fit, None)))
        else:
            scales = np.sqrt(known.variance)
        red, green, blue = scales.tolist()
        # By the data; of albedo and roughness it is known beside that they are in [0, 1].
        variances = np.concatenate([one.marginal for one in bands])[:, 2:]
        if shown.is_nothing:
            variances[:] = np.inf
        dark = (variances[:, :3] >= UNIFORM_VARIANCE).all(axis=1)
        variances[:, :4] = np.minimum(variances[:, :4], UNIFORM_VARIANCE)
        held = self.options.metallic is not None
        variances[held | dark, 4] = 0.0 if held else METALLIC_DEVIATION**2
        sigma = np.sqrt(variances)
        value = np.concatenate(
            [
                np.column_stack([one.state.albedo, one.state.roughness, one.state.metallic])
                for one in bands
            ]
        )
        reach = TWO_SIDED * sigma

        def maps(values: Array) -> Materials:
            found = placed(values, valid)
            return Materials(found[..., :3], found[..., 3], found[..., 4])

        deviation = maps(sigma)
        return Uncertainty(
            deviation=deviation,
            low=maps(np.clip(value - reach, 0, value)),
            high=maps(np.clip(value + reach, value, 1)),
            noise=fit.noise.floor * scale,
            effective_share=1.0,
            albedo_scale=(red, green, blue),
            verdicts=by_deviations(deviation),
        )


def balanced(pixels: LampPixels, lamps: Lamps, albedo: Array) -> tuple[Lamps, Array]:
    """Lamps and albedos (P, 3) that are known up to a factor a channel, in the pictures' units.

    See `of_usual_scale`.
    """
    cosines = np.maximum(pixels.normals @ lamps.places.T, 0)
    shown = cosines[..., None] * lamps.colors[None] * albedo[:, None]
    lit = (cosines > 0.3)[..., None] & pixels.told
    ratio = np.where(lit & (shown > 0), pixels.samples / np.maximum(shown, 1e-12), 1)
    factor = np.array(
        [np.median(ratio[..., c][lit[..., c]]) if lit[..., c].any() else 1.0 for c in range(3)]
    )
    albedo = np.maximum(albedo * factor, 1e-9)
    return of_usual_scale(lamps, np.maximum(lamps.colors, 1e-9), albedo)


def albedo_under(pixels: LampPixels, lamps: Lamps) -> Array:
    """(P, 3): the median over the pictures of what surfaces would be if they were matt."""
    directions, strengths = lamps.at(pixels.points, len(pixels))
    cosines = np.maximum(np.einsum("px,pkx->pk", pixels.normals, directions), 0) * strengths
    shown = np.zeros(pixels.samples.shape)
    for k, picture in enumerate(lamps.pictures):
        shown[:, picture] += cosines[:, k, None] * lamps.colors[k]
    lit = (shown > 0) & pixels.told
    ratio = np.where(lit, pixels.samples / np.maximum(shown, 1e-12), ALBEDO_MEAN)
    return np.asarray(np.clip(np.median(ratio, axis=1), 0.01, 0.95))


def _spread(values: Array, few: NDArray[np.intp], places: NDArray[np.intp], width: int) -> Array:
    """(P, ...): at places, what the nearest of some others have."""
    from scipy.spatial import cKDTree

    tree = cKDTree(np.stack(np.divmod(few, width), axis=-1))
    return np.asarray(values[tree.query(np.stack(np.divmod(places, width), axis=-1))[1]])


def check_light(scene: Scene, setup: FitSetup) -> None:
    """Raise InputError if lamps are asked for, or known, and cannot be fitted."""
    if setup.options.light == "lamps" and scene.lighting is not None:
        raise InputError("light: expected unknown light for lamps, found known SH light")
    if scene.lamps is not None and scene.lamps.near.any() and scene.depth is None:
        raise InputError("lamps: expected depth for near lamps, found none")


def normals_from_pictures(
    scene: Scene, *, threads: int = 0, progress: Callable[[Progress], None] | None = None
) -> tuple[Array, Array, NDArray[np.float32], Lamps, tuple[str, ...]]:
    """Normals, their deviation in degrees, height and lamps of a fit to pictures without normals.

    Maps are as in `Result`. Also what the pictures leave open, in words. Raises InputError if there
    are fewer than three pictures, known SH light, or near lamps without depth.
    """
    began = time.perf_counter()
    options = FitOptions(light="lamps", model=chosen_model(None, scene.model), uncertainty=True)
    scene = aligned(scene)
    setup = FitSetup(options, whole_number("threads", threads), progress, began)
    check_light(scene, setup)
    start = first_shape(scene)
    found = LampFit(scene, setup, start).solve()
    assert found.lamps is not None
    assert found.normal_sigma is not None
    height = height_of(found.normals, scene, setup.threads)
    return found.normals, found.normal_sigma, height, found.lamps, start.undetermined
