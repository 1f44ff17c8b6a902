"""What `pbrfit decompose` tells: how scenes go on, one table in the end or JSON lines, what failed.

A single scene has a table of its own, with verdicts; of several each has a row.
"""

from __future__ import annotations

import argparse
import json
import time
from collections import Counter
from collections.abc import Sequence
from contextlib import nullcontext
from dataclasses import dataclass, replace
from typing import Any, Self

from pbrfit.batch.driver import Attempt, repeat_log
from pbrfit.batch.scenes import SceneOutcome, SceneTask, rmse_in_words
from pbrfit.commands.messages import complain, in_flags, unread_is_no_failure
from pbrfit.commands.progress import progress_bar
from pbrfit.commands.terminal import (
    DIM,
    columns_of_stdout,
    held_out_lines,
    marked,
    painted,
    verdict_lines,
)
from pbrfit.io.json_files import as_json
from pbrfit.result.result import REPORT_FILE
from pbrfit.result.verdict import LEVELS, PARAMETERS, Level, nothing_usable
from pbrfit.values.quoting import shown


@dataclass(frozen=True)
class Row:
    """A scene in the table of a batch."""

    name: str
    status: str
    residual: str
    held_out: str
    """Relative error of left-out pictures; empty where none were."""
    levels: tuple[Level | None, ...]
    """Of the maps; None where there is no verdict."""
    seconds: float


class SceneDisplay:
    """Tells of each scene as it ends.

    A single one of so many `scenes` has no bar, and a table of its own. Of the command's options
    `verbose` tells how its fit went, too; `quiet` leaves out bar, lines of progress and table;
    `json` prints a line a scene in place of the table; `strict` complains of scenes without a
    usable map.
    """

    def __init__(self, scenes: int, options: argparse.Namespace) -> None:
        self._scenes, self._options = scenes, options
        self._bar: Any = None
        self._rows: list[Row] = []
        self._began = time.perf_counter()
        self.ended = 0
        self.failed: list[SceneTask] = []
        self.unusable: list[SceneTask] = []
        """Scenes without a usable map, where `strict`."""

    def __enter__(self) -> Self:
        if self._scenes > 1:
            # Without smoothing: the time left is by the mean of all that was done.
            self._bar = progress_bar(
                self._scenes, quiet=self._options.quiet, unit="scene", name="scenes", smoothing=0
            )
        return self

    def __exit__(self, *_: object) -> None:
        if self._bar is not None:
            self._bar.close()

    def tell(self, task: SceneTask, attempt: Attempt[SceneOutcome]) -> None:
        """Tell that a scene has ended."""
        self.ended += 1
        outcome = attempt.value
        with nullcontext() if self._bar is None else self._bar.external_write_mode():
            repeat_log(attempt.said)
            if attempt.error is not None:
                self.failed.append(task)
                named = str(task.scene) in attempt.error or str(task.output) in attempt.error
                complain(attempt.error if named else f"{task.scene}: {attempt.error}")
            if self._options.strict and outcome is not None and nothing_usable(outcome.verdicts):
                self.unusable.append(task)
                said = ", ".join(f"{name} {one.level}" for name, one in outcome.verdicts.items())
                complain(f"{task.scene}: no usable map: {said}")
            with unread_is_no_failure():
                if self._options.json:
                    print(_as_json(task, attempt), flush=True)
                elif self._options.quiet:
                    pass
                elif self._scenes > 1:
                    self._rows.append(_row(task, attempt))
                elif outcome is not None:
                    page = task.output / REPORT_FILE
                    parts = [
                        outcome.details if self._options.verbose else (),
                        held_out_lines(outcome.held_out)[: 1 + self._options.verbose],
                        verdict_lines(outcome.verdicts, outcome.steps),
                        [f"{page}: open it in a browser"] if page.is_file() else [],
                    ]
                    print("\n\n".join([outcome.table, *map("\n".join, filter(None, parts))]))
        if self._bar is not None:
            kept = outcome is not None and outcome.status == "kept"
            if kept and not self._bar.disable:
                self._bar.initial += 1  # it took no time, and so says nothing about the time left
            self._bar.update()

    def show(self, running: int) -> None:
        """Tell that so many scenes are at work."""
        if self._bar is not None:
            self._bar.set_postfix_str(f"{running} at work")

    def summary(self) -> None:
        """Print the table of several scenes; say what failed, and what has no usable map."""
        if self._rows:
            seconds = time.perf_counter() - self._began
            with unread_is_no_failure():
                print("\n".join(batch_table(self._rows, seconds)))
        if self.unusable:
            names = ", ".join(str(task.scene) for task in self.unusable)
            complain(f"{len(self.unusable)} of {self._scenes} scenes have no usable map: {names}")
        if self.failed:
            names = ", ".join(str(task.scene) for task in self.failed)
            complain(f"{len(self.failed)} of {self._scenes} scenes failed: {names}")


def _as_json(task: SceneTask, attempt: Attempt[SceneOutcome]) -> str:
    outcome = attempt.value
    line: dict[str, Any] = {
        "scene": str(task.scene),
        "output": str(task.output),
        "status": "failed" if outcome is None else outcome.status,
        "error": None if attempt.error is None else in_flags(attempt.error),
        "seconds": round(attempt.seconds, 3),
    }
    facts = ("peak_bytes", "stop_reason", "iterations")  # null of scenes that failed
    line |= {name: getattr(outcome, name, None) for name in facts}
    held_out, verdicts = getattr(outcome, "held_out", None), getattr(outcome, "verdicts", {})
    line["held_out"] = as_json(held_out)
    line["metrics"] = dict(getattr(outcome, "metrics", {}))
    line["verdicts"] = as_json(verdicts)
    return json.dumps(line)


def batch_table(rows: Sequence[Row], seconds: float) -> list[str]:
    """Lines about several scenes in the order of their names, and how many there were of what.

    Verdicts are told by their first words where a line would not fit into the terminal.
    """
    rows = sorted((replace(row, name=shown(row.name)) for row in rows), key=lambda row: row.name)
    of_name = max(len("scene"), *(len(row.name) for row in rows))

    def line(
        name: str, status: str, errors: Sequence[str], levels: Sequence[str], last: str
    ) -> str:
        columns = [f"{name:<{of_name}}", f"{status:<6}", *(f"{one:>8}" for one in errors), *levels]
        return "  ".join([*columns, f"{last:>7}"])

    def head(width: int) -> str:
        maps = [f"{name:<{2 + width}}" for name in PARAMETERS]
        return line("scene", "status", ("residual", "held out"), maps, "seconds")

    words: dict[Level, str] = {level: level for level in LEVELS}
    of_level, columns = max(map(len, LEVELS)), columns_of_stdout()
    if columns is not None and len(head(of_level)) > columns:
        words = {level: level.split()[0] for level in LEVELS}
        of_level = max(map(len, PARAMETERS)) - 2
    lines = [painted(head(of_level), DIM)]
    for row in rows:
        levels = [
            " ".join(marked(level, f"{words[level]:<{of_level}}"))
            if level is not None
            else " " * (2 + of_level)
            for level in row.levels
        ]
        errors = (row.residual, row.held_out)
        lines.append(line(row.name, row.status, errors, levels, f"{row.seconds:.1f}"))
    counts = Counter(row.status for row in rows)
    parts = [
        f"{counts[status]} {status}" for status in ("done", "kept", "failed") if counts[status]
    ]
    usable = sum("usable" in row.levels for row in rows)
    parts.append(f"{usable} with a usable map")
    return [*lines, f"\n{len(rows)} scenes in {seconds:.1f} s: {', '.join(parts)}"]


def _row(task: SceneTask, attempt: Attempt[SceneOutcome]) -> Row:
    outcome = attempt.value
    if outcome is None:
        return Row(task.name, "failed", "", "", (None,) * len(PARAMETERS), attempt.seconds)
    levels = tuple(
        outcome.verdicts[name].level if name in outcome.verdicts else None for name in PARAMETERS
    )
    residual = rmse_in_words(outcome.metrics["recon_rmse"])
    held_out = "" if outcome.held_out is None else outcome.held_out.error_in_words
    return Row(task.name, outcome.status, residual, held_out, levels, attempt.seconds)
