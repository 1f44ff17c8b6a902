"""Where results of a batch lie until they are whole: `DIR/.pbrfit`, held by one batch at a time."""

from __future__ import annotations

import os
import secrets
import shutil
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO

from pbrfit.output import making

NAME = ".pbrfit"

LOCK = "lock"


@contextmanager
def of_batch(folder: Path) -> Iterator[Path]:
    """Give `folder/.pbrfit` for temporary folders, to this process alone; afterwards it is gone.

    What a killed batch left there is removed first; a result that it was about to replace is put
    back. A new `folder` that stays empty is removed too.

    Raises
    ------
    FileExistsError
        If another batch works there. Where the system has no `flock` (Windows), that is not known.
    OSError
        If nothing can be written there.
    """
    target = folder.resolve()
    new_parents = [parent for parent in (target, *target.parents) if not parent.exists()]
    place = target / NAME
    try:
        with making(folder, "folder"):
            place.mkdir(parents=True, exist_ok=True)
            lock = _locked(place / LOCK)
        if lock is None:
            raise FileExistsError(
                f"{folder}: expected no other batch that writes there, found one at work"
            )
        try:
            _clear(place)
            yield place
        finally:
            shutil.rmtree(place, ignore_errors=True)
            lock.close()
            shutil.rmtree(place, ignore_errors=True)  # Windows removes no file that is open
    finally:
        with suppress(OSError):  # one that is not empty stays, and so do those above it
            for parent in new_parents:
                parent.rmdir()


@contextmanager
def of_one(output: Path) -> Iterator[Path]:
    """Give a folder beside `output` for a result that another process writes; then it is gone."""
    target = output.resolve()
    place = target.with_name(f"{NAME}-{secrets.token_hex(6)}")
    new_parents = [parent for parent in target.parents if not parent.exists()]
    try:
        with making(output, "folder"):
            place.mkdir(parents=True)
        yield place
    finally:
        shutil.rmtree(place, ignore_errors=True)
        with suppress(OSError):
            for parent in new_parents:
                parent.rmdir()


def _clear(place: Path) -> None:
    for left in place.iterdir():
        if left.name == LOCK:
            continue
        if left.name.endswith("-old"):
            for old in left.iterdir():
                if not (place.parent / old.name).exists():
                    old.rename(place.parent / old.name)
        if left.is_dir():
            shutil.rmtree(left)
        else:
            left.unlink()


def _locked(path: Path) -> IO[bytes] | None:
    """Open a file that nobody else has locked, and lock it; None if somebody has."""
    while True:
        file = path.open("ab")
        if not _lock(file):
            file.close()
            return None
        # Who held it may have removed it meanwhile; then it is no longer what others will open.
        with suppress(OSError):
            if sys.platform == "win32" or os.path.samestat(os.fstat(file.fileno()), path.stat()):
                return file
        file.close()
        path.parent.mkdir(exist_ok=True)


def _lock(file: IO[bytes]) -> bool:
    if sys.platform == "win32":
        return True
    import fcntl

    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return True
