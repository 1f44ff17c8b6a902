"""The stability suite as rows, verdicts and tables."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from pbrfit_evaluation.stability.sections import SECTIONS, Task
from pbrfit_evaluation.suite import Results, Row, Section, Table, Verdict


def verdicts(results: Results[Task], _: Sequence[Row] = ()) -> list[Verdict]:
    """Every figure and its bound."""
    return [
        Verdict(what, value, most, where, part=task.section)
        for task, values in results.finished
        for key, (what, most) in SECTIONS[task.section].bounds.items()
        if key in values["figures"]
        for value, where in [values["figures"][key]]
    ]


def rows(results: Results[Task]) -> list[Row]:
    """A row a section: figures, their bounds, and how many fail."""
    found = []
    for task, record in results.pairs:
        of = results.of(section=task.section)
        failed = sum(not verdict.holds for verdict in verdicts(of))
        metrics: dict[str, float | None] = {}
        of_task = (record.values or {}).get("figures", {})
        for key, (_, most) in SECTIONS[task.section].bounds.items():
            if key in of_task:
                metrics[key] = of_task[key][0]
                if most is not None:
                    metrics[f"{key}_bound"] = most
        status = record.error or ("not held" if failed else "ok")
        found.append(Row(task.section, 0, None, metrics | {"failed": failed}, status=status))
    return found


def sections(results: Results[Task], _: Sequence[Row]) -> Iterator[Section]:
    """What was measured, why the bounds are what they are, and all cases."""
    for task, values in results.finished:
        of, rows = SECTIONS[task.section], values.get("rows", {})
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
