"""Wrong normals: what they cost, and how much of it refining them wins back."""

from __future__ import annotations

import argparse
import os
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, Literal

from pbrfit.commands.arguments import add_threads, whole_number
from pbrfit_evaluation.normals import cost, figures, real, rooms
from pbrfit_evaluation.normals.disturbances import DISTURBANCES, Disturbance
from pbrfit_evaluation.normals.fits import FIRST_SEED, room_kind
from pbrfit_evaluation.options import count, folders, option
from pbrfit_evaluation.suite import Options, Part, Section, Suite, Table

Starts = Sequence[tuple[Disturbance | Literal["true"], float]]
"""Disturbances with their θ."""

LARGEST = 45.0
"""Degrees of a disturbance, at most."""


def theta(text: str) -> float:
    """Read the size of a disturbance.

    Raises
    ------
    argparse.ArgumentTypeError
        If it makes no sense.
    """
    value = float(text)
    if not 0 < value <= LARGEST:
        raise argparse.ArgumentTypeError(
            f"expected more than 0 and at most {LARGEST:g}, found {value:g}"
        )
    return value


def _of_rooms(options: Options, part: rooms.Name, starts: Starts) -> list[rooms.Case]:
    """Every scene under each disturbance."""
    return [
        rooms.Case(part, room_kind(i), seed, options.size, kind, degrees, options.iterations)
        for i in range(options.scenes)
        for seed in [options.first_seed + i]
        for kind, degrees in starts
    ]


def _wrong(options: Options, degrees: Iterable[float]) -> list[tuple[Disturbance, float]]:
    """Disturbances that are asked for, at these sizes."""
    kinds = [kind for kind in DISTURBANCES if kind in options.disturbances]
    return [(kind, size) for kind in kinds for size in sorted(set(degrees))]


def room_cases(options: Options) -> list[rooms.Case]:
    """Every scene with true normals, and under every disturbance at every θ."""
    return _of_rooms(options, "rooms", [("true", 0.0), *_wrong(options, options.degrees)])


def exact_cases(options: Options) -> list[rooms.Case]:
    """Every scene under those of `rooms.EXACT` that are asked for."""
    starts = _wrong(options, [rooms.EXACT_DEGREES])
    return _of_rooms(options, "exact", [one for one in starts if one[0] in rooms.EXACT])


def real_tasks(options: Options) -> list[real.Task]:
    """Every public set from its true normals, from all wrong ones, and from flat ones."""
    given = options.folders or [Path(of) for of in [os.environ.get("PBRFIT_DATA")] if of]
    wrong: list[tuple[real.Start, float]] = [*_wrong(options, options.real_degrees)]
    return [
        real.Task(source, start, degrees, options.real_size, options.iterations, digest)
        for source in real.find(given)
        for digest in [source.digest()]
        for start, degrees in [("true", 0.0), *wrong, ("flat", 0.0)]
    ]


def cost_tasks(options: Options) -> list[cost.Task]:
    """Both cases at every size."""
    return [
        cost.Task(case, options.first_seed, size, repeats, options.iterations)
        for size, repeats in options.repeats.items()
        for case in cost.CASES
    ]


def _part(name: str, *made: Any, **more: Any) -> Part[Any]:
    return Part(name, *made, csvs=lambda results, _: figures.csvs(name, results), **more)


SUITE = Suite(
    name="normals",
    title="Wrong normals, refined",
    description="Disturb the normals of scenes whose ground truth is known, by 1 to 25 degrees, "
    "and fit them with and without refinement: errors of materials, relighting and normals; "
    "without noise; on public sets with true normals; and what it costs. Writes report.html, plots "
    "and pictures, normals.md, scenes.csv and summary.json. Exit code 1 if something does not "
    "hold.",
    protocol="pbrfit-normals-1, {effort}",
    parts=[
        _part(
            *("rooms", room_cases, rooms.run, figures.room_rows),
            verdicts=figures.room_verdicts,
            sections=figures.room_sections,
        ),
        _part(
            *("exact", exact_cases, rooms.run, figures.exact_rows),
            verdicts=figures.exact_verdicts,
            sections=lambda _, rows: [Section("Without noise", tables=[Table.of(rows)])],
        ),
        _part(
            *("real", real_tasks, real.run, figures.real_rows),
            sections=figures.real_sections,
        ),
        _part(
            *("cost", cost_tasks, cost.run, figures.cost_rows),
            verdicts=figures.cost_verdicts,
            sections=figures.cost_sections,
            alone=True,
        ),
    ],
    options=(
        folders(
            "public sets: as for `pbrfit evaluate real` (default: the folder that the environment "
            "variable PBRFIT_DATA names, if any)"
        ),
        add_threads,
        option(
            "--disturbances",
            metavar="KIND",
            nargs="+",
            choices=DISTURBANCES,
            help=f"only these (default: all): {', '.join(DISTURBANCES)}",
        ),
        option(
            "--degrees",
            metavar="THETA",
            nargs="+",
            type=theta,
            help="sizes of the disturbance (default: 1 2 5 10 15 20 25, with --quick 10); true "
            "normals are always there",
        ),
        count("--scenes", "K", "rooms"),
        count("--size", "PIXELS", "of the rooms' pictures"),
        count("--iterations", "K", "of a fit"),
        option(
            "--first-seed",
            metavar="SEED",
            type=whole_number,
            default=FIRST_SEED,
            help="of the first room (default: %(default)s; nothing was tuned on seeds from there "
            "on)",
        ),
    ),
    effort={
        "disturbances": (DISTURBANCES, DISTURBANCES),
        "degrees": ((1.0, 2.0, 5.0, 10.0, 15.0, 20.0, 25.0), (10.0,)),
        "scenes": (12, 2),
        "size": (128, 32),
        "iterations": (500, 100),
        "real_degrees": ((5.0, 10.0, 20.0), (10.0,)),
        "real_size": (256, 48),
        "repeats": ({64: 5, 128: 3, 256: 3, 512: 1}, {32: 1, 64: 1}),
    },
    about=(
        "What wrong normals cost, and how much of it comes back when they are refined together "
        "with materials and lights. docs/benchmarks/normals.md says what each part measures, and "
        f"what must hold. Judged is “{figures.JUDGED}”, the default; without noise “on”.",
    ),
    timed=True,
    verdict_rows=True,
)
