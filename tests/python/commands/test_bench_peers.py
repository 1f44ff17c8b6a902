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

from pbrfit import _core
from peers import race
from peers.case import Case
from peers.race import Settings, Standing
from peers.roster import OURS, ROSTER, Entry
from peers.worker import Ready

REPOSITORY = Path(__file__).resolve().parents[3]
ENTRIES = {entry.name: entry for entry in ROSTER}


@pytest.mark.parametrize("name", [name for name in ENTRIES if name != OURS])
@pytest.mark.parametrize(("pixels", "pictures"), [(37, 3), (9000, 6)])
@pytest.mark.parametrize("threads", [1, 2])
def test_peers_agree_with_the_core(name: str, pixels: int, pictures: int, threads: int) -> None:
    pytest.importorskip(ENTRIES[name].package)
    if "GPU" in name and not pytest.importorskip("torch").cuda.is_available():
        pytest.skip("no GPU")
    case = Case.make(pixels, pictures, seed=pixels)
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


def own(name: str) -> Entry:
    return Entry(name, "numpy", "test_bench_peers", name)


def test_peers_that_cannot_take_part_are_named_with_the_reason() -> None:
    entries = [
        ENTRIES["pbrfit"],
        Entry("absent", "absent", "peers_of_no_such_name", "Absent"),
        own("Wrong"),
        own("Dies"),
    ]
    ours, absent, wrong, dies = race.race(entries, Settings(16, 2, (1,), 2))
    assert ours.status == "ok"
    assert ours.times is not None
    assert ours.times.median_ms > 0
    assert ours.gradient_error == 0
    for standing in (absent, wrong, dies):
        assert standing.times is None
    assert absent.status == "ModuleNotFoundError: No module named 'peers_of_no_such_name'"
    assert wrong.status.startswith("disagrees: ")
    assert "roughness 1.0e-02" in wrong.status
    assert "albedo 0.0e+00" in wrong.status
    assert dies.status == "its process ended with code 3"


def test_tolerances_at_their_borders() -> None:
    gradient = np.ones(16)
    case = Case.make(2, 1)
    assert case.x.size == 10 + 48
    ready = Ready(1.0, gradient.copy(), "1", ())
    standing = Standing("peer", "package", 1)
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


def test_command_wants_figures_for_its_own_numbers_of_threads(tmp_path: Path) -> None:
    bench = tmp_path / "machine.json"
    bench.write_text(json.dumps({"vector_bits": 256, "measured": []}), encoding="utf-8")
    ran = run("--quick", "--machine", bench)
    assert ran.returncode != 0
    assert ran.stderr.strip().endswith(f"{bench}: expected figures for 1 threads, found none")


def standing(name: str, threads: int, ms: float | None) -> Standing:
    times = None if ms is None else race.Times(ms, (ms, ms), 1.0, 0.0)
    return Standing(name, "package", threads, "ok" if ms else "lost", times=times)
