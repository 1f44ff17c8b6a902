"""`pbrfit evaluate uncertainty`: scenes are what they say, bars can fail on both sides, files.

How well posteriors are calibrated is not tested here: figures are of records made by hand.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from evaluation_tasks import recorded
from pbrfit.io.color import encode_srgb
from pbrfit.model.geometry import angles_between, positions
from pbrfit.model.materials import Materials
from pbrfit.model.reflection import render
from pbrfit.result.uncertainty import Uncertainty
from pbrfit.result.verdict import PARAMETERS, ROUGH_ERROR, USABLE_ERROR, Verdict, deserved
from pbrfit.scene.scene import Scene
from pbrfit_evaluation.everyday.disturbances import NOISE
from pbrfit_evaluation.grid import Case
from pbrfit_evaluation.suite import Results, Row
from pbrfit_evaluation.suite import Verdict as Bar
from pbrfit_evaluation.uncertainty import conditions, figures, measure
from pbrfit_evaluation.uncertainty.conditions import CONDITIONS, NAMES, Name, made
from pbrfit_evaluation.uncertainty.figures import (
    ABOVE_GUESS,
    COVERED,
    UNDETERMINED_WRONG,
    USABLE_RIGHT,
)
from pbrfit_evaluation.uncertainty.measure import calibration
from scene_files import lights_of, truth_of

SEED = 7


def scene(name: Name, size: int = 16) -> Scene:
    return made(name, "furnished", SEED, size, "paper", 1)


@pytest.fixture(scope="module")
def clean() -> Scene:
    return scene("clean")


@pytest.mark.parametrize("name", NAMES)
def test_scenes_have_true_materials_and_the_same_ones_each_time(name: Name, clean: Scene) -> None:
    first, again = scene(name), scene(name)
    np.testing.assert_array_equal(first.images, again.images)
    assert first.images.dtype == np.float32
    assert first.depth is None
    found, true = truth_of(first).materials, truth_of(clean).materials
    np.testing.assert_array_equal(found.roughness, true.roughness)
    if name == "grey":
        assert np.ptp(found.albedo, axis=-1).max() == 0
    else:
        np.testing.assert_array_equal(found.albedo, true.albedo)
    if name not in ("png", "jpeg", "three"):
        assert first.images.mean() == pytest.approx(0.4, rel=0.01)


def test_what_is_told_wrong(clean: Scene) -> None:
    noisy = scene("noise")
    assert (noisy.images - clean.images).std() == pytest.approx(NOISE, rel=0.03)
    told = scene("fov-90")
    assert (told.fov, clean.fov) == (90, 60)
    np.testing.assert_array_equal(told.images, clean.images)
    off: dict[Name, float] = {"normals-3": 3, "normals-5": 5}
    for name, degrees in off.items():
        wrong = scene(name)
        angles = angles_between(wrong.normals, clean.normals)
        assert angles.mean() == pytest.approx(degrees, rel=0.2)  # of few patches
        np.testing.assert_array_equal(wrong.images, noisy.images)
    other = scene("other-model")
    assert (clean.model, other.model) == ("paper", "principled")
    assert np.abs(other.images - clean.images).max() > 0.01
    assert len(scene("three").images) == 3


def test_files_are_of_8_bits() -> None:
    names: tuple[Name, ...] = ("png", "jpeg")
    for name in names:
        codes = 255 * encode_srgb(scene(name).images)
        np.testing.assert_allclose(codes, np.round(codes), atol=1e-3)


def test_surfaces_block_light_and_reflect_it(clean: Scene) -> None:
    """At one exposure: less light than without them, and more with what they reflect."""

    def by_clean(name: Name) -> Any:
        found = scene(name)
        exposure = np.median(lights_of(found) / lights_of(clean))
        return (found.images / exposure - clean.images).mean()

    blocked, reflected = by_clean("shadows"), by_clean("bounces")
    assert blocked < -0.02
    assert reflected > blocked + 0.02


def test_lamps_hang_before_what_the_camera_sees_and_light_most(clean: Scene) -> None:
    points = positions(np.full((16, 16), 2.0), 60.0).reshape(-1, 3)
    lamps = conditions.drawn_lamps(200, points, np.random.default_rng(0))
    assert lamps.near.mean() == 0.5
    depths = -lamps.places[lamps.near][:, 2]
    assert depths.min() >= 2 * conditions.NEAREST
    assert depths.max() <= 2 * conditions.FARTHEST
    assert lamps.places[~lamps.near][:, 2].min() > 0
    found = scene("lamps")
    truth = truth_of(found)
    assert truth.lighting is None
    ambient = conditions.AMBIENT * lights_of(clean)
    around = render(truth.materials, found.normals, ambient, 60.0, model="paper")
    shares = around.mean(axis=(1, 2, 3)) / found.images.mean(axis=(1, 2, 3))
    np.testing.assert_allclose(shares, conditions.AMBIENT, rtol=0.02)


def planted(scale: float, count: int = 20_000) -> Mapping[str, Any]:
    """Calibration of Gaussian errors so many times as large as is said."""
    rng = np.random.default_rng(1)
    deviation = 10 ** rng.uniform(-3, -1, count)
    true = np.full(count, 0.5)
    found = true + scale * deviation * rng.standard_normal(count)
    low, high = found - 1.96 * deviation, found + 1.96 * deviation
    return calibration(found, true, deviation, low, high)


@pytest.mark.parametrize("scale", [0.5, 1.0, 2.0])
def test_coverage_of_gaussian_errors(scale: float) -> None:
    found = planted(scale)
    for name, steps in (("within_1", 1), ("within_2", 2), ("in_interval", 1.96)):
        assert found[name] == pytest.approx(math.erf(steps / scale / math.sqrt(2)), abs=0.01)
    assert found["deviation"] == pytest.approx(0.01, rel=0.1)


def test_rounding_is_no_error_and_what_is_said_to_be_exact_must_be() -> None:
    zero = np.zeros(4)
    found = np.array([0.5, 0.5 + 1e-7, 0.6, 0.5])
    of = calibration(found, np.full(4, 0.5), zero, found, found)
    assert of["within_1"] == of["within_2"] == of["in_interval"] == 0.75


def test_a_result_is_compared_with_the_truth(clean: Scene) -> None:
    true = truth_of(clean).materials
    found = replace(true, albedo=1.1 * true.albedo, roughness=true.roughness + 0.15)

    def constant(value: float) -> Materials:
        full = np.full(true.roughness.shape, value)
        return Materials(np.repeat(full[..., None], 3, axis=-1), full, full)

    class Found:
        materials = found
        uncertainty = Uncertainty(
            *(constant(0.1), constant(0.0), constant(1.0)),
            noise=None,
            effective_share=1.0,
            albedo_scale=(0.1, 0.01, 0.0),
            verdicts={name: Verdict("usable", 0.1) for name in PARAMETERS},
        )

    of = measure.said(Found(), clean)  # type: ignore[arg-type]
    rough, metal = of["roughness"], of["metallic"]
    assert rough["rmse"] == pytest.approx(0.15)
    assert (rough["within_1"], rough["within_2"]) == (0, 1)
    assert rough["deserved"] == deserved("roughness", 0.15) != "usable"
    assert (metal["rmse"], metal["deserved"]) == (0, "usable")
    assert metal["guess"] == pytest.approx(np.sqrt(np.mean(true.metallic**2)))
    json.dumps(of)


def record(
    within_2: float = 0.95,
    rmse: float = 0.05,
    guess: float = 0.3,
    said: str | None = None,
) -> dict[str, Any]:
    """What a scene may have, alike in all maps; its verdicts are right unless another is given."""
    one = {
        **planted(1.0, 1000),
        "within_2": within_2,
        "rmse": rmse,
        "guess": guess,
        "expected_error": rmse,
        "cause": "",
    }
    maps = {
        name: {**one, "said": said or deserved(name, rmse), "deserved": deserved(name, rmse)}
        for name in PARAMETERS
    }
    return {"said": maps, "scores": {"seconds": 1.0}}


def results(*values: Mapping[str, Any] | str, name: Name = "noise") -> Results[Case]:
    """A row of these scenes."""
    pairs = ((Case(name, "default", i, 8), one) for i, one in enumerate(values))
    return recorded(*pairs, conditions=[name])


def judged(found: Results[Case]) -> tuple[list[Row], list[Bar]]:
    rows = figures.rows(found)
    return rows, list(figures.verdicts(found, rows))


def missed(*values: Mapping[str, Any]) -> list[str]:
    """What does not hold of such scenes."""
    return [one.what for one in judged(results(*values))[1] if not one.holds]


def test_calibrated_records_hold() -> None:
    rows, bars = judged(results(record(), record()))
    assert all(bar.holds for bar in bars)
    [row] = rows
    assert row.name == CONDITIONS["noise"].title
    assert row.scenes == 2
    for name in PARAMETERS:
        assert row.metrics[f"{name}_over_guess"] == pytest.approx(0.05 / 0.3)
        assert row.metrics[f"{name}_within_2"] == 0.95


@pytest.mark.parametrize(
    ("within_2", "what"),
    [
        *((bar, None) for bar in COVERED),
        (COVERED[0] - 0.001, "least"),
        (COVERED[1] + 0.001, "largest"),
    ],
)
def test_coverage_fails_on_both_sides(within_2: float, what: str | None) -> None:
    title = CONDITIONS["noise"].title
    expected = [f"{title}: share of errors within two deviations, {what}"] if what else []
    assert missed(record(within_2)) == expected


def test_one_map_that_is_off_fails_its_row() -> None:
    off = record()
    off["said"]["metallic"]["within_2"] = 0.5
    _, bars = judged(results(off))
    [bar] = [bar for bar in bars if not bar.holds]
    assert bar.where == "metallic"


def test_an_error_above_that_of_the_guess_fails() -> None:
    assert not missed(record(guess=0.05 / (ABOVE_GUESS - 0.001)))
    [found] = missed(record(guess=0.05 / (ABOVE_GUESS + 0.001)))
    assert "guess" in found


WELL = record(rmse=min(ROUGH_ERROR.values()), said="not determined")


@pytest.mark.parametrize(
    ("odd", "right", "share", "what"),
    [
        (record(rmse=2 * USABLE_ERROR["albedo"], said="usable"), record(), USABLE_RIGHT, "usable"),
        (WELL, record(rmse=0.29), 1 - UNDETERMINED_WRONG, "not determined"),
    ],
    ids=["usable", "not determined"],
)
def test_shares_of_scenes(odd: Any, right: Any, share: float, what: str) -> None:
    enough = math.ceil(share / (1 - share) - 1e-9)
    assert not missed(odd, *[right] * enough)
    [found] = missed(odd, *[right] * (enough - 1))
    assert what in found


def test_verdicts_are_counted_by_what_was_said_and_what_is_true() -> None:
    found = results(record(), record(rmse=0.29), record(rmse=0.05, said="not determined"))
    np.testing.assert_array_equal(figures.confusion(found), [[3, 0, 0], [0, 0, 0], [3, 0, 3]])


def test_without_scenes_nothing_holds() -> None:
    rows, bars = judged(results("it broke"))
    assert rows[0].status == "1 of 1 scenes failed"
    assert not any(bar.holds for bar in bars if bar.bar is not None)
    assert list(figures.sections(results("it broke"), rows))


def test_pages_show_tables_and_the_plot_of_verdicts() -> None:
    pairs = [pair for name in NAMES for pair in results(record(), name=name).pairs]
    found = Results(results().options, pairs)
    found.options.conditions = NAMES
    rows = figures.rows(found)
    assert [row.name for row in rows] == [one.title for one in CONDITIONS.values()]
    sections = list(figures.sections(found, rows))
    [plot] = [one for section in sections for one in section.figures]
    assert plot.png.startswith(b"\x89PNG")
