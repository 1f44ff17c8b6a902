"""Processes that tests start: waited for, and looked at."""

from __future__ import annotations

import contextlib
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import pytest


def until(condition: Callable[[], bool]) -> None:
    """Wait for something that is bound to happen soon."""
    for _ in range(1200):
        if condition():
            return
        time.sleep(0.05)
    raise AssertionError("it did not happen")


def waiting_at(ending: str, folder: Path) -> dict[str, str]:
    """Environment of processes that wait for ever before they open a file whose path ends so.

    Each then has a file in `folder`, by its number.
    """
    folder.mkdir()
    (folder / "sitecustomize.py").write_text(
        "import os, sys, time\n"
        "def wait(event, arguments):\n"
        f"    if event == 'open' and str(arguments[0]).endswith({ending!r}):\n"
        f"        open({str(folder)!r} + f'/{{os.getpid()}}', 'w').close()\n"
        "        time.sleep(3600)\n"
        "sys.addaudithook(wait)\n"
    )
    paths = [str(folder), *filter(None, [os.environ.get("PYTHONPATH")])]
    return {**os.environ, "PYTHONPATH": os.pathsep.join(paths)}


@contextlib.contextmanager
def running(*command: str | Path) -> Iterator[subprocess.Popen[str]]:
    """A process that can be interrupted, and that does not outlive the test."""
    process = subprocess.Popen(
        [*map(str, command)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        # A shell gives processes in the background SIGINT ignored, which would be inherited.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )
    try:
        yield process
    finally:
        process.kill()
        process.communicate()


def alive(process: int) -> bool:
    """Whether it runs; one that has ended and waits for its parent does not."""
    try:
        os.kill(process, 0)
        status = Path(f"/proc/{process}/stat")
        return not status.exists() or status.read_text("utf-8").rpartition(")")[2].split()[0] != "Z"
    except (ProcessLookupError, FileNotFoundError):
        return False


ROOT = hasattr(os, "getuid") and os.getuid() == 0
NOBODY = 65534


def closed(path: Path) -> Path:
    """Let nobody but NOBODY do anything with it."""
    if ROOT:
        os.chown(path, NOBODY, NOBODY)
        path.chmod(0o700 if path.is_dir() else 0o600)
    else:
        path.chmod(0)
    return path


def with_rights(rights: str, *options: str) -> list[str]:
    """What stands before a command that keeps only some of root's rights; if not root, none."""
    if not ROOT:
        return []
    if shutil.which("setpriv") is None:
        pytest.skip("no setpriv")
    return ["setpriv", "--bounding-set", rights, "--inh-caps", rights, *options]


def as_nobody_special(arguments: Sequence[object]) -> tuple[int, str, str]:
    """Exit code, stdout and stderr of `pbrfit` for somebody to whom closed files are closed."""
    command = [*with_rights("-all"), sys.executable, "-m", "pbrfit", *map(str, arguments)]
    found = subprocess.run(command, capture_output=True, text=True, check=False)
    return found.returncode, found.stdout, found.stderr
