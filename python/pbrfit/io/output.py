"""Output folders and files that are whole or not there."""

from __future__ import annotations

import errno
import hashlib
import secrets
import shutil
import tempfile
from collections.abc import Collection, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

from pbrfit import _core

ASIDE = "-old"
"""Ending of a folder in which something lies that is being replaced, by its name."""


@contextmanager
def unfinished(
    temporary: Path, *, aside: tuple[Path, Path] | None = None, parents: Sequence[Path] = ()
) -> Iterator[None]:
    """Say what has to go away if the process is ended in the block; the block itself removes it.

    A command that is told to end has half a second to do that (`pbrfit.cli.run`). Then this is done
    for it, also while a long call keeps the interpreter.

    Parameters
    ----------
    temporary
        File or folder, there or not.
    aside
        What was set aside and the name it gets back, if that is free; else it goes away too.
    parents
        Folders made for it, the deepest first; those that are empty go away, here in any case.
    """
    number = _core.unfinished(temporary, aside, list(parents))
    try:
        yield
    finally:
        for parent in parents:
            with suppress(OSError):  # one that is not empty stays, and so do those above it
                parent.rmdir()
        _core.finished(number)


@contextmanager
def undisturbed() -> Iterator[None]:
    """Let a few renames all happen or none, should the process be ended."""
    _core.hold_end()
    try:
        yield
    finally:
        _core.allow_end()


@contextmanager
def scratch_folder() -> Iterator[Path]:
    """Give a folder where the system keeps temporary ones, for the length of the block."""
    folder = Path(tempfile.gettempdir()).resolve() / f"pbrfit-{secrets.token_hex(6)}"
    with unfinished(folder):
        folder.mkdir(mode=0o700)
        try:
            yield folder
        finally:
            shutil.rmtree(folder, ignore_errors=True)


@contextmanager
def making(path: Path, what: str) -> Iterator[None]:
    """Let a failure say that nothing can be made at `path`."""
    try:
        yield
    except OSError as error:
        found = error.strerror or str(error)
        raise type(error)(
            f"{path}: expected a place where a {what} can be made, found: {found}"
        ) from None


@contextmanager
def naming(path: Path, temporary: Path) -> Iterator[None]:
    """Let failures name what was to be written: not the temporary beside it, and not nothing."""
    try:
        yield
    except OSError as error:
        unnamed = error.filename is None and error.errno in _NO_ROOM
        if unnamed or str(error.filename).startswith(str(temporary)):
            error.filename = str(path)
        raise


_NO_ROOM = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO)
"""What writing to an open file fails with; the error then does not know the file's name."""


@contextmanager
def new_folder(
    path: Path,
    *,
    overwrite: bool = False,
    contains: Collection[str] = (),
    temporaries: Path | None = None,
) -> Iterator[Path]:
    """Give a temporary folder beside `path` that takes its name when the block ends well.

    When the block raises, also by Ctrl-C, everything is as before: no temporary folder, no new
    parent folders, and a folder that was to be replaced still there. `temporaries` is a folder on
    the same file system that takes the place of that beside `path`, unless `path` is a link to
    elsewhere; a folder that is replaced lies in it for an instant as `*-old/NAME`. Raises
    FileExistsError, see `check_free`; OSError if no folder can be made there.
    """
    check_free(path, overwrite=overwrite, contains=contains)
    target = path.resolve()  # of a link to a folder, the folder is replaced and the link stays
    token = secrets.token_hex(6)
    temporary = target.with_name(f".pbrfit-{token}")
    if temporaries is not None and temporaries.resolve().parent == target.parent:
        temporary = temporaries / token
    aside = temporary.with_name(f"{temporary.name}{ASIDE}")
    old = aside / target.name
    new_parents = [parent for parent in target.parents if not parent.exists()]
    with unfinished(temporary, aside=(old, target), parents=[aside, *new_parents]):
        try:
            with making(path, "folder"):
                target.parent.mkdir(parents=True, exist_ok=True)
                temporary.mkdir()
            with naming(path, temporary):
                yield temporary
            # Another process may have been here meanwhile.
            check_free(path, overwrite=overwrite, contains=contains)
            with undisturbed():
                if target.exists():
                    # Two renames: the old folder is gone for an instant, but never half replaced.
                    aside.mkdir()
                    target.rename(old)
                temporary.rename(target)
        except BaseException:
            if old.exists() and not target.exists():
                old.rename(target)
            raise
        finally:
            for leftover in (temporary, aside):
                shutil.rmtree(leftover, ignore_errors=True)


@contextmanager
def new_file(path: Path, *, overwrite: bool = False) -> Iterator[Path]:
    """Give a temporary path beside `path`, for a file that takes its name when the block ends well.

    When the block raises, everything is as before. Raises FileExistsError, see `check_free_file`;
    OSError if no file can be made there.
    """
    check_free_file(path, overwrite=overwrite)
    target = path.resolve()
    temporary = target.with_name(f".pbrfit-{secrets.token_hex(6)}{target.suffix}")
    new_parents = [parent for parent in target.parents if not parent.exists()]
    with unfinished(temporary, parents=new_parents):
        try:
            with making(path, "file"):
                target.parent.mkdir(parents=True, exist_ok=True)
                temporary.touch()  # no right to write shows before the work, not after it
            with naming(path, temporary):
                yield temporary
            check_free_file(path, overwrite=overwrite)  # as above
            temporary.replace(target)
        finally:
            with suppress(OSError):
                temporary.unlink(missing_ok=True)


def digest(path: Path) -> str:
    """sha256 of a file, hexadecimal."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def check_free_file(path: Path, *, overwrite: bool) -> None:
    """Check that a file may be written at `path`.

    Raises FileExistsError if something is there, unless it is a file and `overwrite` is True.
    """
    if path.is_dir():
        raise FileExistsError(f"{path}: expected a file or nothing, found a folder")
    if not overwrite and (path.exists() or path.is_symlink()):
        raise FileExistsError(
            f"{path}: expected a file that does not exist yet, found one; "
            "overwrite=True replaces it"
        )


def check_free(path: Path, *, overwrite: bool, contains: Collection[str] = ()) -> None:
    """Check that a folder may be made at `path`.

    Only what looks like an earlier output is replaced: an empty folder, or one that holds all the
    names in `contains`. Pictures that somebody took are not lost to a slip of the fingers. Raises
    FileExistsError if something is there, unless it is a folder and `overwrite` is True. A folder
    that the process works in is never replaced.
    """
    if path.is_dir():
        if not overwrite:
            raise FileExistsError(
                f"{path}: expected a folder that does not exist yet, found one; "
                "overwrite=True replaces it"
            )
        missing = [name for name in contains if not (path / name).exists()]
        if missing and any(path.iterdir()):
            raise FileExistsError(
                f"{path}: expected an earlier output to replace, found a folder without "
                f"{missing[0]}; remove it yourself if it is not needed"
            )
        if Path.cwd().is_relative_to(path.resolve()):
            raise FileExistsError(
                f"{path}: expected a folder to replace, found the current one or one above it"
            )
    elif path.exists() or path.is_symlink():
        raise FileExistsError(f"{path}: expected a folder or nothing, found a file")
