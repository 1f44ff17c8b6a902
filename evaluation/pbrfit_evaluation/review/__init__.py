"""How often the review of generated pictures finds damage, and refuses honest pictures."""

from __future__ import annotations

from pbrfit_evaluation import cycles
from pbrfit_evaluation.options import absolute, cycles_cache, first_seed, option
from pbrfit_evaluation.review import figures
from pbrfit_evaluation.review.measure import Task, work
from pbrfit_evaluation.review.pictures import Renderer
from pbrfit_evaluation.suite import Options, Part, Suite

SOURCES: dict[str, tuple[tuple[str, Renderer, int], ...]] = {
    "full": (
        ("furnished", "cycles-full", 1),
        ("furnished", "cycles", 4),
        ("detailed", "cycles", 2),
        ("furnished", "own", 3),
        ("detailed", "own", 3),
        ("textured", "own", 2),
        ("room", "own", 1),
        ("spheres", "own", 1),
    ),
    "quick": (("furnished", "own", 1), ("textured", "own", 1)),
}
"""Kinds of scenes, what renders them, and how many of each."""


def cases(options: Options) -> list[Task]:
    """All scenes; those by Cycles where it is there and wanted."""
    own_alone = options.no_cycles or bool(cycles.why_not())
    cache = absolute(options.cycles_cache)
    return [
        Task(kind, renderer, seed, options.size, options.pictures, options.sets, cache)
        for kind, renderer, scenes in SOURCES[options.effort]
        if renderer == "own" or not own_alone
        for seed in range(options.first_seed, options.first_seed + scenes)
    ]


SUITE = Suite(
    name="review",
    title="What the review of generated pictures finds",
    protocol="pbrfit-review-1: share of damaged pictures refused, and of honest ones",
    parts=[Part.shown_by(figures, "review", cases, work)],
    options=(
        # Nothing was tuned on seeds from 6000 on.
        first_seed("scene of a source"),
        cycles_cache,
        option(
            "--no-cycles", action="store_true", help="only our own renders, even with Cycles there"
        ),
    ),
    effort={"first_seed": (6000, 6000), "size": (512, 256), "pictures": (16, 8), "sets": (3, 1)},
    about=(
        "Renders of one view under many lights stand for the photograph and for pictures that a "
        "generator made of it. Some are damaged on purpose, five in each set. The review judges "
        "each against the photograph and then all together, as in `pbrfit generate`. Pictures are "
        "8-bit sRGB. Without Blender Cycles (make cycles-env), which casts hard shadows, only our "
        "own renders are judged.",
    ),
)
