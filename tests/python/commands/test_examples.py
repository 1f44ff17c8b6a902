"""The example, run as users run it."""

from __future__ import annotations

import json
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
