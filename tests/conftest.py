"""Where the shared test data lies."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).resolve().parents[1]


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """The shared data folder: PBRFIT_DATA, else ../shared/data beside the repository."""
    folder = Path(os.environ.get("PBRFIT_DATA", REPOSITORY.parent / "shared" / "data"))
    if not folder.is_dir():
        pytest.skip("no shared data: set PBRFIT_DATA")
    return folder
