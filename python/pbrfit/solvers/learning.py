"""The material prior in a fit: learnt around a state, a penalty from there on."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pbrfit import material_prior
from pbrfit.material_prior import MaterialPull
from pbrfit.needs import Needs
from pbrfit.priors import penalties
from pbrfit.solvers.run import Run

Array = NDArray[np.float64]


def learns(run: Run) -> bool:
    """Whether the fit has a prior that is learnt."""
    return run.priors.material > 0


def learnt(run: Run, x: Array) -> tuple[Array, MaterialPull | None]:
    """X with the material prior learnt around it, which is a penalty from here on; one iteration.

    Where time runs out before, x is as it was and there is no prior.

    Weights that are chosen by rule are chosen by the lights that were found with it.
    """
    objective = run.objective
    with run.stage("material prior") as notes:
        found = material_prior.learn(
            objective.reweighted(x), x, run.priors.material, out_of_time=run.out_of_time
        )
        if found is None:
            notes.append("stopped before all pixels had theirs")
            return x, None
        x, pull = found
        run.measured_lighting = objective.unpack(x)[1]
        needs = Needs.of(
            run.scene, objective.layout, priors=run.priors, lighting=run.measured_lighting
        )
        objective.penalties = [*penalties(objective.layout, needs.priors), pull]
        objective.robust = objective.robust_around(x, run.robust)
        loss = run.evaluate(x)[0]
        run.iteration += 1
        run.record(x, loss)
    return x, pull
