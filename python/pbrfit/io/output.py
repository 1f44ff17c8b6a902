"""Output folders and files that are whole or not there.

What is replaced is what pbrfit wrote: a file, or a folder that holds nothing else. No link at the
name itself is followed, as what it leads to may be anybody's; links among the folders above are.
"""

from __future__ import annotations

import errno
import re
import secrets
import shutil
from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, suppress
from dataclasses import dataclass
from fnmatch import fnmatchcase, translate
from functools import partial
from glob import escape
from pathlib import Path

from pbrfit import _core
from pbrfit.io.input_files import FILE, FOLDER, LINK, kind_of, there
from pbrfit.values.quoting import listed

TOKEN_BYTES = 6
"""Random bytes, in hexadecimal, by which unfinished outputs are named."""

ASIDE = "-old"
"""Ending of a folder in which something lies that is being replaced, by its name."""

PASSED_OVER = (".DS_Store", "._*", ".nfs*", "Thumbs.db", "desktop.ini", ".pbrfit-*")
"""Patterns of names of files that systems, and pbrfit when it is killed, leave in any folder."""

_passed_over = re.compile("|".join(map(translate, PASSED_OVER))).match


@dataclass(frozen=True)
class FolderForm:
    """By what an earlier output folder is known, and what may be in it."""

    contains: tuple[str, ...] = ()
    """Paths that are in each one."""
    holds: tuple[str, ...] = ()
    """Paths of all files that pbrfit writes into one, as patterns of `fnmatch`."""
    listed: Callable[[Path], Collection[str]] = lambda _: ()
    """Gives further paths of files: those that a folder itself says it holds."""

    def foreign(self, folder: Path) -> Iterator[Path]:
        """What is in a folder and not of pbrfit, or of a system."""
        patterns = (*self.holds, *map(escape, self.listed(folder)))
        return _foreign(folder, [pattern.split("/") for pattern in patterns])


def _foreign(folder: Path, patterns: Sequence[list[str]]) -> Iterator[Path]:
    for path in sorted(folder.iterdir()):
        ends = [end for first, *end in patterns if fnmatchcase(path.name, first)]
        kind = kind_of(path.lstat())
        if kind == FOLDER and any(ends):
            yield from _foreign(path, [end for end in ends if end])
        elif kind != FILE or ([] not in ends and not _passed_over(path.name)):
            yield path


@contextmanager
def unfinished(
    temporary: Path, *, aside: tuple[Path, Path] | None = None, parents: Sequence[Path] = ()
) -> Iterator[None]:
    """Say what has to go away if the process is ended in the block; the block itself removes it.

    A command that is told to end has half a second for that (`pbrfit.cli.run`); then the core does
    it. `temporary` is a file or folder, there or not; `aside` what was set aside, and the name that
    it gets back if that is free; of `parents`, made for it, the deepest first, empty ones go away.
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
def making(path: Path, what: str) -> Iterator[None]:
    """Let a failure say that nothing can be made at `path`."""
    try:
        yield
    except OSError as error:
        words = f"{path}: expected a place where a {what} can be made, found: "
        raise type(error)(words + (error.strerror or str(error))) from None


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
def _new(
    path: Path, what: str, check: Callable[[], None], temporaries: Path | None = None
) -> Iterator[Path]:
    """Give a temporary file or folder that takes the name `path` when the block ends well.

    When the block raises, also by Ctrl-C, everything is as before: nothing temporary, no new parent
    folders, and what was to be replaced still there. For an instant a folder lies in `*-old/NAME`.
    """
    check()
    # No link is followed but in the folders above.
    target = path.parent.resolve() / path.name if path.name not in ("", "..") else path.resolve()
    token, folder = secrets.token_hex(TOKEN_BYTES), what == "folder"
    temporary = target.with_name(f".pbrfit-{token}{'' if folder else target.suffix}")
    if temporaries is not None and temporaries.resolve().parent == target.parent:
        temporary = temporaries / token
    aside = temporary.with_name(f"{temporary.name}{ASIDE}")
    old = aside / target.name
    parents = [aside, *(parent for parent in target.parents if not parent.exists())]
    with unfinished(temporary, aside=(old, target), parents=parents):
        try:
            with making(path, what):
                target.parent.mkdir(parents=True, exist_ok=True)
                # No right to write shows before the work, not after it.
                (temporary.mkdir if folder else temporary.touch)(exist_ok=False)
            with naming(path, temporary):
                yield temporary
            check()  # Another process may have been here meanwhile.
            with undisturbed():
                if folder and there(target):
                    # Two renames: the old folder is gone for an instant, but never half replaced.
                    aside.mkdir()
                    target.rename(old)
                (temporary.rename if folder else temporary.replace)(target)
        except BaseException:
            if there(old) and not there(target):
                old.rename(target)
            raise
        finally:
            with suppress(OSError):
                temporary.unlink()
            for leftover in (temporary, aside):
                shutil.rmtree(leftover, ignore_errors=True)


def new_folder(
    path: Path,
    *,
    overwrite: bool = False,
    form: FolderForm = FolderForm(),
    temporaries: Path | None = None,
) -> AbstractContextManager[Path]:
    """A new folder at `path`, whole or not there (`_new`); `temporaries` is where to work instead.

    That is a folder beside `path`. Raises FileExistsError (`check_free`), or OSError.
    """
    check = partial(check_free, path, overwrite=overwrite, form=form)
    return _new(path, "folder", check, temporaries)


def new_file(path: Path, *, overwrite: bool = False) -> AbstractContextManager[Path]:
    """A new file at `path`, whole or not there; raises as `check_free_file`, or OSError."""
    return _new(path, "file", partial(check_free_file, path, overwrite=overwrite))


def check_free_file(path: Path, *, overwrite: bool, kind: str = FILE) -> None:
    """Check that a file, or something of another `kind`, may be written at `path`.

    Raises FileExistsError if something is there, unless it is of that kind and `overwrite` is True.
    """
    found = what_is(path)
    if found not in (None, kind):
        raise FileExistsError(f"{path}: expected {kind} or nothing, found {found}")
    if found and not overwrite:
        expected = f"{kind} that does not exist yet, found one"
        raise FileExistsError(f"{path}: expected {expected}; overwrite=True replaces it")


def check_free(path: Path, *, overwrite: bool, form: FolderForm = FolderForm()) -> None:
    """Check that a folder may be made at `path`.

    Only an earlier output is replaced: an empty folder, or one of the given form in which there is
    nothing else. Raises FileExistsError if something is there, unless it is such a folder and
    `overwrite` is True. A folder that the process works in is never replaced.
    """
    check_is_output(path, overwrite=overwrite, form=form)
    if there(path) and (foreign := list(form.foreign(path))):
        found = listed(one.relative_to(path).as_posix() for one in foreign)
        raise FileExistsError(
            f"{path}: expected nothing but an earlier output to replace, found {found} besides; "
            "move it away first"
        )


def check_is_output(path: Path, *, overwrite: bool, form: FolderForm) -> None:
    """As `check_free`, whatever else an earlier output may hold by now."""
    check_free_file(path, overwrite=overwrite, kind=FOLDER)
    if not there(path):
        return
    missing = next((name for name in form.contains if not there(path / name)), None)
    if missing and not all(_passed_over(one.name) for one in path.iterdir()):
        raise FileExistsError(
            f"{path}: expected an earlier output to replace, found a folder without {missing}; "
            "remove it yourself if it is not needed"
        )
    if Path.cwd().is_relative_to(path.resolve()):
        raise FileExistsError(
            f"{path}: expected a folder to replace, found the current one or one above it"
        )


def what_is(path: Path) -> str | None:
    """What has a name, in words, with what it leads to if it is a link; None = nothing has."""
    if not there(path):
        return None
    found = kind_of(path.lstat())
    return f"{found} to {path.readlink()}" if found == LINK else found
