"""`pbrfit demo`."""

from __future__ import annotations

import argparse
from pathlib import Path

from pbrfit.batch.scenes import table
from pbrfit.commands.arguments import DONE, add_flags, add_quiet, switch
from pbrfit.commands.fit_options import MODEL_OF_PICTURES, add_fit_options, add_option, fit_options
from pbrfit.commands.progress import fit_steps
from pbrfit.commands.synth import add_synthetic, make_scene
from pbrfit.commands.terminal import held_out_lines, verdict_lines
from pbrfit.fit.decompose import decompose
from pbrfit.io.images import write_png
from pbrfit.io.output import FolderForm, new_folder
from pbrfit.model.reflection import DEFAULT_MODEL
from pbrfit.report import write_report
from pbrfit.result.advice import next_steps
from pbrfit.result.relighting import DirectionalLight, relight
from pbrfit.result.relit_files import Screen, write_animation
from pbrfit.result.result import RESULT_FOLDER
from pbrfit.scene.folder import SCENE_FOLDER
from pbrfit.scene.scene import Scene

LAMP = DirectionalLight(-50.0, 35.0)
"""Azimuth and elevation, in degrees, of the hard light that the result is relit with."""

FRAMES = 48
"""Frames of the animation in which the lamp goes once around."""

DEMO_FOLDER = FolderForm(
    contains=("scene", "result"),
    holds=(
        *(f"scene/{path}" for path in SCENE_FOLDER.holds),
        *(f"result/{path}" for path in RESULT_FOLDER.holds),
        *("relit.png", "relit.webp", "report.html"),
    ),
    listed=lambda folder: [f"scene/{path}" for path in SCENE_FOLDER.listed(folder / "scene")],
)


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add its options."""
    parser.add_argument("out", metavar="DIR", type=Path, help="folder to write")
    add_synthetic(parser)
    add_option(parser, "model", MODEL_OF_PICTURES, DEFAULT_MODEL)
    add_option(parser, "sh_order", "of the lights, true and fitted")
    add_fit_options(parser, there=("model", "sh_order"))
    add_flags(parser, overwrite=switch("replace an existing folder"))
    add_quiet(parser)


def run(options: argparse.Namespace) -> int:
    """Make a scene, fit it, relight it and report."""
    with new_folder(options.out, overwrite=options.overwrite, form=DEMO_FOLDER) as folder:
        make_scene(options).save(folder / "scene")
        scene = Scene.load(folder / "scene")
        with fit_steps(quiet=options.quiet) as show:
            result = decompose(scene, fit_options(options), threads=options.threads, progress=show)
        result.save(folder / "result", scene=scene)
        screen, threads = Screen(), options.threads
        write_png(folder / "relit.png", screen.shown(relight(result, LAMP, threads)), "srgb")
        lamps = (LAMP.turned(360 * k / FRAMES) for k in range(FRAMES))
        frames = (screen.shown(relight(result, lamp, threads)) for lamp in lamps)
        write_animation(folder / "relit.webp", ".webp", frames, fps=16)
        write_report(result, folder / "report.html", scene)
    if not options.quiet:
        said = [
            *table(result, scene, options.out / "result"),
            "",
            *held_out_lines(result.held_out),
            *verdict_lines(result.verdicts, next_steps(result)),
            f"\n{options.out / 'report.html'}: all of it, to be opened in a browser",
            f"{options.out / 'relit.png'}: under a lamp that is in none of the pictures; "
            "relit.webp: the lamp goes around",
        ]
        print("\n".join(said))
    return DONE
