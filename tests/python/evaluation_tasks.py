"""Tasks for tests of `evaluation.jobs`, in a file that worker processes can import."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any


@dataclass(frozen=True)
class Task:
    """Writes its name into a folder, then does as it is told."""

    key: str
    folder: Path
    act: str = "well"


def work(task: Task, threads: int) -> dict[str, Any]:
    """Leave a trace of every attempt, then end in one of several ways."""
    with (task.folder / f"{task.key}.trace").open("a", encoding="utf-8") as file:
        file.write("attempt\n")
    if task.act == "raise":
        raise ValueError("two\nlines")
    if task.act == "die":
        os._exit(7)
    if task.act == "interrupt":
        raise KeyboardInterrupt
    return {"name": task.key, "threads": threads}
