"""Memory that is refused: each allocation of a small fit fails in turn, and what comes of it.

    python tests/reliability/allocations.py --least 65536 --times 40

The command is that of users under a limit of address space, which does a scene in a process of its
own; in that process the allocation fails. An outcome is the right result, a memory error or an end
of that process, each told in one line with exit code 2 and with nothing left beside the output; or
a fault. Needs Linux, glibc and a C compiler.
"""

from __future__ import annotations

import argparse
import ctypes
import hashlib
import io
import os
import resource
import shutil
import subprocess
import sys
import tempfile
from collections import Counter
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import replace
from pathlib import Path

SOURCE = Path(__file__).with_name("failing_allocations.c")
RIGHT, REFUSED, ENDED, FAULT = "right result", "memory error", "process ended, and told", "fault"

ADDRESS_SPACE = 16 << 30
"""Bytes that nothing reaches: that there is a limit gives a scene its own process."""

SECONDS = 60
"""That a fit of a fraction of a second may take without a step before it is given up."""

WHICH = "PBRFIT_FAILING_ALLOCATION"
"""Environment variable: its number, from how many bytes on they count, where to write how many."""


def main() -> int:
    """Try allocations spread evenly over a fit; 1 if one led to a fault."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--least", type=int, default=65536, help="bytes from which on they count")
    parser.add_argument("--times", type=int, default=40, help="how many to try")
    options = parser.parse_args()
    if "failing_allocations" not in os.environ.get("LD_PRELOAD", ""):
        return _loaded()
    found = outcomes(options.least, options.times)
    for what, count in sorted(found.items()):
        print(f"{count:6d}  {what}")
    return int(bool(found[FAULT]))


def _loaded() -> int:
    """This program again, with the library that lets allocations fail."""
    with tempfile.TemporaryDirectory() as folder:
        library = Path(folder) / "failing_allocations.so"
        cc = ["cc", "-O1", "-shared", "-fPIC", "-o", str(library), str(SOURCE)]
        subprocess.run(cc, check=True)
        os.environ["LD_PRELOAD"] = str(library)
        os.environ["PYTHONPATH"] = str(Path(__file__).parent)  # so that workers find `failing`
        return subprocess.run([sys.executable, *sys.argv], check=False).returncode


def failing(task: object, threads: int) -> object:
    """`decompose_scene`, of which one allocation fails, once everything is loaded."""
    from pbrfit.batch.scenes import SceneTask, decompose_scene

    assert isinstance(task, SceneTask)
    number, least, counted = os.environ[WHICH].split(",", 2)
    with tempfile.TemporaryDirectory() as folder:
        before = replace(task, output=Path(folder) / "before", temporaries=None)
        decompose_scene(before, threads)
    library = ctypes.CDLL(os.environ["LD_PRELOAD"])
    library.allocations.restype = ctypes.c_long
    library.fail_at(ctypes.c_long(int(number)), ctypes.c_long(int(least)), ctypes.c_long(0))
    try:
        return decompose_scene(task, threads)
    finally:
        Path(counted).write_text(str(library.allocations()))


def outcomes(least: int, times: int) -> Counter[str]:
    """How often each outcome came, of so many allocations."""
    import allocations  # workers know `failing` by this name
    from pbrfit.commands import decompose
    from pbrfit.synthetic import make_scene

    vars(decompose)["decompose_scene"] = allocations.failing  # what the command calls
    _, hard = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (ADDRESS_SPACE, hard))
    found = Counter[str]()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        make_scene("room", size=16, lights=4, held_out=1, noise=0.01).save(folder / "scene")
        code, expected, said, _ = _fitted(folder, 0, least)
        assert code == 0, said
        count = int((folder / "counted").read_text())
        print(f"{count} allocations of {least} bytes and more")
        for number in range(1, count + 1, max(1, count // times)):
            code, digest, said, left = _fitted(folder, number, least)
            what = FAULT
            if code == 0 and digest == expected and left == ["out"]:
                what = RIGHT
            elif code == 2 and not left and "memory" in said and said.count("\n") == 1:
                what = ENDED if "died" in said else REFUSED
            found[what] += 1
            if what == FAULT:
                print(f"{number}: exit code {code}, left {left}, {said!r}", flush=True)
    return found


def _fitted(folder: Path, number: int, least: int) -> tuple[int, str, str, list[str]]:
    """Exit code, sha256 of the maps, stderr, and what is there afterwards, of a fit."""
    from pbrfit.cli import main as pbrfit

    work = folder / "work"
    work.mkdir()
    os.environ[WHICH] = f"{number},{least},{folder / 'counted'}"
    said = io.StringIO()
    arguments = ["decompose", str(folder / "scene"), "--out", str(work / "out"), "--quiet"]
    with redirect_stdout(io.StringIO()), redirect_stderr(said):
        code = pbrfit([*arguments, "--patience", str(SECONDS)])
    maps = work / "out" / "materials.exr"
    digest = hashlib.sha256(maps.read_bytes()).hexdigest() if maps.exists() else ""
    left = sorted(path.name for path in work.iterdir())
    shutil.rmtree(work)
    return code, digest, said.getvalue(), left


if __name__ == "__main__":
    sys.exit(main())
