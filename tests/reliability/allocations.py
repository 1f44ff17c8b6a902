"""Memory that is refused: each allocation of a small fit fails in turn, and what comes of it.

    python tests/reliability/allocations.py --least 4096 --times 200

An outcome is right, a line about memory with exit code 2, or a fault: another exception, an abort,
a process that does not end, or something that is left beside the output. Needs Linux, glibc and a C
compiler.
"""

from __future__ import annotations

import argparse
import ctypes
import hashlib
import io
import os
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path

SOURCE = Path(__file__).with_name("failing_allocations.c")
RIGHT, REFUSED, FAULT = "right result", "memory error", "fault"
ABORT, HANG = "abort", "hang"

SECONDS = 60
"""That a fit of a fraction of a second may take before it counts as hanging."""


def main() -> int:
    """Try allocations spread evenly over a fit; 1 if one led to a hang or a fault."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--least", type=int, default=4096, help="bytes from which on they count")
    parser.add_argument("--times", type=int, default=200, help="how many to try")
    parser.add_argument("--from-there-on", action="store_true", help="all after it fail too")
    options = parser.parse_args()
    if "failing_allocations" not in os.environ.get("LD_PRELOAD", ""):
        return _loaded()
    found = outcomes(options.least, options.times, from_there_on=options.from_there_on)
    for what, count in sorted(found.items()):
        print(f"{count:6d}  {what}")
    return int(bool(found[FAULT] or found[HANG]))


def _loaded() -> int:
    """This program again, with the library that lets allocations fail."""
    with tempfile.TemporaryDirectory() as folder:
        library = Path(folder) / "failing_allocations.so"
        cc = ["cc", "-O1", "-shared", "-fPIC", "-o", str(library), str(SOURCE)]
        subprocess.run(cc, check=True)
        os.environ["LD_PRELOAD"] = str(library)
        return subprocess.run([sys.executable, *sys.argv], check=False).returncode


def outcomes(least: int, times: int, *, from_there_on: bool) -> Counter[str]:
    """How often each outcome came, of so many allocations."""
    from pbrfit.address_space import reserve_blas
    from pbrfit.synthetic import make_scene

    # A limit that nothing reaches has buffers of linear algebra made.
    resource.setrlimit(resource.RLIMIT_AS, (1 << 42, resource.RLIM_INFINITY))
    reserve_blas()
    resource.setrlimit(resource.RLIMIT_AS, (resource.RLIM_INFINITY, resource.RLIM_INFINITY))
    library = ctypes.CDLL(os.environ["LD_PRELOAD"])
    library.allocations.restype = ctypes.c_long
    found = Counter[str]()
    with tempfile.TemporaryDirectory() as folder:
        scene = Path(folder) / "scene"
        make_scene("room", size=16, lights=4, held_out=1, noise=0.01).save(scene)
        expected = _fitted(scene, Path(folder) / "first")[1]  # loads all there is
        out = Path(folder) / "counted"
        library.fail_at(ctypes.c_long(0), ctypes.c_long(least), ctypes.c_long(0))
        _fitted(scene, out)
        count = library.allocations()
        print(f"{count} allocations of {least} bytes and more")
        for number in range(1, count + 1, max(1, count // times)):
            what, said = _tried(
                scene, Path(folder), library, number, least, from_there_on, expected
            )
            found[what] += 1
            if what not in (RIGHT, REFUSED):
                print(f"{number}: {what}: {said}", flush=True)
    return found


def _fitted(scene: Path, out: Path) -> tuple[int, str, str]:
    """Exit code, sha256 of the maps, and stderr of a fit."""
    from pbrfit.cli import main as pbrfit

    said = io.StringIO()
    arguments = ["decompose", str(scene), "--out", str(out), "--threads", "2", "--quiet"]
    with redirect_stdout(io.StringIO()), redirect_stderr(said):
        code = pbrfit(arguments)
    maps = out / "materials.exr"
    digest = hashlib.sha256(maps.read_bytes()).hexdigest() if maps.exists() else ""
    return code, digest, said.getvalue()


def _tried(
    scene: Path,
    folder: Path,
    library: ctypes.CDLL,
    number: int,
    least: int,
    from_there_on: bool,
    expected: str,
) -> tuple[str, str]:
    """What comes of a fit in a child whose allocation of this number fails, and what it says."""
    out, told = folder / "work" / "out", folder / "told"
    shutil.rmtree(out.parent, ignore_errors=True)
    out.parent.mkdir()
    child = os.fork()
    if child == 0:
        with told.open("wb") as file:
            os.dup2(file.fileno(), 2)
        library.fail_at(ctypes.c_long(number), ctypes.c_long(least), ctypes.c_long(from_there_on))
        try:
            code, digest, said = _fitted(scene, out)
            library.allocations()
            fine = code == 0 and digest == expected
            one_line = code == 2 and "memory" in said.lower() and said.count("\n") == 1
            if not fine and not one_line:
                os.write(2, f"exit code {code}, {said}".encode())
            os._exit(0 if fine else 2 if one_line else 3)
        except BaseException as error:
            library.allocations()
            os.write(2, f"{type(error).__name__}: {error}".encode())
            os._exit(3)
    status = _waited(child)
    said = told.read_text("utf-8", "replace").strip()[-300:].replace("\n", " | ")
    left = sorted(path.name for path in out.parent.iterdir())
    if status is None:
        return HANG, said
    if os.WIFSIGNALED(status):
        return ABORT, f"{signal.Signals(os.WTERMSIG(status)).name}, {said}, left {left}"
    code = os.waitstatus_to_exitcode(status)
    if left != (["out"] if code == 0 else []):
        return FAULT, f"left {left}, {said}"
    return {0: RIGHT, 2: REFUSED}.get(code, FAULT), said


def _waited(child: int) -> int | None:
    """How a child ended; None if it had to be killed."""
    until = time.monotonic() + SECONDS
    while time.monotonic() < until:
        done, status = os.waitpid(child, os.WNOHANG)
        if done:
            return status
        time.sleep(0.02)
    os.kill(child, signal.SIGKILL)
    os.waitpid(child, 0)
    return None


if __name__ == "__main__":
    sys.exit(main())
