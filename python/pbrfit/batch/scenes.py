"""The task of `pbrfit decompose`: one scene folder to one result folder."""

from __future__ import annotations

import logging
import platform
import re
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from pbrfit import address_space
from pbrfit._core import InputError
from pbrfit.batch import heartbeat, process_memory
from pbrfit.batch.prediction import of_scene
from pbrfit.batch.unchanged import kept
from pbrfit.errors import in_one_line
from pbrfit.io.json_files import read_as
from pbrfit.io.normal_files import NORMAL_FILES
from pbrfit.io.output import new_folder
from pbrfit.registration.placement import aligned
from pbrfit.report import write_report
from pbrfit.result import advice
from pbrfit.result.data import Status
from pbrfit.result.held_out import HeldOut
from pbrfit.result.options import FitOptions
from pbrfit.result.result import REPORT_FILE, RESULT_FOLDER, Result
from pbrfit.result.verdict import Verdict, verdicts_of
from pbrfit.scene.folder import PARTS, first_and_last, is_scene, loose_pictures
from pbrfit.scene.options import ReadOptions
from pbrfit.scene.scene import Scene
from pbrfit.steps import step

if TYPE_CHECKING:
    from pbrfit.fit.decompose import Progress

log = logging.getLogger("pbrfit")

LIBRARIES_BYTES = 200 * 2**20
"""Bytes a process with numpy, scipy and the rest takes: whole processes took 103 to 158 MiB more
than was predicted for scenes of 16² to 128², and 40 more as dask's workers."""

NO_SCENES = re.compile(r"\..*|(flat|truth|lost\+found)$")
"""Names of folders in a folder that are no scenes; nobody may look into that of the file system."""

LOOK_EVERY = 0.2
"""Seconds after which a worker looks whether its scene is still wanted."""


@dataclass(frozen=True)
class SceneTask:
    """A scene to decompose."""

    scene: Path
    output: Path
    reading: ReadOptions
    options: FitOptions
    pictures: tuple[Path, ...] = ()
    """Files that were named one by one; none = those of the scene folder."""
    threads: int = 0
    """As asked for; 0 = what there are for a task."""
    resume: bool = False
    """Whether a result that would come out again stays."""
    overwrite: bool = False
    """Whether a result that is there is replaced, whatever it is."""
    report: bool = True
    """Whether the result has a page about it."""
    temporaries: Path | None = None
    """Folder for what is unfinished; None = beside the output. Whoever waits for the task removes
    it to say that the task is no longer wanted."""

    @property
    def source(self) -> Path | tuple[Path, ...]:
        """What `Scene.load` takes."""
        return self.pictures or self.scene

    @property
    def name(self) -> str:
        """Of the scene, for people."""
        return self.scene.resolve().name


@dataclass(frozen=True)
class SceneOutcome:
    """What came of it."""

    status: Literal["done", "kept"]
    """Of these "kept": the result was there."""
    stop_reason: str
    iterations: int
    metrics: Mapping[str, float] = field(default_factory=dict)
    """As in `result.json`."""
    verdicts: Mapping[str, Verdict] = field(default_factory=dict)
    """By name of the map; none where the uncertainty was not estimated."""
    held_out: HeldOut | None = None
    """How well left-out pictures are explained; None where none were."""
    peak_bytes: int | None = None
    """Memory of the process at its highest meanwhile; None where unknown, and of kept results."""
    table: str = ""
    """The result in words and figures, lines for people, without held-out error and verdicts."""
    details: tuple[str, ...] = ()
    """Stages and decisions, in lines; none of a result that was kept."""
    steps: tuple[str, ...] = ()
    """What would make it better, as `result.advice` says; of a kept result by its verdicts."""


def decompose_scene(
    task: SceneTask, threads: int, show: Callable[[Progress], None] | None = None
) -> SceneOutcome:
    """Read, fit, write, put in place.

    `threads` are used where the task asks for none. Raises InputError, OSError or MemoryError if
    the scene cannot be used, or its result not be written. The message names the file.
    """
    from pbrfit.fit.decompose import decompose  # here: it takes long to import

    address_space.reserve_blas()
    wanted = _Wanted(task, show)
    wanted.check()
    if not task.overwrite and task.output.is_dir():
        content = kept(task.output, task.source, task.reading, task.options)
        if content is not None:
            # Without `resume` the place was free: the result is of an attempt at this very task,
            # whose process died before it could tell.
            verdicts = verdicts_of(content["uncertainty"])
            return SceneOutcome(
                "kept" if task.resume else "done",
                stop_reason=str(content["stop_reason"]),
                iterations=int(content["iterations"]),
                metrics=dict(content["metrics"]),
                verdicts=verdicts,
                held_out=read_as(HeldOut | None, content["held_out"]),
                table=f"{task.output}: kept, nothing has changed",
                steps=advice.of_verdicts(verdicts),
            )
    fresh = process_memory.forget_peak()
    # The folder is opened first: no right to write should show before the work, not after it.
    with new_folder(
        task.output,
        overwrite=task.overwrite or task.resume,
        form=RESULT_FOLDER,
        temporaries=task.temporaries,
    ) as folder:
        with step("reading"):
            scene = Scene.load(task.source, task.reading)
        heartbeat.step()
        if task.options.align == "auto":
            # Here: pictures that are put back are written too, and the others are let go.
            limit = task.options.time_limit
            end = time.monotonic() + (float("inf") if limit is None else limit)
            with step("alignment"):
                scene = aligned(scene, stop=lambda: time.monotonic() >= end)
            heartbeat.step()
        threads = task.threads or threads
        result = decompose(scene, task.options, threads=threads, progress=wanted.show)
        heartbeat.step()
        with step("writing"):
            scene = result.as_fitted(scene)  # once for all, and other pictures are let go
            result.write(folder, scene, task.output)
        wanted.check()
        if task.report:
            try:
                with step("report"):
                    write_report(result, folder / REPORT_FILE, scene)
            except MemoryError as error:  # what was fitted is worth more
                log.warning("%s: no report: %s", task.output, in_one_line(error))
    if result.status is Status.TIME_LIMIT:
        reason = result.stop_reason
        log.warning("%s: unfinished: %s; the best state so far is written", task.output, reason)
    peak = process_memory.status_kib("VmHWM") if fresh else None
    return SceneOutcome(
        "done",
        stop_reason=result.stop_reason,
        iterations=result.history.iterations,
        metrics=dict(result.metrics),
        verdicts=result.verdicts,
        held_out=result.held_out,
        peak_bytes=None if peak is None else 1024 * peak,
        table="\n".join(table(result, scene, task.output)),
        details=tuple(details(result)),
        steps=advice.next_steps(result),
    )


def scenes_in(folder: Path) -> list[Path]:
    """The scene folders that a folder holds, itself where it is one; none if it holds nothing.

    Two or more photographs that lie beside each other are one where no folder below says that it is
    a scene; one alone may be anything.
    """

    def is_one(path: Path) -> bool:
        try:
            return is_scene(path)
        except PermissionError:
            return True  # one that nobody may look into will fail and say why

    if is_one(folder):
        return [folder]
    below = [p for p in sorted(folder.iterdir()) if p.is_dir() and not NO_SCENES.match(p.name)]
    scenes, loose = list(filter(is_one, below)), loose_pictures(folder)
    if len(loose) > 1 and not scenes:
        return [folder]
    if not any((folder / part).exists() for part in (*PARTS, *NORMAL_FILES)):
        scenes = [one for one in below if one in scenes or len(loose_pictures(one)) > 1]
    if scenes and loose:
        said = first_and_last(loose)
        log.warning("%s: %s not read, as folders in it are scenes", folder, said)
    return scenes


def memory_of(task: SceneTask, threads: int) -> int:
    """Bytes that a worker of so many threads will take with a scene; 0 for what cannot be read."""
    try:
        needed = of_scene(task.source, task.reading, task.options, task.threads or threads)
        return LIBRARIES_BYTES + needed.peak
    except (InputError, OSError):
        return 0


class _Wanted:
    """Whether a scene is still wanted, asked now and then."""

    def __init__(self, task: SceneTask, show: Callable[[Progress], None] | None) -> None:
        self._task, self._show, self._asked = task, show, time.monotonic()

    def show(self, progress: Progress) -> None:
        heartbeat.step()
        if time.monotonic() - self._asked > LOOK_EVERY:
            self.check()
            self._asked = time.monotonic()
        if self._show is not None:
            self._show(progress)

    def check(self) -> None:
        place = self._task.temporaries
        if place is not None and not place.is_dir():
            raise OSError(
                f"{self._task.output}: expected {place}, which a running batch has and all its "
                f"workers see, found none on {platform.node()}"
            )


def table(result: Result, scene: Scene, output: Path) -> list[str]:
    """What was fitted and the errors that are known, line by line."""
    lines = [
        f"{output}: {len(scene.images)} pictures of {scene.width} × {scene.height}, "
        f"model {result.model}, {result.stop_reason}",
        "",
    ]
    for key, value in result.metrics.items():
        name = key.removesuffix("_rmse").replace("recon", "residual").replace("_", ", ")
        lines.append(f"{name:<22}{rmse_in_words(value):>10}  RMSE")
    return lines


def details(result: Result) -> list[str]:
    """How a fit went and what it decided, line by line."""
    lines = [f"fit: {result.history.iterations} iterations in {result.seconds:.1f} s"]
    for one in result.stages:
        lines.append(f"{one.seconds:>6.1f} s  {one.name}" + f" ({one.note})" * bool(one.note))
    lines.append(f"normals: {result.refinement.in_words()}")
    lines += [f"{name}: {said}" for name, said in result.assumed.items() if name != "normals"]
    return [*lines, *(f"left out: {said}" for said in result.left_out)]


def rmse_in_words(value: float) -> str:
    """An error with four decimals, or what there is where these would all be 0."""
    return f"{value:.4f}" if value >= 5e-5 or value == 0 else f"{value:.1e}"
