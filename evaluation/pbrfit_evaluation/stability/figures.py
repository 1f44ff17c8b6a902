"""The stability suite as rows, verdicts and tables."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from pbrfit.commands.arguments import value, whole_number
from pbrfit_evaluation.arrays import worst
from pbrfit_evaluation.jobs import Values
from pbrfit_evaluation.options import Setting, fixed, threads
from pbrfit_evaluation.stability.sections import SECTIONS, Task, cases, run
from pbrfit_evaluation.suite import Results, Row, Section, Suite, Table, Verdict


def worst_of(task: Task, values: Values) -> dict[str, tuple[float, str]]:
    """The worst of each key that has a bound, and where, over all rows that have it."""
    found = {
        key: {name: row[key] for name, row in values["rows"].items() if key in row}
        for key in SECTIONS[task.section].bounds
    }
    return {key: worst(of) for key, of in found.items() if of}


def verdicts(results: Results[Task], _: Sequence[Row] = ()) -> list[Verdict]:
    """Every figure and its bound."""
    return [
        Verdict(what, found, most, where, part=task.section)
        for task, values in results.finished
        for key, (found, where) in worst_of(task, values).items()
        for what, most in [SECTIONS[task.section].bounds[key]]
    ]


def rows(results: Results[Task]) -> list[Row]:
    """A row a section: figures, their bounds, and how many fail."""
    made = []
    for task, record in results.pairs:
        failed = sum(not verdict.holds for verdict in verdicts(results.of(section=task.section)))
        metrics: dict[str, float | None] = {}
        for key, (found, _) in (worst_of(task, record.values) if record.values else {}).items():
            most = SECTIONS[task.section].bounds[key][1]
            metrics |= {key: found} if most is None else {key: found, f"{key}_bound": most}
        status = record.error or ("not held" if failed else "ok")
        made.append(Row(task.section, 0, None, metrics | {"failed": failed}, status=status))
    return made


def sections(results: Results[Task], _: Sequence[Row]) -> Iterator[Section]:
    """What was measured, why the bounds are what they are, and all cases."""
    for task, values in results.finished:
        of, rows = SECTIONS[task.section], values["rows"]
        text = f"{of.text}\n\nWhy these bounds: {of.why}"
        bars = {key: most for key, (_, most) in of.bounds.items() if most is not None}
        if failed := [
            name
            for name, row in rows.items()
            if any(not row[key] <= most for key, most in bars.items() if key in row)
        ]:
            text += f"\n\nNot held by: {'; '.join(failed)}"
        keys = list(dict.fromkeys(key for row in rows.values() for key in row))
        lines = [[name, *(row.get(key) for key in keys)] for name, row in rows.items()]
        table = Table(["", *(key.replace("_", " ") for key in keys)], lines)
        yield Section(task.section.capitalize(), text, [table] if rows else [])


SUITE = Suite(
    name="stability",
    title="Numerical stability",
    # Under one name, with the same effort and seed, the same is measured in the same way.
    protocol="pbrfit-stability-3, {effort}",
    cases=cases,
    run=run,
    rows=rows,
    verdicts=verdicts,
    sections=sections,
    settings={
        "seed": fixed(0, value("SEED", whole_number, "of pixels, lights, pictures")),
        "threads": threads,
        "fast objective": Setting((393_216,), (8_192,)),  # pixels of a kind
        "cancellation": Setting((65_536,), (4_096,)),  # pixels
        # 4^k pixels, of many pictures, draws
        "accumulated error": Setting((10, 65_536, 32), (8, 4_096, 8)),
        "tiny numbers": Setting((65_536,), (8_192,)),  # pixels
        "stiff fits": Setting((48, 16, 300), (10, 5, 20)),  # size, pictures, iterations
        "edges": Setting((100,), (6,)),  # scenes
    },
    jobs=1,
    about=(
        "Loss and gradient against float64 references, and a bound for every figure. pbrfit "
        "computes what depends on a material alone in float64, and the products with lights and "
        "residuals, which are nearly all of the work, in float32. This page says how far the "
        "results are from exact ones, and where they stop meaning anything. Every figure is the "
        "worst of all that was tried; u = 2⁻²⁴ = 6·10⁻⁸ is the largest relative error of one "
        "rounding to float32.",
    ),
)
