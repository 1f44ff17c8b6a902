"""The one place that decides between explanations of the same pictures.

An explanation says by which curve the files' values are decoded, what lights the pictures, how
samples weigh and how much the prior on materials weighs. Each is fitted to some of the
pictures, at some of the pixels; then only the light of the others is fitted, and what is left of
these is its error e, in the files' own values, so that different curves compare. With the mean
square of picture i over the P pixels, and k numbers of its light,

    score = mean over pictures of [ln Σ e²/P + k/n ln n],    n = the effective number of pixels

which is −2/n times the evidence by G. Schwarz ("Estimating the dimension of a model", Annals of
Statistics 6, 1978). A light of harmonics has 48 numbers and a lamp 8: the former can take up what
normals or a curve have wrong, which is no merit of theirs.

An explanation with more numbers is chosen where its score is lower by more than two standard
errors; the differences are as uncertain as their means over patches of the pictures say. What
explains the pictures but for rounding, or leaves nothing but noise, ends the comparison.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from pbrfit.fit import settings
from pbrfit.fit.estimator import find_lights, gauss_newton
from pbrfit.fit.lamps.estimator import Found, LampFit
from pbrfit.fit.lamps.picture_light import light_of_picture
from pbrfit.fit.lamps.problem import LampPixels, LampState, radiance
from pbrfit.fit.lamps.shape import FirstShape, first_shape
from pbrfit.fit.tiles.windows import SceneCutter, strided_window
from pbrfit.fit.whole_picture import FitSetup
from pbrfit.io import limits as file_limits
from pbrfit.io.color import Curve
from pbrfit.io.resampling import averaged, averaged_channels, reduced_size
from pbrfit.model.lamps import Lamps
from pbrfit.model.reflection import DEFAULT_MODEL, Model, shade
from pbrfit.result.held_out import Candidate, HeldOut
from pbrfit.result.options import Loss
from pbrfit.scene.scene import Scene
from pbrfit.threads import one_blas_thread

Array = NDArray[np.float64]
LightKind = Literal["sh", "lamps"]

NUMBERS: dict[LightKind, int] = {"sh": 48, "lamps": 8}
"""Of a picture's light: 16 coefficients a channel; a direction, a colour and ambient light."""


@dataclass(frozen=True)
class Explanation:
    """What differs between explanations of the same pictures."""

    response: Curve | None
    """The curve that files' values are decoded by; None = as the scene has it, for good."""
    light: LightKind
    material: float
    """Strength of the material prior, `Priors.material`."""
    robust: Loss
    """How samples weigh, `FitOptions.robust`."""

    def in_words(self) -> str:
        """In a few words, for people."""
        light = "light from all around" if self.light == "sh" else "a lamp in each picture"
        words = [light]
        if self.response is not None:
            words.append(f"{'sRGB' if self.response == 'srgb' else self.response} values")
        if self.light == "sh":
            words.append("material prior" if self.material else "no material prior")
            if self.robust == "none":
                words.append("all samples alike")
        return ", ".join(words)

    @property
    def numbers(self) -> int:
        """How many a picture's light has."""
        return NUMBERS[self.light]


@dataclass(frozen=True, eq=False)
class Choice:
    """What explains the pictures best, and where its fit stands."""

    explanation: Explanation
    held_out: HeldOut | None
    """What was compared; None where nothing was."""
    found: Found | None = None
    """Of a fit under far lamps, for that of all pixels to go on from."""


@dataclass(frozen=True, eq=False)
class _Explained:
    """Left-out pictures as one explanation has them."""

    explanation: Explanation
    squares: Array
    """(M, P): squared error of a pixel, in the files' values; NaN where a picture tells nothing."""
    sizes: Array
    """(M, P): squares of the values themselves, likewise."""
    is_noise: bool
    """Whether the pictures that were fitted leave only noise, or nothing."""
    found: Found | None = None
    """Of a fit under far lamps: with those of all pictures."""

    @property
    def error(self) -> float:
        """Relative root mean square error of the pictures, their geometric mean."""
        return float(np.exp(0.5 * (self._logs - np.log(np.nanmean(self.sizes, axis=1))).mean()))

    @property
    def score(self) -> float:
        """As in the head of this file."""
        n = self.squares.shape[1]
        return float(self._logs.mean()) + self.explanation.numbers / n * math.log(n)

    @property
    def _logs(self) -> Array:
        return np.log(np.maximum(np.nanmean(self.squares, axis=1), settings.NOISE_VARIANCE_MIN))

    def error_of_difference(self, other: _Explained, patches: NDArray[np.intp]) -> float:
        """Standard error of the difference of two scores, by its means over patches (P,).

        A small change of a picture's mean square moves its logarithm by the change over the mean.
        """
        shares = [
            one.squares
            / np.maximum(np.nanmean(one.squares, axis=1, keepdims=True), settings.NOISE_VARIANCE_MIN)
            for one in (self, other)
        ]
        difference = np.nan_to_num(shares[0] - shares[1])
        count = int(patches.max()) + 1
        sums = np.array([np.bincount(patches, row, count) for row in difference])
        sums /= difference.size
        return float(np.sqrt(np.square(sums - sums.mean()).sum()))


@dataclass(frozen=True, eq=False)
class _Fitted:
    """Some pixels of a scene as an explanation has them, by the pictures that were fitted."""

    materials: tuple[Array, Array, Array]
    """(P, 3), (P,), (P,)."""
    normals: Array
    views: Array
    """(P, 3) each."""
    is_noise: bool
    pixels: LampPixels | None = None
    found: Found | None = None
    """Of a fit under lamps."""


@one_blas_thread()
def choose(scene: Scene, setup: FitSetup) -> Choice:
    """The explanation that a scene is to be fitted by.

    Raises
    ------
    InputError
        If normals are missing and too few pictures tell them.
    """
    return _Comparison(scene, setup).best()


class _Comparison:
    """The comparison of a scene's explanations, under way."""

    def __init__(self, scene: Scene, setup: FitSetup) -> None:
        self._scene, self._setup, self._options = scene, setup, setup.options
        self._model: Model = setup.options.model or scene.model or DEFAULT_MODEL
        self._few = _reduced(scene)
        least = 2 if scene.normals_known else settings.COMPARE_KEPT_MIN
        self._folds = list(_folds(len(scene.images), least))
        few = np.count_nonzero(self._few.valid) < settings.COMPARE_PIXELS_MIN
        if scene.lighting is not None or setup.options.iterations == 0 or few:
            self._folds = []
        self._shapes: dict[tuple[Curve | None, int], FirstShape] = {}
        self._tried: list[_Explained] = []
        self._patches: NDArray[np.intp] | None = None

    def best(self) -> Choice:
        """The explanation of those that a scene can need."""
        lights, responses = self._lights(), self._responses()
        simplest = lights[-1] if self._scene.normals_known else lights[0]
        loss = self._options.robust
        first = Explanation(responses[0], simplest, self._strength, loss)
        if not self._folds:
            return Choice(first, None)
        kinds = [
            replace(first, response=response, light=light, material=self._strength_of(light))
            for response in responses
            for light in lights
        ]
        # Light from all around first: where it leaves only noise, nothing is left to explain.
        kinds.sort(key=lambda one: (one.light == "lamps", one.response != self._scene.response))
        for kind in kinds:
            found = self._try(kind)
            if found.is_noise and kind.response == self._scene.response:
                break
        best = self._chosen()
        if best.explanation.light == "sh":
            if self._strength:
                self._try(replace(best.explanation, material=self._strength))
            if loss == "auto" and not best.is_noise:
                self._try(replace(best.explanation, robust="none"))
            best = min(self._tried, key=lambda one: one.score)
        best = self._chosen()
        return self._choice(best)

    @property
    def _strength(self) -> float:
        return self._options.priors.material

    def _strength_of(self, light: LightKind) -> float:
        """Of the prior in the first comparison: light from all around is found without, sooner."""
        return self._strength if light == "lamps" else 0.0

    def _lights(self) -> tuple[LightKind, ...]:
        scene, options = self._scene, self._options
        if options.light != "auto":
            return (options.light,)
        if scene.lighting is not None or options.mono_light or len(scene.images) < 3:
            return ("sh",)
        if scene.lamps is not None:
            return ("lamps",)
        return ("lamps", "sh")

    def _responses(self) -> list[Curve | None]:
        scene = self._scene
        if scene.response is None or self._options.response not in ("auto", "fit"):
            return [scene.response]
        return [scene.response, "linear" if scene.response == "srgb" else "srgb"]

    def _chosen(self) -> _Explained:
        """The simplest of those that are not surely worse than the best."""
        best = min(self._tried, key=lambda one: one.score)
        if any(one.is_noise for one in self._tried):
            best = next(one for one in self._tried[::-1] if one.is_noise)
        assert self._patches is not None
        for one in sorted(self._tried, key=self._complexity):
            error = one.error_of_difference(best, self._patches)
            if one.score - best.score <= settings.COMPARE_ERRORS_MIN * error:
                return one
        return best

    def _complexity(self, one: _Explained) -> tuple[object, ...]:
        """By numbers of the light, freedom of materials, and what was not said."""
        kind = one.explanation
        return (
            kind.numbers,
            -kind.material,
            kind.response != self._scene.response,
            kind.robust != self._options.robust,
        )

    def _choice(self, best: _Explained) -> Choice:
        """What was chosen, with what was compared."""
        others = sorted(self._tried, key=lambda one: one.score)
        held_out = HeldOut(
            error=best.error,
            nearest_picture=self._nearest(),
            pictures=sum(len(out) for _, out in self._folds),
            candidates=tuple(
                Candidate(one.explanation.in_words(), one.score, one.error) for one in others
            ),
            chosen=best.explanation.in_words(),
        )
        return Choice(best.explanation, held_out, best.found)

    # Fits

    def _try(self, kind: Explanation) -> _Explained:
        """Fit some pictures and explain the others, fold by fold."""
        squares, sizes, fits = [], [], []
        lamps: list[Lamps] = []
        for number, (kept, out) in enumerate(self._folds):
            scene = self._few
            if kind.response is not None:
                scene = scene.decoded_by(kind.response)
            few, shape = self._pixels(scene, kept, kind.response, number)
            fit = (self._under_lamps if kind.light == "lamps" else self._under_harmonics)(
                kind, few.of_pictures(kept), shape
            )
            fits.append(fit)
            for picture in out:
                shown, lamp = _explained(self._model, fit, few, picture)
                values = few.file_values(few.samples(picture).astype(np.float64))
                error = values - few.file_values(np.maximum(shown, 0.0))
                weights = few.channel_weights(picture)
                if weights is not None:
                    untold = weights[few.valid] == 0
                    error[untold] = values[untold] = np.nan
                squares.append(_mean(error))
                sizes.append(_mean(values))
                if number == 0 and lamp is not None:
                    lamps.append(lamp)
            if self._patches is None:
                self._patches = _patches(few.valid)
        explained = _Explained(
            kind,
            np.array(squares),
            np.array(sizes),
            all(one.is_noise for one in fits),
            None if fits[0].found is None else self._of_all(fits[0].found, lamps),
        )
        self._tried.append(explained)
        return explained

    def _pixels(
        self, scene: Scene, kept: Sequence[int], response: Curve | None, number: int
    ) -> tuple[Scene, FirstShape | None]:
        """The pixels that are compared, of all pictures, and the shape that some tell."""
        if self._scene.normals_known:
            return scene, None
        if (response, number) not in self._shapes:
            self._shapes[response, number] = first_shape(
                scene.of_pictures(kept), places_max=settings.COMPARE_PIXELS
            )
        shape = self._shapes[response, number]
        known = replace(scene, normals=shape.normals, normals_known=True)
        window = strided_window(known.valid, 1, settings.COMPARE_PIXELS)
        few = SceneCutter(known).cut(window)
        return few, replace(
            shape, normals=window.of(shape.normals), albedo=window.of(shape.albedo)
        )

    def _under_harmonics(
        self, kind: Explanation, scene: Scene, shape: FirstShape | None
    ) -> _Fitted:
        options = replace(
            self._options,
            model=self._model,
            priors=replace(self._options.priors, material=kind.material),
            robust=kind.robust,
            refine_normals="off",
            uncertainty=False,
        )
        setup = replace(self._setup, options=options, progress=None)
        objective = setup.objective(scene)
        run = setup.run(scene, objective)
        x = objective.start()
        run.record(x, run.evaluate(x)[0])
        lights = find_lights(run, x)
        x = gauss_newton(run, x, lights)[0] if run.goes_on else lights.x
        materials, _ = run.objective.unpack(x)
        valid = scene.valid
        return _Fitted(
            (materials.albedo[valid], materials.roughness[valid], materials.metallic[valid]),
            np.asarray(scene.normals, np.float64)[valid],
            scene.through(run.camera.fov_degrees).views[valid],
            lights.exact or lights.is_noise,
        )

    def _under_lamps(self, kind: Explanation, scene: Scene, shape: FirstShape | None) -> _Fitted:
        options = replace(self._options, model=self._model, refine_normals="off", uncertainty=False)
        setup = replace(self._setup, options=options, progress=None)
        fit = LampFit(scene, setup, shape, rounds=settings.COMPARE_LAMP_ROUNDS)
        pixels, state, found = fit.of_all_pixels()
        return _Fitted(
            (state.albedo, state.roughness, state.metallic),
            state.normals,
            pixels.views,
            False,
            pixels,
            found,
        )

    def _of_all(self, found: Found, out: Sequence[Lamps]) -> Found | None:
        """With the lamps of left-out pictures beside those of the fitted ones."""
        if found.lamps.near.any():
            return None
        kept, left = self._folds[0]
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
        scene, valid = self._few, self._few.valid
        values = [
            scene.file_values(scene.samples(i).astype(np.float64)) for i in range(len(scene.images))
        ]
        told = [scene.channel_weights(i) for i in range(len(values))]
        for kept, out in self._folds:
            for picture in out:
                counted = np.ones_like(values[picture])
                if told[picture] is not None:
                    counted = (told[picture][valid] > 0).astype(np.float64)
                true = values[picture] * counted
                least = min(
                    float(np.square(true - _factor(values[i] * counted, true)).sum()) for i in kept
                )
                logs.append(math.log(max(least, 1e-300) / max(float(np.square(true).sum()), 1e-300)))
        return math.exp(0.5 * float(np.mean(logs)))


def _explained(
    model: Model, fit: _Fitted, scene: Scene, picture: int
) -> tuple[Array, Lamps | None]:
    """(P, 3): radiance of a left-out picture as a fit explains it, its light alone fitted.

    And that light, if it is a lamp.
    """
    samples = scene.samples(picture).astype(np.float64)
    weights = scene.channel_weights(picture)
    told = np.ones_like(samples) if weights is None else weights[scene.valid].astype(np.float64)
    slope = _slope(scene, samples)
    if fit.pixels is None:
        rows = shade(fit.normals, fit.views, *fit.materials, model=model)
        return _under_best_harmonics(scene, rows, samples, told), None
    pixels = replace(
        fit.pixels,
        samples=samples[:, None] / fit.pixels.scale,
        weights=(told * slope**2)[:, None],
        limits=np.zeros((len(samples), 1, 3), np.uint8),
    )
    state = LampState(
        Lamps(np.zeros(1, np.intp), np.array([[0.0, 0, 1]]), colors=np.ones((1, 3))),
        np.zeros((1, 16, 3)),
        fit.normals,
        *fit.materials,
    )
    found = light_of_picture(pixels, state, None, 1)
    lamp = replace(found.lamps, colors=found.lamps.colors * fit.pixels.scale)
    return radiance(pixels, found)[:, 0] * fit.pixels.scale, lamp


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


def _mean(values: Array) -> Array:
    """(P,): mean square over the channels that tell something; NaN without any."""
    told = np.isfinite(values)
    sums = np.square(np.where(told, values, 0.0)).sum(axis=1)
    count = told.sum(axis=1)
    return np.where(count > 0, sums / np.maximum(count, 1), np.nan)


def _factor(other: Array, true: Array) -> Array:
    """Another picture times the best factor for each channel."""
    below = np.maximum(np.square(other).sum(axis=0), 1e-300)
    return np.asarray(other * ((other * true).sum(axis=0) / below))


def _folds(pictures: int, least: int) -> Iterator[tuple[tuple[int, ...], tuple[int, ...]]]:
    """(Fitted, left out): enough left-out pictures altogether, spread evenly, none of them twice."""
    out = max(1, pictures // settings.COMPARE_SHARE)
    if pictures - out < least:
        return
    count = min(-(-settings.COMPARE_PICTURES_MIN // out), pictures // out)
    step = pictures / (out * count)
    chosen = [int((k + 0.5) * step) for k in range(out * count)]
    for fold in range(count):
        left = tuple(chosen[fold::count])
        yield tuple(i for i in range(pictures) if i not in left), left


def _patches(valid: NDArray[np.bool_]) -> NDArray[np.intp]:
    """(P,): number of the patch that each valid pixel is in."""
    rows, columns = np.nonzero(valid)
    side = max(valid.shape) / settings.COMPARE_PATCHES
    numbers = (rows // side) * settings.COMPARE_PATCHES + columns // side
    return np.asarray(np.unique(numbers, return_inverse=True)[1], np.intp)


def _reduced(scene: Scene) -> Scene:
    """A scene of few pixels: some of those with normals, which stay as exact as they are given.

    Without normals, pictures are averaged down: neighbours tell the shape.
    """
    if scene.normals_known:
        window = strided_window(scene.valid, 1, settings.COMPARE_PIXELS)
        return SceneCutter(scene).cut(window)
    full = scene.height, scene.width
    size = reduced_size(full, settings.COMPARE_SIDE)
    if size == full:
        return scene
    images = np.stack([averaged_channels(image, size) for image in scene.images])
    mask = averaged(scene.valid, size) > 1 - 1e-4
    if not mask.any():
        return scene
    limits: NDArray[np.uint8] = np.zeros(images.shape, np.uint8)
    if scene.limits is not None:
        limits = np.stack([file_limits.averaged(np.array(of), size) for of in scene.limits])
    weights = None
    if scene.weights is not None:
        weights = np.stack([averaged_channels(of, size) for of in scene.weights])
    return replace(
        scene,
        images=images,
        mask=mask,
        limits=limits,
        weights=weights,
        normals=None,
        depth=None,
        segments=None,
        file_noise=None,
        normal_sigma=None,
        truth=None,
        fov=scene.fov if scene.fov_known else None,
    )
