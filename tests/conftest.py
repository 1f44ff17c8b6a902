"""Fixtures of all tests: where shared data lies, a scene folder, fits without a comparison."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from scene_files import write_folder

REPOSITORY = Path(__file__).resolve().parents[1]


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """The shared data folder: PBRFIT_DATA, else ../shared/data beside the repository."""
    folder = Path(os.environ.get("PBRFIT_DATA", REPOSITORY.parent / "shared" / "data"))
    if not folder.is_dir():
        pytest.skip("no shared data: set PBRFIT_DATA")
    return folder


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder of a room's pictures in float EXR, with normals and its field of view."""
    return write_folder(tmp_path / "scene")


@pytest.fixture
def uncompared(monkeypatch: pytest.MonkeyPatch) -> None:
    """Fits compare no explanations, which takes most of the time of a small one.

    For tests of what follows the choice of an explanation; fit/test_compare.py tests the choice.
    """
    monkeypatch.setattr("pbrfit.fit.settings.COMPARE_KEPT_MIN", 1 << 20)
