"""What the parts cost: penalties beside the data term, and whole fits."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from pbrfit.fit.objective import Objective
from pbrfit.fit.priors.penalties import penalties
from pbrfit.fit.robust import SCALES
from pbrfit.model.reflection import Model
from pbrfit.result.options import Priors, prior_names
from pbrfit_evaluation.ablation.cases import case
from pbrfit_evaluation.ablation.configurations import WEIGHTS, Configuration

REPEATS = 30

PENALTIES: tuple[str, ...] = tuple(name for name in prior_names() if name != "material")
"""The other prior is learnt as a fit runs, and shows in the time of whole fits."""

NOISE = 0.01
"""Scale of robust losses."""


def measure(
    size: int,
    iterations: int,
    seed: int,
    configurations: Sequence[Configuration],
    model: Model,
    threads: int,
) -> dict[str, Any]:
    """Time evaluations and fits of a "constant" room.

    Returns
    -------
    dict
        "data": milliseconds of loss and gradient without priors. "more": what each penalty, and
        each robust loss instead of the square, takes beside that. Medians. "fits": seconds,
        evaluations and iterations of each configuration.
    """
    scene = case("constant", seed, size=size, model=model)
    objective = Objective(scene, threads=threads, model=model)
    x, gradient = objective.start(), np.zeros(objective.size)
    data = _milliseconds(lambda: objective.problem.value_and_grad(x))
    more = {}
    for name in PENALTIES:
        priors = replace(Priors.none(), **{name: getattr(WEIGHTS, name)})
        [penalty] = penalties(objective.layout, priors)
        more[name] = _milliseconds(partial(penalty.value_and_grad, x, gradient))
    for loss in SCALES:
        robust = _milliseconds(partial(objective.problem.value_and_grad, x, (loss, NOISE)))
        more[f"{loss} loss"] = max(0.0, robust - data)
    fits = {}
    for one in configurations:
        fit = one.fit(scene, iterations=iterations, threads=threads)
        fits[one.key] = {
            "seconds": fit.seconds,
            "evaluations": fit.evaluations,
            "iterations": int(fit.history["iteration"][-1]),
        }
    return {"data": data, "more": more, "fits": fits}


def _milliseconds(act: Callable[[], object]) -> float:
    """Median time of `REPEATS` calls, after one that is not counted."""
    act()
    times = []
    for _ in range(REPEATS):
        began = time.perf_counter()
        act()
        times.append(time.perf_counter() - began)
    return 1e3 * float(np.median(times))
