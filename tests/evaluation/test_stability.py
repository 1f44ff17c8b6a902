"""The stability suite: its references, its verdicts, its report and its command."""

from __future__ import annotations

import html
import json
import math
import subprocess
import sys
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
from pbrfit.report.notation import scientific
from pbrfit.synthetic.lights import condition
from pbrfit_evaluation import page, stability, summary
from pbrfit_evaluation.stability import (
    FULL,
    QUICK,
    SECTIONS,
    Check,
    Stability,
    bands,
    determinism,
    kernel,
    plots,
    report,
    stiff_fits,
    tiny,
)
from pbrfit_evaluation.stability.checks import ratio, worst_entry, worst_of
from pbrfit_evaluation.stability.double_precision import Case, evaluate, sums
from pbrfit_evaluation.stability.exact_bands import exact_bands, paper_rule
from pbrfit_evaluation.stability.extreme_pixels import (
    KINDS,
    Kind,
    make_case,
    random_lights,
    random_pixels,
    random_targets,
    seen_at,
)
from pbrfit_evaluation.stability.stiff_scenes import stiff_scenes
from scene_files import run

Array = NDArray[np.floating[Any]]

GOLDEN = Path(__file__).resolve().parents[1] / "data"


@pytest.fixture(scope="module")
def measured() -> Stability:
    return stability.measure(QUICK)


@pytest.fixture
def failing(measured: Stability) -> Stability:
    """The same, as if every bound of the last section were broken."""
    broken = tuple(replace(check, worst=1.0) for check in measured.determinism.checks)
    return replace(measured, determinism=replace(measured.determinism, checks=broken))


def case_of(pixels: int, pictures: int, seed: int = 0) -> Case:
    rng = np.random.default_rng(seed)
    return Case(
        random_pixels(rng, pixels),
        random_lights(rng, pictures),
        random_targets(rng, pictures, pixels),
    )


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


def failures(checks: tuple[Check, ...]) -> list[str]:
    return [check.key for check in checks if not check.passed]


def test_all_bounds_hold(measured: Stability) -> None:
    wrong = [
        f"{check.what}: {check.worst:.2e} > {check.bound} ({check.where})"
        for check in measured.checks
        if not check.passed
    ]
    assert not wrong, "\n".join(wrong)
    assert measured.passed
    assert sum(check.bound is not None for check in measured.checks) >= 40


def test_every_check_says_why_and_has_its_own_name(measured: Stability) -> None:
    assert len(measured.by_section) == len(SECTIONS)
    for checks in measured.by_section:
        keys = [check.key for check in checks]
        assert len(set(keys)) == len(keys) > 0
        assert all(check.why.endswith(".") and check.what for check in checks)


def test_bounds_are_not_empty_words(measured: Stability) -> None:
    """What is bounded was measured: a rounding error that is exactly 0 was not."""
    exact = {"nonzero", "not_finite", "differs_from_mirror", "differs_between_threads"}
    exact.add("differs_between_calls")
    of_core = [check for check in measured.checks if not check.key.startswith("fits_")]
    assert {check.key for check in of_core if check.worst == 0} == exact


def test_same_seed_same_figures() -> None:
    few = replace(QUICK, pixels_of_a_kind=256)
    first, again, other = (
        kernel.measure_kernel(few, np.random.default_rng(seed), threads)
        for seed, threads in ((1, 1), (1, 2), (2, 1))
    )
    assert first.checks == again.checks
    assert first.checks != other.checks


@pytest.mark.parametrize("nth", [0, 1])
@pytest.mark.parametrize("error", [1e-9, math.nan])
def test_wrong_bands_fail(monkeypatch: pytest.MonkeyPatch, nth: int, error: float) -> None:
    def wrong(r: Array) -> tuple[Array, Array]:
        found = pbrfit.ggx_band_weights(r)
        found[nth][len(r) // 2, 2] += error
        return found

    monkeypatch.setattr(bands, "ggx_band_weights", wrong)
    checks = bands.measure_bands(replace(QUICK, band_points=100)).checks
    assert (("value_error", "slope_error")[nth]) in failures(checks)


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


def distort(monkeypatch: pytest.MonkeyPatch, how: Callable[..., Any]) -> None:
    monkeypatch.setattr(Case, "problem", lambda case, threads=0: Distorted(case, threads, how))


def scaled_block(name: str, factor: float) -> Callable[..., Any]:
    def how(loss: float, gradient: Array, case: Case, _: int) -> tuple[float, Array]:
        gradient[case.blocks()[name]] *= factor
        return loss, gradient

    return how


@pytest.mark.parametrize(
    ("how", "key"),
    [
        (lambda loss, gradient, *_: (loss * (1 + 5e-6), gradient), "loss_error"),
        (lambda loss, gradient, *_: (loss * math.nan, gradient), "loss_error"),
        *((scaled_block(name, 1 + 5e-6), f"{name}_block_error") for name in kernel.QUANTITIES[1:]),
        *((scaled_block(name, math.nan), f"{name}_entry_error") for name in kernel.QUANTITIES[1:]),
    ],
)
def test_wrong_objective_fails(
    monkeypatch: pytest.MonkeyPatch, how: Callable[..., Any], key: str
) -> None:
    distort(monkeypatch, how)
    few = replace(QUICK, pixels_of_a_kind=256)
    assert key in failures(kernel.measure_kernel(few, np.random.default_rng(0), 1).checks)


def test_one_wrong_pixel_fails(monkeypatch: pytest.MonkeyPatch) -> None:
    """One entry of thousands that is off by 2e-5 of itself shows beside its natural scale only."""

    def how(loss: float, gradient: Array, case: Case, _: int) -> tuple[float, Array]:
        albedo = gradient[case.blocks()["albedo"]]
        albedo[np.argsort(np.abs(albedo))[len(albedo) // 2]] *= 1 + 2e-5
        return loss, gradient

    distort(monkeypatch, how)
    failed = failures(kernel.measure_kernel(QUICK, np.random.default_rng(0), 1).checks)
    assert failed == ["albedo_entry_error"]


def test_bits_that_depend_on_threads_fail(monkeypatch: pytest.MonkeyPatch) -> None:
    def how(loss: float, gradient: Array, _: Case, threads: int) -> tuple[float, Array]:
        if threads == 3:
            gradient[-1] = np.nextafter(gradient[-1], np.inf)
        return loss, gradient

    distort(monkeypatch, how)
    few = replace(QUICK, repeated=((10, 2),))
    checks = determinism.measure_determinism(few, np.random.default_rng(0)).checks
    assert failures(checks) == ["differs_between_threads"]
    assert checks[0].worst == 1


def test_bits_that_depend_on_the_call_fail(monkeypatch: pytest.MonkeyPatch) -> None:
    calls = iter(range(10**6))

    def how(loss: float, gradient: Array, *_: Any) -> tuple[float, Array]:
        return loss * (1 + 1e-15 * (next(calls) % 2)), gradient

    distort(monkeypatch, how)
    few = replace(QUICK, repeated=((10, 2),))
    checks = determinism.measure_determinism(few, np.random.default_rng(0)).checks
    assert "differs_between_calls" in failures(checks)


@pytest.mark.parametrize(
    ("how", "key"),
    [
        (lambda loss, gradient, *_: (loss, gradient + 1e-30), "nonzero"),
        (lambda loss, gradient, *_: (loss, gradient * math.inf), "not_finite"),
        (lambda loss, gradient, *_: (loss + 1e-35, gradient), "exposure_error"),
    ],
)
@pytest.mark.filterwarnings("ignore:invalid value:RuntimeWarning")
def test_wrong_tiny_numbers_fail(
    monkeypatch: pytest.MonkeyPatch, how: Callable[..., Any], key: str
) -> None:
    distort(monkeypatch, how)
    few = replace(QUICK, subnormal_pixels=600)
    assert key in failures(tiny.measure_tiny(few, np.random.default_rng(0), 1).checks)


def test_checks() -> None:
    check = Check("key", "what", 1.0, 1.0, "why.")
    assert check.passed
    assert not replace(check, worst=math.nextafter(1.0, 2.0)).passed
    assert not replace(check, worst=math.nan).passed
    assert replace(check, worst=math.nan, bound=None).passed
    assert worst_of({"a": 1.0, "b": 3.0, "c": 2.0}) == ("b", 3.0)
    assert worst_of({"a": 1.0, "b": math.nan, "c": 2.0})[0] == "b"
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


def test_a_fit_that_is_worse_or_silent_or_broken_fails_its_check() -> None:
    def failed(*fits: stiff_fits.Fit) -> list[str]:
        return [check.key for check in stiff_fits.of_fits(fits) if not check.passed]

    reference = fit_of("a", "lbfgsb")
    assert failed(reference, fit_of("a", "auto")) == []
    assert failed(reference, fit_of("a", "auto", recon=1.1e-3)) == ["fits_above_lbfgsb"]
    assert failed(reference, fit_of("a", "auto", recon=math.nan)) == ["fits_above_lbfgsb"]
    exact = fit_of("a", "lbfgsb", recon=1e-9)
    assert failed(exact, fit_of("a", "auto", recon=2e-7)) == []  # both below what float32 shows
    assert failed(fit_of("a", "lbfgsb", not_finite=1)) == ["fits_not_finite"]
    assert failed(fit_of("a", "lbfgsb", beyond=1)) == ["fits_beyond"]
    assert failed(fit_of("a", "lbfgsb", over_limit=1)) == ["fits_iterations_over"]
    [check] = [c for c in stiff_fits.of_fits([fit_of("b", "auto", overlooked=2)]) if not c.passed]
    assert (check.key, check.worst, check.where) == ("fits_overlooked", 2, "b, auto")


def test_every_solver_fits_every_stiff_scene(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(stiff_fits, "SOLVERS", ("lbfgsb",))
    found = stiff_fits.measure_stiff_fits(TINY, threads=1)
    assert [fit.scene for fit in found.fits] == [
        one.name for one in stiff_scenes(TINY.fit_size, TINY.fit_pictures)
    ]
    assert all(check.passed for check in found.checks)
    by_name = {fit.scene: fit for fit in found.fits}
    assert by_name["1 picture, its light known"].undetermined["roughness"] == 1.0
    assert {fit.iterations for fit in found.fits} == {TINY.fit_iterations}


# Report


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (0.0, "0"),
        (3, "3"),
        (16384, "16,384"),
        (1e6, "10⁶"),
        (0.041, "0.041"),
        (2.61, "2.6"),
        (648.2, "648"),
        (4.69e-15, "4.7·10⁻¹⁵"),
        (1e-12, "10⁻¹²"),
        (2e-6, "2·10⁻⁶"),
        (-2.5e7, "-2.5·10⁷"),
        (math.nan, "not a number"),
        (math.inf, "infinite"),
    ],
)
def test_scientific(value: float, text: str) -> None:
    assert scientific(value) == text


TINY = stability.Effort(
    name="tiny",
    band_points=100,
    pixels_of_a_kind=64,
    pictures=2,
    branch_pixels=4,
    scan_points=5,
    residual_pixels=16,
    summed_pixels=(16, 64),
    summed_pictures=2,
    summed_many=(8, 4),
    draws=1,
    subnormal_pixels=16,
    repeated=((3, 2),),
    fit_size=5,
    fit_pictures=4,
    fit_iterations=2,
)

BOUNDS = 50

FILES = [
    "accumulation.png",
    "bands.png",
    "cancellation.png",
    "exposures.png",
    "jumps.png",
    "kernel.png",
    "noise.png",
    "report.html",
    "summary.json",
]


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory, measured: Stability) -> Path:
    folder = tmp_path_factory.mktemp("stability")
    report.write(folder, measured)
    return folder


@pytest.fixture
def no_plots(monkeypatch: pytest.MonkeyPatch) -> None:
    """Drawing takes seconds."""
    for name in vars(plots):
        if name.startswith("draw_"):
            monkeypatch.setattr(plots, name, lambda _: b"a plot")


def test_report(written: Path, measured: Stability) -> None:
    assert sorted(path.name for path in written.iterdir()) == FILES
    page = (written / "report.html").read_text(encoding="utf-8")
    assert f"All {BOUNDS} bounds hold." in page
    assert ">FAIL<" not in page
    assert page.count("data:image/png;base64,") == 7
    assert "http" not in page  # all of it is inside
    assert page.count("<h2>") == len(SECTIONS)
    for check in measured.checks:
        assert f"<td>{html.escape(check.what)}</td>" in page


def test_plots(written: Path) -> None:
    for name in FILES:
        if name.endswith(".png"):
            pixels = images.read_data(written / name)
            assert pixels.shape[1] > 1000
            assert 0.005 < np.mean(pixels < 0.9) < 0.3, f"{name} is blank, or nothing but ink"


def test_summary(written: Path, measured: Stability) -> None:
    content = json.loads((written / "summary.json").read_text(encoding="utf-8"))
    assert list(content) == ["protocol", "version", "machine", "rows"]
    assert content["protocol"] == "pbrfit-stability-1, quick"
    assert [row["name"] for row in content["rows"]] == list(SECTIONS)
    for row, checks in zip(content["rows"], measured.by_section, strict=True):
        assert list(row) == ["name", "scenes", "solver", "metrics", "paper", "status"]
        assert (row["paper"], row["status"], row["metrics"]["failed"]) == (None, "ok", 0)
        for check in checks:
            assert row["metrics"][check.key] == check.worst
            assert row["metrics"].get(f"{check.key}_bound") == check.bound


@pytest.mark.usefixtures("no_plots")
def test_report_of_failures(tmp_path: Path, failing: Stability) -> None:
    report.write(tmp_path, failing)
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert f"2 of {BOUNDS} bounds fail." in page
    assert page.count(">FAIL<") == 2
    rows = json.loads((tmp_path / "summary.json").read_text(encoding="utf-8"))["rows"]
    assert [row["metrics"]["failed"] for row in rows] == [0, 0, 0, 0, 0, 0, 2, 0]


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_report_of_nonsense(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """However wrong the core is, the page is drawn and says so."""
    distort(monkeypatch, lambda loss, gradient, *_: (loss * math.nan, gradient * math.nan))
    found = stability.measure(TINY)
    assert not found.passed
    report.write(tmp_path, found)
    assert sorted(path.name for path in tmp_path.iterdir()) == FILES
    failed = sum(not check.passed for check in found.checks)
    assert failed > 20
    assert (tmp_path / "report.html").read_text(encoding="utf-8").count(">FAIL<") == failed


def test_page_escapes_its_text(tmp_path: Path) -> None:
    row = [page.Cell("a < b & c"), page.Cell('the "reason"', "why")]
    table = page.Table([page.Cell("one"), page.Cell("two")], [row])
    page.write_page(tmp_path, "<T>", ["x < y"], [page.Section("S & T", [], [table])])
    content = (tmp_path / "report.html").read_text(encoding="utf-8")
    for text in (
        "a &lt; b &amp; c", "the &quot;reason&quot;", "<h1>&lt;T&gt;</h1>", "S &amp; T", "x &lt; y"
    ):  # fmt: skip
        assert text in content


def test_summary_writes_null_for_what_is_no_number(tmp_path: Path) -> None:
    metrics = {"a": math.nan, "b": math.inf, "c": 1.5, "d": None}
    rows = [
        summary.Row("one", 3, "lbfgsb", metrics, paper={"c": 2.0}),
        summary.Row("two", 0, None, {}, status="needs torch"),
    ]
    summary.write_summary(tmp_path, "protocol-1", rows)
    content = json.loads((tmp_path / "summary.json").read_text(encoding="utf-8"))
    assert content["rows"] == [
        {
            "name": "one",
            "scenes": 3,
            "solver": "lbfgsb",
            "metrics": {"a": None, "b": None, "c": 1.5, "d": None},
            "paper": {"c": 2.0},
            "status": "ok",
        },
        {
            "name": "two",
            "scenes": 0,
            "solver": None,
            "metrics": {},
            "paper": None,
            "status": "needs torch",
        },
    ]
    assert content["machine"]["processor"]


def test_measuring_imports_no_plots() -> None:
    code = (
        "import sys; import pbrfit.cli; from pbrfit_evaluation.stability import report; "
        "sys.exit('matplotlib' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


# The command


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch, measured: Stability) -> list[dict[str, Any]]:
    """Take what is measured already; remember what was asked for."""
    asked: list[dict[str, Any]] = []

    def measure(
        effort: stability.Effort, *, progress: Callable[[str], None], **options: Any
    ) -> Stability:
        for section in SECTIONS:
            progress(section)
        asked.append({"effort": effort, **options})
        return measured

    monkeypatch.setattr(stability, "measure", measure)
    return asked


@pytest.mark.usefixtures("no_plots")
def test_command(
    tmp_path: Path, asked: list[dict[str, Any]], capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "new" / "out"
    assert run("evaluate", "stability", "--out", out, "--quick") == 0
    captured = capsys.readouterr()
    assert captured.err == ""
    assert captured.out.count("\n") == 1 + BOUNDS + 2
    assert f"all {BOUNDS} bounds hold; look at {out / 'report.html'}" in captured.out
    assert sorted(path.name for path in out.iterdir()) == FILES
    options = ("--seed", 7, "--threads", 2, "--quiet")
    assert run("evaluate", "stability", "--out", out, "--overwrite", *options) == 0
    assert capsys.readouterr() == ("", "")
    assert asked == [
        {"effort": QUICK, "seed": 0, "threads": 0},
        {"effort": FULL, "seed": 7, "threads": 2},
    ]


@pytest.mark.usefixtures("no_plots")
def test_command_when_a_bound_fails(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    failing: Stability,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(stability, "measure", lambda *_, **__: failing)
    assert run("evaluate", "stability", "--out", tmp_path / "out") == 1
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == FILES
    out = capsys.readouterr().out
    assert out.count("FAILS") == 2
    assert f"2 of {BOUNDS} bounds fail" in out


@pytest.mark.usefixtures("asked", "no_plots")
def test_command_overwrites_only_its_own(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    out.mkdir()
    (out / "holiday.jpg").write_bytes(b"")
    for extra in ((), ("--overwrite",)):
        assert run("evaluate", "stability", "--out", out, *extra) == 2
        assert capsys.readouterr().err.startswith(f"pbrfit: {out}: expected")
    assert [path.name for path in tmp_path.iterdir()] == ["out"]
    assert [path.name for path in out.iterdir()] == ["holiday.jpg"]


def test_command_leaves_nothing_behind(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(*_: Any, **__: Any) -> Stability:
        raise KeyboardInterrupt

    monkeypatch.setattr(stability, "measure", interrupted)
    assert run("evaluate", "stability", "--out", tmp_path / "a" / "b") == 130
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("arguments", [(), ("speed", "--out", "out"), ("stability",)])
def test_command_with_bad_arguments(
    arguments: tuple[str, ...], capsys: pytest.CaptureFixture[str]
) -> None:
    assert run("evaluate", *arguments) == 2
    assert capsys.readouterr().err.count("\n") == 1
