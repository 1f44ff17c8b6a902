"""The stability suite: its references, its verdicts, its report and its command."""

from __future__ import annotations

import itertools
import json
import math
from argparse import Namespace
from collections.abc import Callable
from dataclasses import replace
from decimal import Decimal
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import pbrfit
import reference
from pbrfit.io import images
from pbrfit.synthetic.lights import condition
from pbrfit_evaluation.jobs import Record, Values
from pbrfit_evaluation.stability import bands, figures, stiff_fits
from pbrfit_evaluation.stability.bounds import SECTIONS
from pbrfit_evaluation.stability.double_precision import Case, evaluate, sums
from pbrfit_evaluation.stability.exact_bands import exact_bands, paper_rule
from pbrfit_evaluation.stability.extreme_pixels import (
    KINDS,
    Kind,
    make_case,
    random_case,
    random_pixels,
    seen_at,
)
from pbrfit_evaluation.stability.measure import EFFORTS, Effort, count, ratio, worst, worst_entry
from pbrfit_evaluation.stability.objective import QUANTITIES
from pbrfit_evaluation.stability.run import Task, sections
from pbrfit_evaluation.stability.run import run as run_section
from pbrfit_evaluation.stability.stiff_scenes import stiff_scenes
from pbrfit_evaluation.suite import Results
from scene_files import run

Array = NDArray[np.floating[Any]]

GOLDEN = Path(__file__).resolve().parents[1] / "data"


def case_of(pixels: int, pictures: int, seed: int = 0) -> Case:
    return random_case(np.random.default_rng(seed), pixels, pictures)


# References


def test_exact_bands_against_golden_values() -> None:
    rows = json.loads((GOLDEN / "bands.json").read_text(encoding="utf-8"))["rows"]
    exact = exact_bands(np.array([row["r"] for row in rows]))
    for key, nearest, rest in (
        ("h", exact.weight, exact.weight_rest),
        ("dh_dr", exact.slope, exact.slope_rest),
    ):
        for i, row in enumerate(rows):
            for found, left, stated in zip(nearest[i], rest[i], row[key], strict=True):
                error = abs(Decimal(float(found)) + Decimal(float(left)) - Decimal(stated))
                # 25 digits; where the slope is 0, at r = 1, the file has 6e-81.
                assert error <= abs(Decimal(stated)) * Decimal("1e-23") + Decimal("1e-75"), (
                    f"{key} at r = {row['r']!r}"
                )


def test_paper_rule_is_right_in_the_middle_and_wrong_above_its_switch() -> None:
    middle = exact_bands(np.linspace(0.05, 0.6, 200))
    h, dh = paper_rule(middle.r, np.float64)
    assert np.abs(middle.weight_errors(h)).max() < 1e-13
    assert np.abs(middle.slope_errors(dh)).max() < 1e-12
    within = exact_bands(1 - np.logspace(-12, -5, 100))  # its Taylor series
    h, dh = paper_rule(within.r, np.float64)
    assert np.abs(within.weight_errors(h)).max() < 1e-15
    assert np.abs(within.slope_errors(dh)).max() < 1e-12
    # As stated in docs/model.md.
    above = exact_bands(1 - np.logspace(np.log10(2.501e-4), -3.5, 3000))
    h, dh = paper_rule(above.r, np.float64)
    assert 0.02 < np.abs(above.weight_errors(h)).max() < 0.05
    assert 300 < np.abs(above.slope_errors(dh)).max() < 800


def test_double_precision_path_against_independent_objective() -> None:
    case = case_of(37, 3)
    found = evaluate(case)
    p = case.pixels
    loss, gradient = reference.value_and_grad(
        case.images.astype(np.float64), p.normals, p.views, case.x
    )
    assert found.loss == pytest.approx(loss, rel=1e-13)
    assert np.abs(found.gradient - gradient).max() <= 1e-12 * np.abs(gradient).max()


def test_pieces_and_sums_agree_with_the_whole(monkeypatch: pytest.MonkeyPatch) -> None:
    case = case_of(100, 3)
    whole = evaluate(case)
    monkeypatch.setattr("pbrfit_evaluation.stability.double_precision.PIECE", 7)
    pieces, only = evaluate(case), sums(case)
    lights = case.blocks()["lights"]
    for found in (pieces.loss, only.loss):
        assert found == pytest.approx(whole.loss, rel=1e-14)
    for entries, stated in (
        (pieces.gradient, whole.gradient),
        (pieces.gradient_scale, whole.gradient_scale),
        (only.by_lights, whole.gradient[lights]),
    ):
        assert np.allclose(entries, stated, rtol=1e-12, atol=1e-15)


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.name)
def test_scale_is_no_smaller_than_the_gradient(kind: Kind) -> None:
    case = make_case(np.random.default_rng(0), kind, 64, 4)
    found = evaluate(case)
    assert (found.gradient_scale >= np.abs(found.gradient) * (1 - 1e-12)).all()
    assert found.loss_scale >= found.loss


def test_scale_is_tight_where_nothing_cancels() -> None:
    # Dielectrics seen along v = n = z under a light of band 0 alone: the residual is I, basis
    # functions of order 0 are at their largest and those of other orders are 0, and all terms have
    # one sign (but those of band 3, where h turns negative).
    case = case_of(5, 2)
    normals = np.zeros((5, 3))
    normals[:, 2] = 1
    lighting = np.zeros((2, 16, 3))
    lighting[:, 0] = 2.0
    pixels = replace(case.pixels, normals=normals, views=normals, metallic=np.zeros(5))
    found = evaluate(Case(pixels, lighting, np.zeros((2, 5, 3), dtype=np.float32)))
    blocks = case.blocks()
    entries, scale = np.abs(found.gradient), found.gradient_scale
    for name in ("albedo", "roughness"):
        assert np.allclose(scale[blocks[name]], entries[blocks[name]], rtol=1e-12)
    lights, of_lights = (
        a[blocks["lights"]].reshape(2, 16, 3)[:, [0, 2, 6]] for a in (entries, scale)
    )
    assert np.allclose(of_lights, lights, rtol=1e-12)


def test_extreme_pixels_are_what_they_say() -> None:
    rng = np.random.default_rng(3)
    made = {kind.name: make_case(rng, kind, 4000, 8) for kind in KINDS}

    def cosine(case: Case) -> Array:
        return np.asarray(np.sum(case.pixels.normals * case.pixels.views, axis=-1))

    assert made["r near 0"].pixels.roughness.max() <= 1e-8
    assert (made["r near 1"].pixels.roughness == 1).any()
    assert made["r near 1"].pixels.roughness.min() >= 1 - 1.1e-8
    across = made["r across 0.4"].pixels.roughness
    assert (across < 0.4).any()
    assert (across > 0.4).any()
    assert (across == 0.4).any()
    grazing = cosine(made["n·v from 1 to 10⁻⁷, or negative"])
    assert grazing.min() < 0
    assert 0 < np.abs(grazing).min() < 1e-6
    assert grazing.max() > 0.9
    bounds = made["ρ, r, m exactly 0 or 1"].pixels
    assert set(np.unique([*bounds.albedo.T, bounds.roughness, bounds.metallic])) == {0.0, 1.0}
    mixed = np.abs(made["lights × 10⁻⁶ … 10⁶ in one problem"].lighting[:, 0]).max(axis=-1)
    assert mixed.max() / mixed.min() > 1e11
    dark = made["blue dark"]
    assert not dark.images[..., 2].any()
    assert not dark.lighting[:4, :, 2].any()
    assert dark.lighting[4:, 0, 2].all()


def test_seen_at() -> None:
    rng = np.random.default_rng(0)
    views = random_pixels(rng, 100).views
    wanted = rng.uniform(-1, 1, 100)
    normals = seen_at(rng, views, wanted)
    assert np.allclose(np.sum(normals * views, axis=-1), wanted, atol=1e-15)
    assert np.allclose(np.linalg.norm(normals, axis=-1), 1, atol=1e-14)


# Verdicts


TINY = Effort(
    band_points=100,
    pixels_of_a_kind=256,
    pictures=2,
    branch_pixels=4,
    scan_points=5,
    residual_pixels=16,
    summed_pixels=(16, 64),
    summed_pictures=2,
    summed_many=(8, 4),
    draws=1,
    subnormal_pixels=600,
    repeated=((10, 2),),
    fit_size=5,
    fit_pictures=4,
    fit_iterations=2,
)


def judged(section: str, values: Values | None = None) -> dict[str, bool]:
    """Whether the figures of a section hold, by their keys; measured if not given."""
    task = Task(section, TINY, 0)
    record = Record(task.key, run_section(task, 1) if values is None else values, None, 0.0)
    results = Results(Namespace(), [(task, record)])
    found = record.values["figures"] if record.values else {}
    keys = [key for key in SECTIONS[section].bounds if key in found]
    return dict(zip(keys, (v.holds for v in figures.verdicts(results)), strict=True))


def failures(section: str) -> set[str]:
    return {key for key, holds in judged(section).items() if not holds}


def test_every_section_is_measured_and_says_why() -> None:
    assert list(SECTIONS) == list(sections())
    assert all(section.why.endswith(".") for section in SECTIONS.values())


def test_same_seed_same_figures() -> None:
    first, again, other = (
        run_section(Task("fast objective", TINY, seed), threads)["figures"]
        for seed, threads in ((1, 1), (1, 2), (2, 1))
    )
    assert first == again
    assert first != other


@pytest.mark.parametrize("nth", [0, 1])
@pytest.mark.parametrize("error", [1e-9, math.nan])
def test_wrong_bands_fail(monkeypatch: pytest.MonkeyPatch, nth: int, error: float) -> None:
    def wrong(r: Array) -> tuple[Array, Array]:
        found = pbrfit.ggx_band_weights(r)
        found[nth][len(r) // 2, 2] += error
        return found

    monkeypatch.setattr(bands, "ggx_band_weights", wrong)
    assert (("value_error", "slope_error")[nth]) in failures("band weights")


class Distorted:
    """A problem whose loss and gradient go through a function first."""

    def __init__(self, case: Case, threads: int, distort: Callable[..., Any]) -> None:
        self._problem = pbrfit._core.Problem(
            case.images, case.pixels.normals, case.pixels.views, threads
        )
        self._case, self._threads, self._distort = case, threads, distort

    def value_and_grad(self, x: NDArray[np.float64]) -> tuple[float, Array]:
        loss, gradient = self._problem.value_and_grad(x)
        found: tuple[float, Array] = self._distort(loss, gradient, self._case, self._threads)
        return found


def scaled_block(name: str, factor: float) -> Callable[..., Any]:
    def how(loss: float, gradient: Array, case: Case, _: int) -> tuple[float, Array]:
        gradient[case.blocks()[name]] *= factor
        return loss, gradient

    return how


def one_wrong_pixel(loss: float, gradient: Array, case: Case, _: int) -> tuple[float, Array]:
    """One entry of hundreds, off by 2e-5 of itself, shows beside its natural scale only."""
    albedo = gradient[case.blocks()["albedo"]]
    albedo[np.argsort(np.abs(albedo))[len(albedo) // 2]] *= 1 + 2e-5
    return loss, gradient


def by_threads(loss: float, gradient: Array, _: Case, threads: int) -> tuple[float, Array]:
    if threads == 3:
        gradient[-1] = np.nextafter(gradient[-1], np.inf)
    return loss, gradient


CALLS = itertools.count()


@pytest.mark.parametrize(
    ("section", "how", "key"),
    [
        ("fast objective", lambda loss, gradient, *_: (loss * (1 + 5e-6), gradient), "loss_error"),
        ("fast objective", lambda loss, gradient, *_: (loss * math.nan, gradient), "loss_error"),
        *(
            ("fast objective", scaled_block(name, factor), f"{name}_{kind}_error")
            for name in QUANTITIES[1:]
            for factor, kind in ((1 + 5e-6, "block"), (math.nan, "entry"))
        ),
        ("fast objective", one_wrong_pixel, "albedo_entry_error"),
        ("determinism", by_threads, "differs_between_threads"),
        (
            "determinism",
            lambda loss, gradient, *_: (loss * (1 + 1e-15 * (next(CALLS) % 2)), gradient),
            "differs_between_calls",
        ),
        ("tiny numbers", lambda loss, gradient, *_: (loss, gradient + 1e-30), "nonzero"),
        ("tiny numbers", lambda loss, gradient, *_: (loss, gradient * math.inf), "not_finite"),
        ("tiny numbers", lambda loss, gradient, *_: (loss + 1e-35, gradient), "exposure_error"),
    ],
)
@pytest.mark.filterwarnings("ignore:invalid value:RuntimeWarning")
def test_wrong_objective_fails(
    monkeypatch: pytest.MonkeyPatch, section: str, how: Callable[..., Any], key: str
) -> None:
    monkeypatch.setattr(Case, "problem", lambda case, threads=0: Distorted(case, threads, how))
    assert key in failures(section)


def test_worst_figures() -> None:
    assert worst({"a": 1.0, "b": 3.0, "c": 2.0}) == (3.0, "b")
    assert worst({"a": 1.0, "b": math.nan, "c": 2.0})[1] == "b"
    assert count({"a": 0, "b": 2, "c": 1}, "cases") == (3, "b")
    assert count({"a": 0, "b": 0}, "cases") == (0, "2 cases")
    assert (ratio(0, 0), ratio(1, 4), ratio(1, 0)) == (0, 0.25, math.inf)
    zero = np.zeros(1)
    assert worst_entry(zero, zero) == 0
    assert worst_entry(zero + 1e-300, zero) == math.inf
    assert worst_entry(np.array([1.0, -3.0]), np.array([2.0, 4.0])) == 0.75


# Stiff fits


def test_stiff_scenes_are_what_their_names_say() -> None:
    scenes = {one.name: one for one in stiff_scenes(12, 5)}

    def lighting(name: str) -> Any:
        truth = scenes[name].scene.truth
        assert truth is not None
        assert truth.lighting is not None
        return truth.lighting

    for number, name in ((10, "10"), (1e3, "1,000"), (1e5, "100,000"), (1e8, "10⁸")):
        found = condition(lighting(f"light matrix of condition {name}"))
        assert found == pytest.approx(number, rel=1e-6)
    assert np.ptp(lighting("all lights equal"), axis=0).max() == 0
    for one in scenes.values():
        truth = one.scene.truth
        assert truth is not None
        assert truth.lighting is not None
        assert one.scene.images.dtype == np.float32
        rendered = pbrfit.render(truth.materials, one.scene.normals, truth.lighting, one.scene.fov)
        np.testing.assert_allclose(
            rendered[:, one.counted], one.scene.images[:, one.counted], rtol=1e-6, atol=1e-7
        )
    assert len(scenes["1 picture, its light known"].scene.images) == 1
    assert scenes["1 picture, its light known"].scene.lighting is not None
    assert [len(scenes[f"{n} pictures"].scene.images) for n in (2, 3)] == [2, 3]
    black, bright = scenes["black pixels"], scenes["a pixel 10⁴ brighter"]
    assert (~black.counted).sum() == 9
    assert black.scene.images[:, ~black.counted].max() == 0
    assert (~bright.counted).sum() == 1
    plain = scenes["plain"].scene.images[:, ~bright.counted]
    np.testing.assert_allclose(bright.scene.images[:, ~bright.counted], 1e4 * plain, rtol=1e-6)
    assert len(plain) == 5


def fit_of(scene: str, solver: str, **changes: Any) -> stiff_fits.Fit:
    zeros = dict.fromkeys(stiff_fits.MAPS, 0.0)
    plain = stiff_fits.Fit(scene, solver, 1e-3, zeros, zeros, 0, 0, 0, 0, 5, 6, 0.1, "converged")
    return replace(plain, **changes)


def test_a_fit_that_is_worse_or_unflagged_or_broken_fails_its_check() -> None:
    def failed(*fits: stiff_fits.Fit) -> list[str]:
        found = judged("stiff fits", {"figures": stiff_fits.of_fits(fits)})
        return [key for key, holds in found.items() if not holds]

    reference = fit_of("a", "lbfgsb")
    assert failed(reference, fit_of("a", "auto")) == []
    assert failed(reference, fit_of("a", "auto", recon=1.1e-3)) == ["fits_above_lbfgsb"]
    assert failed(reference, fit_of("a", "auto", recon=math.nan)) == ["fits_above_lbfgsb"]
    exact = fit_of("a", "lbfgsb", recon=1e-9)
    assert failed(exact, fit_of("a", "auto", recon=2e-7)) == []  # both below what float32 shows
    assert failed(fit_of("a", "lbfgsb", not_finite=1)) == ["fits_not_finite"]
    assert failed(fit_of("a", "lbfgsb", beyond=1)) == ["fits_beyond"]
    assert failed(fit_of("a", "lbfgsb", over_limit=1)) == ["fits_iterations_over"]
    assert failed(fit_of("b", "auto", overlooked=2)) == ["fits_overlooked"]
    found = stiff_fits.of_fits([reference, fit_of("b", "auto", overlooked=2)])
    assert found["fits_overlooked"] == (2, "b, auto")


# The command


def test_the_command_holds_every_bound_and_writes_its_report(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "new" / "out"
    assert run("evaluate", "stability", "--out", out, "--quick") == 0, capsys.readouterr().out
    assert str(out / "report.html") in capsys.readouterr().out
    content = json.loads((out / "summary.json").read_text(encoding="utf-8"))
    assert content["protocol"] == "pbrfit-stability-1, quick"
    assert [row["name"] for row in content["rows"]] == list(SECTIONS)
    exact = {"nonzero", "not_finite", "differs_from_mirror", "differs_between_threads"}
    exact.add("differs_between_calls")
    for row in content["rows"]:
        metrics = row["metrics"]
        assert (row["status"], metrics["failed"]) == ("ok", 0)
        for key, (_, most) in SECTIONS[row["name"]].bounds.items():
            assert metrics.get(f"{key}_bound") == most
            # What is bounded was measured: a rounding error that is exactly 0 was not.
            if not key.startswith("fits_"):
                assert (metrics[key] == 0) == (key in exact), key
    fits = json.loads((out / "records" / "stiff-fits.json").read_text("utf-8"))["values"]["fits"]
    names = [one.name for one in stiff_scenes(10, 5)]
    assert list(dict.fromkeys(fit["scene"] for fit in fits)) == names
    alone = [fit for fit in fits if fit["scene"] == "1 picture, its light known"]
    assert {fit["undetermined"]["roughness"] for fit in alone} == {1.0}
    page = (out / "report.html").read_text(encoding="utf-8")
    plots = sorted(path.name for path in out.glob("*.png"))
    assert len(plots) == page.count("data:image/png;base64,") == 7
    for name in plots:
        pixels = images.read_data(out / name)
        assert 0.005 < np.mean(pixels < 0.9) < 0.3, f"{name} is blank, or nothing but ink"


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_nonsense_is_reported_and_fails(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """However wrong the core is, the page is drawn and says so."""
    monkeypatch.setitem(EFFORTS, "quick", TINY)
    monkeypatch.setattr(stiff_fits, "SOLVERS", ("lbfgsb",))

    def how(loss: float, gradient: Array, *_: object) -> tuple[float, Array]:
        return loss * math.nan, gradient * math.nan

    monkeypatch.setattr(Case, "problem", lambda case, threads=0: Distorted(case, threads, how))
    out = tmp_path / "out"
    assert run("evaluate", "stability", "--out", out, "--quick", "--threads", 1) == 1
    assert capsys.readouterr().out.count("FAILS") > 20
    rows = json.loads((out / "summary.json").read_text(encoding="utf-8"))["rows"]
    assert rows[1]["status"] == "not held"
    assert rows[1]["metrics"]["failed"] == 9
    assert len(list(out.glob("*.png"))) == 7
