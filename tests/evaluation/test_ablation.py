"""The ablation: its scenes, its configurations, its verdicts, its report."""

from __future__ import annotations

import argparse
import csv
import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest

import pbrfit
from pbrfit.result.options import Priors, prior_names
from pbrfit.scene.scene import Scene
from pbrfit.synthetic import make_scene
from pbrfit.synthetic.exposure import MEAN_RADIANCE
from pbrfit_evaluation import ablation
from pbrfit_evaluation.ablation import cases, figures
from pbrfit_evaluation.ablation.cases import CASES, case, merged, shifted, varied
from pbrfit_evaluation.ablation.configurations import CONFIGURATIONS, FEW, curves
from pbrfit_evaluation.ablation.demands import DEMANDS, Demand, judge
from pbrfit_evaluation.ablation.measure import RoomTask
from pbrfit_evaluation.jobs import Record
from pbrfit_evaluation.recipes import PAPER_PRIORS
from pbrfit_evaluation.scores import Scores
from pbrfit_evaluation.suite import Results
from scene_files import held_out_of, known, lights_of, run, truth_of

SIZE, SEED = 24, 2000


def segments_of(scene: Scene) -> cases.Ids:
    return known(scene.segments)


def test_the_constant_room_is_the_room() -> None:
    made = case("constant", SEED, size=SIZE)
    plain = make_scene("room", size=SIZE, seed=SEED, noise=0.01)
    np.testing.assert_allclose(made.images, plain.images, atol=1e-12)
    np.testing.assert_array_equal(segments_of(made), segments_of(plain))
    for i in np.unique(segments_of(made)):
        here = segments_of(made) == i
        assert len(np.unique(truth_of(made).materials.roughness[here])) == 1
        assert len(np.unique(truth_of(made).materials.metallic[here])) == 1


@pytest.mark.parametrize("name", [name for name in CASES if name != "shadowed"])
def test_truth_explains_the_pictures_but_for_the_noise(name: cases.CaseName) -> None:
    scene = case(name, SEED, size=SIZE)
    maps = truth_of(scene).materials
    given = (scene.images, lights_of(scene), 0.01), (*held_out_of(scene), 0.0)
    for images, lighting, noise in given:
        rendered = pbrfit.kernel.render(maps, scene.normals, lighting, scene.fov)
        assert np.std(images - rendered) == pytest.approx(noise, rel=0.03, abs=1e-12)
    assert scene.images.mean() == pytest.approx(MEAN_RADIANCE, abs=1e-3)


def test_wrong_segments_leave_the_pictures_as_they_are() -> None:
    right = case("constant", SEED, size=SIZE)
    for name in ("shifted", "merged", "none"):
        np.testing.assert_array_equal(case(name, SEED, size=SIZE).images, right.images)
    assert case("none", SEED, size=SIZE).segments is None


def test_grey_lights_have_no_colour() -> None:
    truth, colored = truth_of(case("grey", SEED, size=8)), truth_of(case("constant", SEED, size=8))
    for name in ("lighting", "relight_lighting"):
        lights = getattr(truth, name)
        assert np.ptp(lights, axis=-1).max() == 0
        of_mean = getattr(colored, name).mean(axis=-1)
        ratio = lights[..., 0] / of_mean  # the exposure differs
        np.testing.assert_allclose(ratio, ratio[0, 0], rtol=1e-9)


def test_every_picture_has_a_shadow_of_its_own() -> None:
    found, plain = (case(name, SEED, size=48).images for name in ("shadowed", "constant"))
    dark = found != plain
    np.testing.assert_allclose(found[dark], cases.SHADOW_LIGHT * plain[dark])
    shares = dark.mean(axis=(1, 2, 3))
    # A disc in the middle has all of its area, one in a corner a quarter.
    area = np.pi / 4 * cases.SHADOW_DIAMETER**2
    assert 0.2 * area < shares.min() <= shares.max() < 1.1 * area
    assert len(np.unique(np.packbits(dark, axis=(1)), axis=0)) == len(found)


def test_roughness_varies_inside_segments_and_nothing_else_does() -> None:
    scene, plain = case("varying", SEED, size=64), case("constant", SEED, size=64)
    found, before = truth_of(scene).materials, truth_of(plain).materials
    np.testing.assert_array_equal(found.metallic, before.metallic)
    np.testing.assert_array_equal(found.albedo, before.albedo)
    deviations, means = [], []
    for i, count in zip(*np.unique(segments_of(scene), return_counts=True), strict=True):
        if count >= 64:
            here = segments_of(scene) == i
            deviations.append(found.roughness[here].std())
            means.append(abs(found.roughness[here].mean() - before.roughness[here].mean()))
    assert len(deviations) >= 10
    assert min(deviations) >= 0.06  # some of a pattern may be clipped
    assert max(deviations) <= cases.SPREAD[1] + 1e-12
    assert np.median(deviations) >= cases.SPREAD[0]
    assert max(means) < 0.05


def test_patterns_are_the_same_at_any_size() -> None:
    fine, coarse = np.ones((60, 60), np.uint16), np.ones((20, 20), np.uint16)
    found = [
        varied(np.full(ids.shape, 0.5), ids, np.random.default_rng(3)) for ids in (fine, coarse)
    ]
    # Pixel centres of the coarse picture are those of every third pixel, from the second.
    sampled = found[0][1::3, 1::3]
    assert np.corrcoef(sampled.ravel(), found[1].ravel())[0, 1] > 0.999999


def test_shifted_by_one_pixel_right_and_down() -> None:
    ids = np.arange(1, 13).reshape(3, 4)
    np.testing.assert_array_equal(shifted(ids), [[1, 1, 2, 3], [1, 1, 2, 3], [5, 5, 6, 7]])


def test_a_third_takes_the_ids_of_others() -> None:
    ids = np.repeat(np.repeat(np.arange(1, 13).reshape(3, 4), 2, axis=0), 2, axis=1)
    near = 0
    for seed in range(20):
        found = merged(ids, np.random.default_rng(seed))
        pairs = np.unique(np.stack([ids.ravel(), found.ravel()]), axis=1).T
        assert len(pairs) == 12  # segments stay whole
        changed = [(int(old), int(new)) for old, new in pairs if old != new]
        assert len(changed) == 4
        assert len(np.unique(found)) == 8
        assert not {old for old, _ in changed} & {new for _, new in changed}
        rows = [((a - 1) // 4, (b - 1) // 4, abs(a - b)) for a, b in changed]
        near += sum(apart == 4 or (apart == 1 and above == row) for above, row, apart in rows)
    # Of 80, at least every second one, but for those that have none but takers around them. Of
    # ids drawn from all alike, 34 / 132 would be near: some 21.
    assert 36 <= near <= 60


def test_each_prior_is_off_and_alone_once() -> None:
    everything = {*CONFIGURATIONS, *curves(ablation.SUITE.effort["weights"][0])}
    assert len({one.key for one in everything}) == len(everything)
    assert len({one.title for one in everything}) == len(everything)
    by_key = {one.key: one.priors for one in CONFIGURATIONS}
    for name in ("cohesion", "smoothness", "sparsity", "monochrome"):
        expected = dataclasses.replace(PAPER_PRIORS, **{name: 0.0})
        assert by_key[f"paper-no-{name}"] == expected
    alone = by_key["material=1"]
    assert alone is not None
    assert [name for name in prior_names() if getattr(alone, name) != 0] == ["material"]
    assert by_key["default"] == Priors()
    assert by_key["none"] is None


def test_verdicts_by_hand() -> None:
    ratio = Demand("a", "constant", "roughness", 0.5)
    verdict = judge(ratio, [0.1, 0.3], [0.06, 0.12])
    assert verdict.value == pytest.approx(0.18 / 0.4)
    assert verdict.rooms == pytest.approx((0.6, 0.4))
    assert verdict.holds
    assert verdict.holding == 1
    plain = Demand("a", "constant", "metallic", 0.03, relative=False)
    verdict = judge(plain, [0.1, 0.3], [0.02, 0.05])
    assert verdict.value == pytest.approx(0.035)
    assert verdict.rooms == pytest.approx((0.02, 0.05))
    assert not verdict.holds
    exact = Demand("a", "constant", "albedo", 1.0)
    assert judge(exact, [0.2], [0.2]).holds
    assert not judge(exact, [0.2], [np.nextafter(0.2, 1)]).holds


def rooms_with(errors: dict[str, float]) -> Results[RoomTask]:
    """Two rooms a case, with one error for all metrics of a configuration; one room failed."""
    options = argparse.Namespace(
        quick=True, scenes=2, size=8, iterations=1, first_seed=SEED, model="paper", weights=(0.1, 1)
    )
    names = Scores.__dataclass_fields__
    pairs = []
    for task in ablation.rooms(options):
        scores = {
            one.key: dict.fromkeys(names, errors.get(one.key, 0.2)) for one in task.configurations
        }
        pairs.append((task, Record(task.key, {"scores": scores}, None, 1.0)))
    pairs[-1] = (pairs[-1][0], Record(pairs[-1][0].key, None, "MemoryError: too large", 1.0))
    return Results(options, pairs)


def test_the_default_is_judged_and_failures_are_named() -> None:
    results = rooms_with({"default": 0.12})
    rows = {row.name: row for row in figures.rows(results)}
    demands = [row for name, row in rows.items() if name.startswith("must hold")]
    assert len(demands) == len(DEMANDS) == len(figures.verdicts(results, []))
    missed = {row.name for row in demands if row.status == "not held"}
    assert missed == {
        "must hold (a): constant, metallic",
        "must hold (a): constant, roughness",
        *(f"must hold (d): {one}, roughness" for one in ("constant", "shifted", "merged", "none")),
    }
    assert rows["must hold (a): constant, roughness"].metrics["value"] == pytest.approx(0.6)
    assert rows["merged, default"].metrics["albedo_ratio"] == pytest.approx(0.6)
    assert rows["merged, material=0.1"].metrics["albedo_ratio"] == pytest.approx(1.0)
    assert "shifted, material=0.1" not in rows  # weights vary in some cases alone
    assert rows["shadowed, default"].status == "1 of 2 rooms failed"
    [held, *_] = figures.sections(results, list(rows.values()))
    assert held.tables[0].rows[0][0] == "default"
    assert held.tables[0].rows[0][1:] == pytest.approx([0.6, 0.12, 0.6, 0.6, 0.6, 0.6, "32 of 38"])
    failed = [(task, Record(task.key, None, "OSError: full", 0.0)) for task, _ in results.pairs]
    nothing = Results(results.options, failed)
    assert [row.status for row in figures.rows(nothing)] == ["2 of 2 rooms failed"] * len(CASES)
    assert not list(figures.sections(nothing, []))


@pytest.mark.slow
def test_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "out"
    command = ("evaluate", "ablation", "--out", out, "--quick", "--jobs", "1",
               "--first-seed", SEED, "--size", 12, "--iterations", 2)  # fmt: skip
    assert run(*command) == 0
    printed = capsys.readouterr()
    assert printed.err == ""
    assert printed.out.count("of 1 rooms") == len(DEMANDS)
    names = {path.name for path in out.iterdir()}
    files = {"records", "report.html", "ablation.md", "rooms.csv", "summary.json"}
    assert names == {f"room-{name}.png" for name in CASES} | files
    with (out / "rooms.csv").open(newline="", encoding="utf-8") as file:
        rooms = list(csv.DictReader(file))
    assert len(rooms) == len(CASES) * len(FEW)
    rows = json.loads((out / "summary.json").read_text("utf-8"))["rows"]
    by_name = {row["name"]: row for row in rows}
    of = {(r["case"], r["configuration"]): float(r["albedo"]) for r in rooms}
    assert by_name["varying, default"]["metrics"]["albedo"] == of["varying", "default"]
