"""`pbrfit generate`: from one photograph to a scene folder."""

from __future__ import annotations

import argparse
import dataclasses
import json
import shlex
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import get_args

from pbrfit._core import InputError
from pbrfit.acquire.generation import generate
from pbrfit.acquire.generation_report import GenerationReport
from pbrfit.acquire.generators import create
from pbrfit.acquire.prompts import listing, read_prompts, shipped_text
from pbrfit.acquire.rounds import REGENERATE, Progress
from pbrfit.acquire.weights import Device, Offload, Precision
from pbrfit.commands.arguments import (
    DONE,
    add_quiet,
    number,
    positive,
    progress_bar,
    unread_is_no_failure,
    whole_number,
)
from pbrfit.commands.network_options import source
from pbrfit.io.color import ColorSpace
from pbrfit.io.output import new_file

MAX_SIZE = 1024
"""Longer side in pixels that larger photographs are averaged down to."""

ASKING = ("flux2-klein", "gpt-image-2")
BELONGS = {
    "prompts": ASKING,
    "negative": ASKING,
    "seed": ASKING,
    "regenerate": ASKING,
    "model": ASKING,
    "guidance": ASKING[:1],
    "steps": ASKING[:1],
    "dtype": ASKING[:1],
    "offload": ASKING[:1],
    "quality": ASKING[1:],
}
"""Which generators an option is for; those not named here are for all."""


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add its options."""
    parser.description = (
        "Make a scene folder of one photograph: pictures of the same view under other lights, "
        "each checked against the photograph; normals and segments. Needs extra packages for "
        "all but --generator folder:DIR --normals flat --segments none; docs/generate.md says "
        "which, what they cost, and that gpt-image-2 sends the photograph to OpenAI."
    )
    parser.usage = (
        "%(prog)s PHOTO --out SCENE [OPTION ...]\n"
        "       %(prog)s --list-prompts [--prompts FILE]\n"
        "       %(prog)s --save-prompts FILE"
    )
    parser.add_argument("photo", metavar="PHOTO", nargs="?", type=Path, help="the photograph")
    parser.add_argument("--out", metavar="SCENE", type=Path, help="scene folder to write")
    again = parser.add_mutually_exclusive_group()
    again.add_argument(
        "--resume",
        action="store_true",
        help="go on with a run of the same photograph and settings, or add pictures to it; what "
        "was received is never asked for twice",
    )
    again.add_argument(
        "--overwrite",
        action="store_true",
        help="make an earlier scene anew, also with another photograph or other settings; "
        "received pictures are kept and taken where they are what is asked for (of "
        "--save-prompts: replace the file)",
    )
    add_quiet(parser, "no progress bar, no summary")
    parser.add_argument("--json", action="store_true", help="print review.json as the summary")

    photo = parser.add_argument_group("the photograph")
    photo.add_argument(
        "--fov",
        metavar="DEG",
        type=number,
        help="horizontal field of view, 0 = orthographic (default: EXIF, else 60)",
    )
    photo.add_argument(
        "--color-space",
        choices=get_args(ColorSpace),
        help="of the photograph (default: its ICC profile, else sRGB, of float files linear)",
    )
    photo.add_argument(
        "--max-size",
        metavar="PIXELS",
        type=positive,
        default=MAX_SIZE,
        help="average a larger photograph down to this longer side, which all pictures then have",
    )
    photo.add_argument(
        "--without-photo",
        action="store_true",
        help="leave the photograph itself out of the scene's pictures",
    )

    pictures = parser.add_argument_group("pictures under other lights")
    pictures.add_argument(
        "--generator",
        metavar="flux2-klein|gpt-image-2|folder:DIR",
        default="flux2-klein",
        help="FLUX.2 Klein on this machine; GPT-Image-2 by OpenAI's service, with the key in "
        "OPENAI_API_KEY; or pictures that are there already",
    )
    pictures.add_argument(
        "--count",
        metavar="N",
        type=positive,
        help="how many (default: 16, of a folder all)",
    )
    pictures.add_argument(
        "--seed", type=whole_number, help="of the first; the next has one more (default: 0)"
    )
    pictures.add_argument(
        "--model",
        metavar="ID|FOLDER",
        help="another checkpoint, on the Hugging Face Hub or in a folder, or another model of "
        "OpenAI's",
    )
    pictures.add_argument(
        "--guidance", metavar="G", type=number, help="flux2-klein: towards the prompt (default: 5)"
    )
    pictures.add_argument(
        "--steps", metavar="N", type=positive, help="flux2-klein: of the sampler (default: 50)"
    )
    pictures.add_argument(
        "--dtype",
        choices=get_args(Precision),
        help="flux2-klein: of its numbers (default: bfloat16 on a GPU, else float32)",
    )
    pictures.add_argument(
        "--offload",
        choices=get_args(Offload),
        help="flux2-klein: what waits outside the GPU's memory (default: none)",
    )
    pictures.add_argument(
        "--quality",
        metavar="low|medium|high|auto",
        help="gpt-image-2: decides most of the price (default: high)",
    )

    prompts = parser.add_argument_group("prompts")
    prompts.add_argument(
        "--prompts", metavar="FILE", type=Path, help="catalogue (default: the one that ships)"
    )
    negative = prompts.add_mutually_exclusive_group()
    negative.add_argument(
        "--negative", metavar="TEXT", help="what must not appear (default: the catalogue's)"
    )
    negative.add_argument(
        "--no-negative", dest="negative", action="store_const", const="", help="no negative prompt"
    )
    prompts.add_argument(
        "--list-prompts", action="store_true", help="print the catalogue and do nothing else"
    )
    prompts.add_argument(
        "--save-prompts",
        metavar="FILE",
        type=Path,
        help="write the catalogue that ships to a file to edit, and do nothing else",
    )

    review = parser.add_argument_group("review")
    review.add_argument(
        "--regenerate",
        metavar="N",
        type=whole_number,
        help="ask for a refused picture again so often, with other seeds (default: 2)",
    )
    review.add_argument("--no-review", action="store_true", help="take every picture as it comes")

    maps = parser.add_argument_group("normals and segments")
    maps.add_argument(
        "--normals",
        metavar="marigold|flat|depth:FILE|FILE",
        type=source(("marigold", "flat"), ("depth:",)),
        default="marigold",
        help="by a network, none (every surface faces the camera), or from a file",
    )
    maps.add_argument(
        "--segments",
        metavar="sam2|none|FILE",
        type=source(("sam2", "none")),
        default="sam2",
        help="by a network, none, or from a file",
    )
    maps.add_argument(
        "--device",
        choices=get_args(Device),
        help="where networks compute, those for pictures too (default: a GPU if there is one)",
    )


def run(options: argparse.Namespace) -> int:
    """Make the scene, or tell or save the prompts."""
    if options.save_prompts is not None:
        with new_file(options.save_prompts, overwrite=options.overwrite) as file:
            file.write_text(shipped_text(), encoding="utf-8")
        print(f"{options.save_prompts}: edit it, and pass it as --prompts")
        return DONE
    catalogue = read_prompts(options.prompts)
    if options.list_prompts:
        print(listing(catalogue))
        return DONE
    if options.photo is None or options.out is None:
        missing = "PHOTO" if options.photo is None else "--out SCENE"
        raise InputError(f"generate: expected {missing}, found none; see pbrfit generate --help")
    _check_belonging(options)
    if options.negative is not None:
        catalogue = dataclasses.replace(catalogue, negative=options.negative)
    names = ["model", "guidance", "steps", "dtype", "offload", "quality"]
    if options.generator == "flux2-klein":
        names += ["device", "quiet"]
    generator = create(options.generator, **{name: getattr(options, name) for name in names})
    networks = {} if options.device is None else {"device": options.device}
    with _progress(options) as told:
        report = generate(
            options.photo,
            options.out,
            generator=generator,
            catalogue=catalogue,
            count=options.count,
            seed=options.seed or 0,
            regenerate=REGENERATE if options.regenerate is None else options.regenerate,
            review=not options.no_review,
            normals=options.normals,
            normal_options=networks if options.normals == "marigold" else None,
            segments=options.segments,
            segment_options=networks if options.segments == "sam2" else None,
            fov=options.fov,
            color_space=options.color_space,
            max_size=options.max_size,
            with_photo=not options.without_photo,
            resume=options.resume,
            overwrite=options.overwrite,
            progress=told,
        )
    with unread_is_no_failure():
        if options.json:
            print(json.dumps(report.as_json(), indent=1, ensure_ascii=False))
        elif not options.quiet:
            _print_summary(report)
    return DONE


def _check_belonging(options: argparse.Namespace) -> None:
    """Refuse options that would do nothing."""
    chosen = options.generator.partition(":")[0]
    for name, generators in BELONGS.items():
        if getattr(options, name) is not None and chosen not in generators:
            raise InputError(
                f"--{name}: goes with --generator {' or '.join(generators)}, found {chosen}"
            )
    if options.no_review and options.regenerate is not None:
        raise InputError("--regenerate: goes with the review, found --no-review")
    networks = ("flux2-klein", "marigold", "sam2")
    used = (chosen, options.normals, options.segments)
    if options.device is not None and not set(networks) & set(used):
        raise InputError(
            "--device: goes with flux2-klein, marigold or sam2, found no network to be used"
        )


@contextmanager
def _progress(options: argparse.Namespace) -> Iterator[Progress]:
    with progress_bar(1, quiet=options.quiet, unit="picture", name="generate") as bar:

        def told(what: str, done: int, total: int) -> None:
            bar.total = total
            bar.set_postfix_str(what, refresh=False)
            bar.update(max(done - 1, 0) - bar.n)
            bar.refresh()

        yield told
        bar.update(bar.total - bar.n)


def _print_summary(report: GenerationReport) -> None:
    """How it went, and what comes next."""
    accepted = len(report.accepted)
    with_photo = " and the photograph" if report.with_photo else ""
    facts = [
        ("scene", f"{report.out}"),
        ("pictures", f"{accepted} of {len(report.pictures)} generated{with_photo}"),
    ]
    facts += [
        ("left out" if i == 0 else "", f"{picture.request.name}: {picture.reason}")
        for i, picture in enumerate(report.left_out)
    ]
    if report.cost_usd is not None:
        facts.append(("cost", f"about {report.cost_usd:.2f} US dollars, all attempts together"))
    facts.append(("review", f"{report.out / 'review.png'}"))
    result = report.out.with_name(f"{report.out.name}-result")
    scene, out = (shlex.quote(str(path)) for path in (report.out, result))
    facts.append(("next", f"pbrfit decompose {scene} --out {out}"))
    for topic, fact in facts:
        print(f"{topic:<12}{fact}")
