"""Large pictures: lights from a strided subset of pixels, then tiles that hold what it found."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pytest

import pbrfit
from pbrfit.fit import decompose as decompose_module
from pbrfit.fit import memory, settings
from pbrfit.fit.parameters import ParameterLayout
from pbrfit.fit.run import Progress
from pbrfit.fit.settings import WHOLE_PIXELS_MAX
from pbrfit.fit.tiles import ending, fit_tiles
from pbrfit.fit.windows import strided_window
from pbrfit.result.data import Status
from pbrfit.synthetic import make_scene
from scene_files import known, truth_of

NINE: dict[str, Any] = {"side": 30, "subset": 1296}
"""Of pictures of 72², a subset of every second row and column, and nine tiles."""

ERRORS = ("recon_rmse", "albedo_rmse", "roughness_rmse", "metallic_rmse", "relight_rmse")


@pytest.fixture(scope="module")
def exact() -> pbrfit.Scene:
    return make_scene("furnished", size=72, lights=8, held_out=2, seed=2005)


@pytest.fixture(scope="module")
def noisy() -> pbrfit.Scene:
    return make_scene("furnished", size=72, lights=8, held_out=2, noise=0.01, seed=2005)


def in_tiles(patch: pytest.MonkeyPatch, *, side: int, subset: int) -> None:
    """Every picture is a large one: lights from about `subset` pixels, then tiles of `side`²."""
    patch.setattr(settings, "WHOLE_PIXELS_MAX", 0)
    tiled = partial(fit_tiles, subset_pixels=subset, side=side)
    patch.setattr(decompose_module, "fit_tiles", tiled)


@pytest.fixture
def nine_tiles(monkeypatch: pytest.MonkeyPatch) -> None:
    """Every picture is a large one."""
    in_tiles(monkeypatch, **NINE)


def held(scene: pbrfit.Scene, **options: Any) -> pbrfit.Result:
    return pbrfit.decompose(scene, refine_normals="off", **options)


class TestCutting:
    @pytest.mark.parametrize(
        ("shape", "striped", "wanted"),
        [
            ((1000, 1500), slice(None), (48_000, 60_000)),
            # Rows that a window of every fourth row would all miss, or all hit.
            ((4096, 4096), slice(None, None, 8), (1 << 12, 1 << 17)),
            ((1024, 1024), slice(4, None, 8), (1 << 10, 5 * 2048)),
        ],
        ids=["all", "missed", "hit"],
    )
    def test_a_subset_has_about_as_many_pixels_as_asked_for(
        self, shape: tuple[int, int], striped: slice, wanted: tuple[int, int]
    ) -> None:
        valid = np.zeros(shape, bool)
        valid[striped] = True
        at_least, at_most = wanted
        found = np.count_nonzero(strided_window(valid, at_most).of(valid))
        assert at_least <= found <= 1.25 * at_most


@pytest.mark.usefixtures("nine_tiles")
class TestFit:
    @pytest.mark.usefixtures("uncompared")
    def test_without_noise_tiles_are_exact(self, exact: pbrfit.Scene) -> None:
        result = held(exact)
        assert result.status is Status.CONVERGED
        for error in ERRORS:
            assert result.metrics[error] < 2e-5, error

    @pytest.mark.slow
    def test_borders_of_tiles_do_not_show(self, noisy: pbrfit.Scene) -> None:
        """The same maps to what a few pixels that are tried again can make of them."""
        result = held(noisy, uncertainty=False)
        # One tile has no borders.
        with pytest.MonkeyPatch.context() as patch:
            in_tiles(patch, **NINE | {"side": 200})
            whole = held(noisy, uncertainty=False)
        np.testing.assert_array_equal(result.lighting, whole.lighting)
        difference = np.abs(result.roughness - whole.roughness)
        assert np.mean(difference > 1e-3) < 0.01
        assert np.median(difference) < 1e-5

    @pytest.mark.slow
    def test_it_is_as_good_as_a_fit_of_all_pixels(
        self, noisy: pbrfit.Scene, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        """With lights from all of them."""
        in_tiles(monkeypatch, **NINE | {"subset": 72**2})
        in_nine = held(noisy)
        monkeypatch.setattr(settings, "WHOLE_PIXELS_MAX", 1 << 21)
        whole = held(noisy)
        for error in ERRORS:
            assert in_nine.metrics[error] < 1.1 * whole.metrics[error] + 1e-4, error
        one, other = known(in_nine.uncertainty), known(whole.uncertainty)
        assert one.noise == pytest.approx(other.noise, rel=0.01)
        here, there = (u.deviation.albedo for u in (one, other))
        assert np.median(here) == pytest.approx(np.median(there), rel=0.05)
        np.testing.assert_allclose(one.albedo_scale, other.albedo_scale, rtol=0.1)

    @pytest.mark.slow
    def test_wrong_normals_are_refined_in_tiles_too(
        self, noisy: pbrfit.Scene, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        """The subset has to be dense enough for neighbours to turn alike."""
        in_tiles(monkeypatch, **NINE | {"subset": 72**2})
        rows, columns = np.indices(noisy.valid.shape) / 72
        wrong = noisy.normals + 0.12 * np.stack(
            [np.sin(5 * rows), np.cos(4 * columns), np.zeros_like(rows)], axis=-1
        )
        given = replace(noisy, normals=wrong)
        result = pbrfit.decompose(given, uncertainty=False)
        assert result.refinement.refined
        assert result.given_normals is not None
        before, after = (
            np.median(pbrfit.model.geometry.angles_between(normals, noisy.normals))
            for normals in (given.normals, result.normals)
        )
        assert after < 0.75 * before  # as a fit of all pixels, to a tenth
        assert result.metrics["recon_rmse"] < 0.012

    @pytest.mark.slow
    def test_masks_and_weights_are_kept(self, noisy: pbrfit.Scene) -> None:
        mask = np.ones(noisy.valid.shape, bool)
        mask[:40, :45] = mask[60:, 66:] = False
        weights = np.ones(noisy.images.shape[:3], np.float32)
        weights[:, 50:] = 0.5
        weights[2, :32] = 0  # a tile of which one picture shows nothing
        images = noisy.images.copy()
        images[2, :32] = np.nan
        scene = replace(noisy, images=images, mask=mask, weights=weights)
        result = held(scene)
        assert np.isnan(result.roughness[~mask]).all()
        assert np.isfinite(result.roughness[mask]).all()
        assert np.isfinite(known(result.uncertainty).deviation.roughness[mask]).all()
        assert known(result.uncertainty).noise == pytest.approx(0.01, rel=0.2)

    @pytest.mark.usefixtures("uncompared")
    def test_known_lights_are_held(self, noisy: pbrfit.Scene) -> None:
        scene = replace(noisy, lighting=truth_of(noisy).lighting)
        result = held(scene)
        np.testing.assert_array_equal(result.lighting, truth_of(noisy).lighting)
        assert result.metrics["recon_rmse"] < 0.0105

    @pytest.mark.parametrize(
        ("fault", "message"),
        [
            ("wider", r"albedo: expected shape \(72, 72, 3\), found \(72, 73, 3\)"),
            ("unknown", "roughness: expected finite values at all valid pixels, found NaN"),
        ],
    )
    def test_a_start_is_checked_off_the_subset_too(
        self, noisy: pbrfit.Scene, fault: str, message: str
    ) -> None:
        true = truth_of(noisy).materials
        albedo, roughness, metallic = true.albedo, true.roughness.copy(), true.metallic
        if fault == "wider":
            albedo = np.pad(albedo, ((0, 0), (0, 1), (0, 0)))
        else:
            roughness[0, 0] = np.nan
        start = pbrfit.Materials(albedo, roughness, metallic)
        for given in (start, (start, truth_of(noisy).lighting)):
            with pytest.raises(pbrfit.InputError, match=message):
                held(noisy, start=given)

    @pytest.mark.parametrize(
        ("of_subset", "of_tiles", "status", "reason"),
        [
            ("converged", "c" * 9, "converged", "as the subset"),
            ("converged", "cccicccci", "iteration_limit", "500 iterations done in 2 of 9 tiles"),
            ("iteration_limit", "cccicccci", "iteration_limit", "as the subset"),
            ("converged", "cccicctt", "time_limit", "time limit of 60 s reached: 2 of 8 tiles"),
            ("time_limit", "cccc", "time_limit", "half of the time limit of 60 s was not enough"),
        ],
    )
    def test_why_it_ended(self, of_subset: str, of_tiles: str, status: str, reason: str) -> None:
        names = {"c": Status.CONVERGED, "i": Status.ITERATION_LIMIT, "t": Status.TIME_LIMIT}
        options = pbrfit.FitOptions(time_limit=60.0)
        statuses = [names[letter] for letter in of_tiles]
        found = ending(Status(of_subset), "as the subset", statuses, options)
        assert found[0] is Status(status)
        assert found[1].startswith(reason)

    @pytest.mark.usefixtures("uncompared")
    def test_progress_counts_tiles(self, noisy: pbrfit.Scene) -> None:
        told: list[Progress] = []
        result = held(noisy, progress=told.append, uncertainty=False)
        counted = [one.tiles for one in told if one.tiles is not None]
        assert counted == [(i, 9) for i in range(10)]
        assert [one.tiles for one in told[: -len(counted)]] == [None] * (len(told) - 10)
        assert result.history.iterations == told[-1].iteration
        assert result.stages[-1].name == "all pixels in tiles, lights held"
        materials, _ = told[-1].state()
        np.testing.assert_array_equal(materials.roughness, result.roughness)

    @pytest.mark.usefixtures("uncompared")
    @pytest.mark.parametrize("options", [{"iterations": 0}, {"iterations": 1}, {"time_limit": 0}])
    def test_limits_leave_a_whole_result(
        self, noisy: pbrfit.Scene, options: dict[str, Any]
    ) -> None:
        result = pbrfit.decompose(noisy, **options)
        assert result.status in (Status.ITERATION_LIMIT, Status.TIME_LIMIT)
        assert np.isfinite(result.albedo).all()
        assert np.isfinite(result.lighting).all()
        assert result.uncertainty is not None


class TestWhenTilesAreUsed:
    def layout(self, pixels: int, pictures: int = 3) -> ParameterLayout:
        scene = make_scene("room", size=8, lights=pictures, held_out=1)
        valid = np.broadcast_to(np.True_, (1, pixels))
        return replace(ParameterLayout.of(scene), valid=valid)

    def plan(self, pixels: int, solver: Any = "gauss-newton") -> memory.Plan:
        layout = self.layout(pixels)
        return memory.plan(layout, solver, held=pixels * 48, refine_normals=True, optional=True)

    @pytest.fixture
    def available(self, monkeypatch: pytest.MonkeyPatch) -> list[int | None]:
        free: list[int | None] = [None]
        monkeypatch.setattr(memory, "available", lambda: free[0])
        return free

    @pytest.mark.usefixtures("available")
    def test_above_the_stated_size(self) -> None:
        assert not self.plan(WHOLE_PIXELS_MAX).tiled
        assert self.plan(WHOLE_PIXELS_MAX + 1).tiled
        assert not self.plan(WHOLE_PIXELS_MAX + 1, "lbfgsb").tiled

    def test_where_a_whole_fit_has_no_room(self, available: list[int | None]) -> None:
        whole = self.plan(WHOLE_PIXELS_MAX)
        available[0] = whole.needed.further - 1
        smaller = self.plan(WHOLE_PIXELS_MAX)
        assert smaller.tiled
        assert smaller.refine_normals
        assert smaller.needed.further < whole.needed.further

    def test_which_is_said(
        self,
        noisy: pbrfit.Scene,
        monkeypatch: pytest.MonkeyPatch,
        caplog: pytest.LogCaptureFixture,
    ) -> None:
        real = memory.plan
        monkeypatch.setattr(memory, "plan", lambda *a, **b: replace(real(*a, **b), tiled=True))
        options: dict[str, Any] = {"iterations": 0, "uncertainty": False}
        held(noisy, **options)
        assert [one.message for one in caplog.records] == [
            "fitted in tiles: there is not enough memory for all pixels at once"
        ]
        caplog.clear()
        in_tiles(monkeypatch, **NINE)
        held(noisy, **options)
        assert not caplog.records

    def test_then_without_refined_normals(self, available: list[int | None]) -> None:
        available[0] = self.plan(2 * WHOLE_PIXELS_MAX).needed.further - 1
        without = self.plan(2 * WHOLE_PIXELS_MAX)
        assert without.tiled
        assert not without.refine_normals
        assert "are available" in known(without.hindered)

    def test_eight_megapixels_with_16_pictures_take_less_than_8_gib(self) -> None:
        pixels = 8_000_000
        layout, held = self.layout(pixels, pictures=16), pixels * (16 * 12 + 24)
        needed = memory.of_fit(layout, "gauss-newton", held=held, refine_normals=True, tiled=True)
        assert needed.peak < 8 * 2**30
