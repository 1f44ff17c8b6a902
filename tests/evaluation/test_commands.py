"""Every suite as a command: its files, exit code and records; what figures are is elsewhere."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any

import pytest

from pbrfit_evaluation import cycles
from pbrfit_evaluation.ablation.measure import TITLES as ABLATED
from scene_files import run

TINY = ("--scenes", 1, "--size", 12)
NOWHERE = ("--marigold", "nowhere", "--rgbx", "nowhere")
ROWS = ("base", "normals-refined", "regularized", "cycles-panorama")
SHORT = ("--lights", 4, "--iterations", 3, "--model", "paper", "--ways", "default", "constant")

COMMANDS: dict[str, tuple[tuple[Any, ...], int, set[str]]] = {
    "ablation": (
        (*TINY, "--quick", "--iterations", 2),
        15,
        {f"room-{name}.png" for name in ABLATED},
    ),
    "convergence": (("--quick",), 0, {"points.csv", "recon.png", "relight.png"}),
    "everyday": ((*TINY, "--disturbances", "shifted", "fov-wrong"), 4, {"everyday-maps.png"}),
    "gap": (("--quick",), 5, {"albedo.png", "ratio.png", "spheres.png"}),
    "generated": (("--quick",), 6, {"inputs.png", "maps.png"}),
    "lamps": (("--quick",), 0, set()),
    "normals": (
        (*TINY, "--degrees", 20, "--iterations", 3, "--disturbances", "biased"),
        7,
        {"normals.png"},
    ),
    "peers": ((*TINY, *NOWHERE, "--quick"), 2, {"maps-own.png"}),
    "review": (("--quick",), 2, {"judged.csv"}),
    "solvers": ((*TINY, "--quick", "--iterations", 3), 13, set()),
    "stability": (("--quick",), 6, set()),
    "table1": (
        (*TINY, "--quick", *SHORT, "--rows", *ROWS),
        4,
        {"table1.png", "maps-base.png", "maps-regularized.png"},
    ),
    "transport": (("--quick",), 0, set()),
    "uncertainty": ((*TINY, "--rows", "noise", "grey"), 2, {"verdicts.png"}),
}
"""Options by suite, cases, and files beside those of every suite."""

QUICK = ("lamps", "transport")


@pytest.mark.parametrize(
    "name",
    [pytest.param(name, marks=() if name in QUICK else pytest.mark.slow) for name in COMMANDS],
)
def test_a_command_writes_its_files_and_goes_on_from_its_records(
    name: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(cycles, "why_not", lambda: "no bpy")
    out, (options, cases, files) = tmp_path / "out", COMMANDS[name]
    command = ("evaluate", name, "--out", out, "--jobs", 1, *options)
    code = run(*command)
    told = capsys.readouterr()
    assert f"Look at {out / 'report.html'}" in told.out
    assert "failed" not in told.err
    rows = json.loads((out / "summary.json").read_text("utf-8"))["rows"]
    held = "not held" not in [row["status"] for row in rows]
    assert code == (0 if held else 1)
    assert held == ("FAILS" not in told.out)
    assert held or name != "stability"
    usual = {"records", "report.html", f"{name}.md", "scenes.csv", "summary.json"}
    assert {path.name for path in out.iterdir()} == usual | files
    records = {path: path.stat().st_mtime_ns for path in (out / "records").iterdir()}
    with (out / "scenes.csv").open(newline="", encoding="utf-8") as file:
        assert len(list(csv.DictReader(file))) == len(records)
    assert len(records) == cases or not cases
    if not records:
        assert {row["status"] for row in rows} == {"not run: no bpy"}
        return
    assert run(*command, "--resume", "--quiet") == code
    assert {path: path.stat().st_mtime_ns for path in records} == records
