"""What the parts cost: penalties beside the data term, and whole fits."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from pbrfit.evaluation.ablation.cases import case
from pbrfit.evaluation.ablation.configurations import WEIGHTS, Configuration
from pbrfit.objective import Objective
from pbrfit.priors import Priors, penalties, prior_names

REPEATS = 30

EVALUATED: tuple[str, ...] = tuple(name for name in prior_names() if name != "material")
"""Priors that are penalties of the objective from the start: the other is learnt as a fit runs."""


def measure(
    size: int, iterations: int, seed: int, configurations: Sequence[Configuration], threads: int
) -> dict[str, Any]:
    """Time evaluations and fits of a "constant" room.

    Returns
    -------
    dict
        "evaluation": milliseconds of the data term with its gradient ("data"), and of each prior's
        by its name; medians. "fits": seconds, evaluations and iterations of each configuration.
    """
    scene = case("constant", seed, size=size)
    objective = Objective(scene, threads=threads)
    x, gradient = objective.start(), np.zeros(objective.size)
    evaluation = {"data": _milliseconds(lambda: objective.data_value_and_grad(x))}
    for name in EVALUATED:
        priors = replace(Priors.none(), **{name: getattr(WEIGHTS, name)})
        [penalty] = penalties(objective.layout, priors)
        evaluation[name] = _milliseconds(partial(penalty.value_and_grad, x, gradient))
    fits = {}
    for one in configurations:
        fit = one.fit(scene, iterations=iterations, threads=threads)
        fits[one.key] = {
            "seconds": fit.seconds,
            "evaluations": fit.evaluations,
            "iterations": int(fit.history["iteration"][-1]),
        }
    return {"evaluation": evaluation, "fits": fits}


def _milliseconds(act: Callable[[], object]) -> float:
    """Median time of `REPEATS` calls, after one that is not counted."""
    act()
    times = []
    for _ in range(REPEATS):
        began = time.perf_counter()
        act()
        times.append(time.perf_counter() - began)
    return 1e3 * float(np.median(times))
