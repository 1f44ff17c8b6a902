"""Limits of a process's address space (`ulimit -v`, `ulimit -d`), and buffers that need it early.

OpenBLAS asks the system for a buffer when it is first called, and tries for ever where there is
none. So a command that has too little address space is refused before numpy is loaded, and a fit
has these buffers made before it fills memory. numpy and scipy have an OpenBLAS each.
"""

from __future__ import annotations

import ctypes
import os
import sys
import threading
import time
from contextlib import suppress
from functools import cache
from importlib import import_module
from pathlib import Path

from pbrfit.threads import AT_ONCE_MAX, processors

LIBRARIES_BYTES = 512 * 2**20
"""Address space in bytes of a process with all libraries of a fit: 305 MiB were measured with one
BLAS thread, two buffers among them; 3 more buffers and the stacks of 4 threads take 128 MiB."""

STACK_BYTES = 4 * 2**20
"""Least stack in bytes of the main thread, which takes its share of the core's work: blocks of
pixels among surroundings take 2 MiB there."""

FILES_MIN = 16
"""Least number of files that a process may have open: 6 do for a scene, libraries and workers have
some for a time, and Python takes one that it cannot open for one that is not there."""

LIBRARIES = ("fft", "linalg", "ndimage", "optimize", "sparse.csgraph", "spatial")
"""Parts of scipy that a fit loads as it comes to them, `special` with them."""

M_ARENA_MAX = -8
"""Of glibc's `mallopt`: how many heaps threads have; each takes 64 MiB of address space."""

BUFFER_BYTES = 32 * 2**20
"""Address space in bytes of a buffer of OpenBLAS, as numpy and scipy build it."""

GEMM_SIDE = 400
"""Of matrices whose product takes a core some milliseconds: as long as threads take to start, so
that each holds a buffer while the others want one."""


def left() -> int | None:
    """Bytes of address space that this process may still take; None where nothing limits it."""
    return min((most - used for most, used in _limits()), default=None)


def check_limits() -> None:
    """Have as much stack as is allowed, up to `STACK_BYTES`.

    Raises MemoryError if that is less, OSError if Python may open too few files to find libraries.
    """
    if sys.platform == "win32":
        return
    expected = f"open files (ulimit -n): expected {FILES_MIN} or more, found"
    try:
        import resource
    except ImportError:  # no file is left to look for it with
        raise OSError(f"{expected} too few") from None
    files = resource.getrlimit(resource.RLIMIT_NOFILE)[0]
    if 0 <= files < FILES_MIN:
        raise OSError(f"{expected} {files}")
    soft, hard = resource.getrlimit(resource.RLIMIT_STACK)
    if soft == resource.RLIM_INFINITY or soft >= STACK_BYTES:
        return
    if hard != resource.RLIM_INFINITY and hard < STACK_BYTES:
        raise MemoryError(
            f"stack (ulimit -s): expected {STACK_BYTES >> 10} KiB of memory or more, found "
            f"{soft >> 10} KiB"
        )
    resource.setrlimit(resource.RLIMIT_STACK, (STACK_BYTES, hard))
    threading.stack_size(STACK_BYTES)  # else what the limit was when the process began


def check_libraries() -> None:
    """Raise MemoryError if the libraries of a fit have no room; call it before they are loaded.

    Raises OSError if SOURCE_DATE_EPOCH, which they read, is no time.
    OpenBLAS is told to make no threads: a fit uses none of them, each takes a buffer, and where one
    cannot be had it interrupts the process. Where address space is limited, glibc is told to make
    no heaps for threads.
    """
    epoch = os.environ.get("SOURCE_DATE_EPOCH", "0")
    try:
        time.gmtime(int(epoch))  # as numpy does
    except (ValueError, OverflowError, OSError):
        said = f"SOURCE_DATE_EPOCH: expected whole seconds since 1970, found {epoch[:60]!r}"
        raise OSError(said) from None
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    limits = _limits()
    if not limits:
        return
    os.environ.setdefault("MALLOC_ARENA_MAX", "1")  # of workers
    with suppress(OSError, AttributeError):
        ctypes.CDLL(None).mallopt(M_ARENA_MAX, 1)
    most = min(most for most, _ in limits)
    if most < LIBRARIES_BYTES:
        raise MemoryError(
            f"address space (ulimit -v, ulimit -d): expected {LIBRARIES_BYTES >> 20} MiB of memory "
            f"or more, found {most >> 20} MiB"
        )


@cache
def reserve_blas() -> None:
    """Load libraries, and have OpenBLAS make its buffers, one for each thread that may call it.

    They are kept for later calls. Raises MemoryError if there is no room for them. Does nothing
    where address space is not limited.
    """
    if not _limits():
        return
    import numpy as np
    from scipy.linalg.blas import dgemm

    for name in LIBRARIES:
        import_module(f"scipy.{name}")
    threads = min(processors(), AT_ONCE_MAX)
    expected = (threads + 1) * BUFFER_BYTES
    free = left()
    if free is not None and free < expected:
        raise MemoryError(
            f"address space (ulimit -v, ulimit -d): expected {expected >> 20} MiB of memory for "
            f"linear algebra, found {free >> 20} MiB"
        )
    square = np.ones((GEMM_SIDE, GEMM_SIDE))
    dgemm(1.0, square, square)
    begin = threading.Barrier(threads)

    def multiply() -> None:
        begin.wait()
        square @ square

    others = [threading.Thread(target=multiply) for _ in range(threads)]
    for one in others:
        one.start()
    for one in others:
        one.join()


def _limits() -> list[tuple[int, int]]:
    """Of each limit of this process how much it is, and how much of that is used, in bytes."""
    try:
        import resource

        status = Path("/proc/self/status").read_text(encoding="utf-8")
    except (ImportError, OSError):
        return []  # Windows, macOS
    used = dict(line.split(":", 1) for line in status.splitlines())
    names = ((resource.RLIMIT_AS, "VmSize"), (resource.RLIMIT_DATA, "VmData"))
    found = [(resource.getrlimit(which)[0], name) for which, name in names]
    return [
        (most, 1024 * int(used[name].split()[0]))
        for most, name in found
        if most != resource.RLIM_INFINITY
    ]
