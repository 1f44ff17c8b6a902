"""The Blender extension, installed from the .zip of an export, and what it makes of the export."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pbrfit.export.blender import ZIP_FILE
from pbrfit_evaluation.cycles.process import find_python, run_worker

WORKER = Path(__file__).with_name("blender_extension_worker.py")


@dataclass(frozen=True)
class Import:
    """A run of the import operator with these options, and of the light's where there are some.

    `samples` of Cycles; 0 renders nothing. `png`: a picture for the eye, too.
    """

    name: str
    options: dict[str, Any] = field(default_factory=dict)
    then: dict[str, Any] = field(default_factory=dict)
    samples: int = 256
    png: bool = False


def imported(
    folder: Path, export: Path, runs: Sequence[Import], timeout: float = 600
) -> tuple[dict[str, Any], dict[str, NDArray[np.float32]]]:
    """What Blender says of each run, and pictures (H, W, 4) by name; `folder` is for files."""
    folder.mkdir(parents=True)
    job = {
        "zip": str(export / ZIP_FILE),
        "export": str(export / "export.json"),
        "renders": [asdict(of) for of in runs],
    }
    (folder / "job.json").write_text(json.dumps(job), encoding="utf-8")
    run_worker(find_python(), folder, timeout, worker=WORKER)
    facts = json.loads((folder / "facts.json").read_text(encoding="utf-8"))
    found = {of.name: folder / f"{of.name}.npy" for of in runs}
    return facts, {name: np.load(path) for name, path in found.items() if path.exists()}
