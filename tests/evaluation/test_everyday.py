"""`pbrfit evaluate everyday`: disturbances are what they say, verdicts can fail, files are written.

How well disturbed scenes are fitted is not tested here: verdicts are on figures made by hand.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from evaluation_tasks import recorded
from pbrfit.fit.decompose import decompose
from pbrfit.io.color import encode_srgb
from pbrfit.model.reflection import render
from pbrfit.scene.arrays import CHANNELS
from pbrfit.scene.scene import Scene
from pbrfit_evaluation.everyday import figures, measure
from pbrfit_evaluation.everyday.figures import MOST
from pbrfit_evaluation.everyday.measure import BAD_PICTURE, DISTURBANCES, disturbed
from pbrfit_evaluation.grid import NOISE, PICTURES, Case
from scene_files import known, truth_of

SIZE, SEED = 16, 7


def made(disturbance: str, size: int = SIZE) -> Scene:
    return disturbed(disturbance, "room", SEED, size)


@pytest.fixture(scope="module")
def noise() -> Scene:
    return made("noise")


@pytest.fixture(scope="module")
def clean() -> Scene:
    return made("clean")


def others() -> list[int]:
    return [i for i in range(PICTURES) if i != BAD_PICTURE]


def test_the_reference_has_noise_and_the_clean_scene_none_but_rounding(
    noise: Scene, clean: Scene
) -> None:
    truth = truth_of(clean)
    lit = render(truth.materials, clean.normals, known(truth.lighting), 60, model="paper")
    np.testing.assert_allclose(clean.images, lit, rtol=6e-8)
    assert noise.images.dtype == np.float32
    assert (noise.images - lit).std() == pytest.approx(NOISE, rel=0.03)


@pytest.mark.parametrize("disturbance", ["hot", "clipped", "brightest", "shifted", "another"])
def test_what_is_not_disturbed_is_the_reference(disturbance: Any, noise: Scene) -> None:
    found, before = made(disturbance).images, noise.images
    changed = found != before
    if disturbance in ("shifted", "another"):
        assert not changed[others()].any()
        assert changed[BAD_PICTURE].mean() > 0.9
    elif disturbance == "hot":
        assert changed.mean() == pytest.approx(measure.HOT_SHARE, rel=0.5)
        most = measure.HOT_RANGE * noise.images.mean()
        assert 0.5 * most < found[changed].max() <= most
    else:
        limit = found.max()
        np.testing.assert_array_equal(found, np.minimum(before, limit))
        if disturbance == "clipped":
            assert limit == np.float32(measure.CLIPPED_AT)
        else:
            assert changed.mean() == pytest.approx(0.002, rel=0.1)


def test_files_of_8_bits_clip_the_brightest_half_percent(noise: Scene) -> None:
    png = made("png")
    assert png.source is not None
    sound = (known(png.limits) == 0).all(axis=-1)
    assert 0 < np.mean(~sound) < 3 * 0.005 + 0.02  # of pixels with a clipped or without a code
    white = np.quantile(noise.images, measure.UNCLIPPED)
    written = 255 * encode_srgb(noise.images[sound] / white)
    codes = 255 * encode_srgb(png.images[sound])
    np.testing.assert_allclose(codes, np.round(codes), atol=1e-3)
    assert np.abs(codes - written.clip(0, 255)).max() <= 0.51


def test_the_scale_is_that_of_albedo(clean: Scene) -> None:
    true = truth_of(clean).materials.albedo[clean.valid]
    found = measure.scale_errors(true * [1.1, 1.0, 0.8], true, [0.05, 0.0, 0.1])
    errors, deviations = zip(*(one.values() for one in found.values()), strict=True)
    np.testing.assert_allclose(errors, np.abs(np.log([1.1, 1, 0.8])), atol=1e-9)
    assert deviations == (0.05, 0.0, 0.1)
    assert measure.covered(found) == [True, True, False]


def found(error: float, seconds: float = 1.0, **more: Any) -> dict[str, Any]:
    """What a fit found with the same error in all maps."""
    scale = {name: {"error": 0.01, "deviation": 0.01} for name in CHANNELS}
    fov = {"degrees": 60.0, "error": 0.0, "said": None, "contradicted": False}
    return {
        "scores": dict.fromkeys(figures.ERRORS, error) | {"processor": seconds},
        "refined": False,
        "scale": more.get("scale", scale),
        "fov": fov | more.get("fov", {}),
    }


def test_each_demand_can_fail() -> None:
    """Errors and seconds by the twin; the field of view; scales, of which two of three hold."""

    def judged(name: str, of: dict[str, Any]) -> set[str]:
        pairs = {DISTURBANCES[name].twin: found(0.1, 2.0), "noise": found(0.1), name: of}
        cases = [(Case(at, "default", 1, 16, "room"), values) for at, values in pairs.items()]
        results = recorded(*cases, conditions=pairs)
        verdicts = figures.verdicts(results, figures.rows(results))
        return {one.what.partition(": ")[2] for one in verdicts if not one.holds}

    worst = found(0.1 * MOST["jpeg-75-420"] * 0.999, 2.99)
    assert judged("jpeg-75-420", worst) == set()
    worst["scores"] |= {"roughness": 0.1 * MOST["jpeg-75-420"] * 1.001, "processor": 3.01}
    beside = f"over {DISTURBANCES[DISTURBANCES['jpeg-75-420'].twin].title}"
    assert judged("jpeg-75-420", worst) == {
        f"error of the worst map {beside}", f"processor seconds {beside}",
    }  # fmt: skip
    off = "largest error in degrees"
    for error, expected in ((1.99, set()), (2.01, {off})):
        assert judged("fov-unknown", found(0.1, fov={"error": error})) == expected
    said = "share of scenes in which the fit contradicts it"
    for contradicted in (True, False):
        of = found(0.1, fov={"contradicted": contradicted})
        assert (said in judged("fov-wrong", of)) != contradicted
        assert (said in judged("fov-true", of)) == contradicted
    scale = {name: {"error": 0.021, "deviation": 0.01} for name in CHANNELS}
    of = found(0.1, scale=scale | {"red": {"error": 0.019, "deviation": 0.01}})
    assert judged("hot", of) == {"share of scales within two of their deviations"}


@pytest.mark.parametrize(("error", "covered"), [(0.99e-6, True), (1.01e-6, False)])
def test_rounding_is_no_error_of_the_scale(error: float, covered: bool) -> None:
    assert measure.covered({"red": {"error": error, "deviation": 1e-8}}) == [covered]


@pytest.mark.parametrize(
    "seed", [7300, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (7303, 7311))]
)
def test_what_jpeg_lost_refutes_no_curve(seed: int) -> None:
    """Both curves leave no more than files did, of which linear values leave less."""
    scene = disturbed("jpeg-90-444", "furnished", seed, 32)
    plain: dict[str, Any] = {"refine_normals": "off", "align": "off", "priors": None}
    found = decompose(scene, uncertainty=False, light="sh", **plain)
    assert "sRGB values" in known(found.held_out).chosen
