"""Output folders that are whole or not there."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def new_folder(path: Path, *, overwrite: bool = False) -> Iterator[Path]:
    """Give a temporary folder beside `path` that takes its name when the block ends well.

    When the block raises, also by Ctrl-C, the temporary folder is removed and `path` is as before.

    Raises
    ------
    FileExistsError
        If `path` exists and `overwrite` is False, or is not a folder.
    OSError
        If the parent folder cannot be made or written.
    """
    check_free(path, overwrite=overwrite)
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = Path(tempfile.mkdtemp(prefix=f".{path.name}-", dir=path.parent))
    try:
        temporary.chmod(0o777 & ~_umask())
        yield temporary
        if path.exists():
            # Two renames: the old folder is gone for an instant, but never half replaced.
            old = temporary.with_name(temporary.name + "-old")
            path.rename(old)
            temporary.rename(path)
            shutil.rmtree(old)
        else:
            temporary.rename(path)
    except BaseException:
        shutil.rmtree(temporary, ignore_errors=True)
        raise


def check_free(path: Path, *, overwrite: bool) -> None:
    """Raise FileExistsError unless `path` is free or may be replaced."""
    if path.is_dir():
        if not overwrite and any(path.iterdir()):
            raise FileExistsError(
                f"{path}: expected a folder that does not exist yet, found one; "
                "--overwrite (overwrite=True) replaces it"
            )
    elif path.exists() or path.is_symlink():
        raise FileExistsError(f"{path}: expected a folder or nothing, found a file")


def _umask() -> int:
    """The process's permission mask, which can only be read by setting it."""
    mask = os.umask(0o077)
    os.umask(mask)
    return mask
