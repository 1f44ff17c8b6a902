"""The example, run as users run it; a script of a user, checked as typed users check theirs."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

import pbrfit

EXAMPLE = Path(__file__).resolve().parents[3] / "examples" / "one_photograph.py"


@pytest.mark.slow
def test_one_photograph_becomes_materials(tmp_path: Path) -> None:
    out = tmp_path / "out"
    command = [sys.executable, str(EXAMPLE), "--out", str(out), "--size=160", "--iterations=3"]
    ran = subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)
    assert ran.returncode == 0, ran.stderr
    report = json.loads((out / "scene" / "review.json").read_text())
    damaged = {one["name"]: one["accepted"] for one in report["pictures"] if "-" in one["name"]}
    assert len(damaged) == 3
    assert not damaged["light_04-shift"]
    assert sum(damaged.values()) <= 1, damaged  # on pictures this small a repaint may escape
    assert sum(one["accepted"] for one in report["pictures"]) >= 8
    assert "photo" in pbrfit.Result.load(out / "result").pictures


SCRIPT = """
import pbrfit
scene = pbrfit.Scene.load("photos", max_size=512)
result: pbrfit.Result = pbrfit.decompose(scene, iterations=5, priors=pbrfit.Priors())
levels: list[str] = [verdict.level for verdict in result.verdicts.values()]
relit = pbrfit.relight(result, pbrfit.DirectionalLight(-40, 30)) + result.relight(picture=0)
error: float = float(relit.max()) + result.metrics["recon_rmse"]
files: list[str] = [file.path for file in result.export("out", preset="blender").files]
objective = pbrfit.Objective(scene)
materials, lighting = objective.unpack(objective.value_and_grad(objective.start())[1])
weights, slopes = pbrfit.kernel.ggx_band_weights(materials.roughness)
"""


@pytest.mark.slow
@pytest.mark.parametrize(("script", "errors"), [(SCRIPT, 0), ("import pbrfit\npbrfit.no", 1)])
def test_a_strict_type_checker_takes_a_script(script: str, errors: int, tmp_path: Path) -> None:
    pytest.importorskip("mypy")
    (tmp_path / "script.py").write_text(script, "utf-8")
    command = [sys.executable, "-m", "mypy", "--strict", "--config-file=", "script.py"]
    where = os.environ | {"MYPYPATH": str(Path(pbrfit.__file__).parents[1])}
    ran = subprocess.run(command, cwd=tmp_path, env=where, capture_output=True, text=True)
    assert ran.returncode == errors, ran.stdout
