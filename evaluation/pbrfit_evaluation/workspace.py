"""The output folder of a suite that can be resumed.

While the suite runs, the folder holds its records, and perhaps a report of an earlier run. Report
and summary come last, one rename each, `summary.json` at the very end: a folder with a summary is
complete.
"""

from __future__ import annotations

import secrets
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from pbrfit.io.output import check_free
from pbrfit_evaluation import summary
from pbrfit_evaluation.jobs import RECORDS, is_record


def prepare(folder: Path, *, resume: bool, overwrite: bool) -> None:
    """Make the folder, or clear it, or leave it as it is to go on with its records.

    Raises
    ------
    FileExistsError
        If something is there that may not be replaced (see `pbrfit.io.output.check_free`), or its
        records are not those of a suite.
    """
    there = folder / RECORDS
    if there.is_dir() and (resume or overwrite):
        _check_ours(folder)
    if resume and there.is_dir():
        (folder / summary.FILE).unlink(missing_ok=True)
        return
    check_free(folder, overwrite=overwrite, contains=(RECORDS,))
    if folder.is_dir():
        shutil.rmtree(folder.resolve())  # of a link to a folder, the link stays
    (folder.resolve() / RECORDS).mkdir(parents=True)


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
def publish(folder: Path) -> Iterator[Path]:
    """Give a temporary folder whose files go to `folder` when the block ends well."""
    (folder / summary.FILE).unlink(missing_ok=True)  # until the new one is there, it is not whole
    temporary = folder / f".pbrfit-{secrets.token_hex(6)}"
    temporary.mkdir()
    try:
        yield temporary
        for made in sorted(temporary.iterdir(), key=lambda path: path.name == summary.FILE):
            target = folder / made.name
            if target.is_dir():
                shutil.rmtree(target)
            made.replace(target)
    finally:
        shutil.rmtree(temporary, ignore_errors=True)
