"""The command line: one command a verb. Nothing imports this file."""

from __future__ import annotations

import argparse
import io
import logging
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn, get_args

from pbrfit._core import InputError
from pbrfit.arguments import (
    DONE,
    INTERRUPTED,
    SOME_FAILED,
    UNUSABLE,
    add_out,
    add_priors,
    add_quiet,
    add_threads,
    code_range,
    complain,
    given_priors,
    progress_bar,
    unread_is_no_failure,
    whole_number,
    with_signed_values,
)
from pbrfit.color import ColorSpace
from pbrfit.evaluation.commands import add_suites
from pbrfit.images import CODE_RANGE
from pbrfit.relight_command import add_relight
from pbrfit.robust import LOSSES

if TYPE_CHECKING:
    from pbrfit.result import Result
    from pbrfit.scene import Scene

EXPOSURES = {"auto": None, "as-is": False, "equal": True}
"""`equal_exposures` by what it is called here."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command; returns the exit code: 0 done, 1 some scenes failed, 2 unusable input."""
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace")  # a terminal that lacks a sign: no reason
    given = sys.argv[1:] if arguments is None else arguments
    options = _parser().parse_args(with_signed_values(given))
    try:
        with _logging_to_stderr(quiet=getattr(options, "quiet", False)), _ending_when_told():
            command: Callable[[argparse.Namespace], int] = options.command
            return command(options)
    except (InputError, OSError, MemoryError) as error:
        complain(_message(error))
        return UNUSABLE
    except KeyboardInterrupt as interrupt:
        complain(str(interrupt) or "interrupted; no unfinished result was left behind")
        return INTERRUPTED


@contextmanager
def _ending_when_told() -> Iterator[None]:
    """Let SIGTERM unwind the stack as Ctrl-C does, so that nothing half written stays behind."""
    if threading.current_thread() is not threading.main_thread():
        yield  # only the main thread is told
        return

    def end(number: int, _frame: object) -> NoReturn:
        sys.exit(128 + number)

    before = signal.signal(signal.SIGTERM, end)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


class _HelpFormatter(argparse.ArgumentDefaultsHelpFormatter):
    """Tells defaults, but not of switches and of options whose help says it in words."""

    def _get_help_string(self, action: argparse.Action) -> str | None:
        if action.default is None or action.default is False:
            return action.help
        return super()._get_help_string(action)


class _Parser(argparse.ArgumentParser):
    """Parser that complains in one line and takes no shortened flags."""

    def __init__(self, **arguments: Any) -> None:
        super().__init__(allow_abbrev=False, formatter_class=_HelpFormatter, **arguments)

    def error(self, message: str) -> NoReturn:
        self.exit(UNUSABLE, f"{self.prog}: {message}; see {self.prog} --help\n")


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(
        prog="pbrfit",
        description="Recover physically based materials (albedo, roughness, metallic) and the "
        "lighting of each picture from several pictures of one view under different lights.",
        epilog="Start with: pbrfit demo out",
    )
    parser.add_argument("--version", action="version", version=f"pbrfit {version('pbrfit')}")
    commands = parser.add_subparsers(metavar="COMMAND", required=True, title="commands")

    def command(
        name: str, run: Callable[[argparse.Namespace], int], summary: str
    ) -> argparse.ArgumentParser:
        added = commands.add_parser(
            name, help=summary, description=summary[0].upper() + summary[1:] + "."
        )
        added.set_defaults(command=run)
        return added

    added = command("decompose", _decompose, "fit materials and lights to scene folders")
    added.add_argument(
        "scenes", metavar="SCENE", nargs="+", type=Path, help="scene folder, or a folder of them"
    )
    add_out(added, "result folder; with several scenes it holds one result folder a scene")
    _add_input_options(added)
    _add_solver_options(added)
    _add_model_options(added, "of the lights; 2 leaves out band 3")
    add_priors(added)
    add_quiet(added)

    added = command("report", _report, "write a page about a result, to be looked at in a browser")
    added.add_argument("result", metavar="RESULT", type=Path, help="result folder")
    added.add_argument(
        "--out", metavar="FILE", type=Path, required=True, help="page to write, FILE.html"
    )
    added.add_argument(
        "--scene",
        metavar="SCENE",
        type=Path,
        help="scene folder that the result was made from (default: where it was then)",
    )
    added.add_argument("--overwrite", action="store_true", help="replace an existing file")
    add_quiet(added)

    added = command("inspect", _inspect, "show what a scene folder holds and what is assumed")
    added.add_argument("scene", metavar="SCENE", type=Path, help="scene folder")
    added.add_argument(
        "--preview",
        metavar="FILE",
        type=Path,
        help="write a PNG with a picture, the normals and which of them face the camera",
    )
    _add_input_options(added)

    added = command("synth", _synth, "render a synthetic scene folder with ground truth")
    added.add_argument("out", metavar="DIR", type=Path, help="scene folder to write")
    _add_synth_options(added)
    _add_sh_order(added, "of the lights")
    added.add_argument("--overwrite", action="store_true", help="replace an existing folder")

    add_relight(commands)

    added = command("normals", _normals, "give normals to a folder of pictures")
    added.add_argument("scene", metavar="SCENE", type=Path, help="scene folder")
    added.add_argument(
        "--from",
        dest="source",
        choices=("flat",),
        default="flat",
        help="flat: every surface faces the camera",
    )
    added.add_argument("--overwrite", action="store_true", help="replace existing normals")

    added = command("export", _export, "write a result for Blender, Unreal, Unity and others")
    _add_export_options(added)

    added = command(
        "check-gradients", _check_gradients, "compare the gradient with finite differences"
    )
    added.add_argument("scene", metavar="SCENE", type=Path, help="scene folder")
    _add_input_options(added)
    _add_model_options(added, "of the lights; 2 leaves out band 3")
    add_priors(added)
    added.add_argument(
        "--seed", type=whole_number, default=0, help="of the random point and directions"
    )

    suites = commands.add_parser(
        "evaluate",
        help="measure this package and write a report",
        description="Run a suite of measurements and write its report.",
    ).add_subparsers(metavar="SUITE", required=True, title="suites")
    add_suites(suites)

    added = command("demo", _demo, "make a synthetic scene, decompose it, compare with the truth")
    added.add_argument("out", metavar="DIR", type=Path, help="folder to write")
    _add_synth_options(added)
    _add_solver_options(added)
    _add_model_options(added, "of the lights, true and fitted")
    add_priors(added)
    added.add_argument("--overwrite", action="store_true", help="replace an existing folder")
    add_quiet(added)
    return parser


def _add_input_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--fov",
        metavar="DEG",
        type=float,
        help="horizontal field of view, 0 = orthographic (default: scene.toml, EXIF, else 60)",
    )
    parser.add_argument(
        "--color-space",
        choices=get_args(ColorSpace),
        help="of all pictures (default: scene.toml, ICC profile, else sRGB for integer files and "
        "linear Rec.709 for float files)",
    )
    parser.add_argument(
        "--max-size",
        metavar="PIXELS",
        type=int,
        help="average larger pictures down to this longer side (default: as they are)",
    )
    parser.add_argument(
        "--code-range",
        metavar="LOW,HIGH",
        type=code_range,
        default=f"{CODE_RANGE[0]},{CODE_RANGE[1]}",
        help="leave out samples of integer pictures with a channel above HIGH, or with all below "
        "LOW, in 8-bit codes; 0,255 keeps all",
    )


def _add_solver_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--solver", choices=("lbfgsb",), default="lbfgsb", help="optimiser")
    parser.add_argument("--iterations", metavar="K", type=int, default=500, help="at most so many")
    parser.add_argument(
        "--time-limit",
        metavar="S",
        type=float,
        help="stop the fit of a scene after so many seconds (default: none)",
    )
    add_threads(parser)


def _add_model_options(parser: argparse.ArgumentParser, what_order: str) -> None:
    _add_sh_order(parser, what_order)
    parser.add_argument(
        "--metallic",
        choices=("free", "0"),
        default="free",
        help="0: no pixel is a metal, and metallic is not fitted",
    )
    parser.add_argument(
        "--robust",
        choices=LOSSES,
        default="none",
        help="loss that shadows and other outliers pull less at than at squares",
    )
    parser.add_argument(
        "--exposures",
        choices=EXPOSURES,
        default="auto",
        help="equal: pictures are divided by their mean radiance, so that bright ones do not "
        "outweigh dark ones; as-is: they are not; auto: where one has more than 4 times the mean "
        "of another",
    )

    parser.add_argument(
        "--mono-light",
        action="store_true",
        help="lights are grey: the same in all colour channels",
    )


def _add_sh_order(parser: argparse.ArgumentParser, what: str) -> None:
    parser.add_argument("--sh-order", type=int, choices=(2, 3), default=3, help=what)


def _add_synth_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--scene",
        dest="kind",
        choices=("room", "spheres", "textured", "furnished", "detailed"),
        default="room",
        help="kind of scene: plain pieces; a grid of spheres; patterned pieces; a room with "
        "furniture; that room with fine textures and relief",
    )
    parser.add_argument(
        "--textures",
        metavar="DIR",
        type=Path,
        help="with --scene detailed: maps NAME_albedo, NAME_roughness, NAME_metallic, NAME_normal "
        "(default: procedural detail)",
    )
    parser.add_argument("--size", metavar="PIXELS", type=int, default=128, help="side of a picture")
    parser.add_argument("--lights", metavar="N", type=int, default=16, help="number of pictures")
    parser.add_argument(
        "--noise", metavar="S", type=float, default=0.0, help="Gaussian; mean radiance is 0.4"
    )
    parser.add_argument("--seed", type=whole_number, default=0, help="of scene, lights and noise")


def _add_export_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("result", metavar="RESULT", type=Path, help="result folder")
    parser.add_argument("--out", metavar="DIR", type=Path, required=True, help="folder to write")
    parser.add_argument(
        "--format",
        choices=("gltf", "exr", "png"),
        help="this one alone (default: those of the preset, else all)",
    )
    parser.add_argument(
        "--preset",
        choices=("blender", "unreal", "unity"),
        help="textures with the names, channels and normals that a tool expects (default: a file "
        "a map)",
    )
    parser.add_argument(
        "--normals",
        choices=("opengl", "directx"),
        help="green of normal maps upwards or downwards (default: as the preset says, else opengl)",
    )
    parser.add_argument(
        "--bits",
        type=int,
        choices=(8, 16),
        help="of PNG files and of textures in glTF (default: as the preset says, else 16, and in "
        "glTF 16 for normals alone)",
    )
    parser.add_argument(
        "--geometry",
        choices=("card", "facets"),
        help="of glTF: a card with a normal texture, or a rectangle a pixel, turned to its normal, "
        "for path tracers (default: card)",
    )
    parser.add_argument("--overwrite", action="store_true", help="replace an earlier export")
    parser.add_argument("--quiet", action="store_true", help="no list of files, no warnings")


def _decompose(options: argparse.Namespace) -> int:
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
            message = _message(error)
            complain(message if str(path) in message else f"{path}: {message}")
            failed.append(path)
    if failed:
        names = ", ".join(str(path) for path in failed)
        complain(f"{len(failed)} of {len(scenes)} scenes failed: {names}")
        return SOME_FAILED if len(failed) < len(scenes) else UNUSABLE
    return DONE


def _decompose_one(path: Path, output: Path, options: argparse.Namespace) -> None:
    from pbrfit.output import new_folder
    from pbrfit.result import CONTAINS

    # The folder is opened first: no right to write should show before the work, not after it.
    with new_folder(output, overwrite=options.overwrite, contains=CONTAINS) as folder:
        scene = _load(path, options)
        result = _fit(scene, path.resolve().name, options)
        result.write(folder, scene)
    if not options.quiet:
        with unread_is_no_failure():
            _print_result(result, scene, output)


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


def _load(path: Path, options: argparse.Namespace) -> Scene:
    from pbrfit.scene import Scene

    return Scene.load(
        path,
        fov=options.fov,
        color_space=options.color_space,
        max_size=options.max_size,
        code_range=options.code_range,
    )


def _fit(scene: Scene, name: str, options: argparse.Namespace) -> Result:
    from pbrfit.solve import Progress, decompose

    with progress_bar(options.iterations, quiet=options.quiet, name=name) as bar:

        def show(progress: Progress) -> None:
            bar.set_postfix_str(f"recon {progress.recon_rmse:.2e}", refresh=False)
            bar.update(progress.iteration - bar.n)

        return decompose(
            scene,
            solver=options.solver,
            iterations=options.iterations,
            time_limit=options.time_limit,
            threads=options.threads,
            sh_order=options.sh_order,
            metallic=_metallic(options),
            mono_light=options.mono_light,
            priors=given_priors(options),
            robust=options.robust,
            equal_exposures=EXPOSURES[options.exposures],
            progress=show,
        )


def _metallic(options: argparse.Namespace) -> float | None:
    return None if options.metallic == "free" else float(options.metallic)


def _report(options: argparse.Namespace) -> int:
    from pbrfit.report import write_report
    from pbrfit.result import Result

    result = Result.load(options.result)
    write_report(result, options.out, options.scene, options.overwrite)
    if not options.quiet:
        size = options.out.stat().st_size / 1e6
        print(f"{options.out}: {size:.1f} MB, open it in a browser")
    return DONE


def _inspect(options: argparse.Namespace) -> int:
    from pbrfit import images, inspection, preview

    scene = _load(options.scene, options)
    for topic, fact in inspection.facts(scene):
        print(f"{topic:<18}{fact}")
    if options.preview is not None:
        images.write_png(options.preview, preview.normals_preview(scene), tag="srgb")
        print(f"{'preview':<18}{options.preview}")
    return DONE


def _synth(options: argparse.Namespace) -> int:
    from pbrfit.output import check_free
    from pbrfit.scene_folder import CONTAINS

    check_free(options.out, overwrite=options.overwrite, contains=CONTAINS)
    _make_scene(options).save(options.out, overwrite=options.overwrite)
    print(f"{options.out}: {options.kind}, {options.lights} pictures and ground truth")
    return DONE


def _make_scene(options: argparse.Namespace) -> Scene:
    from pbrfit.synthetic import make_scene

    return make_scene(
        options.kind,
        size=options.size,
        lights=options.lights,
        sh_order=options.sh_order,
        noise=options.noise,
        seed=options.seed,
        textures=options.textures,
    )


def _normals(options: argparse.Namespace) -> int:
    from pbrfit import scene_folder

    path = scene_folder.write_flat_normals(options.scene, overwrite=options.overwrite)
    print(f"{path}: every surface faces the camera")
    return DONE


def _export(options: argparse.Namespace) -> int:
    from pbrfit.export import CONTAINS, export_result
    from pbrfit.output import check_free
    from pbrfit.result import Result

    if options.result.resolve().is_relative_to(options.out.resolve()):
        raise InputError(
            f"{options.out}: expected a folder apart from the result, found {options.result}"
        )
    check_free(options.out, overwrite=options.overwrite, contains=CONTAINS)
    exported = export_result(
        Result.load(options.result),
        options.out,
        format=options.format,
        preset=options.preset,
        normals=options.normals,
        bits=options.bits,
        geometry=options.geometry,
        overwrite=options.overwrite,
    )
    if not options.quiet:
        with unread_is_no_failure():
            total = sum(file.size for file in exported.files)
            print(f"{options.out}: {len(exported.files) + 1} files, {total / 1e6:.2f} MB")
            width = max(len(file.path) for file in exported.files)
            for file in exported.files:
                print(f"{file.path:<{width}}{file.size / 1e3:>10.1f} kB  {file.holds}")
    return DONE


def _check_gradients(options: argparse.Namespace) -> int:
    from pbrfit.gradient_check import check_gradients
    from pbrfit.objective import Objective

    scene = _load(options.scene, options)
    objective = Objective(
        scene,
        sh_order=options.sh_order,
        metallic=_metallic(options),
        mono_light=options.mono_light,
        priors=given_priors(options),
        equal_exposures=EXPOSURES[options.exposures],
    )
    objective.robust = objective.robust_around(objective.start(), options.robust)
    checks = check_gradients(objective, seed=options.seed)
    print(f"{'function':<12}{'unknowns':<12}{'analytic':>16}{'numeric':>16}{'relative error':>16}")
    for check in checks:
        verdict = "" if check.passed else "   differs"
        print(
            f"{check.function:<12}{check.unknowns:<12}{check.analytic:>16.8e}{check.numeric:>16.8e}"
            f"{check.relative_error:>16.1e}{verdict}"
        )
    failed = sum(not check.passed for check in checks)
    print(f"{len(checks) - failed} of {len(checks)} within {checks[0].tolerance:g}")
    return SOME_FAILED if failed else DONE


def _demo(options: argparse.Namespace) -> int:
    from pbrfit import preview
    from pbrfit.output import new_folder
    from pbrfit.scene import Scene

    parts = ("scene", "result")
    with new_folder(options.out, overwrite=options.overwrite, contains=parts) as folder:
        _make_scene(options).save(folder / "scene")
        scene = Scene.load(folder / "scene")
        result = _fit(scene, options.kind, options)
        result.save(folder / "result", scene=scene)
        preview.plot_history(result, folder / "history.png")
    if not options.quiet:
        _print_result(result, scene, options.out / "result")
        print(
            f"\nLook at {options.out / 'result' / 'preview.png'} and {options.out / 'history.png'}"
        )
    return DONE


def _print_result(result: Result, scene: Scene, output: Path) -> None:
    iterations = len(result.history) - 1
    print(
        f"{output}: {len(scene.images)} pictures of {scene.width} × {scene.height}, "
        f"{iterations} iterations in {result.seconds:.1f} s ({result.stop_reason})"
    )
    rows = [
        ("reconstruction", "recon_rmse"),
        ("albedo", "albedo_rmse"),
        ("albedo, best scale", "albedo_scaled_rmse"),
        ("roughness", "roughness_rmse"),
        ("metallic", "metallic_rmse"),
        ("relight", "relight_rmse"),
    ]
    print(f"\n{'RMSE':<22}{'start':>10}{'result':>10}")
    for name, key in rows:
        if key in result.metrics:
            at_start = (
                f"{result.history[key][0]:>10.4f}" if key in result.history.columns else f"{'':>10}"
            )
            print(f"{name:<22}{at_start}{result.metrics[key]:>10.4f}")
    if result.left_out:
        print(f"\nleft out: {'; '.join(result.left_out)}")


@contextmanager
def _logging_to_stderr(*, quiet: bool) -> Iterator[None]:
    handler = logging.StreamHandler()
    handler.setFormatter(logging.Formatter("pbrfit: %(levelname)s: %(message)s"))
    handler.setLevel(logging.ERROR if quiet else logging.WARNING)
    logger = logging.getLogger("pbrfit")
    logger.addHandler(handler)
    try:
        yield
    finally:
        logger.removeHandler(handler)


def _message(error: Exception) -> str:
    """One line that names the file."""
    if isinstance(error, OSError) and error.strerror and error.filename:
        return f"{error.filename}: {error.strerror}"
    return " ".join(str(error).split())


if __name__ == "__main__":
    sys.exit(main())
