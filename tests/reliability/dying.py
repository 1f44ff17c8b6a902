"""`pbrfit`, killed just before a chosen step on disk: makes, renames and removals are counted.

    DIE_AT=7 DIE_WHO=group DIE_UNDER=out python tests/reliability/dying.py decompose ...

Python tells audit hooks of each step before it does it. At the step DIE_AT of the batch's process
or of any worker (each counts its own, of paths below DIE_UNDER; DIE_KIND counts only those, such
as os.rename) a SIGKILL goes to DIE_WHO: "group" all processes, "batch" the batch's process alone,
so that its workers are orphans, "worker" the first one that takes the step, once (DIE_ONCE).
"""

from __future__ import annotations

import os
import signal
import sys
from itertools import count
from pathlib import Path
from typing import Any

STEPS = {"os.mkdir", "os.rename", "os.remove", "os.rmdir"}

_under = os.path.realpath(os.environ.get("DIE_UNDER", "."))
_at, _who = int(os.environ.get("DIE_AT", "0")), os.environ.get("DIE_WHO", "group")
_kind = os.environ.get("DIE_KIND", "")
_steps = count(1)


def _writes(event: str, arguments: tuple[Any, ...]) -> bool:
    if event in STEPS:
        # What a tree is removed by names its files relative to an open folder.
        return os.fspath(arguments[0]).startswith(_under) or not Path(arguments[0]).is_absolute()
    if event != "open" or not isinstance(arguments[0], (str, bytes, os.PathLike)):
        return False
    path, mode = os.fsdecode(arguments[0]), str(arguments[1] or "")
    return path.startswith(_under) and any(letter in mode for letter in "wax")


def _hook(event: str, arguments: tuple[Any, ...]) -> None:
    if event not in STEPS and event != "open":
        return
    if _kind in ("", event) and _writes(event, arguments) and next(_steps) == _at:
        batch = int(os.environ["DIE_BATCH"])
        if _who == "group":
            os.killpg(batch, signal.SIGKILL)
        elif _who == "batch":
            os.kill(batch, signal.SIGKILL)
        elif os.getpid() != batch and _once():
            os.kill(os.getpid(), signal.SIGKILL)


def _once() -> bool:
    """A worker dies once; who comes after it goes on."""
    try:
        os.close(os.open(os.environ["DIE_ONCE"], os.O_CREAT | os.O_EXCL))
    except FileExistsError:
        return False
    return True


if _at:
    sys.addaudithook(_hook)

if __name__ == "__main__":
    from pbrfit.cli import run

    os.environ["DIE_BATCH"] = str(os.getpid())
    sys.argv[0] = str(Path(sys.argv[0]).name)
    run()
