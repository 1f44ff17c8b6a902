"""The one place that decides between explanations of the same pictures.

An explanation says by which curve the files' values are decoded, what lights the pictures, what
blocks that light, whether normals are held, how samples weigh and how much the prior on materials
weighs. Each is fitted to some of the pictures, at some of the pixels; then only the light of the
others is fitted, and what is left of these, in the files' own values, so that different curves
compare, has a score (`pbrfit.fit.left_out`).

The lowest score wins; but the curve that the files are said to have stays unless another is better
by more than two standard errors under some light. It is out then, unless that is as much worse
than the best. Surroundings and other normals than the given ones have to gain as much, and the
material prior as much in each picture. What explains the pictures but for rounding, or leaves
nothing but noise, ends the comparison.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Iterator, Sequence
from copy import copy
from dataclasses import dataclass, replace
from operator import attrgetter
from typing import Any

import numpy as np

from pbrfit._core import InputError
from pbrfit.fit import settings
from pbrfit.fit.coarse import Lights
from pbrfit.fit.estimator import fit_materials, lights_and_noise
from pbrfit.fit.given import Contradiction, contradiction
from pbrfit.fit.lamps.estimator import LOOK_LAST, Found, LampFit
from pbrfit.fit.lamps.picture_light import light_of_picture
from pbrfit.fit.lamps.samples import FirstShape
from pbrfit.fit.lamps.shape import first_shape
from pbrfit.fit.left_out import Explanation, LeftOut, LightKind
from pbrfit.fit.normals import refined_fit
from pbrfit.fit.objective import Objective
from pbrfit.fit.run import FitSetup, Run, Trace
from pbrfit.fit.transport import Surrounded, search
from pbrfit.fit.windows import cut, strided_window, without_shape
from pbrfit.io.color import Curve
from pbrfit.model.lamps import Lamps
from pbrfit.model.reflection import shade
from pbrfit.result.held_out import Candidate, HeldOut
from pbrfit.result.options import FitOptions, Loss
from pbrfit.scene.scene import Scene
from pbrfit.threads import one_blas_thread
from pbrfit.transport.decision import NOT_TRIED, Kind, Transport
from pbrfit.transport.scenery import PixelTransfer, Scenery
from pbrfit.values.arrays import Array

log = logging.getLogger("pbrfit")

SCORE = attrgetter("score")


NOT_COMPARED = "explanations were not compared"


@dataclass(frozen=True, eq=False)
class Choice:
    """What explains the pictures best, and where its fit stands."""

    explanation: Explanation
    held_out: HeldOut | None
    """What was compared; None where nothing was."""
    found: Found | None = None
    """Of a fit under far lamps and given normals, for that of all pixels to go on from."""
    other_fov: tuple[float, float] | None = None
    """Degrees of a field of view, and their standard deviation, that explains left-out pictures so
    much better than the given one that it contradicts this."""
    transport: Transport = NOT_TRIED
    scenery: Scenery | None = None
    """What blocks light, and why; None where nothing does."""
    why_normals: str = NOT_COMPARED
    """Why normals are refined, or not."""
    contradiction: Contradiction | None = None


@dataclass(frozen=True, eq=False)
class _Fitted:
    """Some pixels of a scene as an explanation has them, by the pictures that were fitted."""

    materials: tuple[Array, ...]
    """Albedo (P, 3), roughness (P,), metallic (P,)."""
    normals: Array
    views: Array
    """(P, 3) each."""
    found: Found | None = None
    """Of a fit under lamps."""
    fov: tuple[float, float] | None = None
    """That was fitted, and its standard deviation, in degrees."""


@one_blas_thread()
def choose(scene: Scene, setup: FitSetup, *, start_given: bool = False) -> Choice:
    """The explanation that a scene is to be fitted by.

    Nothing is compared where a start is given, whose units are those of the files as they are said
    to be, or the paper's recipe is asked for.

    Raises
    ------
    InputError
        If normals are missing and too few pictures tell them, or surroundings are asked for and
        there is no depth that tells them.
    """
    told = start_given or setup.options.solver != "gauss-newton"
    compared = _Comparison(scene, setup, told=told)
    contradicted = contradiction(scene, compared.reduced, setup.options.model)
    return replace(compared.best(), contradiction=contradicted)


class _Comparison:
    """The comparison of a scene's explanations, under way."""

    def __init__(self, scene: Scene, setup: FitSetup, *, told: bool = False) -> None:
        self._scene, self._setup, self._options = scene, setup, setup.options
        # Pixels with normals stay as exact as they are; without, neighbours tell the shape.
        if scene.normals_known:
            self.reduced: Scene = cut(scene, strided_window(scene.valid, settings.COMPARE_PIXELS))
        else:
            self.reduced = without_shape(scene)
        self._few = self.reduced
        pixels = int(np.count_nonzero(self._few.valid))
        shown = [
            np.count_nonzero((_weights(self._few, i) > 0).any(axis=-1))
            for i in range(len(scene.images))
        ]
        least = min(pixels, settings.COMPARE_PIXELS_MIN)
        usable = [i for i, count in enumerate(shown) if count >= least]
        self._folds = list(_folds(usable, len(scene.images)))
        valid = self._few.valid.copy()  # in any fold
        for kept, _ in self._folds:
            valid &= self._few.of_pictures(kept).valid
        few = np.count_nonzero(valid) < settings.COMPARE_PIXELS_MIN
        if not few and not (valid == self._few.valid).all():
            self._few = replace(self._few, mask=valid)
        if told or setup.options.iterations == 0 or few:
            self._folds = []
        self._shapes: dict[tuple[Curve | None, int], tuple[Scene, LampFit]] = {}
        self._tried: dict[Explanation, list[LeftOut]] = {}
        self._lit: dict[tuple[Explanation, int], tuple[Run, Lights]] = {}
        self._normals: dict[tuple[Explanation, int], refined_fit.Found] = {}
        self._surrounded: Surrounded | None = None
        self._no_surroundings = self._without_surroundings()
        self._transfer: PixelTransfer | None = None
        """Of the pixels that are compared, with all pictures."""
        self._is_late = Trace(self._setup_with()).out_of_time

    def best(self) -> Choice:
        """The explanation of those that a scene can need."""
        asked = self._options.transport
        if asked != "auto":
            self._find_surroundings()
        lights, responses = self._lights(), self._responses()
        simplest = lights[-1] if self._scene.normals_known else lights[0]
        loss, priors = self._options.robust, self._options.priors
        strength, given = priors.material_strength, "none" if asked == "auto" else self._kind
        under_lamps = Explanation(responses[0], simplest, strength, loss)
        first = under_lamps if simplest == "lamps" else replace(under_lamps, surroundings=given)
        if not self._folds:
            return self._choice(None, first)
        # Light from all around first: where it leaves only noise, nothing is left to explain. It is
        # found as the paper has it, with neither priors nor weights of samples, which have to pay.
        equal: Loss = "none" if loss == "auto" else loss
        plain = replace(first, material=priors.material or 0.0, robust=equal, surroundings=given)
        kinds = [
            replace(plain if light == "sh" else under_lamps, response=response, light=light)
            for light in lights[::-1]
            for response in responses
        ]
        if asked == "auto":
            kinds = self._with_surroundings(kinds)
        best = self._race(kinds)
        if best is None:
            return self._choice(None, first)
        best = self._simplest()
        if best.explanation.light == "sh" and best.is_noise:
            return self._choice(best, replace(best.explanation, material=strength, robust=loss))
        other_fov = self._other_fov(best)
        if other_fov is None and self._may_refine(best.explanation):
            self._try_all(replace(best.explanation, free_normals=True), best)
            best = self._simplest()
        # Lamps have both already. Priors and weights may do what other normals did.
        by_harmonics = [one for one in self._lasting() if one.explanation.light == "sh"]
        likely = min(by_harmonics, key=SCORE, default=None)
        if likely and not likely.is_worse(best, settings.COMPARE_ERRORS_MIN):
            full = replace(likely.explanation, material=strength, robust=loss)
            for kind in (full, replace(full, material=plain.material)):
                for one in dict.fromkeys((replace(kind, free_normals=False), kind)):
                    self._try_all(one, best)
        best = self._simplest()
        return self._choice(best, best.explanation, None if other_fov is None else other_fov.fov)

    def _try_all(self, kind: Explanation, best: LeftOut) -> None:
        """Try an explanation in as many folds as the best, if there is time."""
        if kind not in self._tried and not self._is_late():
            for fold in range(len(self._tried[best.explanation])):
                self._try(kind, fold)

    # What given data says may be

    def _with_surroundings(self, kinds: list[Explanation]) -> list[Explanation]:
        """Explanations, with those among surroundings, if the others leave more than noise."""
        of_open = [one for one in kinds if one.light == "sh"]
        if not self._no_surroundings:
            for kind in of_open:
                self._try(kind, 0)
            if any(one.is_noise for one in self._results()):
                self._no_surroundings = "left-out pictures are explained up to noise without"
                return kinds
        self._find_surroundings()
        if self._kind == "none":
            return kinds
        # Before lamps, by which shadows could be explained otherwise.
        among = [replace(one, surroundings=self._kind) for one in of_open]
        return [*of_open, *among, *(one for one in kinds if one not in of_open)]

    def _find_surroundings(self) -> None:
        """Those that a scene's depth tells, if environment light may be what lights it."""
        scene, asked = self._scene, self._options.transport
        for missing, what in ((scene.depth is None, "depth"), (not scene.normals_known, "normals")):
            if asked in ("occlusion", "bounce") and missing:
                raise InputError(f"transport: expected a scene with {what} for {asked}, found none")
        if self._no_surroundings:
            return
        part = cut(scene, strided_window(scene.valid, 2 * settings.TRANSPORT_PIXELS))
        try:
            found = search(part, self._objective(part), asked, self._is_late)
        except InputError as error:
            if asked != "auto":
                raise
            log.warning("transport: left out: %s", error)
            self._no_surroundings = str(error)
            return
        self._surrounded = found
        if self._folds:
            self._transfer = found.tables(self._objective(self._few))

    def _without_surroundings(self) -> str:
        """Why a scene can have no surroundings; empty if it can."""
        scene, options = self._scene, self._options
        if options.transport == "none":
            return "not asked for"
        if scene.depth is None:
            return "no depth is given"
        if not scene.normals_known:
            return "no normals are given"
        if "sh" not in self._lights():
            return "they are known for environment light alone"
        if options.iterations == 0:
            return "0 iterations asked for"
        return "" if self._folds or options.transport != "auto" else NOT_COMPARED

    def _objective(self, scene: Scene) -> Objective:
        return self._setup_with().objective(scene)

    @property
    def _kind(self) -> Kind:
        return "none" if self._surrounded is None else self._surrounded.transport.kind

    def _may_refine(self, kind: Explanation) -> bool:
        """Whether other normals than the given ones may be compared with these.

        Not where a curve is fitted, whose bends normals would take up.
        """
        return (
            self._scene.normals_known
            and self._options.response != "fit"
            and self._options.refine_normals == "auto"
            and self._setup.why_normals == ""
            and kind.light == "sh"
            and kind.surroundings == "none"
        )

    def _other_fov(self, best: LeftOut) -> LeftOut | None:
        """One of a field of view that contradicts the given one."""
        scene = self._scene
        told = scene.fov_known and scene.normals_known and scene.lighting is None
        plain = best.explanation.light == "sh" and best.explanation.surroundings == "none"
        if not told or not plain or self._is_late():
            return None
        kind = replace(best.explanation, other_fov=True)
        other, given = self._of_fold(kind, 0), self._tried[best.explanation][0]
        if other.fov is None or given.score - other.score < settings.COMPARE_FOV_GAIN_MIN:
            return None
        (fov, sigma), errors = other.fov, settings.COMPARE_ERRORS_MIN
        differs = abs(fov - scene.fov) > errors * sigma
        return other if differs and given.is_worse(other, errors) else None

    def _race(self, kinds: Sequence[Explanation]) -> LeftOut | None:
        """The best of some, of which those go on from fold to fold that may still be the best.

        None if the pictures of a fold are too few, or too much alike, for any of them, or if there
        is no time for all: of some alone the best says little.
        """
        best = None
        for fold in range(len(self._folds)):
            for kind in kinds:
                # What one leaves may say that another need not be tried.
                if fold == 0 and any(
                    one.leaves_no_lamp
                    if kind.light == "lamps"
                    else one.is_noise and kind.surroundings != "none"
                    for one in self._results()
                ):
                    continue
                if len(self._tried.get(kind, ())) == fold and not self._is_late():
                    self._try(kind, fold)
            if self._is_late():
                break
            results = [one for one in self._results() if one.explanation in kinds]
            if not results:
                break
            best = min(results, key=SCORE)
            errors = 2 * settings.COMPARE_ERRORS_MIN
            kinds = [one.explanation for one in results if not one.is_worse(best, errors)]
            if len(kinds) == 1:
                break
        return best

    def _results(self, folds: int | None = None) -> list[LeftOut]:
        """What was tried in so many folds, in these, or all; what none explains tells nothing."""
        tried = [of[:folds] for of in self._tried.values()]
        hot = [
            np.logical_and.reduce([of[fold].is_hot for of in tried if len(of) > fold])
            for fold in range(max(map(len, tried), default=0))
        ]
        return [
            LeftOut.together([one.without(none) for one, none in zip(of, hot, strict=False)])
            for of in tried
            if len(of) >= (folds or 1)
        ]

    def _lights(self) -> tuple[LightKind, ...]:
        scene, options = self._scene, self._options
        if options.light != "auto":
            return (options.light,)
        if scene.lighting is not None or options.mono_light or len(scene.images) < 3:
            return ("sh",)
        return ("lamps", "sh") if scene.lamps is None else ("lamps",)

    def _responses(self) -> list[Curve | None]:
        scene = self._scene
        asked = self._options.response
        if scene.response is None or asked == "fit" or scene.lighting is not None:
            return [scene.response]
        if asked != "auto":
            return [asked]
        return [scene.response, "linear" if scene.response == "srgb" else "srgb"]

    def _lasting(self) -> list[LeftOut]:
        """What was tried in as many folds as anything was."""
        return self._results(max(map(len, self._tried.values())))

    def _simplest(self) -> LeftOut:
        """The best, or the simplest under the same kind of light that is not surely worse."""
        results = self._lasting()
        best = min(results, key=SCORE)
        kind, errors = best.explanation, settings.COMPARE_ERRORS_MIN
        said = self._scene.response
        refuted = self._is_refuted(said, errors)
        if (kind.response == said) == refuted:
            same = [one for one in results if one.explanation.light == kind.light]
            allowed = [one for one in same if (one.explanation.response == said) != refuted]
            other = min(allowed, key=SCORE, default=best)
            # What refutes a curve under one light is outweighed where it is surely best under all.
            best = best if refuted and other.is_worse(best, errors) else other
        for plainer in ({"surroundings": "none"}, {"free_normals": False}):
            kind = replace(best.explanation, **plainer)
            plain = next((one for one in results if one.explanation == kind), best)
            best = best if plain.is_worse(best, errors) else plain
        kind = replace(best.explanation, material=0.0)
        free = [one for one in results if replace(one.explanation, robust=kind.robust) == kind]
        plain = min(free, key=SCORE, default=best)
        everywhere = (best.means < plain.means).all()
        return best if everywhere and plain.is_worse(best, errors) else plain

    def _is_refuted(self, response: Curve | None, errors: float) -> bool:
        """Whether it leaves more than noise, and another is surely better under some light.

        Of noise another may leave less, because it weighs that of dark samples otherwise.
        """
        if any(one.is_noise for one in self._results(1) if one.explanation.response == response):
            return False
        for light in ("sh", "lamps"):
            # In the folds that explanations with that curve were tried in.
            kinds = [one for one in self._tried if (one.light, one.response) == (light, response)]
            if kinds:
                folds = max(len(self._tried[one]) for one in kinds)
                same = [one for one in self._results(folds) if one.explanation.light == light]
                as_said = min((one for one in same if one.explanation in kinds), key=SCORE)
                if as_said.is_worse(min(same, key=SCORE), errors):
                    return True
        return False

    def _choice(
        self,
        best: LeftOut | None,
        chosen: Explanation,
        other_fov: tuple[float, float] | None = None,
    ) -> Choice:
        """What was chosen, with what was compared; `best` is None where nothing was."""
        transport = Transport(why=self._no_surroundings)
        scenery, asked = None, self._options.transport != "auto"
        if chosen.surroundings != "none":
            assert self._surrounded is not None
            transport, scenery = self._surrounded.transport, self._surrounded.scenery
            if not asked:
                transport = replace(transport, why="left-out pictures are explained better")
        elif self._surrounded is not None:
            why = "left-out pictures are explained no better with surroundings"
            transport = Transport(why=why, figures=self._surrounded.transport.figures)
        choice = Choice(chosen, None, None, other_fov, transport, scenery)
        if best is None:
            return choice
        others = sorted(self._results(), key=SCORE)
        held_out = HeldOut(
            error=best.error,
            nearest_picture=self._nearest(),
            pictures=len(best.squares),
            candidates=tuple(
                Candidate(
                    (chosen if one.explanation == best.explanation else one.explanation).in_words(),
                    one.score,
                    one.error,
                )
                for one in others
            ),
            chosen=chosen.in_words(),
        )
        # A shape that smaller pictures have told is no start for all of its pixels.
        found = best.found if self._scene.normals_known else None
        why = self._why_normals(best, chosen, contradicted=other_fov is not None)
        return replace(choice, held_out=held_out, found=found, why_normals=why)

    def _why_normals(self, best: LeftOut, chosen: Explanation, *, contradicted: bool) -> str:
        if chosen.free_normals:
            return "left-out pictures are explained better with other normals"
        if chosen.surroundings != "none":
            return "surroundings block light, which is known for the given normals alone"
        if best.is_noise:
            return "the given normals explain left-out pictures up to noise"
        if contradicted:
            return "another field of view explains left-out pictures better"
        if any(one.free_normals for one in self._tried):
            return "left-out pictures are explained no better with other normals"
        return NOT_COMPARED

    # Fits

    def _try(self, kind: Explanation, fold: int) -> None:
        """Fit the pictures of a fold and explain those that it leaves out, if they tell enough."""
        try:
            explained = self._of_fold(kind, fold)
        except InputError as error:
            log.debug("%s: not compared: %s", kind.in_words(), error)
        else:
            if not self._is_late():  # else the limit has cut the fit short
                self._tried.setdefault(kind, []).append(explained)

    def _of_fold(self, kind: Explanation, fold: int) -> LeftOut:
        kept, out = self._folds[fold]
        scene = self._few if kind.response is None else self._few.decoded_by(kind.response)
        few, told = self._pixels(scene, kept, kind.response, fold)
        if kind.light == "lamps":
            fit = self._under_lamps(told or self._lamp_fit(few.of_pictures(kept)))
        else:
            fit = self._under_harmonics(kind, fold, few.of_pictures(kept), self._among(kind, kept))
        errors, values, rounding, lamps = [], [], [], []
        for picture in out:
            if kind.surroundings != "none":
                shown, lamp = self._explained_among(kind, fit, few, picture), None
            else:
                shown, lamp = _explained(self._setup, fit, few, picture)
            values.append(few.file_values(few.samples(picture).astype(np.float64)))
            errors.append(values[-1] - few.file_values(np.maximum(shown, 0.0)))
            untold = _weights(few, picture) == 0
            errors[-1][untold] = values[-1][untold] = np.nan
            floor = few.noise_floor(picture)
            slope = _slope(few, few.samples(picture).astype(np.float64))
            off = 0.0 if floor is None else floor[few.valid] * slope
            rounding.append(float(np.mean(np.square(off))))
            if lamp is not None:
                lamps.append(lamp)
        return LeftOut(
            kind,
            self._numbers(kind),
            np.array(errors),
            np.array(values),
            np.array(rounding),
            few.valid,
            None if fit.found is None else self._of_all(fit.found, lamps, fold),
            fit.fov,
        )

    def _numbers(self, kind: Explanation) -> int:
        """Of a left-out picture's light, that are fitted to it."""
        if self._scene.lighting is not None:
            return 0
        if kind.light == "lamps":
            return 8  # direction, colour, and constant light around it
        return int((self._options.sh_order + 1) ** 2 * (1 if self._options.mono_light else 3))

    def _among(self, kind: Explanation, pictures: Sequence[int]) -> PixelTransfer | None:
        """What surroundings do to the light of the pixels that are compared."""
        if kind.surroundings == "none":
            return None
        assert self._transfer is not None
        return self._transfer.of_pictures(pictures)

    def _explained_among(
        self, kind: Explanation, fit: _Fitted, scene: Scene, picture: int
    ) -> Array:
        """(P, 3): as `_explained`, among surroundings."""
        one = scene.of_pictures([picture])
        objective = self._objective(one).among(self._among(kind, [picture]))
        maps = [objective.layout.whole(of) for of in fit.materials]
        x = objective.with_best_lights(objective.pack(*maps))
        everything = objective.everything
        residuals = objective.problem.residuals(objective.for_core(x), everything)
        rendered = objective.pictures(everything) + residuals
        return np.broadcast_to((rendered * objective._by_picture)[0], (objective.pixels, 3))

    def _pixels(
        self, scene: Scene, kept: Sequence[int], response: Curve | None, number: int
    ) -> tuple[Scene, LampFit | None]:
        """The pixels that are compared, of all pictures, and the fit that has told their shape."""
        if self._scene.normals_known:
            return scene, None
        if (response, number) not in self._shapes:
            shape = first_shape(scene.of_pictures(kept), self._setup.threads)
            told = np.isfinite(shape.normals).all(axis=-1, keepdims=True)
            facing = np.where(told, shape.normals, [0.0, 0.0, 1.0])
            known = replace(scene, normals=facing, normals_known=True)
            window = strided_window(known.valid, settings.COMPARE_PIXELS)
            few, normals, albedo = cut(known, window), window.of(facing), window.of(shape.albedo)
            shape = replace(shape, normals=normals, albedo=albedo)
            fit = self._lamp_fit(few.of_pictures(kept), shape)
            self._shapes[response, number] = replace(few, normals=fit.settled.normals), fit
        return self._shapes[response, number]

    def _setup_with(self, **options: Any) -> FitSetup:
        """That of a fit that is compared: maps alone, with some options in place of the given.

        It has half of the time limit: the other half is for the fit of all pixels.
        """
        limit = self._options.time_limit
        of_all = replace(
            self._options,
            iterations=FitOptions.iterations,
            refine_normals="off",
            transport="none",
            uncertainty=False,
            time_limit=None if limit is None else limit / 2,
            **options,
        )
        return replace(self._setup, options=of_all, progress=None)

    def _under_harmonics(
        self, kind: Explanation, fold: int, scene: Scene, among: PixelTransfer | None
    ) -> _Fitted:
        priors = replace(self._options.priors, material=kind.material)
        setup = self._setup_with(priors=priors, robust=kind.robust)
        if kind.other_fov:
            scene = replace(scene, fov_known=False)
        key = replace(kind, material=0.0), fold
        if kind.free_normals:
            state = refined_fit.fit_held(self._refined(setup, key, scene), setup.objective)
        else:
            state = fit_materials(*self._under_lights(setup, key, scene, among))
        run = state.run
        scene, (materials, _) = run.scene, run.objective.unpack(state.x)
        valid, camera = scene.valid, run.camera
        sigma = camera.fov_sigma
        return _Fitted(
            tuple(
                np.asarray(of, np.float64)[valid]
                for of in (materials.albedo, materials.roughness, materials.metallic)
            ),
            np.asarray(scene.normals, np.float64)[valid],
            scene.through(camera.fov_degrees).views[valid],
            fov=None if sigma is None else (camera.fov_degrees, sigma),
        )

    def _refined(
        self, setup: FitSetup, key: tuple[Explanation, int], scene: Scene
    ) -> refined_fit.Found:
        """Normals of a fold, on which the material prior has no influence."""
        if key not in self._normals:
            run = Run(setup, scene, setup.objective(scene))
            found = refined_fit.find(run, run.objective.start(), setup.objective)
            if found is None:
                raise InputError(refined_fit.OUT_OF_TIME)
            self._normals[key] = found
        found = self._normals[key]
        run = found.run.continued(found.run.scene, found.run.objective, options=setup.options)
        return replace(found, run=run)

    def _under_lights(
        self,
        setup: FitSetup,
        key: tuple[Explanation, int],
        scene: Scene,
        among: PixelTransfer | None,
    ) -> tuple[Run, Lights]:
        """A run of a fold that has found lights, which do not depend on the material prior."""
        if key not in self._lit:
            objective = setup.objective(scene)
            if among is not None:
                objective = objective.among(among)
            run = Run(setup, scene, objective)
            self._lit[key] = run, lights_and_noise(run, objective.start())
        run, lights = self._lit[key]
        run = run.continued(run.scene, copy(run.objective), options=setup.options)
        return run, replace(lights, x=lights.x.copy(), shared=copy(lights.shared))

    def _lamp_fit(self, scene: Scene, shape: FirstShape | None = None) -> LampFit:
        return LampFit(scene, self._setup_with(), shape, rounds=LOOK_LAST)

    def _under_lamps(self, fit: LampFit) -> _Fitted:
        pixels, state, found = fit.of_all_pixels()
        return _Fitted(
            (state.albedo, state.roughness, state.metallic),
            state.normals,
            pixels.views,
            found=found,
        )

    def _of_all(self, found: Found, out: Sequence[Lamps], fold: int) -> Found | None:
        """With the lamps of left-out pictures beside those of the fitted ones."""
        if found.lamps.near.any():
            return None
        kept, left = self._folds[fold]
        pictures = np.array([*(kept[i] for i in found.lamps.pictures), *left])
        order = np.argsort(pictures, kind="stable")
        places, colors = (
            np.concatenate([getattr(one, name) for one in (found.lamps, *out)])[order]
            for name in ("places", "colors")
        )
        return replace(found, lamps=Lamps(pictures[order], places, colors=colors))

    def _nearest(self) -> float:
        """Relative error of left-out pictures where the nearest other one is shown for them."""
        logs = []
        scene = self._few
        values = [
            np.asarray(scene.file_values(scene.samples(i).astype(np.float64)))
            for i in range(len(scene.images))
        ]
        for kept, out in self._folds:
            for picture in out:
                counted = (_weights(scene, picture) > 0).astype(np.float64)
                true = values[picture] * counted
                least = min(
                    float(np.square(true - _factor(values[i] * counted, true)).sum()) for i in kept
                )
                size = float(np.square(true).sum())
                logs.append(math.log(max(least, 1e-300) / max(size, 1e-300)))
        return math.exp(0.5 * float(np.mean(logs)))


def _explained(
    setup: FitSetup, fit: _Fitted, scene: Scene, picture: int
) -> tuple[Array, Lamps | None]:
    """(P, 3): radiance of a left-out picture as a fit explains it, its light alone fitted.

    And that light, if it is a lamp.
    """
    samples = scene.samples(picture).astype(np.float64)
    told = _weights(scene, picture)
    slope = _slope(scene, samples)
    if fit.found is None:
        rows = shade(fit.normals, fit.views, *fit.materials, model=setup.model)
        if scene.lighting is not None:
            return np.einsum("pck,kc->pc", rows, scene.lighting[picture]), None
        rows = rows[..., : (setup.options.sh_order + 1) ** 2]
        return _under_best_harmonics(scene, rows, samples, told), None
    weights = told * slope**2
    lamp, _, shown = light_of_picture(
        samples, weights, fit.normals, fit.views, fit.materials, setup.model
    )
    return shown, lamp


def _under_best_harmonics(scene: Scene, rows: Array, samples: Array, told: Array) -> Array:
    """(P, 3): the sum of rows (P, 3, 16) that leaves least of the files' values.

    Gauss–Newton: with f the curve, f(y + δ) ≈ f(y) + f′(y) δ.
    """
    found = samples
    for _ in range(settings.COMPARE_LIGHT_STEPS):
        slope = _slope(scene, found)
        wanted = found + (scene.file_values(samples) - scene.file_values(found)) / slope
        shares = np.sqrt(told) * slope
        found = np.stack(
            [
                rows[:, c]
                @ np.linalg.lstsq(
                    rows[:, c] * shares[:, c, None], wanted[:, c] * shares[:, c], rcond=1e-9
                )[0]
                for c in range(3)
            ],
            axis=-1,
        )
    return found


def _slope(scene: Scene, radiance: Array) -> Array:
    """Of the files' values by radiance."""
    step = settings.COMPARE_DARKEST
    at = np.maximum(radiance, step)
    return np.asarray((scene.file_values(at + step) - scene.file_values(at)) / step)


def _factor(other: Array, true: Array) -> Array:
    """Another picture times the best factor for each channel."""
    below = np.maximum(np.square(other).sum(axis=0), 1e-300)
    return np.asarray(other * ((other * true).sum(axis=0) / below))


def _weights(scene: Scene, picture: int) -> Array:
    """(P, 3): how much each value of a picture counts, 0 at limits."""
    weights = scene.channel_weights(picture)
    if weights is None:
        return np.ones((np.count_nonzero(scene.valid), 3))
    return weights[scene.valid].astype(np.float64)


def _folds(
    usable: Sequence[int], pictures: int
) -> Iterator[tuple[tuple[int, ...], tuple[int, ...]]]:
    """(Fitted, left out): enough left-out pictures altogether, spread evenly, none twice.

    Left out are those that are usable, of so many pictures in all.
    """
    out = max(1, pictures // settings.COMPARE_SHARE)
    if pictures - out < settings.COMPARE_KEPT_MIN or len(usable) < out:
        return
    count = min(-(-settings.COMPARE_PICTURES_MIN // out), len(usable) // out)
    step = len(usable) / (out * count)
    chosen = [usable[int((k + 0.5) * step)] for k in range(out * count)]
    for fold in range(count):
        left = tuple(chosen[fold::count])
        yield tuple(i for i in range(pictures) if i not in left), left
