"""Estimates of a network: evidence beside the pictures, where they show these."""

from __future__ import annotations

import logging
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from command_runs import done, refused
from pbrfit import FitOptions, InputError, Priors, Scene, decompose
from pbrfit.fit.estimates import (
    ALBEDO_SIGMA,
    DARKEST,
    fused,
    mismatch,
    used,
)
from pbrfit.fit.windows import Window, cut
from pbrfit.io import images
from pbrfit.model.materials import Materials
from pbrfit.result.uncertainty import Uncertainty
from pbrfit.synthetic import make_scene
from pbrfit_evaluation.arrays import known
from pbrfit_evaluation.estimator_errors import estimated_maps

FAST = FitOptions(light="sh", refine_normals="off", align="off", priors=Priors(material=1.0))


def room(seed: int = 3, noise: float = 0.0, size: int = 40) -> Scene:
    return make_scene("textured", size=size, lights=8, held_out=1, seed=seed, noise=noise)


def with_maps(scene: Scene, seed: int = 3) -> Scene:
    return replace(scene, estimates=estimated_maps(scene, scene.images[0].astype(np.float64), seed))


def errors(scene: Scene, found: Materials) -> dict[str, float]:
    true = known(scene.truth).materials
    return {
        name: float(np.sqrt(np.nanmean((getattr(found, name) - of) ** 2)))
        for name, of in vars(true).items()
    }


def constant(value: float, size: int = 4) -> Materials:
    plane = np.full((size, size), value)
    return Materials(np.stack([plane] * 3, axis=-1), plane, plane)


def uncertain(relative: float, brightness: float, albedo: float, size: int = 4) -> Uncertainty:
    maps = constant(np.hypot(relative, brightness) * (albedo + DARKEST), size)
    return Uncertainty(maps, maps, maps, None, 1.0, (brightness,) * 3, {})


def test_albedo_is_the_mean_by_inverse_variances() -> None:
    own, estimates = constant(0.4), constant(0.4)
    estimates.albedo[0, 0] = 0.6
    estimates.albedo[1, 1] = np.nan
    found, of_it = fused(own, uncertain(0.3, 0.0, 0.4), estimates, grey=False)
    share = 0.3**2 / (0.3**2 + ALBEDO_SIGMA**2)
    off = np.log((0.6 + DARKEST) / (0.4 + DARKEST))
    off -= off / 15  # the brightness that all have in common is known
    wanted = (0.4 + DARKEST) * np.exp(share * off) - DARKEST
    np.testing.assert_allclose(found.albedo[0, 0], wanted, rtol=1e-12)
    np.testing.assert_allclose(found.albedo[1, 1], 0.4, rtol=1e-12)
    assert (of_it.deviation.albedo[2, 2] < uncertain(0.3, 0.0, 0.4).deviation.albedo[2, 2]).all()
    assert (of_it.deviation.albedo[1, 1] > of_it.deviation.albedo[2, 2]).all()


def test_brightness_is_a_measurement_of_its_own() -> None:
    found, of_it = fused(constant(0.2), uncertain(1e-9, 0.45, 0.2), constant(0.4), grey=False)
    assert 0.3 < found.albedo.min() == found.albedo.max() < 0.4
    assert max(of_it.albedo_scale) < 0.2
    certain, _ = fused(constant(0.2), uncertain(1e-9, 0.0, 0.2), constant(0.4), grey=False)
    np.testing.assert_allclose(certain.albedo, 0.2, rtol=1e-12)


def test_differences_larger_than_both_errors_widen_the_deviation() -> None:
    wild = constant(0.4)
    wild.albedo[::2] = 0.02
    agreeing = fused(constant(0.4), uncertain(0.3, 0.0, 0.4), constant(0.4), grey=False)[1]
    found, of_it = fused(constant(0.4), uncertain(0.3, 0.0, 0.4), wild, grey=False)
    relative = of_it.deviation.albedo / (found.albedo + DARKEST)
    assert (relative > 2 * agreeing.deviation.albedo / (0.4 + DARKEST)).all()


def test_grey_pictures_take_no_colour_from_a_network() -> None:
    coloured = constant(0.4)
    coloured.albedo[:2] = 0.1, 0.3, 0.8
    found = fused(constant(0.4), uncertain(0.3, 0.2, 0.4), coloured, grey=True)[0]
    np.testing.assert_array_equal(found.albedo[..., 0], found.albedo[..., 2])


def test_pictures_that_tell_all_are_believed() -> None:
    scene = with_maps(room())
    found = decompose(scene, FAST)
    assert max(errors(scene, found.materials).values()) < 1e-4
    assert max(errors(scene, known(scene.estimates)).values()) > 0.08


def test_noisy_pictures_and_estimates_tell_more_than_either() -> None:
    scene = room(noise=0.03)
    without = errors(scene, decompose(scene, FAST).materials)
    found = errors(scene, decompose(with_maps(scene), FAST).materials)
    assert found["albedo"] < 0.9 * without["albedo"]
    assert found["roughness"] < 1.05 * without["roughness"]
    assert found["metallic"] < 0.1 < errors(scene, known(with_maps(scene).estimates))["metallic"]


def test_maps_of_another_view_are_not_used(caplog: pytest.LogCaptureFixture) -> None:
    wrong = replace(room(), estimates=known(with_maps(room(seed=8), 8).estimates))
    with caplog.at_level(logging.WARNING, "pbrfit"):
        scene, options = used(wrong, FitOptions())
    assert "estimates: not used: their edges and those of the pictures" in caplog.text
    assert scene.estimates is None
    assert scene.assumed["estimates"].startswith("not used")
    assert options == FitOptions()
    scene, options = used(with_maps(room()), FitOptions(uncertainty=False))
    assert scene.estimates is not None
    assert options.uncertainty
    assert options.priors.material == 1
    alone = replace(known(scene.estimates), albedo=np.full((40, 40, 3), np.nan))
    assert "no albedo among them" in mismatch(replace(scene, estimates=alone))


@pytest.mark.parametrize("seed", [3, 4])
def test_maps_of_other_views_do_not_fit(seed: int) -> None:
    scene = with_maps(room(seed), seed)
    assert not mismatch(scene)
    maps = vars(known(scene.estimates))
    mirrored = Materials(*(plane[:, ::-1] for plane in maps.values()))
    moved = Materials(*(np.roll(plane, 13, axis=0) for plane in maps.values()))
    even = Materials(*(np.full_like(plane, 0.5) for plane in maps.values()))
    for other in (mirrored, moved, even):
        assert "of another view" in mismatch(replace(scene, estimates=other))
    for other_seed in {3, 4, 5} - {seed}:
        other = known(with_maps(room(other_seed), other_seed).estimates)
        assert "of another view" in mismatch(replace(scene, estimates=other))


def test_a_scene_keeps_its_estimates(tmp_path: Path) -> None:
    scene = with_maps(room())
    scene.save(tmp_path / "scene")
    read = Scene.load(tmp_path / "scene")
    assert "estimates.exr" in read.inputs
    assert "albedo, metallic, roughness from estimates.exr" in read.assumed["estimates"]
    for name, plane in vars(known(scene.estimates)).items():
        np.testing.assert_array_equal(getattr(known(read.estimates), name), plane)
    assert known(Scene.load(tmp_path / "scene", max_size=20).estimates).albedo.shape[0] == 20
    cropped = Scene.load(tmp_path / "scene", crop=(8, 4, 16, 12))
    np.testing.assert_array_equal(
        known(cropped.estimates).roughness, known(scene.estimates).roughness[4:16, 8:24]
    )
    part = cut(scene, Window(slice(3, 9), slice(2, 7)))
    np.testing.assert_array_equal(
        known(part.estimates).metallic, known(scene.estimates).metallic[3:9, 2:7]
    )


def test_estimates_that_are_none_are_refused() -> None:
    scene = room()
    good = constant(0.4, 40)
    for name, value, found in (
        ("roughness", np.full((40, 40), 1.5), "roughness between 0 and 1, found 1.5 to 1.5"),
        ("albedo", np.full((40, 40), 0.5), r"albedo: expected shape \(40, 40, 3\)"),
        ("metallic", np.full((20, 40), 0.5), r"metallic: expected shape \(40, 40\)"),
    ):
        with pytest.raises(InputError, match=found):
            replace(scene, estimates=replace(good, **{name: value}))
    with pytest.raises(InputError, match="expected known values of some map, found none"):
        replace(scene, estimates=constant(np.nan, 40))


def test_maps_by_their_names(tmp_path: Path) -> None:
    room().save(tmp_path / "scene")
    maps = tmp_path / "maps"
    maps.mkdir()
    large = np.full((80, 80), 51, np.uint8)
    images.write_png(maps / "Wall_BaseColor.png", np.stack([large] * 3, axis=-1), tag="srgb")
    images.write_png(maps / "wall_rough.png", large, tag=None)
    command = ("maps", tmp_path / "scene", "--overwrite", "--from")
    said = done("maps", tmp_path / "scene", "--from", *sorted(maps.iterdir()))
    assert "albedo 0.03, roughness 0.20 in the mean" in said
    found = known(Scene.load(tmp_path / "scene").estimates)
    np.testing.assert_allclose(found.roughness, 0.2, atol=1e-6)
    np.testing.assert_allclose(found.albedo, 0.0331, atol=1e-4)
    assert np.isnan(found.metallic).all()
    true = tmp_path / "scene" / "truth" / "materials.exr"  # a result's would do, too
    done(*command, true, "--quiet")
    np.testing.assert_allclose(
        known(Scene.load(tmp_path / "scene").estimates).roughness[20],
        known(room().truth).materials.roughness[20],
        atol=1e-6,
    )
    again = refused("maps", tmp_path / "scene", "--from", maps / "wall_rough.png")
    assert "expected no estimates yet, found some" in again
    images.write_png(maps / "other.png", large, tag=None)
    assert "in each file's name, found none" in refused(*command, maps / "other.png")
    images.write_png(maps / "metal.png", large[:30], tag=None)
    said = refused(*command, maps / "metal.png")
    assert "expected the pictures' size, 40 × 40 pixels" in said
    assert "expected marigold-iid or files" in refused(*command, "marigold")
    said = refused(*command, maps / "wall_rough.png", "--seed", 1)
    assert "--seed: has no meaning with --from" in said
