"""The one task whose record is damaged."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from pbrfit_evaluation import jobs


@dataclass(frozen=True)
class Task:
    """A task of a suite."""

    key: str
    number: int


TASK = Task("task", 3)


def work(task: Task, threads: int) -> jobs.Values:
    """Values of every kind that records hold."""
    return {"number": task.number, "threads": threads, "curve": [0.5, 1.5], "name": "a"}


def write_record(folder: Path, task: Task) -> None:
    """A folder with the task's record."""
    (folder / jobs.RECORDS).mkdir(parents=True)
    jobs.run([task], work, folder)
