"""`pbrfit decompose`."""

from __future__ import annotations

import argparse
import os
import time
from collections import Counter
from collections.abc import Sequence
from functools import partial
from pathlib import Path

from pbrfit import address_space
from pbrfit._core import InputError
from pbrfit.batch import place
from pbrfit.batch.driver import Attempt, drive, workers
from pbrfit.batch.heartbeat import PATIENCE
from pbrfit.batch.scenes import SceneTask, decompose_scene, memory_of, scenes_in
from pbrfit.commands import arguments as cli
from pbrfit.commands.fit_options import add_fit_options, fit_options
from pbrfit.commands.progress import fit_steps
from pbrfit.commands.scene_display import SceneDisplay
from pbrfit.commands.scene_options import add_input, reading
from pbrfit.fit import memory
from pbrfit.io.output import check_is_output
from pbrfit.result.result import RESULT_FOLDER
from pbrfit.scene.folder import check_unread, locate

MOST_USED = (
    *("out", "overwrite", "verbose", "fov", "color_space", "max_size", "light", "white"),
    *("time_limit", "resume", "jobs", "help_all"),
)


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add its options."""
    cli.add_short_help(parser, MOST_USED)
    parser.usage = "%(prog)s PHOTOS [PHOTOS ...] [--out DIR] [OPTION ...]"
    parser.add_argument(
        "scenes",
        metavar="PHOTOS",
        nargs="+",
        type=Path,
        help="folder of pictures of one view, or of such folders; or the pictures of one view",
    )
    output = parser.add_argument_group("output")
    said = "result folder, or with several scenes one of them (default: NAME-pbrfit)"
    cli.add_out(output, said, required=False)
    cli.add_flags(
        output,
        no_report=cli.switch("leave out report.html"),
        verbose=cli.switch("say more: stages of the fit, decisions, what was left out"),
        json=cli.switch("print a line of JSON a scene instead of a table"),
    )
    cli.add_quiet(output)
    add_input(parser.add_argument_group("pictures"))
    add_fit_options(parser.add_argument_group("fit"))
    batch = parser.add_argument_group("several scenes")
    cli.add_flags(
        batch,
        resume=cli.switch(
            "keep results that are whole and would come out again: the same files, options and "
            "version of pbrfit; do all others"
        ),
        strict=cli.switch(
            "exit code 3 if no map of a scene is usable; its result is written all the same. "
            "Exit codes 1 and 2, of scenes that failed, come first"
        ),
    )
    cli.add_jobs(batch, "scenes at the same time, each in a process of its own (default: 1)")
    cli.add_cluster(batch)
    cli.add_flags(
        batch,
        patience=cli.value(
            "SECONDS",
            cli.whole_number,
            "end the process of a scene that makes no step for so long, and let the scene fail; "
            f"0 = never (default: {PATIENCE:.0f}; without --jobs, none: one process does all)",
        ),
    )


def run(options: argparse.Namespace) -> int:
    """Decompose the scenes, here or by workers."""
    if options.resume and options.overwrite:
        raise InputError("expected --resume or --overwrite, found both")
    checks = [
        ("verbose", not (options.quiet or options.json), "neither --quiet nor --json"),
        ("same_lamp", options.light != "sh", "--light lamps or auto, found sh"),
    ]
    cli.refuse_idle(options, checks)
    options.reading = reading(options)
    options.pictures = tuple(options.scenes) if any(map(Path.is_file, options.scenes)) else ()
    if options.pictures:
        scenes, one = [locate(options.pictures).folder], True
    else:
        scenes, one = _find_scenes(options.scenes)
    if options.out is None:  # by the folder that holds all
        paths = [path.resolve() for path in (scenes if one else options.scenes)]
        above = [path.parent for path in paths]
        folder = paths[0] if len(paths) == 1 else Path(os.path.commonpath(above))
        options.out = Path(f"{folder.name or 'scene'}-pbrfit")
    outputs = [options.out if one else options.out / path.resolve().name for path in scenes]
    check_unread(scenes, outputs)
    for output in outputs:
        # What else is in one fails its own scene, and only if that is done again.
        replacing = options.overwrite or options.resume
        check_is_output(output, overwrite=replacing, form=RESULT_FOLDER)
    # Where address space is limited a process may end in a step: another one tells, and clears up.
    safe = address_space.left() is None and options.patience is None
    if one and options.cluster is None and safe:
        return _run_one(_task(scenes[0], outputs[0], options), options)
    return _run_all(scenes, outputs, options, one=one)


def _task(
    scene: Path, output: Path, options: argparse.Namespace, temporaries: Path | None = None
) -> SceneTask:
    far = options.cluster is not None  # workers there have other working folders
    return SceneTask(
        scene=scene.absolute() if far else scene,
        output=output.absolute() if far else output,
        pictures=tuple(map(Path.absolute, options.pictures)) if far else options.pictures,
        reading=options.reading,
        options=fit_options(options),
        threads=options.threads,
        resume=options.resume,
        overwrite=options.overwrite,
        report=not options.no_report,
        temporaries=temporaries,
    )


def _run_one(task: SceneTask, options: argparse.Namespace) -> int:
    began = time.perf_counter()
    with SceneDisplay(1, options) as display:
        try:
            with fit_steps(quiet=options.quiet) as show:
                outcome = decompose_scene(task, 0, show)
        except (InputError, OSError, MemoryError) as error:
            if not options.json:
                raise
            seconds = time.perf_counter() - began
            display.tell(task, Attempt(None, cli.in_one_line(error), seconds=seconds))
            return cli.UNUSABLE
        display.tell(task, Attempt(outcome, None, seconds=time.perf_counter() - began))
    return cli.NO_USABLE_MAP if display.unusable else cli.DONE


def _run_all(
    scenes: Sequence[Path], outputs: Sequence[Path], options: argparse.Namespace, *, one: bool
) -> int:
    where = place.of_one(options.out) if one else place.of_batch(options.out)
    display = SceneDisplay(len(scenes), options)
    with where as temporaries:
        tasks = [
            _task(path, output, options, temporaries)
            for path, output in zip(scenes, outputs, strict=True)
        ]
        patience = options.patience
        if patience is None and options.cluster is None and address_space.left() is not None:
            patience = PATIENCE
        done_by = workers(options.jobs, options.cluster, most=len(tasks), patience=patience)
        own = done_by if options.cluster is None else None  # those whose memory is this machine's
        try:
            with display:
                drive(
                    tasks,
                    decompose_scene,
                    done_by,
                    ended=display.tell,
                    meanwhile=display.show,
                    memory=partial(memory_of, threads=own.threads or 0) if own else None,
                    available=memory.available(),
                )
        except ConnectionError as error:
            cli.complain(cli.in_one_line(error))
            display.summary()
            return cli.SOME_FAILED if display.ended > len(display.failed) else cli.UNUSABLE
        except KeyboardInterrupt:
            raise KeyboardInterrupt(
                f"interrupted after {display.ended} of {len(tasks)} scenes; no unfinished result "
                "was left behind; --resume goes on from there"
            ) from None
    if not one:
        display.summary()
    if display.failed:
        return cli.SOME_FAILED if len(display.failed) < len(tasks) else cli.UNUSABLE
    return cli.NO_USABLE_MAP if display.unusable else cli.DONE


def _find_scenes(paths: Sequence[Path]) -> tuple[list[Path], bool]:
    """All scene folders that were named, directly or by a folder of them; and whether just one."""
    scenes: list[Path] = []
    for path in paths:
        scenes += (scenes_in(path) if path.is_dir() else []) or [path]
    names = Counter(path.resolve().name for path in scenes)
    twice = sorted(name for name, count in names.items() if count > 1)
    if twice:
        raise InputError(f"SCENE: expected different names, found {twice[0]} twice")
    return scenes, len(paths) == 1 and scenes == list(paths)
