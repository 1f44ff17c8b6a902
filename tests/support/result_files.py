"""Files of a result folder, those that the command writes, and keys of `result.json`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import OpenEXR
from numpy.typing import NDArray

from pbrfit.result.camera import Camera

FILES = ["history.csv", "lighting.json", "materials.exr", "preview.png", "result.json"]
WITH_REPORT = sorted([*FILES, "report.html"])
KEYS = [
    *("version", "model", "iterations", "protocol"),
    *("fov", "status", "stop_reason", "evaluations", "seconds", "metrics", "options", "assumed"),
    *("left_out", "inputs", "stages", "camera", "transport", "held_out"),
    *("uncertainty", "normals", "verdicts", "scene", "files"),
]
CONTRADICTED = Camera(
    60.0, "given", contradicted=True, figures={"other_fov_degrees": 88.0, "other_fov_sigma": 2.0}
)
"""A field of view that the pictures contradict."""


def layers_of(path: Path) -> dict[str, NDArray[Any]]:
    """Planes of an EXR file by the names of their channels, by OpenEXR's own reader."""
    [part] = OpenEXR.File(str(path), separate_channels=True).parts
    return {name: channel.pixels for name, channel in part.channels.items()}
