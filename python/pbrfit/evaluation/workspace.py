"""The output folder of a suite that can be resumed.

While the suite runs, the folder holds its records alone. Report and summary come last, one rename
each, `summary.json` at the very end: a folder with a summary is complete.
"""

from __future__ import annotations

import secrets
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from pbrfit.evaluation import summary
from pbrfit.evaluation.jobs import RECORDS
from pbrfit.output import check_free


def prepare(folder: Path, *, resume: bool, overwrite: bool) -> None:
    """Make the folder, or clear it, or leave it as it is to go on with its records.

    Raises
    ------
    FileExistsError
        If something is there that may not be replaced; see `pbrfit.output.check_free`.
    """
    if resume and (folder / RECORDS).is_dir():
        return
    check_free(folder, overwrite=overwrite, contains=(RECORDS,))
    if folder.is_dir():
        shutil.rmtree(folder)
    (folder / RECORDS).mkdir(parents=True)


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
