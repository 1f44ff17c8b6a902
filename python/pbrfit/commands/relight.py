"""`pbrfit relight`."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from pathlib import Path

from pbrfit._core import InputError
from pbrfit.commands import arguments as cli
from pbrfit.commands.light_options import add_light, choose_light
from pbrfit.display.tone import ToneMap
from pbrfit.fit.memory import available, size
from pbrfit.io import images
from pbrfit.io.output import FolderForm, check_free, check_free_file, new_file, new_folder
from pbrfit.result.metrics import stops, white_of
from pbrfit.result.relighting import Light, relight, specular_enhanced, turned
from pbrfit.result.relit_files import Radiance, Screen, write_animation, write_exr
from pbrfit.result.result import Result

FPS = 12.0

UNSEEN_SHARE_MAX = 0.98
"""Share of pixels that are nearly black or clipped above which another exposure is suggested."""

FRAMES_MAX = 3600
"""Frames of a turntable: a tenth of a degree apart, of which the sun covers five."""

LARGEST_EXPOSURE = 100.0
"""Stops, in both directions."""

SAMPLED_FRAMES = 4
"""Frames of a turntable that choose its exposure: what is behind in one is in front in others."""


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add its options."""
    parser.description = (
        "Render a result under a panorama, a lamp far away or near, SH light, or as it was lit. "
        "docs/relight.md says what each of them is good for."
    )
    cli.add_result(
        parser,
        "FILE",
        ".exr: linear float32; .png: 8-bit sRGB; with --turntable also a folder, .gif or .webp",
    )
    add_light(parser)
    cli.add_flags(
        parser,
        no_shadows=cli.switch(
            "light as if there were no surroundings, where the fit decided for some"
        ),
        enhance=cli.choice(
            ("specular",), "surfaces made glossy, whose highlights tell their shape"
        ),
    )
    cli.add_flags(
        parser.add_argument_group("output"),
        turntable=cli.value(
            "N",
            cli.positive,
            "N frames while the light goes once around, from where it is to the right",
        ),
        format=cli.choice(
            ("exr", "png"), "with --turntable and a folder: of the frames (default: exr)"
        ),
        fps=cli.value(
            "F",
            cli.number,
            f"with --turntable and an animation: frames a second, 1 to 50 (default: {FPS:g})",
        ),
        exposure=cli.value(
            "EV",
            cli.number,
            "of files for a screen, in stops: radiance times 2^EV (default: by itself, so that the "
            "brightest 2 %% of the picture are above white)",
        ),
        tone_map=cli.choice(
            ToneMap,
            "of files for a screen: neutral keeps colours and compresses highlights, none clips "
            "(default: neutral)",
        ),
    )
    cli.add_threads(parser)
    cli.add_quiet(parser)


def run(options: argparse.Namespace) -> int:
    """Render, write, and say what was written."""
    kind = _kind(options)
    _check_belonging(options, kind)
    _check_free(options, kind)
    result = cli.read_result(options)
    if options.enhance:
        result = specular_enhanced(result)
    # Animations hold all frames in memory, 4 bytes a pixel.
    count, free = options.turntable or 1, available()
    needed = 4 * count * result.mask.size
    if kind != "folder" and free is not None and needed > free:
        expected = f"expected {size(needed)} of memory for {count} frames, found {size(free)}"
        raise MemoryError(f"{options.out}: {expected}; a folder needs that of one")
    light, said = choose_light(options, result)
    exposure, sampled = options.exposure, dict[int, Radiance]()
    if exposure is None and _for_screen(options, kind):
        sampled, exposure = _sampled(result, light, options)
    screen = Screen(exposure or 0.0, options.tone_map or "neutral")
    with cli.progress_bar(count, quiet=options.quiet, unit="frame") as bar:

        def frames() -> Iterator[Radiance]:
            for k in range(count):
                frame = sampled.pop(k) if k in sampled else _frame(k, result, light, options)
                bar.update()
                yield frame

        _write(options, kind, frames(), screen)
    facts = (*said, *_facts_of_output(options, kind, result, screen))
    cli.tell(options, (f"{topic:<12}{fact}" for topic, fact in facts))
    return cli.DONE


def _kind(options: argparse.Namespace) -> str:
    """What is written: a suffix, with a turntable also ``folder``."""
    suffix: str = options.out.suffix.lower()
    still = options.turntable is None
    known = (".exr", ".png") if still else ("", ".gif", ".webp", ".png")
    if suffix not in known:
        expected, hint = "a file that ends in .exr (linear) or .png (for a screen)", ""
        if not still:
            expected = "with --turntable, a folder (no suffix), .gif, .webp or .png (animated)"
        elif suffix in (".gif", ".webp", ""):
            hint = f"; {suffix or 'a folder'} needs --turntable N"
        raise InputError(f"{options.out}: expected {expected}, found {suffix or 'no suffix'}{hint}")
    return suffix or "folder"


def _for_screen(options: argparse.Namespace, kind: str) -> bool:
    return kind != ".exr" and not (kind == "folder" and options.format != "png")


def _check_belonging(options: argparse.Namespace, kind: str) -> None:
    """Refuse options that would do nothing."""
    given = {name for name, value in vars(options).items() if value is not None}
    folder = kind == "folder"
    lights = given & {"env", "light", "lamp", "sh"}
    own = "picture" in given and not lights
    if not lights and not own:
        raise InputError(
            "light: expected one of --env, --light, --lamp, --sh and --picture, found none"
        )
    far = "--env, --sh or --picture; give --light another azimuth instead"
    animation = "--turntable and .gif, .webp or .png as --out"
    checks = [
        ("rotate", bool(given & {"env", "sh"}) or own, far),
        ("softness", bool(given & {"light", "lamp"}), "--light or --lamp"),
        ("color", bool(given & {"light", "lamp"}), "--light or --lamp"),
        ("picture", "sh" in given or own, "--sh, or alone"),
        ("format", folder, "--turntable and a folder as --out"),
        ("fps", "turntable" in given and not folder, animation),
    ]
    cli.refuse_idle(options, checks)
    for name in ("exposure", "tone_map"):
        if name in given and not _for_screen(options, kind):
            raise InputError(
                f"--{name.replace('_', '-')}: expected a file for a screen, such as .png"
                f"{' (--format png)' if folder else ''}, found EXR: it holds linear radiance, and "
                "what it is shown with is left to who shows it"
            )
    if (options.turntable or 0) > FRAMES_MAX:
        expected = f"expected at most {FRAMES_MAX} frames, a tenth of a degree apart"
        raise InputError(f"--turntable: {expected}, found {options.turntable}")
    if "exposure" in given and not abs(options.exposure) <= LARGEST_EXPOSURE:
        expected = f"expected -{LARGEST_EXPOSURE:g} to {LARGEST_EXPOSURE:g} stops"
        raise InputError(f"--exposure: {expected}, found {options.exposure:g}")
    if "fps" in given and not 1 <= options.fps <= 50:
        raise InputError(f"--fps: expected 1 to 50, found {options.fps:g}")


def _check_free(options: argparse.Namespace, kind: str) -> None:
    """Complain about the output before there is any work."""
    used = [options.result / name for name in ("materials.exr", "preview.png")]
    used += [path for path in (options.env, options.sh) if path is not None]
    out = options.out.resolve()
    # Of a folder that is replaced, all that is in it goes.
    if any(path.resolve().is_relative_to(out) for path in used):
        raise InputError(
            f"{options.out}: expected {'a folder' if kind == 'folder' else 'a file'} apart from "
            "the result's and the light's"
        )
    if kind == "folder":
        check_free(options.out, overwrite=options.overwrite, form=_frames_folder(options))
    else:
        check_free_file(options.out, overwrite=options.overwrite)


def _frames_folder(options: argparse.Namespace) -> FolderForm:
    """Form of a folder of frames."""
    return FolderForm(
        contains=(_frame_name(0, options),), holds=(f"frame_[0-9]*.{options.format or 'exr'}",)
    )


def _frame(k: int, result: Result, light: Light, options: argparse.Namespace) -> Radiance:
    """The picture, or frame k of a turntable."""
    there = turned(light, 360 * k / options.turntable) if k else light
    return relight(result, there, options.threads, shadows=not options.no_shadows)


def _sampled(
    result: Result, light: Light, options: argparse.Namespace
) -> tuple[dict[int, Radiance], float]:
    """Frames by number, and the stops, in tenths, that bring the brightest one's white to 1."""
    count = options.turntable or 1
    steps = sorted({i * count // SAMPLED_FRAMES for i in range(SAMPLED_FRAMES)})
    frames = {k: _frame(k, result, light, options) for k in steps}
    exposure = stops(max(white_of(frame) for frame in frames.values()))
    return frames, min(max(exposure, -LARGEST_EXPOSURE), LARGEST_EXPOSURE)


def _write(
    options: argparse.Namespace, kind: str, frames: Iterator[Radiance], screen: Screen
) -> None:
    if kind == "folder":
        form = _frames_folder(options)
        with new_folder(options.out, overwrite=options.overwrite, form=form) as folder:
            for k, frame in enumerate(frames):
                _write_picture(folder / _frame_name(k, options), frame, screen)
        return
    with new_file(options.out, overwrite=options.overwrite) as path:
        if options.turntable is None:
            _write_picture(path, next(frames), screen)
        else:
            shown = (screen.shown(frame) for frame in frames)
            write_animation(path, kind, shown, options.fps or FPS)


def _write_picture(path: Path, frame: Radiance, screen: Screen) -> None:
    if path.suffix.lower() == ".exr":
        write_exr(path, frame)
    else:
        images.write_png(path, screen.shown(frame), "srgb")


def _frame_name(k: int, options: argparse.Namespace) -> str:
    digits = max(4, len(str(options.turntable - 1)))
    return f"frame_{k:0{digits}}.{options.format or 'exr'}"


def _facts_of_output(
    options: argparse.Namespace, kind: str, result: Result, screen: Screen
) -> Iterator[tuple[str, str]]:
    height, width = result.mask.shape
    what = f"{options.out}: {width} × {height}"
    if result.transport.blocks:
        found = "none: the result has no depth"
        if result.scenery is not None:
            found = f"by surroundings of {len(result.scenery.triangles)} triangles"
        yield "shadows", "left out, as asked for" if options.no_shadows else found
    if options.turntable is not None:
        several = f"{options.turntable} frames, {360 / options.turntable:g} degrees apart"
        what += f", {several if options.turntable > 1 else '1 frame'}"
        if kind != "folder":
            what += f", {options.fps or FPS:g} a second, repeated"
    alpha = "" if result.mask.all() else ", alpha from the mask"
    if not _for_screen(options, kind):
        yield "written", f"{what}, linear Rec.709, float32{alpha}"
        return
    colors = "256 colours a frame" if kind == ".gif" else "8 bits"
    yield "written", f"{what}, sRGB, {colors}{alpha}"
    clipped, black = (count / max(screen.pixels, 1) for count in (screen.clipped, screen.black))
    chosen = " (by itself)" if options.exposure is None else ""
    yield (
        "shown",
        f"exposure {screen.exposure:g} EV{chosen}, tone map {screen.tone_map}; "
        f"{100 * clipped:.1f} % of the pixels are clipped, {100 * black:.1f} % nearly black",
    )
    if clipped + black > UNSEEN_SHARE_MAX:
        none, little = "no light reaches the surfaces that the camera sees", "little can be seen"
        yield "hint", none if chosen else f"{little}; without --exposure, one is chosen"
