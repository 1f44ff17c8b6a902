"""Where results of a batch lie until they are whole: `DIR/.pbrfit`, held by one batch at a time.

Somebody else may have put things there. No link is followed, and nothing is touched whose name is
not of the form that batches make.
"""

from __future__ import annotations

import errno
import os
import re
import secrets
import shutil
import stat
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO

from pbrfit.io.input_files import FILE, FOLDER, kind_of, there
from pbrfit.io.output import ASIDE, TOKEN_BYTES, making, unfinished, what_is

NAME = ".pbrfit"

LOCK = "lock"

OURS = re.compile(rf"[0-9a-f]{{{2 * TOKEN_BYTES}}}({ASIDE}|-ended)?")
"""Names of folders that workers make there; the core renames what it takes away to `*-ended`."""

ATTEMPTS = 3
"""To clear the place, where somebody is still at work."""


@contextmanager
def of_batch(folder: Path) -> Iterator[Path]:
    """Give `folder/.pbrfit` for temporary folders, to this process alone; afterwards it is gone.

    What a killed batch left there is removed first; what is of others stays. A result that was
    about to be replaced is put back, then and afterwards. A new `folder` that stays empty is
    removed too. Raises FileExistsError if another batch works there, or there is a link, a file, or
    somebody else's folder. Where the system has no `flock` (Windows), another batch is not noticed.
    Raises OSError if nothing can be written there.
    """
    target = folder.resolve()
    new_parents = [parent for parent in (target, *target.parents) if not parent.exists()]
    place = target / NAME
    try:
        _check_ours(place, folder / NAME)
        with making(folder, "folder"):
            lock = _locked(place / LOCK)
        if lock is None:
            raise FileExistsError(
                f"{folder}: expected no other batch that writes there, found one at work"
            )
        # At a sudden end only the lock goes, and what is empty then: workers may still be at it.
        with unfinished(place / LOCK, parents=[place, *new_parents]):
            try:
                _clear(place)
                yield place
            finally:
                with suppress(OSError):
                    _clear(place)
                if sys.platform == "win32":
                    lock.close()  # no file that is open can be removed there
                with suppress(OSError):
                    (place / LOCK).unlink()
                _remove(place)
                lock.close()  # not before: whoever got it then would lose what it had just made
    finally:
        with suppress(OSError):  # one that is not empty stays, and so do those above it
            for parent in new_parents:
                parent.rmdir()


@contextmanager
def of_one(output: Path) -> Iterator[Path]:
    """Give a folder beside `output` for a result that another process writes; then it is gone."""
    target = output.resolve()
    place = target.with_name(f"{NAME}-{secrets.token_hex(TOKEN_BYTES)}")
    new_parents = [parent for parent in target.parents if not parent.exists()]
    with unfinished(place / LOCK, parents=[place, *new_parents]):
        try:
            with making(output, "folder"):
                place.mkdir(parents=True)
            yield place
        finally:
            _remove(place)


def _clear(place: Path) -> None:
    """Remove what workers left, and put back what they set aside.

    A worker that has outlived its batch may be at work on the same files. Then something fails,
    here or there, but nothing is removed before there is something in its place.
    """
    for last in (False,) * (ATTEMPTS - 1) + (True,):
        try:
            for left in place.iterdir():
                if not OURS.fullmatch(left.name) or kind_of(left.lstat()) != FOLDER:
                    continue
                if not left.name.endswith(ASIDE):
                    shutil.rmtree(left)
                    continue
                for old in left.iterdir():
                    if there(place.parent / old.name):
                        shutil.rmtree(old)
                    else:
                        old.rename(place.parent / old.name)
                left.rmdir()  # fails if something has come into it meanwhile
        except OSError:
            if last:
                raise
        else:
            return


def _remove(place: Path) -> None:
    """Remove the place, cleared or not, unless the next batch has it by now."""
    for _ in range(ATTEMPTS):
        with suppress(OSError):
            place.rmdir()
            return
        if (place / LOCK).exists():
            return
        with suppress(OSError):
            _clear(place)


def _check_ours(place: Path, said: Path) -> None:
    """See that nothing is there, or a folder of this user or of whoever has the folder above it."""
    found = what_is(place)
    if found not in (None, FOLDER):
        raise FileExistsError(f"{said}: expected the folder of a batch or nothing, found {found}")
    with suppress(FileNotFoundError):  # whoever had it has just removed it
        owner, above = place.lstat().st_uid, place.parent.stat().st_uid
        if sys.platform != "win32" and owner not in (os.geteuid(), above):
            raise FileExistsError(
                f"{said}: expected your own folder or nothing, found one of user {owner}; have it "
                "removed if no batch of theirs is at work"
            )
    lock = what_is(place / LOCK)
    if lock not in (None, FILE):
        raise FileExistsError(f"{said / LOCK}: expected a file or nothing, found {lock}")


def _locked(path: Path) -> IO[bytes] | None:
    """Open a file that nobody else has locked, and lock it; None if somebody has."""
    while True:
        path.parent.mkdir(parents=True, exist_ok=True)
        try:
            file = os.fdopen(os.open(path, _LOCKING, 0o666), "ab")
        except FileNotFoundError:
            if path.parent.is_dir():
                raise
            continue  # whoever held it has just removed the folder
        if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
            file.close()
            raise FileExistsError(errno.EEXIST, "no regular file", str(path))
        if sys.platform != "win32":
            import fcntl

            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                file.close()
                return None
        # Who held it may have removed it meanwhile; then it is no longer what others will open.
        with suppress(OSError):
            if sys.platform == "win32" or os.path.samestat(os.fstat(file.fileno()), path.lstat()):
                return file
        file.close()


_LOCKING = os.O_RDWR | os.O_CREAT | os.O_APPEND
_LOCKING |= getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0)
"""Flags with which the lock is opened, should it have become something else since it was looked at:
a link is not followed, a pipe not waited for."""
