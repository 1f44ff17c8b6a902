"""What `pbrfit decompose` tells while scenes end: a bar, tables or JSON lines, and what failed."""

from __future__ import annotations

import json
from contextlib import AbstractContextManager, nullcontext
from typing import Any, Self

from pbrfit.batch.driver import Attempt, repeat_log
from pbrfit.batch.scenes import SceneOutcome, SceneTask
from pbrfit.commands.arguments import complain, progress_bar, unread_is_no_failure
from pbrfit.result.verdict import nothing_usable


class SceneDisplay:
    """Tells of each scene as it ends.

    Parameters
    ----------
    scenes
        How many there are; a single one has no bar.
    quiet
        No bar and no table.
    as_json
        A line of JSON a scene on stdout, instead of the table.
    strict
        Complain of scenes without a usable map.
    """

    def __init__(self, scenes: int, *, quiet: bool, as_json: bool, strict: bool) -> None:
        self._scenes, self._quiet, self._as_json = scenes, quiet, as_json
        self._strict = strict
        self._bar: Any = None
        self.ended = 0
        self.failed: list[SceneTask] = []
        self.unusable: list[SceneTask] = []
        """Scenes without a usable map, where `strict`."""

    def __enter__(self) -> Self:
        if self._scenes > 1:
            # Without smoothing: the time left is by the mean of all that was done.
            self._bar = progress_bar(
                self._scenes, quiet=self._quiet, unit="scene", name="scenes", smoothing=0
            )
        return self

    def __exit__(self, *_: object) -> None:
        if self._bar is not None:
            self._bar.close()

    def tell(self, task: SceneTask, attempt: Attempt[SceneOutcome]) -> None:
        """Tell that a scene has ended."""
        self.ended += 1
        outcome = attempt.value
        with self._above_the_bar():
            repeat_log(attempt.said)
            if attempt.error is not None:
                self.failed.append(task)
                named = str(task.scene) in attempt.error or str(task.output) in attempt.error
                complain(attempt.error if named else f"{task.scene}: {attempt.error}")
            if self._strict and outcome is not None and nothing_usable(outcome.verdicts):
                self.unusable.append(task)
                said = ", ".join(f"{name} {one.level}" for name, one in outcome.verdicts.items())
                complain(f"{task.scene}: no usable map: {said}")
            with unread_is_no_failure():
                if self._as_json:
                    print(_as_json(task, attempt), flush=True)
                elif outcome is not None and not self._quiet:
                    print(outcome.table)
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
        """Say what failed, and which scenes have no usable map."""
        if self.unusable:
            names = ", ".join(str(task.scene) for task in self.unusable)
            complain(f"{len(self.unusable)} of {self._scenes} scenes have no usable map: {names}")
        if self.failed:
            names = ", ".join(str(task.scene) for task in self.failed)
            complain(f"{len(self.failed)} of {self._scenes} scenes failed: {names}")

    def _above_the_bar(self) -> AbstractContextManager[object]:
        if self._bar is None:
            return nullcontext()
        above: AbstractContextManager[object] = self._bar.external_write_mode()
        return above


def _as_json(task: SceneTask, attempt: Attempt[SceneOutcome]) -> str:
    outcome = attempt.value
    line = {
        "scene": str(task.scene),
        "output": str(task.output),
        "status": "failed" if outcome is None else outcome.status,
        "error": attempt.error,
        "seconds": round(attempt.seconds, 3),
        "peak_bytes": None if outcome is None else outcome.peak_bytes,
        "stop_reason": None if outcome is None else outcome.stop_reason,
        "iterations": None if outcome is None else outcome.iterations,
        "metrics": {} if outcome is None else dict(outcome.metrics),
        "verdicts": {}
        if outcome is None
        else {name: one.as_json() for name, one in outcome.verdicts.items()},
    }
    return json.dumps(line)
