"""`pbrfit evaluate table1`."""

from __future__ import annotations

import argparse
import os
from pathlib import Path
from typing import TYPE_CHECKING

from pbrfit._core import InputError
from pbrfit.commands.arguments import Subcommands, positive, unread_is_no_failure
from pbrfit_evaluation.commands.resumable import (
    add_cycles_cache,
    add_models,
    add_options,
    exit_code,
    models,
    run_tasks,
)
from pbrfit_evaluation.table1.rows import ROWS

if TYPE_CHECKING:
    from pbrfit.model.reflection import Model
    from pbrfit_evaluation.table1.measure import Task
    from pbrfit_evaluation.table1.rows import Row

QUICK_SCENES, QUICK_SIZE = 4, 32
MOST_SCENES = 100


def add(suites: Subcommands) -> None:
    """Add the suite to `pbrfit evaluate`."""
    added = suites.add_parser(
        "table1",
        help="errors of materials and relighting on scenes whose truth is known",
        description="Render scenes, decompose them with and without priors and by the paper's "
        "recipe, and compare with the truth, in the setups of the paper's Table 1. Writes "
        "report.html, table1.csv, scenes.csv and summary.json.",
    )
    added.set_defaults(command=_run)
    add_options(added)
    add_models(added, "is fitted, and what our renderer renders with")
    added.add_argument(
        "--scenes", metavar="K", type=positive, default=67, help=f"at most {MOST_SCENES}"
    )
    added.add_argument("--size", metavar="PIXELS", type=positive, default=128, help="of a picture")
    added.add_argument(
        "--lights",
        metavar="N",
        type=positive,
        default=16,
        help="pictures a scene; as many are held out",
    )
    added.add_argument("--iterations", metavar="K", type=positive, default=500, help="of a fit")
    added.add_argument(
        "--rows",
        metavar="KEY",
        nargs="+",
        choices=[row.key for row in ROWS],
        help="only these setups (default: all): " + ", ".join(row.key for row in ROWS),
    )
    added.add_argument(
        "--textures",
        metavar="DIR",
        type=Path,
        help="PBR maps for the detailed scenes (default: procedural textures)",
    )
    added.add_argument(
        "--predicted-normals",
        metavar="DIR",
        type=Path,
        help="normal maps of an estimator, SEED.exr or SEED.png (default: simulated)",
    )
    added.add_argument(
        "--cycles-scenes",
        metavar="K",
        type=positive,
        default=10,
        help="how many of the scenes are rendered by Blender Cycles",
    )
    add_cycles_cache(added)
    added.add_argument(
        "--quick",
        action="store_true",
        help=f"under two minutes: {QUICK_SCENES} scenes of {QUICK_SIZE} pixels, without Cycles",
    )


def _run(options: argparse.Namespace) -> int:
    from pbrfit_evaluation import workspace
    from pbrfit_evaluation.rooms.textures import load_textures
    from pbrfit_evaluation.table1 import measure, report

    if options.quick:
        options.scenes = min(options.scenes, QUICK_SCENES)
        options.size = min(options.size, QUICK_SIZE)
    if options.scenes > MOST_SCENES:
        raise InputError(f"--scenes: expected at most {MOST_SCENES}, found {options.scenes}")
    if options.lights < 2:
        raise InputError(f"--lights: expected at least 2, found {options.lights}")
    for folder in (options.textures, options.predicted_normals):
        if folder is not None and not folder.is_dir():
            raise InputError(f"{folder}: expected a folder, found none")
    if options.textures is not None:
        load_textures(options.textures)  # what is wrong with them should show before the work
    rows = [row for row in ROWS if not options.rows or row.key in options.rows]
    unavailable = {row.key: why for row in rows if (why := _why_not(row, quick=options.quick))}
    tasks = [
        task
        for row in rows
        if row.key not in unavailable
        for model in models(options)
        for task in _tasks(row, model, options)
    ]
    records = run_tasks(tasks, measure.work, options)
    found = report.outcomes(rows, models(options), tasks, records, unavailable)
    by_cycles = any(o.finished and o.row.renderer == "cycles" for o in found)
    with workspace.publish(options.out) as folder:
        report.write(folder, found, _setup(options, by_cycles=by_cycles))
    if not options.quiet:
        with unread_is_no_failure():
            print("\n".join(report.lines(found)))
            print(f"\nLook at {options.out / 'report.html'}")
    return exit_code(records)


def _why_not(row: Row, *, quick: bool) -> str:
    if row.renderer == "own":
        return ""
    if quick:
        return "--quick leaves Cycles out"
    from pbrfit_evaluation import cycles

    return cycles.why_not() or ""


def _tasks(row: Row, model: Model, options: argparse.Namespace) -> list[Task]:
    from pbrfit_evaluation.jobs import digest_of_files
    from pbrfit_evaluation.table1.measure import FIRST_SEED, Task, predicted_files

    count = options.scenes
    if row.renderer == "cycles":
        count = min(count, options.cycles_scenes)
    textures = _absolute(options.textures) if row.scene == "detailed" else None
    normals = _absolute(options.predicted_normals) if row.normals == "predicted" else None
    of_textures = digest_of_files(textures) if textures else ""

    def inputs(seed: int) -> str:
        return digest_of_files(normals, predicted_files(normals, seed)) if normals else of_textures

    return [
        Task(
            row.key,
            FIRST_SEED + i,
            options.size,
            options.lights,
            options.iterations,
            textures=textures,
            predicted_normals=normals,
            model=model,
            inputs=inputs(FIRST_SEED + i),
            preview=i == 0,
            cycles_cache=_absolute(options.cycles_cache),
        )
        for i in range(count)
    ]


def _absolute(path: Path | None) -> Path | None:
    return None if path is None else path.resolve()


def _setup(options: argparse.Namespace, *, by_cycles: bool) -> list[str]:
    textures = (
        f"the PBR maps in “{options.textures.name}”" if options.textures else "procedural textures"
    )
    normals = (
        f"given in {options.predicted_normals.name}"
        if options.predicted_normals
        else "simulated, with the spread and the correlation of a learned estimator"
    )
    cycles = (
        f" ({min(options.scenes, options.cycles_scenes)} in rows with Cycles)" if by_cycles else ""
    )
    return [
        f"{options.scenes} scenes{cycles} of {options.size} × {options.size} pixels, "
        f"{options.lights} pictures each to decompose and {options.lights} held out; "
        f"{options.iterations} iterations. "
        f"Detailed scenes have {textures}. Predicted normals are {normals}. "
        + (
            f"{options.jobs} jobs on {os.cpu_count()} processors."
            if options.cluster is None
            else "Fitted by the workers of a cluster, so seconds are of different machines."
        )
    ]
