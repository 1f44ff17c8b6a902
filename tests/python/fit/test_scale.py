"""The common scale of albedo and lights: its deviation, its reference."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import maximum_filter, uniform_filter

from pbrfit import FitOptions, InputError, Priors, Scene, decompose
from pbrfit.fit import scale, settings
from pbrfit.io.json_files import as_json, read_as
from pbrfit.result.result import Result
from pbrfit.synthetic import make_scene
from scene_files import known, lights_of, truth_of

uncompared = pytest.mark.usefixtures("uncompared")

SEEDS = (301, 303, 305)


def room(seed: int, size: int = 32, noise: float = 0.01, lights: int = 10) -> Scene:
    """A room of three walls and two spheres."""
    return make_scene("room", size=size, lights=lights, seed=seed, noise=noise)


def relative_scale(lighting: np.ndarray, scene: Scene) -> np.ndarray:
    """(3,): ln of the scale of lights over that of the true ones, weighed by irradiance."""
    true, weights = lights_of(scene), scale.IRRADIANCE[:, None] ** 2
    along = (weights * lighting * true).sum(axis=(0, 1))
    return np.asarray(np.log(along / (weights * true**2).sum(axis=(0, 1))))


def reference(scene: Scene) -> tuple[int, int, float]:
    """The brightest dielectric pixel, and the mean true albedo of the 3 × 3 around it."""
    metallic = maximum_filter(truth_of(scene).materials.metallic, 5, mode="constant", cval=1)
    albedo = uniform_filter(truth_of(scene).materials.albedo.mean(axis=-1), 3)
    row, column = np.unravel_index(np.where(metallic == 0, albedo, 0).argmax(), albedo.shape)
    return int(column), int(row), float(albedo[row, column])


def around(result: Result, column: int, row: int) -> np.ndarray:
    """(3,): mean albedo of 3 × 3 pixels."""
    found = result.albedo[row - 1 : row + 2, column - 1 : column + 2]
    return np.asarray(found.mean(axis=(0, 1)))


@pytest.fixture(scope="module")
def noisy() -> list[tuple[Scene, Result]]:
    """Fits of rooms with noise."""
    scenes = (room(seed, 48, lights=16) for seed in SEEDS)
    return [(scene, decompose(scene)) for scene in scenes]


@pytest.mark.slow
def test_lights_have_no_bias_beyond_their_deviation(noisy: list[tuple[Scene, Result]]) -> None:
    errors = np.array([relative_scale(result.lighting, scene) for scene, result in noisy])
    stated = [result.uncertainty.albedo_scale for _, result in noisy if result.uncertainty]
    mean_deviation = np.sqrt(np.square(stated).mean() / len(stated))
    assert abs(errors.mean()) <= 2 * mean_deviation
    assert np.mean(np.abs(errors) <= 2 * np.array(stated)) >= 0.9
    assert np.max(stated) <= 0.2  # and not because it says nothing


@uncompared
def test_lights_are_as_far_off_as_is_said() -> None:
    scene = room(303)
    result = decompose(scene)
    assert result.assumed["scale"].endswith("with the material prior")
    stated = np.array(known(result.uncertainty).albedo_scale)
    assert (np.abs(relative_scale(result.lighting, scene)) <= 3 * stated).all()
    assert stated.max() <= 0.2


@uncompared
def test_known_lights_have_a_scale() -> None:
    scene = room(301)
    result = decompose(replace(scene, lighting=truth_of(scene).lighting))
    assert result.assumed["scale"] == "by the known lights"
    assert known(result.uncertainty).albedo_scale == (0, 0, 0)


@uncompared
@pytest.mark.parametrize("seed", [301, pytest.param(303, marks=pytest.mark.slow)])
def test_without_priors_the_scale_is_within_its_deviation(seed: int) -> None:
    scene = room(seed)
    result = decompose(scene, priors=None)
    assert result.assumed["scale"].endswith("without priors")
    error = relative_scale(result.lighting, scene)
    assert (np.abs(error) <= 2 * np.array(known(result.uncertainty).albedo_scale)).all()


def test_pictures_without_noise_leave_no_doubt() -> None:
    scene = room(302, size=16, noise=0.0)
    result = decompose(scene)
    assert np.abs(relative_scale(result.lighting, scene)).max() <= 1e-4
    assert max(known(result.uncertainty).albedo_scale) <= 1e-3


@uncompared
def test_a_grey_scene_has_one_scale() -> None:
    scene = room(303, size=16)
    grey = replace(scene, images=np.repeat(scene.images[..., :1], 3, axis=-1), truth=None)
    result = decompose(grey)
    assert len(set(known(result.uncertainty).albedo_scale)) == 1


@uncompared
@pytest.mark.parametrize(
    "priors",
    [
        pytest.param(Priors(), marks=pytest.mark.slow, id="priors"),
        pytest.param(Priors.none(), id="none"),
    ],
)
def test_a_white_reference_fixes_the_scale(priors: Priors) -> None:
    scene = room(303)
    column, row, value = reference(scene)
    result = decompose(scene, white=(column, row, value), priors=priors)
    # Every channel has that albedo: what colour the wall has is then the lights'.
    np.testing.assert_allclose(around(result, column, row), value, rtol=1e-3)
    assert "reference" in result.assumed["scale"]
    assert "9 pixels" in result.assumed["scale"]
    deviation = np.array(known(result.uncertainty).albedo_scale)
    assert (deviation >= settings.WHITE_TOLERANCE).all()
    assert (deviation <= 3 * settings.WHITE_TOLERANCE).all()


@pytest.mark.slow
def test_a_wrong_reference_moves_all_albedos_alike(noisy: list[tuple[Scene, Result]]) -> None:
    scene, before = noisy[1]
    column, row, _ = reference(scene)
    value = 0.8 * around(before, column, row).mean()
    after = decompose(scene, white=(column, row, value))
    np.testing.assert_allclose(around(after, column, row), value, rtol=1e-3)
    dielectric = scene.truth is not None and scene.truth.materials.metallic < 0.5
    ratio = np.median((after.albedo / before.albedo)[dielectric], axis=0)
    expected = value / around(before, column, row)
    np.testing.assert_allclose(ratio, expected, rtol=0.1)


@pytest.mark.parametrize(
    "white", [(1.0,), (1, 2, 3, 4), (-1, 0), (0, 0, 0.0), (0, 0, 1.01), (np.nan, 0), "ab", 3]
)
def test_what_is_no_reference_is_refused(white: object) -> None:
    with pytest.raises(InputError, match=r"^white: expected a pixel"):
        FitOptions(white=white)  # type: ignore[arg-type]


def test_bounds_of_a_reference() -> None:
    assert FitOptions(white=(0, 0)).white == (0, 0, 0.9)  # type: ignore[arg-type]
    assert FitOptions(white=(0, 0, 1.0)).white == (0, 0, 1)
    assert read_as(FitOptions, as_json(FitOptions(white=(3, 4, 0.18)))).white == (3, 4, 0.18)


def test_a_reference_is_in_the_picture_and_its_mask() -> None:
    valid = np.ones((4, 8), dtype=bool)
    valid[0, 0] = False
    assert scale.checked_white((7, 3, 0.5), valid, (4, 8)) == (7, 3, 0.5)
    # Of files twice as large.
    assert scale.checked_white((15, 6, 0.5), valid, (8, 16)) == (7, 3, 0.5)
    for x, y in ((8, 0), (0, 4)):
        with pytest.raises(InputError, match=r"^white: expected x below 8 and y below 4"):
            scale.checked_white((x, y, 0.5), valid, (4, 8))
    with pytest.raises(InputError, match=r"^white: expected a pixel inside the mask"):
        scale.checked_white((0, 0, 0.5), valid, (4, 8))


def test_known_lights_need_no_reference() -> None:
    scene = room(301)
    assert scene.truth is not None
    known = replace(scene, lighting=scene.truth.lighting)
    with pytest.raises(InputError, match=r"^white: expected unknown lights"):
        decompose(known, white=(1, 1, 0.5))
