"""Explanations of the same pictures, decided by pictures that were left out."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from pbrfit import Scene, decompose
from pbrfit.fit import compare, settings
from pbrfit.fit.compare import Choice, _Fitted
from pbrfit.fit.left_out import Explanation, LeftOut, LightKind
from pbrfit.io.color import Curve, decode_srgb, encode_srgb
from pbrfit.result.refinement import FROM_PICTURES
from pbrfit.result.verdict import FOV_CONTRADICTED
from pbrfit.synthetic import make_scene
from pbrfit.values.arrays import Array
from planted_lamps import far, planted, setup, without_colors
from scene_files import known

SH = Explanation(None, "sh", 0.0, "none")
LAMPS = replace(SH, light="lamps")
FAST: dict[str, Any] = {"priors": None, "robust": "none", "light": "sh"}
"""Options that leave few explanations."""


def room(size: int = 10, lights: int = 9, noise: float = 0.0, fov: float = 60.0) -> Scene:
    """A room under harmonics, in [0, 1], with pictures enough for one start."""
    made = make_scene("room", size=size, lights=lights, noise=noise, seed=1, held_out=1, fov=fov)
    return Scene(images=made.images / made.images.max(), normals=made.normals, fov=made.fov)


def choose(scene: Scene, **options: Any) -> Choice:
    return compare.choose(scene, setup("paper", **({"light": "auto", "threads": 1} | options)))


def compared(choice: Choice) -> list[str]:
    return [one.what for one in known(choice.held_out).candidates]


def test_harmonics_that_leave_nothing_end_the_comparison() -> None:
    choice = choose(room())
    assert choice.explanation == Explanation(None, "sh", 1.0, "auto")
    assert compared(choice) == [choice.explanation.in_words()]
    assert choice.held_out is not None
    assert choice.held_out.pictures == 2
    assert choice.held_out.error < 1e-6 < choice.held_out.nearest_picture


def coded(scene: Scene, curve: Curve) -> Scene:
    """As 8-bit files of one curve are read where nobody says which it is."""
    values = encode_srgb(scene.images) if curve == "srgb" else scene.images
    images = decode_srgb(np.rint(255 * values) / 255).astype(np.float32)
    return replace(scene, images=images, response="srgb", limits=np.zeros(images.shape, np.uint8))


@pytest.mark.parametrize("curve", ["srgb", "linear"])
def test_the_curve_of_files_is_told_by_left_out_pictures(curve: Curve) -> None:
    choice = choose(coded(room(), curve), **FAST)
    assert choice.explanation.response == curve
    assert len(compared(choice)) == 2


@pytest.mark.slow
@pytest.mark.parametrize("curve", ["srgb", "linear"])
def test_a_fit_goes_on_with_that_curve(curve: Curve) -> None:
    scene = coded(room(size=16), curve)
    found = decompose(scene, uncertainty=False)
    assert known(found.camera).response == curve
    assert ("left out are explained better" in found.assumed.get("color", "")) == (
        curve == "linear"
    )
    asked = decompose(scene, uncertainty=False, response=curve)
    np.testing.assert_array_equal(asked.albedo, found.albedo)


def test_lamps_are_found_where_lamps_light_the_pictures() -> None:
    choice = choose(planted(far(9), size=10, model="paper").scene, priors=None, robust="none")
    assert choice.explanation.light == "lamps"
    assert compared(choice)[0].startswith("a lamp in each picture")
    np.testing.assert_array_equal(known(choice.found).lamps.pictures, np.arange(9))


@pytest.mark.slow
@pytest.mark.parametrize("normals_known", [True, False])
def test_a_fit_goes_on_with_those_lamps(normals_known: bool) -> None:
    truth = planted(far(8), size=32, normals_known=normals_known)
    found = decompose(truth.scene, model="principled", uncertainty=False)
    assert truth.directions_off(known(found.lamps)).max() < (1 if normals_known else 5)


@pytest.mark.slow
@pytest.mark.parametrize(("told", "contradicted"), [(60.0, True), (90.0, False)])
def test_a_wrong_field_of_view_is_contradicted_and_a_right_one_is_not(
    told: float, contradicted: bool, caplog: pytest.LogCaptureFixture
) -> None:
    scene = replace(room(32, noise=0.003, fov=90.0), fov=told)
    found = decompose(scene, refine_normals="off")
    assert found.fov == told
    doubts = {one.cause for one in known(found.uncertainty).verdicts.values()}
    assert (doubts == {FOV_CONTRADICTED}) == contradicted
    assert known(found.camera).contradicted == contradicted
    said = [one for one in caplog.messages if "field of view" in one]
    assert len(said) == contradicted
    if contradicted:
        assert known(found.camera).figures["other_fov_degrees"] == pytest.approx(90.0, abs=3.0)
        assert found.assumed["fov"].startswith("60 degrees, given; the pictures fit far better")
        assert found.assumed["fov"] in said[0]


@pytest.mark.parametrize("light", ["sh", "lamps"])
def test_left_out_pictures_do_not_touch_the_fit_of_the_others(
    light: LightKind, monkeypatch: pytest.MonkeyPatch
) -> None:
    fits: list[_Fitted] = []
    explained = compare._explained

    def watched(model: Any, fit: _Fitted, *others: Any) -> Any:
        fits.append(fit)
        return explained(model, fit, *others)

    monkeypatch.setattr(compare, "_explained", watched)
    scene = planted(far(5), size=10, model="paper").scene
    options = setup("paper", light=light, threads=1)
    comparison = compare._Comparison(scene, options)
    kept, out = comparison._folds[0]
    for changed in (out, kept):
        images = scene.images.copy()
        images[changed[0]] *= np.linspace(0.2, 0.9, images.shape[1])[:, None, None]
        other = compare._Comparison(replace(scene, images=images), options)
        for one in (comparison, other):
            one._try(replace(SH, light=light), 0)
    before, without, again, within = fits
    assert before.found is None or len(before.found.lamps) == len(kept)
    for name, maps in zip("arm", zip(*(one.materials for one in fits), strict=True), strict=True):
        np.testing.assert_array_equal(maps[0], maps[1], err_msg=name)
    np.testing.assert_array_equal(before.materials[0], again.materials[0])
    assert not np.array_equal(before.materials[0], within.materials[0])
    assert without.found is not within.found or light == "sh"


@pytest.mark.parametrize("pictures", range(1, 13))
def test_folds_leave_out_each_picture_at_most_once(pictures: int) -> None:
    folds = list(compare._folds(range(pictures), pictures))
    assert bool(folds) == (pictures > settings.COMPARE_KEPT_MIN)
    left = [picture for _, out in folds for picture in out]
    assert len(set(left)) == len(left)
    assert not folds or len(left) >= settings.COMPARE_PICTURES_MIN
    for kept, out in folds:
        assert sorted(kept + out) == list(range(pictures))
        assert len(kept) >= max(settings.COMPARE_KEPT_MIN, 0.75 * pictures)


def test_pictures_that_say_nothing_are_never_left_out() -> None:
    for usable in ([3], [0, 7], [1, 2, 5]):
        for kept, out in compare._folds(usable, 8):
            assert set(out) <= set(usable)
            assert len(kept) + len(out) == 8
    assert not list(compare._folds([3], 8))  # of which two are left out at once
    assert [out for _, out in compare._folds([3], 4)] == [(3,)]
    scene = room(12, lights=8)
    weights = np.ones((8, 12 * 12), np.float32)
    for silent in range(6):  # but for 31 pixels, of which each shows others
        weights[silent] = 0
        weights[silent, 22 * silent : 22 * silent + 31] = 1
    for pixels, out in ((31, (6, 7)), (32, (0, 7))):
        weights[0, :pixels] = 1
        few = replace(scene, weights=weights.reshape(8, 12, 12))
        assert [out for _, out in compare._Comparison(few, setup())._folds] == [out]


def explained(kind: Explanation, errors: Array, rounding: float = 0.0) -> LeftOut:
    """What errors (M, H, W, 3) make of an explanation of pictures of ones."""
    of_pixels = errors.reshape(len(errors), -1, 3)
    return LeftOut(
        kind,
        48 if kind.light == "sh" else 8,
        of_pixels,
        np.ones_like(of_pixels),
        np.full(len(errors), rounding),
        np.ones(errors.shape[1:3], bool),
    )


def white(sigma: float = 0.1, seed: int = 0, size: int = 20) -> Array:
    return sigma * np.random.default_rng(seed).normal(size=(2, size, size, 3))


@pytest.mark.parametrize(("kind", "numbers"), [(SH, 48), (LAMPS, 8)])
def test_numbers_of_a_light_have_their_price(kind: Explanation, numbers: int) -> None:
    errors = np.full((2, 10, 10, 3), 0.1)
    errors[1] = 0.01
    found = explained(kind, errors)
    assert found.score == pytest.approx(math.log(1e-3) + 2 * numbers / 100)
    assert found.error == pytest.approx(math.sqrt(1e-3))
    folds = LeftOut.together([explained(kind, errors[i : i + 1]) for i in (0, 1)])
    assert folds.score == pytest.approx(found.score)
    found.squares[:, :50] = np.nan  # samples that say nothing
    assert found.score == pytest.approx(folds.score)


def test_a_difference_counts_by_its_standard_errors() -> None:
    """The larger mean square is 1 + g of the other; patches differ by chance."""
    one = explained(SH, white(seed=0))
    other = explained(SH, white(seed=1))
    better, worse = sorted((one, other), key=lambda one: one.score)
    difference = worse.squares / worse.means[:, None] - better.squares / better.means[:, None]
    spread = difference.std() * math.sqrt(1 / difference.size)
    deviations = (worse.score - better.score) / spread
    # That of patches, which are 128, is as that of samples if these are independent.
    assert worse.is_worse(better, 0.6 * deviations)
    assert not worse.is_worse(better, 1.6 * deviations)
    assert not better.is_worse(worse, 0.0)


@pytest.mark.parametrize(("shared", "noise"), [(0.0, True), (0.1, True), (0.35, False)])
@pytest.mark.parametrize("of", ["pixels", "channels"])
def test_what_pixels_or_channels_share_is_no_noise(of: str, shared: float, noise: bool) -> None:
    """Of independent errors neighbours and channels have nothing in common."""
    own, common = white(size=40), white(size=40, seed=1)
    if of == "channels":
        common[:] = common[..., :1]
    else:  # each channel by itself, alike in blocks of pixels
        common = common[:, ::8, ::8].repeat(8, axis=1).repeat(8, axis=2)
    found = explained(SH, math.sqrt(1 - shared) * own + math.sqrt(shared) * common)
    assert found.is_noise == noise
    assert found.share == pytest.approx(shared, abs=0.1)


@pytest.mark.parametrize(("ratio", "noise"), [(0.99, True), (1.01, False)])
def test_rounding_is_noise_of_float32_and_up_to_twice_the_deviation_of_files(
    ratio: float, noise: bool
) -> None:
    shared = np.full((2, 10, 10, 3), ratio)
    rmse = settings.EXACT_RMSE * settings.MEAN_RADIANCE
    assert explained(SH, rmse * shared).is_noise == noise
    assert explained(SH, 2 * shared / 255, rounding=1 / 255**2).is_noise == noise


@pytest.mark.parametrize(("by_linear", "chosen"), [(0.17, "srgb"), (0.1, "linear")])
def test_a_refuted_curve_stays_where_the_other_is_surely_worse(
    by_linear: float, chosen: Curve
) -> None:
    """Lamps and the files' curve are best; environment light refutes that curve."""
    left: dict[tuple[Curve, LightKind], float] = {
        ("srgb", "sh"): 0.2,
        ("linear", "sh"): 0.15,
        ("srgb", "lamps"): 0.1,
        ("linear", "lamps"): by_linear,
    }
    compared = compare._Comparison(replace(room(), response="srgb"), setup())
    for seed, ((response, light), shared) in enumerate(left.items()):
        kind = Explanation(response, light, 0.0, "none")
        compared._tried[kind] = [explained(kind, shared + white(0.15, seed))]
    assert compared._simplest().explanation == Explanation(chosen, "lamps", 0.0, "none")


@pytest.mark.parametrize(("plain", "light"), [(0.094, "sh"), (0.2, "lamps")])
def test_harmonics_are_weighed_where_lamps_are_ahead_by_little(
    plain: float, light: LightKind, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Weights by noise would leave less, but are tried only if equal ones come near."""

    def of_fold(_: Any, kind: Explanation, fold: int) -> LeftOut:
        weighed = kind.robust == "auto" and not kind.material
        shared = 0.1 if kind.light == "lamps" else 0.05 if weighed else plain
        seed = 2 * len(kind.in_words()) + fold  # of its own
        return explained(kind, shared + white(0.15, seed, size=40))

    monkeypatch.setattr(compare._Comparison, "_of_fold", of_fold)
    assert choose(room()).explanation.light == light


def test_nothing_is_compared_where_it_cannot_be_or_all_is_told() -> None:
    scene = room(8, lights=4)
    mask = np.arange(64).reshape(8, 8) < 31
    untold = Scene(images=scene.images[:3], fov=60)
    for of, options, light in (
        (scene.of_pictures([0, 1, 2]), {}, "sh"),
        (replace(scene, mask=mask), {}, "sh"),
        (replace(scene, mask=mask, lamps=without_colors(far(4))), {}, "lamps"),
        (scene, {"iterations": 0}, "sh"),
        (scene, {"solver": "lbfgsb"}, "sh"),
        (untold, {}, "lamps"),
        (untold, {"light": "sh"}, "sh"),
    ):
        choice = choose(of, **options)
        assert choice.held_out is None
        assert choice.explanation.light == light


@pytest.mark.parametrize(
    ("options", "why"),
    [
        ({"mono_light": True}, "not asked for"),
        ({"iterations": 0}, "not compared with environment light"),
        ({}, "environment light explains the pictures"),
    ],
)
def test_a_result_says_why_there_are_no_lamps(options: dict[str, Any], why: str) -> None:
    plain: dict[str, Any] = {"priors": None, "robust": "none", "uncertainty": False}
    found = decompose(room(), **plain, **options)
    assert f"lamps: {why}" in found.left_out


@pytest.mark.parametrize("light", ["sh", "lamps"])
def test_normals_that_nobody_gave_are_said_to_be_of_the_pictures(light: str) -> None:
    untold = Scene(images=room(16).images[:3], fov=60.0)
    found = decompose(untold, light=light, iterations=3, uncertainty=False)
    assert found.refinement.in_words().startswith(FROM_PICTURES)
    assert "as given" not in found.refinement.in_words()
    assert (found.lamps is None) == (light == "sh")
