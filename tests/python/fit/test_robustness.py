"""What the whole program promises: same bits anywhere, stops when told, survives forks."""

from __future__ import annotations

import csv
import json
import os
import signal
import subprocess
import sys
import time
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pbrfit import Result, Scene, decompose
from pbrfit.result.options import SOLVERS, Solver
from pbrfit.synthetic import make_scene
from processes import running
from result_files import WITH_REPORT
from scene_files import room, run

PBRFIT = (sys.executable, "-m", "pbrfit")
PATIENCE = 60.0
"""Seconds after which a process counts as hung; it should need two or so."""


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A scene of many blocks of pixels, so that threads have something to share."""
    path = tmp_path_factory.mktemp("scenes") / "scene"
    make_scene("room", size=64, lights=6, held_out=1).save(path)
    return path


def comparable(out: Path) -> dict[str, Any]:
    """Contents of a result folder, timings apart."""
    content: dict[str, Any] = {
        name: (out / name).read_bytes()
        for name in ("materials.exr", "lighting.json", "preview.png")
    }
    facts = json.loads((out / "result.json").read_text("utf-8"))
    del facts["seconds"]
    del facts["files"]["history.csv"]  # its digest: there are times in it
    for stage in facts["stages"]:
        del stage["seconds"]
    content["result.json"] = facts
    with (out / "history.csv").open(newline="") as file:
        content["history.csv"] = [row[1:] for row in csv.reader(file)]
    return content


ONE_PROCESSOR = """
import os, sys
os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
from pbrfit.cli import main
sys.exit(main(sys.argv[1:]))
"""


@pytest.mark.slow
@pytest.mark.parametrize("solver", SOLVERS)
def test_results_do_not_depend_on_threads_or_processors(
    scene: Path, tmp_path: Path, solver: str
) -> None:
    options = (
        "--solver",
        solver,
        "--iterations",
        "80",
        "--refine-normals",
        "off",
        "--quiet",
        "--out",
    )
    arguments = ("decompose", str(scene), *options)
    for threads in ("1", "2", "3", "0"):
        assert run(*arguments, tmp_path / threads, "--threads", threads) == 0
    expected = comparable(tmp_path / "1")
    for threads in ("2", "3", "0"):
        assert comparable(tmp_path / threads) == expected
    if not hasattr(os, "sched_setaffinity"):
        pytest.skip("processors cannot be restricted here")
    command = (sys.executable, "-c", ONE_PROCESSOR, *arguments, str(tmp_path / "restricted"))
    subprocess.run(command, check=True, timeout=PATIENCE)
    assert comparable(tmp_path / "restricted") == expected


@cache
def exposed(factor: float, solver: Solver) -> Result:
    """A fit of pictures that are so many times as bright."""
    images = room().images * np.float32(factor)
    return decompose(Scene(images, room().normals), solver=solver, iterations=40)


@pytest.mark.parametrize("solver", SOLVERS)
def test_materials_do_not_depend_on_exposure_by_a_power_of_2(solver: Solver) -> None:
    factor = 2.0**10
    result, reference = exposed(factor, solver), exposed(1.0, solver)
    for name in ("albedo", "roughness", "metallic"):
        np.testing.assert_array_equal(getattr(result, name), getattr(reference, name))
    np.testing.assert_array_equal(result.lighting, reference.lighting * factor)
    np.testing.assert_array_equal(result.history["loss"], reference.history["loss"])
    recon = reference.history["recon_rmse"] * factor
    np.testing.assert_array_equal(result.history["recon_rmse"], recon)


def test_a_time_limit_ends_with_a_whole_result(scene: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    # The other solvers are done before that.
    arguments = ("--solver", "lbfgsb", "--iterations", 10**6, "--time-limit", 0.3, "--quiet")
    assert run("decompose", scene, "--out", out, *arguments) == 0
    assert sorted(path.name for path in out.iterdir()) == WITH_REPORT
    result = Result.load(out)
    assert result.status == "time_limit"
    assert "0.3 s" in result.stop_reason
    assert result.options.time_limit == 0.3
    assert 0.3 <= result.seconds < 5


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no SIGINT for one process")
@pytest.mark.parametrize(
    ("command", "old", "number"),
    [
        ("decompose", True, signal.SIGTERM),
        ("demo", False, signal.SIGINT),
    ],
)
def test_a_signal_stops_within_a_second_and_leaves_what_was_there(
    scene: Path, tmp_path: Path, command: str, old: bool, number: signal.Signals
) -> None:
    out = tmp_path / "out"
    parts: tuple[str, ...] = ("result.json", "materials.exr")
    if command == "demo":
        parts = ("scene/scene.toml", "result/result.json")
    if old:
        for part in parts:
            (out / part).parent.mkdir(parents=True, exist_ok=True)
            (out / part).write_text("old")
    arguments: tuple[str | Path, ...] = ("decompose", scene, "--out", out)
    if command == "demo":
        arguments = ("demo", out, "--size", "64")
    # The other solvers are done before the signal comes.
    arguments = (*arguments, "--solver", "lbfgsb", "--iterations", "1000000", "--overwrite")
    with running(*PBRFIT, *arguments) as process:
        deadline = time.monotonic() + PATIENCE
        while not list(tmp_path.glob(".pbrfit-*")):
            assert process.poll() is None, process.communicate()
            assert time.monotonic() < deadline
            time.sleep(0.01)
        time.sleep(0.5)  # well into the fit
        assert not list(out.glob("*")) or old
        sent = time.monotonic()
        process.send_signal(number)
        stdout, stderr = process.communicate(timeout=PATIENCE)
        assert time.monotonic() - sent < 1.0
    # Python itself ends by the signal when it came amid an exec(); a shell says 130 of both.
    assert process.returncode in (128 + number, -number)
    assert stdout == ""
    if number == signal.SIGINT:
        assert stderr == "pbrfit: interrupted; no unfinished result was left behind\n"
    found = {str(path.relative_to(tmp_path)) for path in tmp_path.rglob("*") if path.is_file()}
    assert found == ({f"out/{part}" for part in parts} if old else set())
    assert old or not list(tmp_path.iterdir())


WORKERS = """
import multiprocessing, sys, threading
import numpy as np
import pbrfit

def fit(seed, iterations=3):
    images = np.random.default_rng(seed).uniform(0.1, 1.0, (3, 40, 40, 3))
    normals = np.zeros((40, 40, 3))
    normals[..., 2] = 1.0
    scene = pbrfit.Scene(images=images, normals=normals)
    return pbrfit.decompose(scene, iterations=iterations, threads=2).metrics["recon_rmse"]

if __name__ == "__main__":
    method, busy = sys.argv[1:]
    expected = [fit(seed) for seed in range(4)]
    if busy == "busy":
        threading.Thread(target=fit, args=(9, 10**9), daemon=True).start()
    with multiprocessing.get_context(method).Pool(2) as pool:
        assert pool.map(fit, range(4)) == expected
    print("same results", flush=True)
    import os
    os._exit(0)  # without waiting for the thread
"""


@pytest.mark.slow
@pytest.mark.parametrize("busy", ["idle", "busy"])
@pytest.mark.parametrize("method", ["fork", "spawn", "forkserver"])
def test_workers_of_a_process_that_used_the_library(tmp_path: Path, method: str, busy: str) -> None:
    if method != "spawn" and sys.platform == "win32":
        pytest.skip("Windows cannot fork")
    script = tmp_path / "workers.py"
    script.write_text(WORKERS)
    done = subprocess.run(
        [sys.executable, "-W", "ignore::DeprecationWarning", script, method, busy],
        capture_output=True,
        text=True,
        timeout=PATIENCE,
        check=False,
    )
    assert (done.stdout, done.returncode) == ("same results\n", 0), done.stderr
