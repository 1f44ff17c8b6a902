"""Files of a result folder, those that the command writes, and keys of `result.json`."""

from __future__ import annotations

FILES = ["history.csv", "lighting.json", "materials.exr", "preview.png", "result.json"]
WITH_REPORT = sorted([*FILES, "report.html"])
KEYS = [
    *("version", "status", "stop_reason", "fov", "model", "iterations", "evaluations"),
    *("seconds", "protocol", "metrics", "uncertainty", "normals", "camera"),
    *("transport", "held_out", "verdicts"),
    *("options", "assumed", "left_out"),
    *("stages", "inputs", "scene", "files"),
]
