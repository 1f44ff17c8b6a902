"""Many tasks in several processes, each result kept on disk: interrupted runs can go on.

Every task ends in a record, `records/KEY.json` in the folder of the suite, which is there whole or
not at all. A later run uses a record again if task and code are the same: the record holds a
digest of both. While a suite runs, its folder holds records, and perhaps a report of an earlier
run. Report and summary come last, one rename each, `summary.json` at the very end: a folder with a
summary is complete.
"""

from __future__ import annotations

import hashlib
import json
import logging
import os
import secrets
import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from typing import Any, Protocol, TypeVar

import pbrfit
import pbrfit_evaluation
from pbrfit.batch.driver import Attempt, drive, repeat_log, workers
from pbrfit.io.json_files import UNFIT, number, table
from pbrfit.io.output import FolderForm, check_free, new_file

RECORDS = "records"
"""Folder of the records, in that of the suite."""

SUMMARY = "summary.json"
"""File that makes the folder complete."""

SUITE_FOLDER = FolderForm(
    contains=(RECORDS,),
    holds=(f"{RECORDS}/*", SUMMARY, "report.html", "*.csv", "*.mat", "*.md", "*.png"),
)
"""Form of a suite's folder."""

_HEAD = b'{\n "digest": "'
"""What every record begins with."""

WRITERS = frozenset(
    {
        *("drawing.py", "html.py", "page.py", "plot.py", "plots.py"),
        *("report.py", "figures.py", "options.py", "suite.py"),
    }
)
WRITING_FOLDERS = frozenset({"commands", "report", "viewer"})
"""Files, and folders of files, that take no part in the results of a suite."""

Values = Mapping[str, Any]
"""What a task found: anything that JSON can hold."""


class Task(Protocol):
    """A frozen dataclass that can be pickled; its `repr` says everything that matters."""

    @property
    def key(self) -> str:
        """Unique name, fit for a file."""


T = TypeVar("T", bound=Task)


@dataclass(frozen=True)
class Record:
    """What became of a task: `values`, or in one line the `error`; and the seconds it took."""

    key: str
    values: Values | None
    error: str | None
    seconds: float


def run(
    tasks: Sequence[T],
    work: Callable[[T, int], Values],
    folder: Path,
    *,
    jobs: int | None = 1,
    cluster: str | None = None,
    progress: Callable[[Record], None] = lambda _: None,
) -> list[Record]:
    """Do all tasks, or take their records from an earlier run.

    Keys of tasks differ. `work`, a function of a module, is called with a task and the number of
    threads it may use. Records that are in the folder already are used again if they are of the
    same task and code, and ended well. `jobs` and `cluster` say how many tasks run at the same
    time, and where (`pbrfit.batch.driver.workers`); `progress` is called with each record, found or
    made. Returns records in the order of tasks; one that raises ends in a record with an error and
    does not stop the others.
    """
    records = folder / RECORDS
    records.mkdir(exist_ok=True)
    done: dict[str, Record] = {}
    missing: list[T] = []
    for task in tasks:
        found = _load(records, task)
        if found is None:
            missing.append(task)
        else:
            done[task.key] = found
            progress(found)

    def keep(task: T, record: Record) -> None:
        _save(records, task, record)
        done[task.key] = record
        progress(record)

    def end(task: T, attempt: Attempt[Values]) -> None:
        repeat_log(attempt.said)
        error, raised = attempt.error, attempt.raised
        if error and raised and not error.startswith(raised):
            error = f"{raised}: {error}"
        keep(task, Record(task.key, attempt.value, error, attempt.seconds))

    if missing:
        done_by = workers(jobs, cluster, most=len(missing))
        drive(missing, partial(_plainly, work), done_by, ended=end)
    return [done[task.key] for task in tasks]


def _plainly(work: Callable[[T, int], Values], task: T, threads: int) -> Values:
    """By way of JSON, so that a new record is what it will be when it is read back."""
    values: Values = json.loads(json.dumps(work(task, threads or os.cpu_count() or 1)))
    return values


def _load(records: Path, task: Task) -> Record | None:
    try:
        content = json.loads((records / f"{task.key}.json").read_text(encoding="utf-8"))
        if content["digest"] == _digest(task) and content["error"] is None:
            return Record(task.key, table(content["values"]), None, number(content["seconds"]))
    except (OSError, *UNFIT):
        pass  # absent or broken: it is made again
    return None


def _save(records: Path, task: Task, record: Record) -> None:
    content = {
        "digest": _digest(task),
        "task": repr(task),
        "error": record.error,
        "seconds": record.seconds,
        "values": record.values,
    }
    with new_file(records / f"{task.key}.json", overwrite=True) as path:
        path.write_text(json.dumps(content, indent=1), encoding="utf-8")


def digest_of_files(folder: Path) -> str:
    """sha256 of names and contents of all files below a folder.

    A task that holds it is done again when its input changes.
    """
    digest = hashlib.sha256()
    for path in sorted(folder.rglob("*")):
        if path.is_file():
            digest.update(path.relative_to(folder).as_posix().encode() + b"\0")
            digest.update(hashlib.sha256(path.read_bytes()).digest())
    return digest.hexdigest()


def is_record(path: Path) -> bool:
    """Whether a file was written by `run`, by its name and first words."""
    if path.suffix != ".json" or not path.is_file():
        return False
    with path.open("rb") as file:
        return file.read(len(_HEAD)) == _HEAD


def _digest(task: Task) -> str:
    return hashlib.sha256(f"{_code()} {task!r}".encode()).hexdigest()


@cache
def _code() -> str:
    """Digest of both packages: results of other code are other results.

    What only writes about results does not count.
    """
    digest = hashlib.sha256()
    for package in (pbrfit, pbrfit_evaluation):
        folder = Path(str(package.__file__)).parent
        for path in _measuring(folder):
            name = path.relative_to(folder.parent).as_posix()
            digest.update(name.encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()


def _measuring(folder: Path) -> list[Path]:
    """Files of a package that results depend on."""
    return [
        path
        for path in sorted(folder.rglob("*"))
        if path.suffix in (".py", ".so", ".pyd")
        and path.name not in WRITERS
        and not WRITING_FOLDERS.intersection(path.relative_to(folder).parts[:-1])
    ]


def prepare(folder: Path, *, resume: bool, overwrite: bool) -> None:
    """Make the folder, or clear it, or leave it as it is to go on with its records.

    Raises FileExistsError if something is there that may not be replaced (see
    `pbrfit.io.output.check_free`), or its records are not those of a suite.
    """
    there = folder / RECORDS
    if there.is_dir() and (resume or overwrite):
        _check_ours(folder)
    if resume and there.is_dir():
        (folder / SUMMARY).unlink(missing_ok=True)
        return
    check_free(folder, overwrite=overwrite, form=SUITE_FOLDER)
    if folder.is_dir():
        shutil.rmtree(folder)
    (folder / RECORDS).mkdir(parents=True)


def _check_ours(folder: Path) -> None:
    """Others call folders `records` too: what is in it must be records, or nothing anywhere."""
    found = sorted((folder / RECORDS).iterdir())
    strange = [path.name for path in found if not is_record(path)]
    if not found:
        strange = [path.name for path in folder.iterdir() if path.name != RECORDS]
    if strange:
        raise FileExistsError(
            f"{folder}: expected an earlier output of a suite, found {strange[0]}; remove it "
            "yourself if it is not needed"
        )


@contextmanager
def unlogged() -> Iterator[None]:
    """What is done inside logs nothing: it would say the same for each way, or too much."""
    logger = logging.getLogger("pbrfit")
    before, logger.disabled = logger.disabled, True
    try:
        yield
    finally:
        logger.disabled = before


@contextmanager
def publish(folder: Path) -> Iterator[Path]:
    """Give a temporary folder whose files go to `folder` when the block ends well."""
    (folder / SUMMARY).unlink(missing_ok=True)  # until the new one is there, it is not whole
    temporary = folder / f".pbrfit-{secrets.token_hex(6)}"
    temporary.mkdir()
    try:
        yield temporary
        for made in sorted(temporary.iterdir(), key=lambda path: path.name == SUMMARY):
            target = folder / made.name
            if target.is_dir():
                shutil.rmtree(target)
            made.replace(target)
    finally:
        shutil.rmtree(temporary, ignore_errors=True)
