"""`pbrfit decompose`."""

from __future__ import annotations

import argparse
import logging
import os
from collections.abc import Sequence
from pathlib import Path

from pbrfit._core import InputError
from pbrfit.arguments import (
    DONE,
    SOME_FAILED,
    UNUSABLE,
    Subcommands,
    add_command,
    add_out,
    add_priors,
    add_quiet,
    complain,
    message_of,
    unread_is_no_failure,
)
from pbrfit.commands.fit_options import (
    add_model,
    add_refinement,
    add_seed,
    add_solver,
    fit,
    print_result,
)
from pbrfit.commands.scene_options import add_input, load

log = logging.getLogger("pbrfit")


def add(commands: Subcommands) -> None:
    """Add the command to `pbrfit`."""
    added = add_command(commands, "decompose", _run, "fit materials and lights to scene folders")
    added.add_argument(
        "scenes", metavar="SCENE", nargs="+", type=Path, help="scene folder, or a folder of them"
    )
    add_out(added, "result folder; with several scenes it holds one result folder a scene")
    add_input(added)
    add_solver(added)
    add_seed(added)
    add_model(added, "of the lights; 2 leaves out band 3")
    add_refinement(added)
    add_priors(added)
    add_quiet(added)


def _run(options: argparse.Namespace) -> int:
    from pbrfit.output import check_free
    from pbrfit.result import CONTAINS

    scenes, one = _find_scenes(options.scenes)
    outputs = [options.out if one else options.out / path.resolve().name for path in scenes]
    for output in outputs:
        for path in scenes:
            if path.resolve().is_relative_to(output.resolve()):
                raise InputError(f"{output}: expected a folder apart from the scene, found {path}")
        check_free(output, overwrite=options.overwrite, contains=CONTAINS)
    failed = []
    for path, output in zip(scenes, outputs, strict=True):
        try:
            _decompose_one(path, output, options)
        except (InputError, OSError, MemoryError) as error:
            if one:
                raise
            message = message_of(error)
            complain(message if str(path) in message else f"{path}: {message}")
            failed.append(path)
    if failed:
        names = ", ".join(str(path) for path in failed)
        complain(f"{len(failed)} of {len(scenes)} scenes failed: {names}")
        return SOME_FAILED if len(failed) < len(scenes) else UNUSABLE
    return DONE


def _decompose_one(path: Path, output: Path, options: argparse.Namespace) -> None:
    from pbrfit import alignment
    from pbrfit.output import new_folder
    from pbrfit.result import CONTAINS

    # The folder is opened first: no right to write should show before the work, not after it.
    with new_folder(output, overwrite=options.overwrite, contains=CONTAINS) as folder:
        scene = load(path, options)
        for complaint in alignment.complaints(scene):
            log.warning("%s: %s: pictures must line up pixel by pixel", path, complaint)
        result = fit(scene, path.resolve().name, options)
        result.write(folder, scene)
    if not options.quiet:
        with unread_is_no_failure():
            print_result(result, scene, output)


def _find_scenes(paths: Sequence[Path]) -> tuple[list[Path], bool]:
    """All scene folders that were named, directly or by a folder of them; and whether just one."""
    from pbrfit import scene_folder

    scenes: list[Path] = []
    for path in paths:
        if path.is_dir() and not scene_folder.is_scene(path):
            below = sorted(
                below
                for below in path.iterdir()
                if below.is_dir()
                and not below.name.startswith(".")
                and os.access(below, os.R_OK | os.X_OK)
                and scene_folder.is_scene(below)
            )
            scenes += below or [path]
        else:
            scenes.append(path)
    names = [path.resolve().name for path in scenes]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise InputError(f"SCENE: expected different names, found {twice[0]} twice")
    return scenes, len(paths) == 1 and scenes == list(paths)
