"""The review's rates as files: page, plot, pictures, Markdown, summary."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from pbrfit_evaluation import page, summary, tables
from pbrfit_evaluation.page import Cell, Figure, Section, Table
from pbrfit_evaluation.review import LEAST_CAUGHT, MOST_REFUSED, Judged, Rate, Task
from pbrfit_evaluation.review.damage import REPAINTS, WHAT
from pbrfit_evaluation.review.plots import draw_examples, draw_rates

MARKDOWN = "review.md"
PICTURES = "pictures.csv"

GROUPS: dict[str, tuple[str, ...]] = {
    "shift": ("shift",),
    "warp": ("warp",),
    "repaint": REPAINTS,
    "swap": ("swap",),
}
"""What has to be caught, by the damages it is made of."""

IN_WORDS: dict[str, str] = {
    **{str(kind): what for kind, what in WHAT.items()},
    "swap": "a picture of another room",
}


@dataclass(frozen=True)
class Scene:
    """A scene and what became of its pictures."""

    task: Task
    judged: Sequence[Judged]


@dataclass(frozen=True)
class Demand:
    """What has to hold of a rate."""

    name: str
    rate: Rate
    bound: float
    at_least: bool

    @property
    def holds(self) -> bool:
        """Of at least one picture."""
        if not self.rate.pictures:
            return False
        share = self.rate.share
        return share >= self.bound if self.at_least else share <= self.bound


def demands(scenes: Sequence[Scene]) -> list[Demand]:
    """Of all scenes together."""
    found = [
        Demand(name, damage_rate(scenes, kinds), LEAST_CAUGHT, True)
        for name, kinds in GROUPS.items()
    ]
    every = damage_rate(scenes, tuple(kind for kinds in GROUPS.values() for kind in kinds))
    return [
        Demand("all damage", every, LEAST_CAUGHT, True),
        *found,
        Demand("honest", honest_rate(scenes, among_damaged=False), MOST_REFUSED, False),
        Demand(
            "honest among damaged", honest_rate(scenes, among_damaged=True), MOST_REFUSED, False
        ),
    ]


def damage_rate(scenes: Sequence[Scene], kinds: Sequence[str]) -> Rate:
    """Caught of some kinds of damage."""
    return Rate.of(one for scene in scenes for one in scene.judged if one.damage in kinds)


def honest_rate(scenes: Sequence[Scene], *, among_damaged: bool) -> Rate:
    """Refused of honest pictures, where all others are honest or where some are not."""
    return Rate.of(
        one
        for scene in scenes
        for one in scene.judged
        if one.damage == "honest" and one.among_damaged == among_damaged
    )


def write(folder: Path, scenes: Sequence[Scene], setup: Sequence[str]) -> None:
    """Write `report.html`, its figures, `review.md`, `pictures.csv`, `summary.json`."""
    found = demands(scenes)
    by_damage = [(kind, damage_rate(scenes, (kind,))) for kind in IN_WORDS]
    verdicts, damages, sources = _verdicts(found), _damages(by_damage), _sources(scenes)
    page.write_page(
        folder,
        "What the review of generated pictures finds",
        [
            "Renders of one view under many lights stand for the photograph and for pictures that "
            "a generator made of it. Some are damaged on purpose. The review judges each against "
            "the photograph and then all together, as in `pbrfit generate`.",
            *setup,
        ],
        [
            Section("Rates", [], [verdicts], [_figure(scenes)]),
            Section("By damage", [], [damages], _examples(scenes)),
            Section("By source", ["Caught or refused of how many."], [sources]),
        ],
    )
    text = "\n".join(page.markdown(table) for table in (verdicts, damages, sources))
    (folder / MARKDOWN).write_text(text, encoding="utf-8")
    columns = ("source", "seed", "damage", "among damaged", "amount", "refused by", "alone")
    tables.write_csv(
        folder / PICTURES,
        columns,
        [
            (
                scene.task.source,
                scene.task.seed,
                one.damage,
                one.among_damaged,
                f"{one.amount:.4g}",
                " ".join(one.refused),
                one.alone,
            )
            for scene in scenes
            for one in scene.judged
        ],
    )
    summary.write_summary(
        folder,
        "pbrfit-review-1: share of damaged pictures refused, and of honest ones",
        [
            summary.Row(
                demand.name,
                len(scenes),
                None,
                {
                    "refused": demand.rate.refused,
                    "pictures": demand.rate.pictures,
                    "share": demand.rate.share,
                    "least" if demand.at_least else "most": demand.bound,
                },
                status="ok" if demand.holds else "not held",
            )
            for demand in found
        ],
    )


def lines(scenes: Sequence[Scene]) -> list[str]:
    """For the terminal."""
    return [
        f"{demand.name:<22}{_share(demand.rate):>8} of {demand.rate.pictures:<5} "
        f"{'at least' if demand.at_least else 'at most'} {100 * demand.bound:.0f} %"
        f"{'' if demand.holds else '   NOT HELD'}"
        for demand in demands(scenes)
    ]


def _verdicts(found: Sequence[Demand]) -> Table:
    columns = [
        Cell("pictures"),
        *(Cell(name, "number") for name in ("refused", "of", "95 % interval", "bar")),
        Cell(""),
    ]
    rows = [
        [
            Cell(demand.name, "name"),
            Cell(_share(demand.rate), "number"),
            Cell(str(demand.rate.pictures), "number"),
            Cell("{} to {}".format(*map(_percent, demand.rate.interval())), "number"),
            Cell(f"{'≥' if demand.at_least else '≤'} {_percent(demand.bound)}", "number"),
            Cell("holds", "pass") if demand.holds else Cell("not held", "fail"),
        ]
        for demand in found
    ]
    return Table(columns, rows)


def _damages(by_damage: Sequence[tuple[str, Rate]]) -> Table:
    columns = [Cell("damage"), Cell("what it is"), Cell("caught", "number"), Cell("of", "number")]
    rows = [
        [
            Cell(kind, "name"),
            Cell(IN_WORDS[kind]),
            Cell(_share(rate), "number"),
            Cell(str(rate.pictures), "number"),
        ]
        for kind, rate in by_damage
    ]
    return Table(columns, rows)


def _sources(scenes: Sequence[Scene]) -> Table:
    names = list(dict.fromkeys(scene.task.source for scene in scenes))
    columns = [
        Cell("source"),
        Cell("scenes", "number"),
        Cell("honest", "number"),
        Cell("among damaged", "number"),
        *(Cell(name, "number") for name in GROUPS),
    ]
    rows = []
    for name in names:
        some = [scene for scene in scenes if scene.task.source == name]
        rates = [
            honest_rate(some, among_damaged=False),
            honest_rate(some, among_damaged=True),
            *(damage_rate(some, kinds) for kinds in GROUPS.values()),
        ]
        counts = [Cell(f"{rate.refused} of {rate.pictures}", "number") for rate in rates]
        rows.append([Cell(name, "name"), Cell(str(len(some)), "number"), *counts])
    return Table(columns, rows)


def _figure(scenes: Sequence[Scene]) -> Figure:
    rates = {f"{name}: caught": damage_rate(scenes, kinds) for name, kinds in GROUPS.items()} | {
        "honest: refused": honest_rate(scenes, among_damaged=False),
        "honest among damaged: refused": honest_rate(scenes, among_damaged=True),
    }
    return Figure("rates", draw_rates(rates), "With intervals of 95 %; the bars as dashed lines.")


def _examples(scenes: Sequence[Scene]) -> list[Figure]:
    task = scenes[0].task
    caption = f"The damages, on a scene of {task.kind} by our own renderer."
    return [Figure("damage", draw_examples(task.kind, task.seed), caption)]


def _share(rate: Rate) -> str:
    return _percent(rate.share) if rate.pictures else "–"


def _percent(share: float) -> str:
    return f"{100 * share:.1f} %"
