"""`pbrfit decompose --strict`: what a result without a usable map does to the exit code."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from command_runs import Ran, ran
from pbrfit.fit.decompose import decompose
from pbrfit.result.result import Result
from pbrfit.result.verdict import PARAMETERS, USABLE_MAX, Verdict, level_of
from scene_files import known, write_folder

FEW = ("--iterations", 0, "--no-report", "--quiet")
LIMIT = USABLE_MAX["albedo"]


@pytest.fixture
def errors(monkeypatch: pytest.MonkeyPatch) -> dict[str, float]:
    """Expected error of albedo by the name of the scene; that of all other maps is 0.5."""
    of_albedo: dict[str, float] = {}

    def fit(scene: Any, *arguments: Any, **options: Any) -> Result:
        result = decompose(scene, *arguments, **options)
        expected = dict.fromkeys(PARAMETERS, 0.5) | {"albedo": of_albedo[scene.source.path.name]}
        verdicts = {n: Verdict(level_of(n, error), error) for n, error in expected.items()}
        return replace(result, uncertainty=replace(known(result.uncertainty), verdicts=verdicts))

    monkeypatch.setattr("pbrfit.fit.decompose.decompose", fit)
    return of_albedo


@pytest.mark.parametrize(("error", "code"), [(LIMIT, 0), (1.001 * LIMIT, 3)])
def test_one_scene(tmp_path: Path, errors: dict[str, float], error: float, code: int) -> None:
    scene, out = write_folder(tmp_path / "scene"), tmp_path / "out"
    errors["scene"] = error
    found = ran("decompose", scene, "--out", out, *FEW, "--strict")
    said = (
        f"pbrfit: {scene}: no usable map: albedo rough guide, roughness not determined, metallic "
    )
    assert found == Ran(code, "", f"{said}not determined\n" if code else "")
    assert Result.load(out).uncertainty is not None  # written all the same
    assert ran("decompose", scene, "--out", out, *FEW, "--overwrite").err == ""
    # A result that is kept is judged as it was.
    again = ran("decompose", scene, "--out", out, *FEW, "--resume", "--strict")
    assert again == found


def test_several_scenes(tmp_path: Path, errors: dict[str, float]) -> None:
    folder, out = tmp_path / "scenes", tmp_path / "out"
    for name in ("one", "two"):
        write_folder(folder / name)
    errors.update(one=0.05, two=0.12)
    run = ("decompose", folder, "--out", out, *FEW, "--strict", "--overwrite")
    found = ran(*run, "--json")
    assert found.code == 3
    lines = [json.loads(line) for line in found.out.splitlines()]
    assert [line["verdicts"]["albedo"]["level"] for line in lines] == ["usable", "rough guide"]
    assert [line["status"] for line in lines] == ["done", "done"]
    complaint, summary = found.err.splitlines()
    assert complaint.startswith(f"pbrfit: {folder / 'two'}: no usable map: albedo rough guide, ")
    assert summary == f"pbrfit: 1 of 2 scenes have no usable map: {folder / 'two'}"
    errors["two"] = 0.05
    assert ran(*run) == Ran(0, "", "")
    # A scene that failed is worse than one that tells little.
    errors["two"] = 0.12
    (folder / "one" / "normals.exr").write_bytes(b"")
    found = ran(*run)
    assert found.code == 1
    assert f"{folder / 'two'}: no usable map" in found.err
    (folder / "two" / "normals.exr").write_bytes(b"")
    found = ran(*run)
    assert found.code == 2
    assert "no usable map" not in found.err
