"""The second-order solvers: whether they reach what they are there for, and at what cost."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from pbrfit_evaluation import ablation, cycles
from pbrfit_evaluation.options import absolute, count, cycles_cache, option
from pbrfit_evaluation.solvers import comparisons, exact, memory, race
from pbrfit_evaluation.solvers import figures as of
from pbrfit_evaluation.solvers.fits import AUTO, FIRST_SEED, GAUSS_NEWTON, LBFGSB, Case
from pbrfit_evaluation.suite import Options, Suite

LARGE_SIZE = 2048
"""Side of pictures of 4 million pixels: only where it is asked for."""

SCENES = (
    {"exact": 67, "noise": 10, "start": 2, "gap": 20, "priors": 5, "race": 3},
    {"exact": 2, "noise": 1, "start": 1, "gap": 1, "priors": 1, "race": 1},
)
SIZE = (
    {"exact": 128, "noise": 128, "start": 64, "gap": 128, "priors": 64, "race": 512},
    {"exact": 32, "noise": 32, "start": 24, "gap": 32, "priors": 32, "race": 64},
)
"""Number of scenes and side of their pictures by part, in full and with `--quick`."""


def _counts(options: Options, part: str) -> tuple[range, int]:
    """Scenes and size of a part: an option is for all parts."""
    scenes, size = (
        of if isinstance(of, int) else of[part] for of in (options.scenes, options.size)
    )
    return range(scenes), size


def _cases(
    part: str,
    variants: Sequence[str] = ("",),
    levels: Sequence[float | None] = (None,),
    first_seed: int = FIRST_SEED,
) -> Callable[[Options], list[Case]]:
    """What gives a part's scenes of every variant at every level of noise."""

    def cases(options: Options) -> list[Case]:
        scenes, size = _counts(options, part)
        return [
            Case(part, first_seed + i, size, options.iterations, variant, noise)
            for i in scenes
            for variant in variants
            for noise in levels
        ]

    return cases


def _gap_cases(options: Options) -> list[Case]:
    """Scenes of each row; those of Cycles where it is at hand."""
    scenes, size = _counts(options, "gap")
    counts = dict.fromkeys(comparisons.ROWS, len(scenes))
    if options.cycles_scenes > 0 and not cycles.why_not():
        counts |= dict.fromkeys(comparisons.CYCLES_ROWS, min(len(scenes), options.cycles_scenes))
    cache = absolute(options.cycles_cache)
    return [
        Case("gap", FIRST_SEED + i, size, options.iterations, row, cycles_cache=cache)
        for row, most in counts.items()
        for i in range(most)
    ]


def _marks(options: Options) -> list[race.Task]:
    """The paper's recipe on each scene, which has to be first."""
    scenes, size = _counts(options, "race")
    return [race.Task("paper", FIRST_SEED + i, size, options.iterations) for i in scenes]


def _memory_tasks(options: Options) -> list[memory.Task]:
    sizes = (options.size,) if isinstance(options.size, int) else options.memory_sizes
    if options.large:
        sizes = (*sizes, LARGE_SIZE)
    return [memory.Task(solver, size) for size in sizes for solver in (GAUSS_NEWTON, AUTO, LBFGSB)]


START = _cases("start", comparisons.KINDS, comparisons.NOISES)
PRIORS = _cases("priors", tuple(comparisons.PRIORS_CASES), first_seed=ablation.FIRST_SEED)

PARTS = (
    of.part(
        "exact",
        "Exact: pictures without noise",
        _cases("exact"),
        exact.run,
        of.exact_verdicts,
        shown=of.exact_shown,
    ),
    of.part(
        "noise",
        "Noise",
        _cases("noise", levels=comparisons.LEVELS),
        comparisons.run_noise,
        of.noise_verdicts,
    ),
    of.part(
        "start",
        "The same start: objective of auto over that of lbfgsb, at most",
        START,
        comparisons.run_start,
        of.start_verdicts,
        of.start_rows,
    ),
    of.part(
        "gap",
        "Model gap: pictures that the model cannot explain",
        _gap_cases,
        comparisons.run_gap,
        of.gap_verdicts,
        of.gap_rows,
        of.gap_shown,
    ),
    of.part(
        "priors",
        "Priors: the ablation's cases, with noise of 0.01",
        PRIORS,
        comparisons.run_priors,
        of.priors_verdicts,
    ),
    of.part(
        "race",
        "Race to where the paper's recipe ends",
        _marks,
        race.work,
        of.race_verdicts,
        of.race_rows,
        of.race_shown,
        alone=True,
        then=race.rest,
    ),
    of.part(
        "memory",
        "Memory",
        _memory_tasks,
        memory.work,
        of.memory_verdicts,
        of.memory_rows,
        alone=True,
    ),
)

SUITE = Suite(
    name="solvers",
    title="The second-order solvers",
    description="Fit rooms with gauss-newton, auto and lbfgsb: without noise to the last digits, "
    "with noise, with priors, where the model does not fit, against the clock, and in memory; and "
    "hold the figures against what they must be. Writes report.html, plots, solvers.md, scenes.csv "
    "and summary.json. Exit code 1 if something does not hold. The race has PyTorch in it where "
    "that is installed (pip install pbrfit-evaluation[peers]).",
    protocol="pbrfit-solvers-1, {effort}",
    parts=PARTS,
    options=(
        count("--scenes", "K", "of every part (default: as each part needs)"),
        count("--size", "PIXELS", "of the pictures, likewise"),
        count("--iterations", "K", "of a fit"),
        option(
            "--cycles-scenes",
            metavar="K",
            type=int,
            help="in the gap part: scenes of a row that Blender Cycles renders",
        ),
        cycles_cache,
        option("--large", action="store_true", help="measure the memory of 4 million pixels too"),
    ),
    effort={
        "scenes": SCENES,
        "size": SIZE,
        "iterations": (500, 100),
        "cycles_scenes": (5, 0),
        "memory_sizes": ((512, 1024), (512,)),
    },
    about=(
        "Whether the second-order solver “gauss-newton”, and “auto”, which goes on from there with "
        "L-BFGS on the whole objective, reach what they are there for, beside “lbfgsb”, scipy's "
        "L-BFGS-B. docs/solvers.md says what each part measures, and what must hold.",
    ),
    jobs=1,
    timed=True,
    verdict_rows=True,
)
