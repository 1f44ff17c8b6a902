"""Pictures of very different exposures count alike, and those that are not stay as they are."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import pbrfit
from pbrfit.fit.objective import Objective
from pbrfit.fit.settings import MEAN_RADIANCE
from pbrfit.scene.exposure import EXPOSURE_RANGE, mean_radiance, relative_exposures
from pbrfit.synthetic import make_scene
from scene_files import known, lights_of, truth_of

pytestmark = pytest.mark.usefixtures("uncompared")

SIZE, N = 12, 5


def made(**options: Any) -> pbrfit.Scene:
    return make_scene("room", size=SIZE, lights=N, seed=4, **options)


def with_means(scene: pbrfit.Scene, means: NDArray[Any]) -> pbrfit.Scene:
    """The scene with pictures of these mean radiances, up to rounding."""
    factors = means / mean_radiance(scene)
    images = scene.images.astype(np.float64) * factors[:, None, None, None]
    return dataclasses.replace(scene, images=images, truth=None)


def brighter(scene: pbrfit.Scene, picture: int, factor: float) -> pbrfit.Scene:
    """The scene with one picture, and its true light, so many times as bright."""
    images, lighting = np.array(scene.images), lights_of(scene).copy()
    images[picture] *= factor
    lighting[picture] *= factor
    truth = dataclasses.replace(truth_of(scene), lighting=lighting)
    return dataclasses.replace(scene, images=images, truth=truth)


def test_exposures_are_evened_out_beyond_the_range() -> None:
    scene = made()
    below, above = (np.array([1, 2, 3, 2, EXPOSURE_RANGE * f]) for f in (0.999, 1.001))
    assert relative_exposures(with_means(scene, below)) is None
    found = relative_exposures(with_means(scene, above))
    assert found == pytest.approx(above / above.mean(), rel=1e-12)
    asked = relative_exposures(with_means(scene, below), equal=True)
    assert asked == pytest.approx(below / below.mean(), rel=1e-12)
    assert relative_exposures(with_means(scene, above), equal=False) is None


def test_the_loss_is_that_of_inverse_square_weights() -> None:
    scene = brighter(made(noise=0.02), 2, 16.0)
    objective = Objective(scene, threads=1)
    exposures = known(objective.exposures)
    maps, lighting = truth_of(scene).materials, lights_of(scene)
    x = objective.pack(maps.albedo, maps.roughness, maps.metallic, lighting)
    np.testing.assert_allclose(objective.unpack(x)[1], lighting, rtol=1e-12)
    loss, _ = objective.value_and_grad(x)
    residuals = pbrfit.kernel.render(maps, scene.normals, lighting, scene.fov) - scene.images
    weighted = np.mean(np.square(residuals) / exposures[:, None, None, None] ** 2)
    assert objective.residual_rmse(loss) == pytest.approx(np.sqrt(weighted), rel=1e-5)
    means = mean_radiance(scene) / (objective.scale * exposures)
    np.testing.assert_allclose(means, MEAN_RADIANCE, rtol=1e-6)


ONE_WAY: dict[str, Any] = {"priors": None, "robust": "none", "light": "sh"}


def difference(a: NDArray[Any], b: NDArray[Any]) -> float:
    return float(np.sqrt(np.mean(np.square(a - b))))


def test_one_bright_picture_hardly_changes_the_materials() -> None:
    scene = make_scene("spheres", size=16, lights=6, seed=2003, held_out=1)
    exposed = brighter(scene, 2, 16.0)
    plain, fitted, as_is = (
        pbrfit.decompose(
            s,
            solver="lbfgsb",
            iterations=150,
            equal_exposures=equal,
            priors=None,
            refine_normals="off",
        )
        for s, equal in ((scene, True), (exposed, None), (exposed, False))
    )
    # The pictures are the same but for rounding once they are divided.
    for name in ("albedo", "roughness", "metallic"):
        off = difference(getattr(fitted, name), getattr(plain, name))
        assert off < 0.02, name
        assert off < 0.3 * difference(getattr(as_is, name), getattr(plain, name)), name
    light = fitted.lighting[2] / 16
    assert np.linalg.norm(light - plain.lighting[2]) < 0.02 * np.linalg.norm(plain.lighting[2])
    assert fitted.assumed["exposures"].startswith("from 0.2")
    assert "exposures" not in as_is.assumed
    assert fitted.options.equal_exposures is None
    assert as_is.options.equal_exposures is False


def test_one_bright_picture_does_not_change_an_exact_fit() -> None:
    """With noise that grows with the picture all divided pictures are the same."""
    scene = make_scene("spheres", size=16, lights=8, seed=2003, held_out=1, noise=0.001)
    exposed = brighter(scene, 2, 16.0)
    plain, fitted = (
        pbrfit.decompose(s, equal_exposures=equal, refine_normals="off", **ONE_WAY)
        for s, equal in ((scene, True), (exposed, None))
    )
    for name in ("albedo", "roughness", "metallic"):
        assert difference(getattr(fitted, name), getattr(plain, name)) < 1e-3, name
    np.testing.assert_allclose(fitted.lighting[2] / 16, plain.lighting[2], rtol=0, atol=1e-2)


def test_errors_of_the_reconstruction_are_weighted_like_the_loss() -> None:
    scene = brighter(made(noise=0.01), 2, 16.0)
    result = pbrfit.decompose(scene, iterations=5, **ONE_WAY)
    found = result.metrics["recon_rmse"]
    assert found == pytest.approx(result.history["recon_rmse"][-1], rel=1e-3)


def test_exposures_within_the_range_change_no_bit(tmp_path: Path) -> None:
    scene = brighter(made(), 2, 0.5)
    by_rule, as_is = (
        pbrfit.decompose(scene, iterations=5, equal_exposures=equal, **ONE_WAY)
        for equal in (None, False)
    )
    np.testing.assert_array_equal(by_rule.albedo, as_is.albedo)
    np.testing.assert_array_equal(by_rule.lighting, as_is.lighting)
    assert by_rule.metrics == as_is.metrics
    assert "exposures" not in by_rule.assumed
    as_is.save(tmp_path / "out")
    loaded = pbrfit.Result.load(tmp_path / "out")
    assert loaded.options.equal_exposures is False
    assert loaded.assumed == as_is.assumed
