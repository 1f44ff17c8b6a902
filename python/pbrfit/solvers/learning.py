"""The material prior in a fit: learnt around a state, a penalty from there on."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pbrfit import material_prior
from pbrfit.material_prior import HeldPull, MaterialPull
from pbrfit.needs import Needs
from pbrfit.priors import Penalty, penalties
from pbrfit.solvers.run import Run

Array = NDArray[np.float64]


def learns(run: Run) -> bool:
    """Whether the fit has a prior that is learnt."""
    return run.priors.material > 0


def learnt(run: Run, x: Array) -> tuple[Array, MaterialPull | HeldPull]:
    """X with the material prior learnt around it, which is a penalty from here on; one iteration.

    Weights that are chosen by rule are chosen by the lights that were found with it.
    """
    objective = run.objective
    with run.stage("material prior"):
        pull: MaterialPull | HeldPull
        others: list[Penalty] = []
        if run.taught is not None and run.taught.material is not None:
            x, pull = run.taught.material.applied(objective.reweighted(x), x)
            others = run.taught.penalties(objective.layout)
        else:
            x, pull, lesson = material_prior.learn(
                objective.reweighted(x), x, run.priors.material, out_of_time=run.out_of_time
            )
            run.lesson = lesson, pull
        run.measured_lighting = objective.unpack(x)[1]
        needs = Needs.of(
            run.scene, objective.layout, priors=run.priors, lighting=run.measured_lighting
        )
        objective.penalties = [*penalties(objective.layout, needs.priors), *others, pull]
        objective.robust = run.robust_around(x)
        loss = run.evaluate(x)[0]
        run.iteration += 1
        run.record(x, loss)
    return x, pull
