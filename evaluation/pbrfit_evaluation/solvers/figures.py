"""Rows and verdicts; what must be reached is in docs/solvers.md."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence

from pbrfit.commands.arguments import positive, value
from pbrfit_evaluation.grid.figures import Bar, Metrics, Of, by_seed, grid_rows, of_bars, of_most
from pbrfit_evaluation.options import Setting, count
from pbrfit_evaluation.solvers.measure import GRID, NOISE, RESIDUAL, run
from pbrfit_evaluation.suite import Row, Suite, Verdict

EXACT_SHARE = 64 / 67
"""Share of the rooms without noise that have to be exact, at least."""

OBJECTIVE_SLACK, METRIC_RATIO = 1e-3, 1.02
"""With noise: objective of `gauss-newton` over the mark, less 1, and its mean error over that of
`lbfgsb`, at most."""

EXACT_METRICS = ("exact", "residual", "worst_map", "seconds")
"""The mean of "exact" is the share of rooms."""

ERRORS = ("albedo", "albedo_scaled", "roughness", "metallic", "relight")

NOISE_METRICS = ("recon", *ERRORS, "seconds")


def above_mark(results: Of, condition: str, way: str) -> dict[int, float]:
    """Objective of each scene without penalties over the mark, less 1; where there is a mark.

    The mark is the lower of L-BFGS-B's, and that of Gauss-Newton from the ground truth, which no
    search for a start can be blamed for. The objective is the square of the residual in float64.
    """
    recon = {
        key: by_seed(results, condition, key, "scores", "recon") for key in ("truth", "lbfgsb", way)
    }
    return {
        seed: (found / min(recon["truth"][seed], recon["lbfgsb"][seed])) ** 2 - 1
        for seed, found in recon[way].items()
        if seed in recon["truth"] and seed in recon["lbfgsb"]
    }


def rows(results: Of) -> list[Row]:
    """Means over the rooms of a condition, a row a way."""

    def more(condition: str, way: str, of: Of) -> Metrics:
        if condition not in NOISE:
            return of.metrics(EXACT_METRICS, "scores")
        above = above_mark(results, condition, way).values()
        mean = sum(above) / len(above) if above else math.nan
        return {"above_mark": mean} | of.metrics(NOISE_METRICS, "scores")

    return grid_rows(GRID, results, (), more)


def verdicts(results: Of, _: Sequence[Row]) -> Iterator[Verdict]:
    """Enough rooms are exact, and `gauss-newton` never above `lbfgsb` nor with larger errors."""
    for condition in RESIDUAL:
        exact = by_seed(results, condition, "gauss-newton", "scores", "exact")
        if exact:
            what = f"{GRID.conditions[condition]}: rooms of {len(exact)} that are exact"
            yield of_most(what, exact, math.ceil(EXACT_SHARE * len(exact) - 1e-9))
    ours, theirs = (
        by_seed(results, "exact", key, "scores", "residual") for key in ("gauss-newton", "lbfgsb")
    )
    above = {seed: ours[seed] / theirs[seed] for seed in ours if seed in theirs}
    yield from _highest("no noise: gauss-newton's residual over lbfgsb's", above, 1.0)
    for condition, title in ((key, GRID.conditions[key]) for key in NOISE):
        above = above_mark(results, condition, "gauss-newton")
        what = f"{title}: gauss-newton's objective over the mark, less 1"
        yield from _highest(what, above, OBJECTIVE_SLACK)
        for suffix, priors in (("", "no priors"), ("-priors", "priors")):
            of, over = ((condition, f"{key}{suffix}") for key in ("gauss-newton", "lbfgsb"))
            what = f"{title}, {priors}: worst mean error, gauss-newton over lbfgsb"
            yield from of_bars(results, [Bar(what, of, over, ERRORS, METRIC_RATIO)])


def _highest(what: str, above: Mapping[int, float], bar: float) -> Iterator[Verdict]:
    """The largest figure of any scene, and how many are above the bar."""
    if above:
        worst = max(above, key=lambda seed: above[seed])
        many = f"above in {sum(value > bar for value in above.values())} of {len(above)}"
        yield Verdict(what, above[worst], bar, f"seed {worst}; {many}")


FIRST_SEED = 1000
"""Rooms from here on are those of `pbrfit evaluate table1`."""

SUITE = Suite(
    name="solvers",
    title="The second-order solver",
    protocol="pbrfit-solvers-1, {effort}",
    cases=GRID.cases,
    run=run,
    rows=rows,
    verdicts=verdicts,
    settings={
        **GRID.settings(
            FIRST_SEED,
            Setting(
                (67, 10),
                (2, 1),
                value("K", positive, "of every condition (default: as each needs)"),
            ),
            (128, 32),
        ),
        "iterations": count("K", "of a fit", 500, 100),
    },
    about=(
        "Whether the second-order solver “gauss-newton” reaches what it is there for, beside "
        "“lbfgsb”, scipy's L-BFGS-B, in rooms without noise, to the last digits, and with noise. "
        "docs/solvers.md says what is measured, and what must hold.",
    ),
    jobs=1,
    timed=True,
)
