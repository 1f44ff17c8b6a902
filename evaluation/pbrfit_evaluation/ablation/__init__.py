"""The ablation: what each prior is worth, where segments are right, wrong or missing."""

from __future__ import annotations

from pbrfit.commands.fit_options import MODEL_OF_PICTURES, add_option
from pbrfit.model.reflection import DEFAULT_MODEL
from pbrfit_evaluation.ablation import figures
from pbrfit_evaluation.ablation.cases import CASES, VARIED_IN
from pbrfit_evaluation.ablation.configurations import curves, table
from pbrfit_evaluation.ablation.measure import RoomTask, room
from pbrfit_evaluation.options import count, first_seed
from pbrfit_evaluation.scores import PROTOCOL as SCORES
from pbrfit_evaluation.suite import Options, Part, Suite

FIRST_SEED = 3000
"""Rooms are those of the seeds from here on. Priors were designed and their weights chosen on seeds
2000 to 2099; none from 3000 on ever served for that."""


def rooms(options: Options) -> list[RoomTask]:
    """Rooms of all cases; a weight that is varied may be one of the table's, and is fitted once."""
    always = table(quick=options.quick)
    varied = tuple(dict.fromkeys((*always, *curves(options.weights))))
    return [
        RoomTask(
            name,
            options.first_seed + i,
            options.size,
            options.iterations,
            varied if name in VARIED_IN else always,
            picture=i == 0,
            model=options.model,
        )
        for i in range(options.scenes)
        for name in CASES
    ]


SUITE = Suite(
    name="ablation",
    title="What the priors are worth",
    description="Fit rooms whose ground truth is known with and without each prior: with right, "
    "wrong and missing segments, and materials that keep to them or not. Writes report.html, "
    "pictures, ablation.md, rooms.csv and summary.json.",
    protocol="pbrfit-ablation-1: rooms with noise of 0.01 at a mean radiance of 0.4; "
    f"{SCORES}; {{size}} pixels, {{iterations}} iterations",
    parts=[Part.shown_by(figures, "rooms", rooms, room)],
    options=(
        lambda parser: add_option(parser, "model", MODEL_OF_PICTURES, DEFAULT_MODEL),
        count("--scenes", "K", "rooms of each case"),
        count("--size", "PIXELS", "of a room's pictures"),
        count("--iterations", "N", "of each fit"),
        first_seed("room", FIRST_SEED),
    ),
    effort={
        "scenes": (5, 1),
        "size": (64, 32),
        "iterations": (500, 60),
        "weights": ((0.01, 0.1, 1.0, 10.0), ()),
    },
    quick="few configurations, small pictures",
    about=(
        "What each prior does to the errors of materials and relighting. Rooms have 16 pictures "
        "with noise of 0.01 at a mean radiance of 0.4, and 16 held out. Ratios are to the fit "
        "without priors, between mean errors over the rooms.",
    ),
    binding=False,
)
