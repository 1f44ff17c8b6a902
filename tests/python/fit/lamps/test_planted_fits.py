"""Whole fits under lamps: planted scenes that obey the model are found."""

from __future__ import annotations

import functools
from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import binary_dilation, binary_erosion

from pbrfit import InputError, decompose
from pbrfit.fit.lamps.estimator import LOOK_LAST, LampFit
from pbrfit.fit.lamps.shape import first_shape, height_of
from pbrfit.fit.whole_picture import FitOutput
from pbrfit.model.lamps import Lamps
from pbrfit.result.verdict import MARGIN
from planted_lamps import (
    Planted,
    best_factor,
    colors,
    dome,
    far,
    planted,
    relief,
    setup,
    without_colors,
)

LAMPS = far(8)


@functools.cache
def dielectrics() -> tuple[Planted, FitOutput]:
    """Known normals, eight far lamps of which nothing is known, two roughnesses."""
    truth = planted(LAMPS)
    return truth, LampFit(truth.scene, setup()).solve()


def lamps_of(found: FitOutput) -> Lamps:
    assert found.lamps is not None
    return found.lamps


@pytest.mark.slow
def test_unknown_far_lamps_and_materials_are_found_by_known_normals() -> None:
    truth, found = dielectrics()
    lamps = lamps_of(found)
    assert not lamps.near.any()
    assert truth.directions_off(lamps).max() < 0.5
    assert truth.albedo_off(found.materials.albedo) < 0.02
    # The scale between lamps and albedo is told by highlights alone.
    assert 0.8 < best_factor(found, truth) < 1.25
    ratio = lamps.colors / LAMPS.colors
    np.testing.assert_allclose(ratio, np.broadcast_to(ratio.mean(axis=0), (8, 3)), rtol=0.02)
    valid = truth.scene.valid
    off = np.abs(found.materials.roughness[valid] - truth.of_valid("roughness"))
    # A label's pixels stay near the roughness of the looks' grid, half an octave wide.
    assert np.median(off) < 0.06
    assert (found.materials.metallic[valid] == 0).all()
    np.testing.assert_array_equal(found.normals[valid], truth.scene.normals[valid])
    assert found.normal_sigma is None


@pytest.mark.slow
def test_a_fit_has_the_same_bits_with_one_thread_and_with_two() -> None:
    truth, found = planted(LAMPS, size=24), []
    for threads in (1, 2):
        one = LampFit(truth.scene, setup(threads=threads)).solve()
        assert one.uncertainty is not None
        maps, lamps = one.materials, lamps_of(one)
        numbers = maps.albedo, maps.roughness, one.lighting, lamps.places, lamps.colors
        found.append((*numbers, one.uncertainty.deviation.albedo))
    for a, b in zip(*found, strict=True):
        np.testing.assert_array_equal(a, b)


@pytest.mark.slow
def test_known_lamps_tell_normals() -> None:
    truth = planted(LAMPS, known=without_colors(LAMPS), normals_known=False, size=32)
    found = LampFit(truth.scene, setup(), first_shape(truth.scene)).solve()
    assert truth.normals_off(found.normals).mean() < 1
    assert truth.albedo_off(found.materials.albedo) < 0.02
    np.testing.assert_allclose(lamps_of(found).places, LAMPS.places, atol=1e-9)
    valid = truth.scene.valid
    assert found.normal_sigma is not None
    assert ((found.normal_sigma[valid] > 0) & (found.normal_sigma[valid] <= 90)).all()
    assert np.isnan(found.normal_sigma[~valid]).all()
    # A dome is highest in its middle, by the radius less what the edge has: in pixels.
    radius = 0.46 * 32
    height = height_of(found.normals, truth.scene)
    rise = height[16, 16] - np.nanmin(height)
    assert abs(rise - radius * (1 - np.sqrt(0.2))) < 0.1 * radius


def test_an_assumed_field_of_view_tells_no_shape() -> None:
    scene = planted(LAMPS, normals_known=False, size=24).scene
    shapes = [first_shape(replace(scene, fov=fov, fov_known=False)) for fov in (20.0, 60.0)]
    np.testing.assert_array_equal(shapes[0].normals, shapes[1].normals)


def test_highlights_tell_how_deep_a_surface_is() -> None:
    """This one ends where its normals are no ball's, so that its outline tells another depth."""
    truth = planted(far(12), normals_known=False, size=32)
    start = first_shape(truth.scene)
    few = LampFit(truth.scene, setup(), start, rounds=LOOK_LAST).settled
    found = LampFit(truth.scene, setup(), start).solve()
    off = [truth.normals_off(one.normals).mean() for one in (start, few, found)]
    assert off[1] < 0.8 * off[0]
    assert off[2] < 0.2  # degrees: pictures that obey the model tell shape and lamps exactly
    assert truth.directions_off(lamps_of(found)).max() < 0.2
    assert truth.albedo_off(found.materials.albedo) < 0.005


def test_the_time_of_the_height_is_told() -> None:
    result = decompose(planted(LAMPS, known=LAMPS, normals_known=False, size=16).scene)
    assert result.stages[-1].name == "height"
    assert 0 < sum(stage.seconds for stage in result.stages) <= result.seconds


def test_told_strengths_are_relative() -> None:
    brighter = replace(LAMPS, colors=3 * LAMPS.colors)
    one, other = (
        LampFit(planted(LAMPS, known=known, size=16).scene, setup()).solve()
        for known in (LAMPS, brighter)
    )
    np.testing.assert_allclose(one.materials.albedo, other.materials.albedo, rtol=1e-6)


@pytest.mark.slow
def test_near_lamps_are_found_by_known_normals_and_depth() -> None:
    places = np.array(
        [
            *([-0.7, 0.5, -0.4], [0.6, 0.6, -0.5], [0.8, -0.3, -0.3], [-0.5, -0.6, -0.4]),
            *([0.1, 0.8, -0.2], [0.2, -0.7, -0.6], [-0.9, 0.1, -0.5], [0.5, 0.1, -0.2]),
        ]
    )
    lamps = Lamps(np.arange(8), places, near=np.ones(8, bool), colors=2.5 * colors(8))
    truth = planted(lamps, shape=relief(32, 50.0), fov=50.0, with_depth=True)
    found = LampFit(truth.scene, setup(transport="none")).solve()
    assert lamps_of(found).near.all()
    off = np.linalg.norm(lamps_of(found).places - places, axis=1)
    assert (off < 0.03 * np.linalg.norm(places - [0, 0, -2], axis=1)).all()
    assert truth.albedo_off(found.materials.albedo) < 0.02


@pytest.mark.slow
def test_metals_are_found_by_segments() -> None:
    truth = planted(LAMPS, metal=True, known=without_colors(LAMPS))
    found = LampFit(truth.scene, setup()).solve()
    metallic, of = found.materials.metallic[truth.scene.valid], truth.of_valid("metallic")
    assert metallic[of == 1].mean() > 0.95
    assert metallic[of == 0].mean() < 0.05


@pytest.mark.slow
def test_cast_shadows_have_little_weight() -> None:
    shadow = np.zeros((8, 32, 32), bool)
    shadow[1, 8:16, 6:14] = True
    shadow[5, 16:24, 16:26] = True
    truth = planted(LAMPS, size=32, shadow=shadow)
    fit = LampFit(truth.scene, setup())
    joint = fit.joint(np.flatnonzero(truth.scene.valid.ravel()))
    dark = shadow[:, truth.scene.valid].T
    lit = joint.pixels.samples.mean(axis=-1) > 0.05
    weights = joint.weights.mean(axis=-1)
    cosines = joint.pixels.normals @ LAMPS.places.T
    hidden = dark & (cosines > 0.3)
    assert hidden.sum() > 50
    assert np.median(weights[hidden]) < 0.05 * np.median(weights[lit])
    assert truth.directions_off(joint.state.lamps).max() < 1
    found = fit._output(joint, *fit._bands(joint))
    # Where shadows end some pixels are taken for lit, and wrong; all others are right.
    border = np.any([binary_dilation(one) & ~binary_erosion(one) for one in shadow], axis=0)
    inside = truth.scene.valid & ~border
    a, b = found.materials.albedo[inside], truth.albedo[inside]
    left = a * (a * b).sum(axis=0) / (a * a).sum(axis=0) - b
    assert np.sqrt(np.mean(left**2)) < 0.02


@pytest.mark.slow
def test_clipped_highlights_tell_no_less_than_others() -> None:
    """As bounds; taken as data they would be wrong."""
    whole = planted(LAMPS, size=32)
    ceiling = float(np.quantile(whole.scene.images[:, whole.scene.valid], 0.97))
    truth = planted(LAMPS, size=32, ceiling=ceiling)
    assert truth.scene.limits is not None
    found = LampFit(truth.scene, setup()).solve()
    assert truth.directions_off(lamps_of(found)).max() < 0.5
    assert truth.albedo_off(found.materials.albedo) < 0.02


def test_the_scale_is_as_uncertain_as_it_is_off() -> None:
    """By another reflection model, whose highlights tell other lamps."""
    off, expected = [], []
    for lamps in (far(10, slant=36), far(8, slant=30)):
        truth = planted(lamps, size=24, shape=dome(24), metal=True)
        found = LampFit(truth.scene, setup(model="paper")).solve()
        off.append(np.mean((found.materials.albedo - truth.albedo)[truth.scene.valid] ** 2))
        assert found.uncertainty is not None
        expected.append(found.uncertainty.verdicts["albedo"].expected_error ** 2)
    assert 0.05**2 < np.mean(off) < MARGIN**2 * np.mean(expected)


@pytest.mark.slow
def test_a_grey_card_fixes_the_scale() -> None:
    card = (10, 20, 0.18)
    truth = planted(LAMPS, size=32, card=card)
    found = LampFit(truth.scene, setup(white=tuple(map(float, card)))).solve()
    of_card = found.materials.albedo[19:22, 9:12].mean(axis=(0, 1))
    np.testing.assert_allclose(of_card, 0.18, rtol=1e-3)
    assert abs(best_factor(found, truth) - 1) < 0.03
    np.testing.assert_allclose(lamps_of(found).colors, LAMPS.colors, rtol=0.05)
    assert found.scale.startswith("by the reference at x 10, y 20: 9 pixels of albedo 0.18; lights")
    assert found.uncertainty is not None
    scale = np.array(found.uncertainty.albedo_scale)
    assert ((scale >= 0.02) & (scale < 0.03)).all()
    deviation = found.uncertainty.deviation.albedo[truth.scene.valid]
    # No albedo is surer than the reference.
    assert (deviation / truth.of_valid("albedo")).min() > 0.02


def test_white_is_refused_outside_the_mask() -> None:
    truth = planted(LAMPS, size=24)
    with pytest.raises(InputError, match=r"^white: expected a pixel inside the mask, found 0, 0"):
        decompose(truth.scene, light="lamps", white=(0, 0, 0.5))
    with pytest.raises(InputError, match=r"^white: .* below 24 and y below 24, found 30, 0"):
        decompose(truth.scene, light="lamps", white=(30, 0))


def test_known_near_lamps_need_depth() -> None:
    near = Lamps(np.arange(8), LAMPS.places, near=np.ones(8, bool))
    scene = replace(planted(LAMPS, size=16).scene, lamps=near)
    for ask in (lambda: LampFit(scene, setup()).solve(), lambda: decompose(scene)):
        with pytest.raises(InputError, match=r"^lamps: expected depth for near lamps, found none$"):
            ask()


def test_lamps_from_one_side_leave_something_open() -> None:
    """Pictures tell what they do not tell, by words in the start, a warning and the note."""
    angle = np.radians(np.linspace(10, 60, 6))
    places = np.stack([np.sin(angle), 0 * angle, np.cos(angle)], axis=1)
    lamps = Lamps(np.arange(6), places, colors=colors(6))
    for known in (None, without_colors(lamps)):
        truth = planted(lamps, size=32, normals_known=False, known=known)
        start = first_shape(truth.scene)
        assert start.undetermined
        assert start.undetermined[0] in start.note
