"""Normals refined together with materials and lights.

Normals of an estimator are ten degrees off and more, and every wrong normal bends its material and
the lights. Pictures under several lights know better: a pixel has a number a picture and channel,
and with its normal seven unknowns.

1. `search`: the pixels of a lattice find lights and normals, from the given normals
   (`joint_step`, `tilt_prior`).
2. `everywhere`: all pixels turn their normals in these lights, then with the lights.
3. A fit with these normals and lights held (`pbrfit.fit.solvers`) finds materials with all priors.
4. All pixels turn again, near the materials of that fit, and 3. once more.

`pbrfit.result.refinement` says whether this is worth while, and what of it is kept.
"""

from pbrfit.fit.normals.everywhere import prior_of, spread_out, start_nearer, turn
from pbrfit.fit.normals.offset_prior import FIRST_SPREAD
from pbrfit.fit.normals.search import find
from pbrfit.fit.normals.tangent_offsets import tilts_between

__all__ = [
    "FIRST_SPREAD",
    "find",
    "prior_of",
    "spread_out",
    "start_nearer",
    "tilts_between",
    "turn",
]
