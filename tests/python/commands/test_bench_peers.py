"""The benchmark against other frameworks: what it claims does not need them installed."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import pbrfit
from pbrfit import _core
from peers import race, scaling
from peers.case import BAND_OF, BANDS, Case, band_polynomials
from peers.machine import Machine
from peers.outcome import Outcome
from peers.race import Settings, Standing
from peers.roster import ROSTER, Entry
from peers.scaling import Point
from peers.worker import Ready

REPOSITORY = Path(__file__).resolve().parents[3]
ENTRIES = {entry.name: entry for entry in ROSTER}


def test_band_polynomials_are_as_close_as_stated() -> None:
    r = np.linspace(0, 1, 2001)
    found = [np.polynomial.Polynomial(c)(2 * r - 1) for c in band_polynomials()]
    np.testing.assert_allclose(np.stack(found, axis=-1), pbrfit.ggx_band_weights(r)[0], atol=3e-6)


def test_bands_hold_their_coefficients() -> None:
    found = [degree for degree, band in enumerate(BANDS) for _ in range(16)[band]]
    assert found == list(BAND_OF)


@pytest.mark.parametrize("name", ["numpy whole arrays", "numpy blocks"])
@pytest.mark.parametrize("pixels", [37, 9000])
@pytest.mark.parametrize("threads", [1, 2])
def test_numpy_peers_agree_with_the_core(name: str, pixels: int, threads: int) -> None:
    case = Case.make(pixels, 3, seed=pixels)
    problem = _core.Problem(case.images, case.normals, case.views, threads=1)
    loss, gradient = problem.value_and_grad(case.x)
    peer = ENTRIES[name].load()(case, threads)
    assert peer.evaluate() == pytest.approx(loss, rel=1e-6)
    borders = [3 * pixels, 4 * pixels, 5 * pixels]
    for found, expected in zip(
        np.split(peer.gradient(), borders), np.split(gradient, borders), strict=True
    ):
        assert np.linalg.norm(found - expected) <= 1e-3 * np.linalg.norm(expected)


class Wrong:
    """A peer whose gradient by roughness is off by 1 %."""

    def __init__(self, case: Case, threads: int) -> None:
        self._problem = _core.Problem(case.images, case.normals, case.views, threads=threads)
        self._case = case

    def evaluate(self) -> float:
        return self._problem.value_and_grad(self._case.x)[0]

    def gradient(self) -> NDArray[np.float64]:
        gradient = self._problem.value_and_grad(self._case.x)[1]
        gradient[3 * self._case.pixels : 4 * self._case.pixels] *= 1.01
        return gradient


class Dies:
    """A peer whose process ends."""

    def __init__(self, _case: Case, _threads: int) -> None:
        raise SystemExit(3)


class Fails:
    """A peer that cannot be made."""

    def __init__(self, _case: Case, _threads: int) -> None:
        raise RuntimeError("cannot open /opt/somewhere/else/compiler.h\nmore")


def own(name: str) -> Entry:
    return Entry(name, "numpy", "test_bench_peers", name)


def test_peers_that_cannot_take_part_are_named_with_the_reason() -> None:
    entries = [
        ENTRIES["pbrfit"],
        Entry("absent", "absent", "peers_of_no_such_name", "Absent"),
        own("Wrong"),
        own("Fails"),
        own("Dies"),
    ]
    ours, absent, wrong, fails, dies = race.race(entries, Settings(16, 2, 1, 2), {}, "test")
    assert ours.status == "ok"
    assert ours.times is not None
    assert ours.times.median_ms > 0
    assert ours.gradient_error == 0
    for standing in (absent, wrong, fails, dies):
        assert standing.times is None
    assert absent.status == "ModuleNotFoundError: No module named 'peers_of_no_such_name'"
    assert wrong.status.startswith("disagrees: ")
    assert "roughness 1.0e-02" in wrong.status
    assert "albedo 0.0e+00" in wrong.status
    assert fails.status == "RuntimeError: cannot open compiler.h"
    assert dies.status == "its process ended with code 3"


def test_a_peer_that_ends_between_turns_withdraws() -> None:
    seat = race.Seat(ENTRIES["pbrfit"], Settings(8, 2, 1, 2))
    try:
        seat.ready()
        seat._process.kill()
        seat._process.join()
        with pytest.raises(race.WithdrawnError, match="its process ended with code"):
            seat.turn()
    finally:
        seat.leave()


def test_tolerances_at_their_borders() -> None:
    gradient = np.ones(16)
    case = Case.make(2, 1)
    assert case.x.size == 10 + 48
    ready = Ready(1.0, gradient.copy(), "1", ())
    standing = Standing("peer", "package")
    assert race.checked(standing, ready, 1.0, gradient, 2).status == "ok"
    for loss, status in ((1 + 0.9e-4, "ok"), (1 + 1.1e-4, "disagrees"), (np.nan, "disagrees")):
        off = Ready(loss, gradient.copy(), "1", ())
        assert race.checked(standing, off, 1.0, gradient, 2).status.startswith(status)
    for part in (slice(0, 6), slice(6, 8), slice(8, 10), slice(10, 16)):
        for factor, status in ((1 + 0.9e-3, "ok"), (1 + 1.1e-3, "disagrees"), (np.nan, "dis")):
            theirs = gradient.copy()
            theirs[part] *= factor
            off = Ready(1.0, theirs, "1", ())
            assert race.checked(standing, off, 1.0, gradient, 2).status.startswith(status)


def run(*arguments: str | Path, without: Path | None = None) -> subprocess.CompletedProcess[str]:
    """The command, with `without` in front on the path that Python finds modules by."""
    path = os.pathsep.join(str(p) for p in (without, REPOSITORY / "benches") if p)
    how: dict[str, Any] = {"capture_output": True, "encoding": "utf-8", "timeout": 300}
    command = [sys.executable, "-m", "peers", *arguments]
    return subprocess.run(command, env=os.environ | {"PYTHONPATH": path}, check=False, **how)


@pytest.mark.slow
def test_command_reports_a_missing_peer(tmp_path: Path) -> None:
    hidden = tmp_path / "hidden"
    hidden.mkdir()
    (hidden / "torch.py").write_text("raise ImportError('torch is not here')\n", encoding="utf-8")
    bench = tmp_path / "machine.json"
    measured = {"threads": 1, "fma_gflops": 100.0, "memory_gbs": 10.0}
    bench.write_text(json.dumps({"vector_bits": 256, "measured": [measured]}), encoding="utf-8")
    ran = run(
        *("--quick", "--size", "24", "--pictures", "3", "--threads", "1", "--rounds", "2"),
        *("--machine", bench, "--out", tmp_path / "out"),
        *("--peers", "numpy blocks", "torch eager matrix"),
        without=hidden,
    )
    assert ran.returncode == 0, ran.stderr
    assert "ImportError: torch is not here" in ran.stdout
    found = json.loads((tmp_path / "out" / "peers.json").read_text(encoding="utf-8"))
    told = {"size": 24, "pictures": 3, "threads": 1, "rounds": 2}
    assert (told | {"fma_peak_gflops": 100.0, "memory_gbs": 10.0}).items() <= found.items()
    *there, torch = found["rows"]
    assert sorted(row["name"] for row in there) == ["numpy blocks", "pbrfit"]
    assert torch["name"] == "torch eager matrix"
    assert torch["status"] == "ImportError: torch is not here"
    assert torch["median_ms"] is None
    [ours] = [row for row in there if row["name"] == "pbrfit"]
    for row in there:
        assert row["status"] == "ok"
        lower, upper = row["quartiles_ms"]
        assert 0 < lower <= row["median_ms"] <= upper
        assert row["ratio_to_ours"] == pytest.approx(row["median_ms"] / ours["median_ms"], rel=1e-2)
        operations = 99 * 3 * 24 * 24 * 3
        assert row["fraction_of_peak"] == pytest.approx(
            operations / (row["median_ms"] * 1e-3 * 100e9), rel=1e-2
        )
        if sys.platform == "linux":
            assert row["peak_mib"] > 0
    page = (tmp_path / "out" / "peers.md").read_text(encoding="utf-8")
    assert "torch eager matrix: ImportError: torch is not here" in page
    assert str(tmp_path) not in page
    assert (tmp_path / "out" / "peers.png").read_bytes().startswith(b"\x89PNG")


def test_command_wants_figures_for_its_own_number_of_threads(tmp_path: Path) -> None:
    bench = tmp_path / "machine.json"
    bench.write_text(json.dumps({"vector_bits": 256, "measured": []}), encoding="utf-8")
    ran = run("--quick", "--machine", bench, "--out", tmp_path / "out")
    assert ran.returncode != 0
    assert ran.stderr.strip() == f"{bench}: expected figures for 2 threads, found none"


def test_rows_without_times_come_last() -> None:
    def standing(name: str, ms: float | None) -> Standing:
        times = None if ms is None else race.Times(ms, (ms, ms), 1.0, 0.0)
        return Standing(name, "package", "ok" if ms else "lost", times=times)

    outcome = Outcome.of_standings(
        [standing("b", None), standing("pbrfit", 2.0), standing("a", 1.0)],
        [standing("b", None), standing("pbrfit", 4.0), standing("a", None)],
        Settings(10, 1, 1, 1),
        Machine("test", 1, None, 256, 1.0, 1.0),
        tuned=True,
    )
    assert [row.name for row in outcome.rows] == ["a", "pbrfit", "b"]
    assert [row.status for row in outcome.rows] == ["lost", "ok", "lost"]
    assert outcome.ratio(outcome.rows[0]) == 0.5
    assert outcome.ratio_installed(outcome.rows[0]) is None
    assert outcome.fraction_of_peak(outcome.rows[1]) == pytest.approx(99 * 300 / 2e6)


def test_scaling_recovers_its_law() -> None:
    def ms(side: int, pictures: int) -> float:
        return 1e-6 * side * side * (20.0 + 3.0 * pictures)

    sizes = [(128, 16), (512, 16), (256, 8), (256, 64)]
    points = [Point(s, n, ms(s, n), (0.0, 0.0)) for s, n in sizes]
    fitted = scaling.fit(points, threads=1, rounds=1)
    assert fitted.per_pixel_ns == pytest.approx(20.0)
    assert fitted.per_sample_ns == pytest.approx(3.0)
    assert abs(fitted.deviation(fitted.worst)) < 1e-9
    off = [*points[:-1], Point(256, 64, 1.2 * ms(256, 64), (0.0, 0.0))]
    fitted = scaling.fit(off, threads=1, rounds=1)
    worst = abs(fitted.deviation(fitted.worst))
    assert worst == max(abs(fitted.deviation(point)) for point in off)
    assert 0.02 < worst < 0.2


def test_scaling_command_writes_points_and_picture(tmp_path: Path) -> None:
    ran = run("--scaling", "--quick", "--rounds", "1", "--threads", "1", "--out", tmp_path)
    assert ran.returncode == 0, ran.stderr
    found = json.loads((tmp_path / "scaling.json").read_text(encoding="utf-8"))
    points = {(p["size"], p["pictures"]) for p in found["points"]}
    assert points == {(64, 16), (128, 16), (256, 8), (256, 16)}
    assert max(abs(p["deviation"]) for p in found["points"]) == abs(found["worst_deviation"])
    assert (tmp_path / "scaling.png").read_bytes().startswith(b"\x89PNG")
