"""The examples, run as users run them."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import pbrfit

EXAMPLES = Path(__file__).resolve().parents[3] / "examples"


def run(
    *arguments: str | Path, example: str = "real_pictures.py"
) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, EXAMPLES / example, *arguments]
    return subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "result", "pictures"),
    [
        ("bunny_ps", "bunny_specular_25", 25),
        ("bunny_ps", "bunny_lambert_noshadow_12", 12),
        ("visiont3lab_shrek", "visiont3lab_shrek", 8),
    ],
)
def test_real_pictures_are_decomposed(
    shared_data: Path, tmp_path: Path, name: str, result: str, pictures: int
) -> None:
    if not (shared_data / name).is_dir():
        pytest.skip(f"no {name} in the shared data")
    ran = run(shared_data / name, "--out", tmp_path, "--iterations", "3", "--max-size", "100")
    assert ran.returncode == 0, ran.stderr
    assert ran.stderr == ""
    found = pbrfit.Result.load(tmp_path / result / "result")
    assert len(found.pictures) == pictures
    assert max(found.mask.shape) == 100
    if name == "visiont3lab_shrek":
        assert found.assumed["color"] == "sRGB (8-bit PNG without a profile)"
    assert found.fov == 0
    # No normal points away, and none leans so far that its axes can have been misread.
    assert (found.normals[found.mask][:, 2] > 0).all()
    assert np.abs(found.normals[found.mask].mean(axis=0)[:2]).max() < 0.15
    # Better than black pictures, and than the start.
    scene = pbrfit.Scene.load(tmp_path / result / "scene", max_size=100)
    radiance = scene.images[:, scene.valid]
    assert found.metrics["recon_rmse"] < np.sqrt(np.mean(np.square(radiance, dtype=np.float64)))
    assert found.history["loss"][-1] < found.history["loss"][0]


def test_absent_data_is_named_with_source_and_licence(tmp_path: Path) -> None:
    ran = run(tmp_path / "nothing", "--out", tmp_path / "out")
    assert ran.returncode == 2
    for words in (
        "github.com/yasumat/RobustPhotometricStereo",
        "f03aa95b57e746a7d31df76b1c0fa0a83584a3c1",
        "GPL-3.0",
        "github.com/visiont3lab/photometric_stereo",
        "9ded70dfbbe409dd2e0a2a6946c71c180d47a926",
        "MIT",
        str(tmp_path / "nothing" / "bunny_ps"),
    ):
        assert words in ran.stdout
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_one_photograph_becomes_materials(tmp_path: Path) -> None:
    out = tmp_path / "out"
    ran = run("--out", out, "--size", "160", "--iterations", "3", example="one_photograph.py")
    assert ran.returncode == 0, ran.stderr
    report = json.loads((out / "scene" / "review.json").read_text())
    damaged = {one["name"]: one["accepted"] for one in report["pictures"] if "-" in one["name"]}
    assert len(damaged) == 3
    assert not damaged["light_04-shift"]
    assert sum(damaged.values()) <= 1, damaged  # on pictures this small a repaint may escape
    assert sum(one["accepted"] for one in report["pictures"]) >= 8
    assert "photo" in pbrfit.Result.load(out / "result").pictures
