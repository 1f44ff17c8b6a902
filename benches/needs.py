"""What leaving out parts saves: `make bench-needs` leaves its table in docs/evidence/needs.json.

One evaluation of loss and gradient of the same pictures, with everything and without one part, or
with one penalty more. Cases take turns, so that a machine that slows down slows all of them.
"""

from __future__ import annotations

import argparse
import dataclasses
import statistics
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

import pbrfit
from pbrfit.fit.objective import Objective
from pbrfit.result.options import Priors
from pbrfit.synthetic import make_scene
from pbrfit_evaluation.report import evidence, markdown
from pbrfit_evaluation.suite import Table, Value

ROUNDS = 41
"""Turns of each case; a median is taken."""

BASE = "all"


def cases(scene: pbrfit.Scene) -> dict[str, Objective]:
    """The objective with everything, and each without a part or with a penalty."""
    assert scene.truth is not None
    known = scene.truth.lighting
    grey = np.repeat(scene.images[..., 1:2], 3, axis=-1)
    half = np.zeros((scene.height, scene.width), bool)
    half[: scene.height // 2] = True
    rng = np.random.default_rng(0)
    weights = rng.uniform(0.5, 1.0, scene.images.shape[:3])
    scenes: dict[str, tuple[pbrfit.Scene, dict[str, Any]]] = {
        BASE: (scene, {}),
        "grey pictures: one channel": (dataclasses.replace(scene, images=grey, truth=None), {}),
        "lights of order 2": (scene, {"sh_order": 2}),
        "metallic given": (scene, {"metallic": 0.0}),
        "lights known": (dataclasses.replace(scene, lighting=known), {}),
        "one light for all channels": (scene, {"mono_light": True}),
        "half of the pixels masked": (dataclasses.replace(scene, mask=half), {}),
        "with weights of samples": (dataclasses.replace(scene, weights=weights), {}),
    }
    for name in ("cohesion", "smoothness", "sparsity", "monochrome"):
        priors = dataclasses.replace(Priors.none(), **{name: 1.0})
        scenes[f"with prior {name}"] = (scene, {"priors": priors})
    return {name: Objective(of, threads=1, **options) for name, (of, options) in scenes.items()}


def medians(objectives: dict[str, Objective], rounds: int) -> dict[str, float]:
    """Milliseconds of an evaluation of each."""
    starts = {name: objective.start() for name, objective in objectives.items()}
    found: dict[str, list[float]] = {name: [] for name in objectives}
    for _ in range(rounds):
        for name, objective in objectives.items():
            began = time.process_time()
            objective.value_and_grad(starts[name])
            found[name].append(1e3 * (time.process_time() - began))
    return {name: statistics.median(times) for name, times in found.items()}


def table_of(found: dict[int, dict[str, float]]) -> Table:
    """Milliseconds, and the difference from the first row as a share of it."""
    sizes = list(found)
    columns = ["", *(head for size in sizes for head in (f"{size}², ms", "change"))]
    lines: list[list[Value]] = []
    for name in found[sizes[0]]:
        line: list[Value] = [name]
        for size in sizes:
            taken, base = found[size][name], found[size][BASE]
            line += [taken, "" if name == BASE else f"{100 * (taken / base - 1):+.0f} %"]
        lines.append(line)
    return Table(columns, lines)


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure and tell."""
    parser = argparse.ArgumentParser(description="Time what leaving out parts saves.")
    parser.add_argument("--docs", type=Path, help="documentation whose table to fill")
    parser.add_argument("--sizes", type=int, nargs="+", default=[128, 512])
    parser.add_argument("--pictures", type=int, default=16)
    parser.add_argument("--rounds", type=int, default=ROUNDS)
    options = parser.parse_args(arguments)
    found = {}
    for size in options.sizes:
        scene = make_scene("room", size=size, lights=options.pictures, held_out=1, seed=2000)
        found[size] = medians(cases(scene), options.rounds)
    table = table_of(found)
    print(markdown(table))
    if options.docs is not None:
        evidence.record(
            options.docs,
            "needs",
            command=f"make bench-needs ({options.rounds} turns)",
            protocol="pbrfit-needs-1: medians of processor time, one thread, cases in turn",
            tables={"Parts left out": table},
        )


if __name__ == "__main__":
    main()
