"""The second-order solver: whether it reaches what it is there for, and at what cost."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from pbrfit_evaluation.options import count
from pbrfit_evaluation.solvers import figures, measure
from pbrfit_evaluation.solvers.measure import FIRST_SEED, Case
from pbrfit_evaluation.suite import Options, Part, Suite


def _cases(part: str, levels: Sequence[float | None] = (None,)) -> Callable[[Options], list[Case]]:
    """What gives a part's rooms at every level of noise; an option is for both parts."""

    def cases(options: Options) -> list[Case]:
        scenes = options.scenes if isinstance(options.scenes, int) else options.scenes[part]
        return [
            Case(part, FIRST_SEED + i, options.size, options.iterations, noise)
            for i in range(scenes)
            for noise in levels
        ]

    return cases


SUITE = Suite(
    name="solvers",
    title="The second-order solver",
    description="Fit rooms with gauss-newton and lbfgsb, without noise to the last digits, "
    "and with noise, and hold the figures against what they must be. Writes report.html, "
    "solvers.md, scenes.csv and summary.json. Exit code 1 if something does not hold.",
    protocol="pbrfit-solvers-1, {effort}",
    parts=[
        Part.shown_by(figures, "exact", _cases("exact"), measure.run_exact, "exact_"),
        Part.shown_by(
            figures, "noise", _cases("noise", measure.LEVELS), measure.run_noise, "noise_"
        ),
    ],
    options=(
        count("--scenes", "K", "of every part (default: as each part needs)"),
        count("--size", "PIXELS", "of the pictures"),
        count("--iterations", "K", "of a fit"),
    ),
    effort={
        "scenes": ({"exact": 67, "noise": 10}, {"exact": 2, "noise": 1}),
        "size": (128, 32),
        "iterations": (500, 100),
    },
    about=(
        "Whether the second-order solver “gauss-newton” reaches what it is there for, beside "
        "“lbfgsb”, scipy's L-BFGS-B. docs/solvers.md says what each part measures, and what must "
        "hold.",
    ),
    jobs=1,
    timed=True,
    verdict_rows=True,
)
