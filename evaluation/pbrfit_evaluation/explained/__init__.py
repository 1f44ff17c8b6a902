"""Rooms by Cycles, each explained in several ways: what the suites `lamps` and `transport` share.

A setup is a row of Table 1 that rooms are rendered as; a variant (`variants.py`) explains them.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from pbrfit._core import InputError
from pbrfit_evaluation import cycles
from pbrfit_evaluation.options import Add, absolute, count, cycles_cache, first_seed, several
from pbrfit_evaluation.suite import Options
from pbrfit_evaluation.table1 import measure as table1
from pbrfit_evaluation.table1.rows import BY_KEY as TABLE1
from pbrfit_evaluation.table1.rows import Row

ROWS: Mapping[str, tuple[str, str]] = {
    "brdf": ("cycles-brdf", "BRDF alone"),
    "shadows": ("cycles-shadows", "and shadows"),
    "bounces": ("cycles-panorama", "all bounces"),
    "detailed": ("cycles-detailed", "all bounces, detailed"),
    "points-shadows": ("cycles-points", "Point lamps with shadows"),
    "points": ("cycles-points-unshadowed", "Point lamps without shadows"),
}
"""Rows of Table 1 by setup, and what the setups are called."""


@dataclass(frozen=True)
class Case:
    """A room of a setup, explained in one way.

    Attributes
    ----------
    setup, variant
        Keys.
    seed
        Of the room, its lights, and what disturbs what the fit is given.
    size, lights
        Side of the pictures, and their number; as many are held out where any are.
    picture
        Whether pictures are kept for the report.
    cycles_cache
        Where renders are kept.
    """

    setup: str
    variant: str
    seed: int
    size: int
    lights: int
    picture: bool = False
    cycles_cache: Path | None = field(default=None, repr=False)

    @property
    def key(self) -> str:
        """Name of the record."""
        return f"{self.setup}_{self.variant}_{self.seed}"

    @property
    def of_table1(self) -> tuple[table1.Task, Row]:
        """The task and the row of Table 1 that renders the room."""
        row = TABLE1[ROWS[self.setup][0]]
        of = (row.key, self.seed, self.size, self.lights, 0)
        return table1.Task(*of, cycles_cache=self.cycles_cache), row


def cases_of(
    variants: Collection[str], pictured: Collection[str]
) -> Callable[[Options], list[Case]]:
    """`Part.cases`: every room of every setup in every way; the first room in some is pictured.

    Rooms change fastest, so that processes side by side do not render the same one. The function
    raises InputError if there are too few pictures.
    """

    def cases(options: Options) -> list[Case]:
        if options.lights < 2:
            raise InputError(f"--lights: expected at least 2, found {options.lights}")
        if cycles.why_not():
            return []
        return [
            Case(
                *(setup, variant, options.first_seed + i, options.size, options.lights),
                picture=i == 0 and variant in pictured,
                cycles_cache=absolute(options.cycles_cache),
            )
            for variant in variants
            if variant in options.variants
            for setup in options.setups
            for i in range(options.scenes)
        ]

    return cases


def options_of(
    setups: Collection[str],
    by_default: str,
    variants: Collection[str],
    few: Collection[str],
    seed: int,
    *,
    held_out: str = "",
) -> tuple[Add, ...]:
    """Options of the suite; setups `by_default` and what is `held_out` in words."""
    return (
        several("--setups", "NAME", setups, default=by_default),
        several("--variants", "NAME", variants, few, what="only these ways to explain a room"),
        count("--scenes", "K", "rooms of a setup"),
        count("--size", "PIXELS", "of the pictures"),
        count("--lights", "N", f"pictures a room{held_out}", default=16),
        first_seed("room", seed),
        cycles_cache,
    )
