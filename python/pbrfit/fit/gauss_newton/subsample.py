"""A few pixels find the lights: rounds of trying all finishes and of joint steps."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from pbrfit.fit.gauss_newton.lights import options
from pbrfit.fit.gauss_newton.normal_equations import Cholesky, as_in_x
from pbrfit.fit.gauss_newton.pixels import descended, put
from pbrfit.fit.objective import Objective

Array = NDArray[np.float64]

ROUNDS = 20
"""At most. Rooms need three to seven."""

STARTS = 2
"""Nodes from which each pixel starts in a round."""

STEPS = 8
"""Joint steps of a round."""

DESCENT = 4
"""Steps of each pixel by itself after a joint one."""

FIRST_DAMPING = 1e-3
LEAST_DAMPING = 1e-9
"""Of the diagonals of pixels, as in Marquardt's method."""

LIGHT_DAMPING = 1e-3
"""Damping of the lights as a share of that of pixels."""

FAILURES = 4
"""Steps in a row that may fail, each followed by ten times the damping."""

SHARES = (1.0, 0.4, 0.1)
"""Of a step that are tried before more damping is."""

STALLED = 1e-4
"""A step that lowers the sum of squares by less than this share of it is the last of its round."""

STALLED_ROUND = 0.02
"""A round that does is the last, unless another scale between albedo and light is better. Where the
way is free a round lowers the sum by a third or more, and what is left of noise is found faster by
more pixels."""

SCALES = (1.2, 1 / 1.2, 1.05, 1 / 1.05)
"""Factors on the lights of a channel that are tried, with its albedo divided by them."""


Visit = Callable[[Array, float], bool]
"""Called with x and its sum of squares after each joint step; whether to stop."""


def minimize(few: Objective, x: Array, visit: Visit) -> tuple[Array, float]:
    """Lights, and materials of these pixels, with their sum of squares.

    Parameters
    ----------
    few
        The objective of the pixels, with unknown lights.
    x
        Where to start.
    visit
        Watches.
    """
    pixels = np.arange(few.pixels, dtype=np.uint64)
    damping, last = FIRST_DAMPING, np.inf
    total = np.inf
    for _ in range(ROUNDS):
        found, squares = descended(few, x, pixels, steps=2 * DESCENT, starts=STARTS)
        x = put(few, x, pixels, found)
        x, total, damping, stop = _joint(few, x, float(squares.sum()), damping, visit)
        if not stop and total > (1 - STALLED_ROUND) * last:
            # The loss is flat along the scale between albedo and light, and curved: look further.
            x, total, scaled = _scaled(few, x, total)
            stop = not scaled
        if stop:
            break
        last = total
    return x, total


def _joint(
    few: Objective, x: Array, total: float, damping: float, visit: Visit
) -> tuple[Array, float, float, bool]:
    """Joint steps; x, its squares, the damping, and whether to stop altogether."""
    pixels = np.arange(few.pixels, dtype=np.uint64)
    done = failed = 0
    while done < STEPS and failed <= FAILURES:
        how = options(few, x, pixels, None) | {"damping": damping}
        matrix, gradient = few.problem.schur_complement(few.for_core(x), pixels, **how)
        try:
            moves = -Cholesky(matrix, LIGHT_DAMPING * damping).solve(gradient)
        except np.linalg.LinAlgError:
            damping, failed = 10 * damping, failed + 1
            continue
        if -float(gradient @ moves) < STALLED * total:
            break
        before = total
        for share in SHARES:
            followed = few.problem.back_substitute(few.for_core(x), pixels, share * moves, **how)
            trial = put(few, x, pixels, followed)
            trial[few.layout.lighting] += share * as_in_x(moves, few.layout)
            found, squares = descended(few, trial, pixels, steps=DESCENT)
            if squares.sum() < total:
                x, total = put(few, trial, pixels, found), float(squares.sum())
                break
        done += 1
        if total < before:
            damping, failed = max(damping / 5, LEAST_DAMPING), 0
        else:
            damping, failed = 10 * damping, failed + 1
        if visit(x, total):
            return x, total, damping, True
        if 0 < before - total < STALLED * before:
            break
    return x, total, min(max(damping, 1e-6), FIRST_DAMPING), False


def _scaled(few: Objective, x: Array, total: float) -> tuple[Array, float, bool]:
    """X with the lights of all channels or of one scaled, if that lowers the squares; whether."""
    layout = few.layout
    pixels = np.arange(few.pixels, dtype=np.uint64)
    before = total
    channels = [slice(None)]
    if layout.light_channels > 1:
        channels += [slice(c, c + 1) for c in range(layout.light_channels)]
    for channel in channels:
        for factor in SCALES:
            trial = x.copy()
            trial[layout.lighting].reshape(-1, layout.light_channels)[:, channel] *= factor
            albedo = trial[layout.albedo].reshape(layout.channels, -1)
            albedo[channel] = np.clip(albedo[channel] / factor, 0, 1)
            found, squares = descended(few, trial, pixels, steps=2 * DESCENT, starts=STARTS)
            if squares.sum() < (1 - STALLED) * total:
                x, total = put(few, trial, pixels, found), float(squares.sum())
    return x, total, total < before
