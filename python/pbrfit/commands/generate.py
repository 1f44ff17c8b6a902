"""`pbrfit generate`: from one photograph to a scene folder."""

from __future__ import annotations

import argparse
import dataclasses
import json
import shlex
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from pbrfit._core import InputError
from pbrfit.acquire.generation import NETWORKS, depth_source, generate
from pbrfit.acquire.generation_report import GenerationReport
from pbrfit.acquire.generators import create
from pbrfit.acquire.prompts import listing, read_prompts, shipped_text
from pbrfit.acquire.rounds import Progress
from pbrfit.acquire.weights import Device, Offload, Precision
from pbrfit.commands import arguments as cli
from pbrfit.commands.network_options import source
from pbrfit.commands.scene_options import field_of_view
from pbrfit.io.color import ColorSpace
from pbrfit.io.output import new_file

MAX_SIZE = 1024
"""Longer side in pixels that larger photographs are averaged down to."""

ASKING = ("flux2-klein", "gpt-image-2")
BELONGS = {
    **dict.fromkeys(("prompts", "negative", "seed", "regenerate", "model"), ASKING),
    **dict.fromkeys(("guidance", "steps", "dtype", "offload"), ASKING[:1]),
    "quality": ASKING[1:],
}
"""Which generators an option is for; those not named here are for all."""


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add its options."""
    parser.description = (
        "Make a scene folder of one photograph: pictures of the same view under other lights, "
        "each checked against the photograph; normals, segments and depth. Needs extra packages "
        "for all but --generator folder:DIR --normals flat --segments none. gpt-image-2 sends the "
        "photograph to OpenAI; docs/tutorials/one-photograph.md has packages and costs."
    )
    parser.usage = "%(prog)s PHOTO --out SCENE [OPTION ...]"
    parser.add_argument("photo", metavar="PHOTO", nargs="?", type=Path, help="the photograph")
    cli.add_flags(parser, out=cli.value("SCENE", Path, "scene folder to write"))
    cli.add_flags(
        parser.add_mutually_exclusive_group(),
        resume=cli.switch(
            "go on with a run of the same photograph and settings, or add pictures to it; what "
            "was received is never asked for twice"
        ),
        overwrite=cli.switch(
            "make an earlier scene anew, also with another photograph or other settings; "
            "received pictures are kept and taken where they are what is asked for (of "
            "--save-prompts: replace the file)"
        ),
    )
    cli.add_quiet(parser, "no progress bar, no summary")
    cli.add_flags(parser, json=cli.switch("print review.json as the summary"))
    cli.add_flags(
        parser.add_argument_group("the photograph"),
        fov=field_of_view(cli.number, "EXIF, else 60"),
        color_space=cli.choice(
            ColorSpace,
            "of the photograph (default: its ICC profile, else sRGB, of float files linear)",
        ),
        max_size=cli.value(
            "PIXELS",
            cli.positive,
            "average a larger photograph down to this longer side, which all pictures then have",
            default=MAX_SIZE,
        ),
        without_photo=cli.switch("leave the photograph itself out of the scene's pictures"),
    )
    cli.add_flags(
        parser.add_argument_group("pictures under other lights"),
        generator=cli.value(
            "flux2-klein|gpt-image-2|folder:DIR",
            str,
            "FLUX.2 Klein on this machine; GPT-Image-2 by OpenAI's service, with the key in "
            "OPENAI_API_KEY; or pictures that are there already",
            default="flux2-klein",
        ),
        count=cli.value("N", cli.positive, "how many (default: 16, of a folder all)"),
        seed=cli.value(None, cli.whole_number, "of the first; the next has one more (default: 0)"),
        model=cli.value(
            "ID|FOLDER",
            str,
            "another checkpoint, on the Hugging Face Hub or in a folder, or another model of "
            "OpenAI's",
        ),
        guidance=cli.value("G", cli.number, "flux2-klein: towards the prompt (default: 5)"),
        steps=cli.value("N", cli.positive, "flux2-klein: of the sampler (default: 50)"),
        dtype=cli.choice(
            Precision, "flux2-klein: of its numbers (default: bfloat16 on a GPU, else float32)"
        ),
        offload=cli.choice(
            Offload, "flux2-klein: what waits outside the GPU's memory (default: none)"
        ),
        quality=cli.value(
            "low|medium|high|auto", str, "gpt-image-2: decides most of the price (default: high)"
        ),
    )
    cli.add_flags(
        parser.add_argument_group("prompts"),
        prompts=cli.value("FILE", Path, "catalogue (default: the one that ships)"),
        negative=cli.value("TEXT", str, "to avoid; '': nothing (default: the catalogue's)"),
        list_prompts=cli.switch("print the catalogue and do nothing else"),
        save_prompts=cli.value(
            "FILE", Path, "write the catalogue that ships to a file to edit, and do nothing else"
        ),
    )
    cli.add_flags(
        parser.add_argument_group("review"),
        regenerate=cli.value(
            "N",
            cli.whole_number,
            "ask for a refused picture again so often, with other seeds (default: 2)",
        ),
        no_review=cli.switch("take every picture as it comes"),
    )
    cli.add_flags(
        parser.add_argument_group("normals, segments and depth"),
        normals=source(
            ("marigold", "flat"),
            "by a network, none (every surface faces the camera), or from a file",
            ("depth:",),
        ),
        segments=source(("sam2", "none"), "by a network, none, or from a file"),
        depth={
            **source(
                ("depth-anything", "marigold", "normals", "none"),
                "by a network, integrated from normals, none, or from a file; made to agree with "
                "the normals (default: depth-anything; with --normals depth:FILE that file, with "
                "--normals flat or --fov 0 none)",
            ),
            "default": None,
        },
        device=cli.choice(
            Device,
            "where networks compute, those for pictures too (default: a GPU if there is one)",
        ),
    )


def run(options: argparse.Namespace) -> int:
    """Make the scene, or tell or save the prompts."""
    if options.save_prompts is not None:
        with new_file(options.save_prompts, overwrite=options.overwrite) as file:
            file.write_text(shipped_text(), encoding="utf-8")
        print(f"{options.save_prompts}: edit it, and pass it as --prompts")
        return cli.DONE
    catalogue = read_prompts(options.prompts)
    if options.list_prompts:
        print(listing(catalogue))
        return cli.DONE
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
    as_given = ["count", "seed", "regenerate", "normals", "segments", "depth", "device", "fov"]
    as_given += ["color_space", "max_size", "resume", "overwrite"]
    given = {name: value for name in as_given if (value := getattr(options, name)) is not None}
    with _progress(options) as told:
        report = generate(
            options.photo,
            options.out,
            generator=generator,
            catalogue=catalogue,
            review=not options.no_review,
            with_photo=not options.without_photo,
            progress=told,
            **given,
        )
    if options.json:
        with cli.unread_is_no_failure():
            print(json.dumps(report.as_json(), indent=1, ensure_ascii=False))
    else:
        cli.tell(options, _summary(report))
    return cli.DONE


def _check_belonging(options: argparse.Namespace) -> None:
    """Refuse options that would do nothing."""
    chosen = options.generator.partition(":")[0]
    checks = [
        (name, chosen in ones, f"--generator {' or '.join(ones)}, found {chosen}")
        for name, ones in BELONGS.items()
    ]
    depth = depth_source(options.depth, options.normals, options.fov)
    networks = {"flux2-klein", *NETWORKS}
    used = {chosen, options.normals, options.segments, depth} & networks
    checks += [
        ("regenerate", not options.no_review, "the review, found --no-review"),
        ("device", bool(used), f"{', '.join(sorted(networks))}, found no network to be used"),
    ]
    cli.refuse_idle(options, checks)


@contextmanager
def _progress(options: argparse.Namespace) -> Iterator[Progress]:
    with cli.progress_bar(1, quiet=options.quiet, unit="picture", name="generate") as bar:

        def told(what: str, done: int, total: int) -> None:
            bar.total = total
            bar.set_postfix_str(what, refresh=False)
            bar.update(max(done - 1, 0) - bar.n)
            bar.refresh()

        yield told
        bar.update(bar.total - bar.n)


def _summary(report: GenerationReport) -> Iterator[str]:
    """How it went, and what comes next."""
    accepted = len(report.accepted)
    with_photo = " and the photograph" if report.with_photo else ""
    yield f"scene       {report.out}"
    yield f"pictures    {accepted} of {len(report.pictures)} generated{with_photo}"
    for i, picture in enumerate(report.left_out):
        yield f"{'' if i else 'left out':<12}{picture.request.name}: {picture.reason}"
    yield f"review      {report.out / 'review.png'}"
    result = report.out.with_name(f"{report.out.name}-result")
    scene, out = (shlex.quote(str(path)) for path in (report.out, result))
    # Left-out pictures would drop the prior, for metals that take up what no light explains.
    yield f"next        pbrfit decompose {scene} --prior material=1 --out {out}"
