"""`summary.json`: what every suite writes for programs to read."""

from __future__ import annotations

import json
import math
import os
import platform
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path

import numpy as np

from pbrfit_evaluation.jobs import SUMMARY
from pbrfit_evaluation.suite import Row

CPUINFO = Path("/proc/cpuinfo")


def write_summary(
    folder: Path,
    protocol: str,
    rows: Sequence[Row],
    *,
    command: str,
    tables: Mapping[str, str],
) -> None:
    """Write `summary.json` into an existing folder.

    `protocol` is name and version of how things were measured: results under one name compare.
    `command` makes them again, without names of this machine; `tables` are those of the page as
    Markdown, by title.
    """
    content = {
        "protocol": protocol,
        "command": command,
        "date": f"{datetime.now(UTC):%Y-%m-%d}",
        "version": version("pbrfit"),
        "machine": machine(),
        "rows": [
            {
                "name": row.name,
                "scenes": row.scenes,
                "solver": row.solver,
                "metrics": _finite(row.metrics),
                "paper": row.paper,
                "status": row.status,
            }
            for row in rows
        ],
        "tables": [{"title": title, "markdown": text} for title, text in tables.items()],
    }
    private = sorted({row.name for row in rows if row.private})
    content |= {"private": private} if private else {}
    text = json.dumps(content, indent=1, ensure_ascii=False, allow_nan=False)
    (folder / SUMMARY).write_text(text + "\n", encoding="utf-8")


def machine() -> dict[str, str | int]:
    """What the measurements ran on."""
    return {
        "system": f"{platform.system()} {platform.machine()}",
        "processor": _processor(),
        "cores": os.cpu_count() or 1,
        "python": platform.python_version(),
        "numpy": np.__version__,
    }


def _processor() -> str:
    try:
        lines = CPUINFO.read_text(encoding="utf-8").splitlines()
    except OSError:
        lines = []
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor() or "unknown"


def _finite(metrics: Mapping[str, float | None]) -> dict[str, float | None]:
    return {
        name: value if value is not None and math.isfinite(value) else None
        for name, value in metrics.items()
    }
