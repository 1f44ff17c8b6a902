"""Errors as lines for users."""

import os
import re


def in_one_line(failure: BaseException) -> str:
    """What went wrong; the type too where it is not one that explains itself."""
    words = " ".join(str(failure).split())
    if isinstance(failure, OSError) and failure.strerror and failure.filename:
        return f"{failure.filename}: {failure.strerror}"
    if isinstance(failure, FileNotFoundError) and failure.errno:  # of no file: of `os.getcwd`
        return f"{os.environ.get('PWD', '.')}: expected the working folder, found it removed"
    if loop := re.fullmatch("Symlink loop from '(.*)'", words):
        return f"{loop[1]}: expected a file or folder, found a link to itself"
    if isinstance(failure, BlockingIOError) or "start new thread" in words:
        return f"threads and processes (ulimit -u): expected more, found {words}"
    if isinstance(failure, MemoryError) and "memory" not in words:
        return f"not enough memory: {words}" if words else "not enough memory"
    if isinstance(failure, (OSError, MemoryError)) and words:
        return words
    from pbrfit._core import InputError  # here: with it comes numpy

    if isinstance(failure, InputError) and words:
        return words
    return ": ".join(filter(None, (type(failure).__name__, words)))
