"""The material prior in a fit: learnt around a state, a penalty from there on."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pbrfit.fit.plan import FitPlan
from pbrfit.fit.priors import material as material_prior
from pbrfit.fit.priors.material import HeldPull, MaterialPull
from pbrfit.fit.priors.penalties import Penalty, penalties
from pbrfit.fit.solvers.run import Run

Array = NDArray[np.float64]


def learns(run: Run) -> bool:
    """Whether the fit has a prior that is learnt."""
    return run.priors.material > 0


def learnt(run: Run, x: Array) -> tuple[Array, MaterialPull | HeldPull | None]:
    """X with the material prior learnt around it, which is a penalty from here on; one iteration.

    Where time runs out before, x is as it was and there is no prior.

    Weights that are chosen by rule are chosen by the lights that were found with it.
    """
    objective = run.objective
    others: list[Penalty] = []
    with run.stage("material prior") as notes:
        found = _learnt(run, x)
        if found is None:
            notes.append("stopped before all pixels had theirs")
            return x, None
        x, pull = found
        if run.taught is not None:
            others = run.taught.penalties(objective.layout)
        run.measured_lighting = objective.unpack(x)[1]
        needs = FitPlan.of(
            run.scene, objective.layout, priors=run.priors, lighting=run.measured_lighting
        )
        objective.penalties = [*penalties(objective.layout, needs.priors), *others, pull]
        objective.robust = run.robust_around(x)
        loss = run.evaluate(x)[0]
        run.iteration += 1
        run.record(x, loss)
    return x, pull


def _learnt(run: Run, x: Array) -> tuple[Array, MaterialPull | HeldPull] | None:
    """X and the pull; by what the run was taught, if it was, and else by its own pixels."""
    reweighted = run.objective.reweighted(x)
    if run.taught is not None:
        assert run.taught.material is not None
        return run.taught.material.applied(reweighted, x, run.out_of_time)
    found = material_prior.learn(reweighted, x, run.priors.material, out_of_time=run.out_of_time)
    if found is None:
        return None
    x, pull, lesson = found
    run.lesson = lesson, pull
    return x, pull
