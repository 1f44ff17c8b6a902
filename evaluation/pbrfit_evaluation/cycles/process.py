"""The Python that has bpy: where it is, and one run of the worker in it.

bpy is Blender as a module, licensed under the GPL, and one version of it fits one version of
Python. So it has an environment and a process of its own; files go in and out, and nothing else.
"""

from __future__ import annotations

import json
import os
import subprocess
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path

import numpy as np

from pbrfit_evaluation.arrays import Array

VARIABLE = "PBRFIT_CYCLES_PYTHON"
WORKER = Path(__file__).with_name("worker.py")
LOG = "log.txt"

_ENVIRONMENTS = (".venv-cycles/bin/python", ".venv-cycles/Scripts/python.exe")
_ASK = "import bpy, numpy, OpenEXR; print(); print(bpy.app.version_string)"


class CyclesError(RuntimeError):
    """A render failed; one line that says where and with which last words."""


class CyclesNotFoundError(CyclesError):
    """There is no Python with bpy; one line that says where it was looked for."""


def find_python() -> Path:
    """Python that has bpy: the variable PBRFIT_CYCLES_PYTHON, else .venv-cycles here.

    Raises CyclesNotFoundError if there is none.
    """
    given = os.environ.get(VARIABLE)
    if given:
        if Path(given).is_file():
            return Path(given).absolute()
        raise CyclesNotFoundError(f"Cycles: {VARIABLE} names {given}, which is no file")
    for name in _ENVIRONMENTS:
        if Path(name).is_file():
            return Path(name).absolute()
    raise CyclesNotFoundError(
        f"Cycles: no .venv-cycles in {Path.cwd()} and no {VARIABLE} set; `make cycles-env` makes "
        "the former"
    )


@lru_cache(maxsize=8)
def blender_version(python: Path) -> str:
    """Blender's version in that Python, as "5.0.1"; takes a second, once.

    Raises CyclesNotFoundError if it has no bpy, or no OpenEXR.
    """
    try:
        found = subprocess.run(
            [python, "-c", _ASK], capture_output=True, text=True, timeout=120, env=_environment()
        )
    except (OSError, subprocess.TimeoutExpired) as error:
        raise CyclesNotFoundError(f"Cycles: {python} does not run: {error}") from None
    if found.returncode != 0:
        raise CyclesNotFoundError(
            f"Cycles: expected a Python with bpy at {python}, found: {last_line(found.stderr)}"
        )
    return last_line(found.stdout)


def why_not() -> str | None:
    """Return the reason why Cycles cannot run here, in one line; None when it can."""
    try:
        blender_version(find_python())
    except CyclesNotFoundError as error:
        return str(error)
    return None


def run_worker(
    python: Path, folder: Path, timeout: float, *arguments: str, worker: Path | None = None
) -> None:
    """Render the job in `folder`; the results are there afterwards.

    `worker` is another program than `WORKER`; it gets the folder and the arguments.

    Raises CyclesError if the process fails or takes longer than `timeout` seconds. It is dead then.
    """
    log = folder / LOG
    with log.open("wb") as output:
        try:
            process = subprocess.run(
                [python, worker or WORKER, folder, *arguments],
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
                timeout=timeout,
                env=_environment(),
            )
        except OSError as error:
            raise CyclesError(f"Cycles: {python} does not run: {error}") from None
        except subprocess.TimeoutExpired:
            raise CyclesError(
                f"Cycles: stopped after {timeout:g} s; its last line: {_last_words(log)}"
            ) from None
    if process.returncode != 0:
        how = (
            f"signal {-process.returncode}"
            if process.returncode < 0
            else f"exit code {process.returncode}"
        )
        raise CyclesError(f"Cycles: {how}; its last line: {_last_words(log)}")


def last_line(text: str) -> str:
    """Return the last line that is not empty; "nothing" without one."""
    lines = [line.strip() for line in text.splitlines() if line.strip()]
    return lines[-1] if lines else "nothing"


def _last_words(log: Path) -> str:
    return last_line(log.read_text(encoding="utf-8", errors="replace"))


def _environment() -> dict[str, str]:
    """Ours without what would lead another Python to our packages."""
    ours = ("PYTHONPATH", "PYTHONHOME", "VIRTUAL_ENV", "PYTHONWARNINGS")
    return {name: value for name, value in os.environ.items() if name not in ours}


# -------------------------------------------------------------------------------- exports opened

OPENED = Path(__file__).with_name("opened.py")

TURN = -90.0
"""Degrees about Z by which docs/export.md tells users to turn the world."""


def rendered_export(
    folder: Path,
    glb: Path,
    size: int,
    panoramas: Sequence[Path],
    *,
    samples: int = 256,
) -> Array:
    """Pictures (M, size, size, 3), linear Rec.709, of an exported square scene, `material.glb`.

    Under panoramas, EXR files as `pbrfit export` writes them, with so many light paths a pixel.
    `folder` is for the files exchanged, and made here. Raises CyclesNotFoundError if there is no
    Python with bpy, CyclesError if the renderer fails.
    """
    folder.mkdir()
    job = {
        "glb": str(glb),
        "size": size,
        "threads": 1,
        "seed": 1,
        "bounces": dict.fromkeys(("all", "diffuse", "glossy"), 0),
        "panoramas": [str(path) for path in panoramas],
        "samples": samples,
        "turn": TURN,
    }
    (folder / "job.json").write_text(json.dumps(job), encoding="utf-8")
    run_worker(find_python(), folder, 600.0, worker=OPENED)
    pictures = [np.load(folder / f"{number}.npy") for number in range(len(panoramas))]
    return np.stack(pictures)[..., :3].astype(np.float64)
