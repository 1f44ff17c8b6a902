"""Users' files, read so that it ends: regular files alone, and no more than a bound.

A pipe has no end that is known, a device may have none, and to open either may wait for ever.
Whatever reads what somebody else may have put there reads it by these functions.
"""

from __future__ import annotations

import functools
import hashlib
import json
import os
import stat
from collections.abc import Callable
from io import BufferedReader
from pathlib import Path
from typing import ParamSpec, TypeVar

from pbrfit._core import InputError

PICTURE_BYTES = 2**34
"""Largest picture file, in bytes: that of a result of the most pixels."""

TEXT_BYTES = 2**24
"""Largest JSON file, and history, in bytes: lights of 10,000 pictures."""

LIST_BYTES = 2**20
"""Largest file of lamps, or of names, in bytes: 10,000 lines of a hundred letters."""

SETTINGS_BYTES = 2**18
"""Largest TOML file, in bytes: people write them, such as a thousand prompts."""

FILE, FOLDER, LINK = "a file", "a folder", "a link"
"""Regular files, folders and symbolic links in words."""

_KINDS = {stat.S_IFREG: FILE, stat.S_IFDIR: FOLDER, stat.S_IFLNK: LINK}
_KINDS |= {stat.S_IFIFO: "a pipe", stat.S_IFSOCK: "a socket"}

_AT_ONCE = getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)
"""Flags with which opening a file waits for nobody, and Windows changes no byte."""

P = ParamSpec("P")
R = TypeVar("R")


def unexpected(place: object, expected: str, found: object) -> InputError:
    """An error about a file, a folder or a part of one."""
    return InputError(f"{place}: expected {expected}, found {found}")


def there(path: Path) -> bool:
    """Whether something has this name, if only a link to nowhere; OSError if nobody may look."""
    try:
        path.lstat()
    except (FileNotFoundError, NotADirectoryError):
        return False
    return True


def kind_of(status: os.stat_result) -> str:
    """What something is, in words."""
    return _KINDS.get(stat.S_IFMT(status.st_mode), "a device")


def open_file(path: Path) -> BufferedReader:
    """Open a regular file, or a link to one, to read; InputError if it is something else."""
    try:
        _check_regular(path, path.stat())  # first, as to open a device may already do something
    except FileNotFoundError:
        if path.is_symlink():
            found = f"a link to {path.readlink()}, where nothing is"
            raise unexpected(path, "a file", found) from None
        raise
    file = os.fdopen(os.open(path, os.O_RDONLY | _AT_ONCE), "rb")
    try:
        _check_regular(path, os.fstat(file.fileno()))
    except InputError:
        file.close()
        raise
    return file


def names_file(read: Callable[P, R]) -> Callable[P, R]:
    """Let a MemoryError of a function that reads a file, its first argument, name it."""

    @functools.wraps(read)
    def named(*args: P.args, **kwargs: P.kwargs) -> R:
        try:
            return read(*args, **kwargs)
        except MemoryError as error:
            found = f"too little: {error}" if str(error) else "too little"
            expected = f"{args[0]}: expected memory for what it holds"
            raise MemoryError(f"{expected}, found {found}") from None

    return named


def content_of(file: BufferedReader, path: Path, most: int) -> bytes:
    """All bytes of an open file; InputError if there are more than `most`."""
    size = _bounded(file, path, most)
    file.seek(0)
    return file.read(size)


@names_file
def read_bytes(path: Path, most: int) -> bytes:
    """Content of a file; raises as `open_file` and `content_of`."""
    with open_file(path) as file:
        return content_of(file, path, most)


def read_text(path: Path, most: int, other: str = "utf-8") -> str:
    """Text of a file, its lines ended by line feeds; raises as `read_bytes`.

    Its encoding is told by its first bytes: UTF-8, UTF-16 or UTF-32 with or without a byte order
    mark; or `other` where it is not UTF-8. Raises InputError if it is no text.
    """
    data = read_bytes(path, most)
    encoding = json.detect_encoding(data)
    try:
        text = data.decode(encoding)
    except UnicodeDecodeError as error:
        if encoding != "utf-8" or other == "utf-8":
            line = data[: error.start].count(b"\n") + 1
            raise unexpected(path, encoding.upper(), f"another byte in line {line}") from None
        text = data.decode(other, "replace")
    return text.replace("\r\n", "\n").replace("\r", "\n")


def digest(path: Path) -> str:
    """sha256 of a file, hexadecimal; raises as `read_bytes`, with the bound of pictures."""
    with open_file(path) as file:
        _bounded(file, path, PICTURE_BYTES)
        return hashlib.file_digest(file, "sha256").hexdigest()


def _bounded(file: BufferedReader, path: Path, most: int) -> int:
    """Size of an open file, in bytes."""
    size = os.fstat(file.fileno()).st_size
    if size > most:
        raise unexpected(path, f"a file of at most {most:,} bytes", f"{size:,}")
    return size


def _check_regular(path: Path, status: os.stat_result) -> None:
    if not stat.S_ISREG(status.st_mode):
        raise unexpected(path, "a regular file", kind_of(status))
