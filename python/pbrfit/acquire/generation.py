"""From a photograph to a scene folder: pictures asked for, reviewed, and put in place.

What can fail for nothing is done first: the place, the key, and segments, normals and depth, which
need the photo alone. Then pictures, each written to the journal as it comes. The scene appears at
the very end.
"""

from __future__ import annotations

import logging
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pbrfit._core import InputError
from pbrfit.acquire import depth as depths
from pbrfit.acquire.generation_report import FILE, SHEET, GenerationReport
from pbrfit.acquire.generators import Generator, Request
from pbrfit.acquire.journal import ESCAPED, FOLDER, Journal
from pbrfit.acquire.normals import DEPTH, Normals, estimate
from pbrfit.acquire.photo import Photo, read_photo
from pbrfit.acquire.prompts import Catalogue
from pbrfit.acquire.review import Reviewer
from pbrfit.acquire.rounds import REGENERATE, Progress, make_pictures
from pbrfit.acquire.scene_output import PHOTO, PICTURES, check_place, place
from pbrfit.acquire.segments import segment
from pbrfit.io import images
from pbrfit.io.color import ColorSpace
from pbrfit.io.json_files import write_json
from pbrfit.io.normal_files import write_normals
from pbrfit.io.weight_files import WEIGHT_FILE, write_weights
from pbrfit.model import geometry
from pbrfit.scene.arrays import FIRST_FOV
from pbrfit.scene.reading import Surface

log = logging.getLogger("pbrfit")

PICTURES_MIN = 2

NETWORKS = ("sam2", "marigold", *depths.NETWORKS)
"""Sources of maps that are networks."""

COUNT = 16
"""How many pictures are asked for unless somebody says so: what the method was published with."""


def generate(
    photo_path: Path,
    out: Path,
    *,
    generator: Generator,
    catalogue: Catalogue,
    count: int | None = None,
    seed: int = 0,
    regenerate: int = REGENERATE,
    review: bool = True,
    reviewer: Reviewer | None = None,
    normals: str = "marigold",
    segments: str = "none",
    depth: str | None = None,
    device: str = "auto",
    fov: float | None = None,
    color_space: ColorSpace | None = None,
    max_size: int | None = 1024,
    with_photo: bool = True,
    resume: bool = False,
    overwrite: bool = False,
    progress: Progress | None = None,
) -> GenerationReport:
    """Make a scene folder of one photograph; docs/tutorials/one-photograph.md has its files.

    Parameters
    ----------
    count, seed
        How many pictures, and the first one's seed. None: `COUNT`, and of pictures that are there
        already, all.
    regenerate
        How often a picture that the review refused is asked for again.
    review
        Whether pictures are reviewed; by `reviewer`, or a `pbrfit.acquire.review.Reviewer`.
    normals, segments, depth
        Sources, as `pbrfit.acquire.normals.estimate`, `pbrfit.acquire.segments.segment` and
        `pbrfit.acquire.depth.estimate` take them; the last two may be "none". Depth of None is
        Depth Anything's, of normals "depth:FILE" the file's, and none beside flat normals and of an
        orthographic camera, where nothing tells the offset of relative depth.
    device
        Where their networks compute, as for `pbrfit.acquire.weights.placement`.
    fov
        Horizontal field of view in degrees, 0 = orthographic; None: EXIF, else 60 with a warning.
    color_space, max_size
        How the photograph is read; see `read_photo`.
    with_photo
        Whether the photograph is a picture of the scene too.
    resume
        Go on with what is in `out`, which must be of the same photo and settings.
    overwrite
        Make the scene in `out` anew. Pictures in its journal are kept all the same, and taken
        where they are what is asked for.

    Raises
    ------
    InputError
        If something cannot be used or had, or fewer than two pictures are left: one line. Pictures
        that had come are in the journal, and `resume` goes on with them.
    FileExistsError
        If `out` is not free.
    """
    if count is None:
        count = COUNT if generator.retries else sys.maxsize
    photo = read_photo(photo_path, color_space=color_space, max_size=max_size)
    settings = {"generator": generator.name, **generator.settings()}
    check_place(out, photo, settings, resume=resume, overwrite=overwrite)
    requests = _requests(generator, catalogue, count, seed, with_photo)
    view, assumed = _field_of_view(photo, fov)
    relief_from = depth_source(depth, normals, view)
    told = progress or (lambda *_: None)
    with place(out) as made:
        generator.check()
        journal = Journal(out / FOLDER, photo, settings)
        if not review:
            reviewer = None
        elif reviewer is None:
            reviewer = Reviewer(photo.pixels * np.float32(2.0**photo.exposure), mask=photo.mask)
        told("segments, normals and depth", 0, len(requests))
        parts: tuple[NDArray[np.uint16], dict[str, Any]] | None = None
        relief: depths.Depth | None = None
        seen = photo.srgb8()
        if segments != "none":
            with _or_instead("segments", segments, "none or FILE", device) as options:
                parts = segment(segments, seen, **options)
        with _or_instead("normals", normals, "flat, depth:FILE or FILE", device) as options:
            surface = estimate(normals, seen, fov=view, mask=photo.mask, **options)
        if relief_from != "none":
            known = _known_surface(photo, view, surface, None if parts is None else parts[0])
            with _or_instead("depth", relief_from, "none, normals or FILE", device) as options:
                relief = depths.estimate(relief_from, seen, known, fuse=True, **options)
        journal.begin()
        with _kept(journal, out):
            pictures = make_pictures(
                requests, photo, generator, journal, reviewer, regenerate, told
            )
        report = GenerationReport(
            out=out,
            photo=photo,
            with_photo=with_photo,
            settings=settings,
            pictures=pictures,
            reviewed=review,
            fov=view,
            assumed=assumed,
            maps={
                "normals": surface.record,
                "segments": None if parts is None else parts[1],
                "depth": None if relief is None else relief.record | {"remarks": relief.remarks},
            },
        )
        asked = sum(len(picture.attempts) for picture in pictures)
        told("writing", asked, asked)
        write_json(made / FILE, report.as_json(), ESCAPED)
        images.write_png(made / SHEET, report.sheet(journal), tag="srgb")
        enough = len(report.accepted) + with_photo >= PICTURES_MIN
        if enough:
            write_normals(made / "normals.exr", surface.normals, surface.uncertainty)
            if surface.weights is not None:
                write_weights(made / WEIGHT_FILE, surface.weights, ())
            if photo.mask is not None:
                mask = np.where(photo.mask, 255, 0).astype(np.uint8)
                images.write_png(made / "mask.png", mask, tag=None)
            (made / "scene.toml").write_text(f"fov = {float(view)!r}\n", encoding="utf-8")
            if parts is not None:
                images.write_png(made / "segments.png", parts[0], tag=None)
            if relief is not None:
                images.write_exr(made / "depth.exr", {"Z": relief.depth})
            (made / PICTURES).mkdir()
            if with_photo:
                images.write_png(made / PICTURES / f"{PHOTO}.png", photo.srgb8(), tag="srgb")
            for picture in report.accepted:
                pixels = journal.pixels(picture.attempts[-1].entry)
                file = made / PICTURES / f"{picture.request.name}.png"
                images.write_png(file, pixels, tag="srgb")
    if not enough:
        raise InputError(_too_few(report))
    return report


def _requests(
    generator: Generator, catalogue: Catalogue, count: int, seed: int, with_photo: bool
) -> list[Request]:
    requests = generator.plan(catalogue, count, seed)
    for request in requests:
        try:
            request.name.encode()
        except UnicodeEncodeError:
            raise InputError(
                f"generated pictures: expected names in UTF-8, found {request.name!r}"
            ) from None
    if with_photo and any(request.name == PHOTO for request in requests):
        raise InputError(
            f"{PHOTO}: expected another name for a generated picture, because the photograph is "
            "called so; --without-photo leaves it out"
        )
    return requests


def _field_of_view(photo: Photo, asked: float | None) -> tuple[float, dict[str, str]]:
    """Degrees, and how they were found."""
    if asked is not None:
        geometry.check_fov(asked)
        return asked, {"fov": f"{asked:g} degrees, asked for"}
    if photo.fov is not None:
        return photo.fov, {"fov": f"{photo.fov:.2f} degrees, from EXIF"}
    log.warning(
        "%s: field of view unknown, assumed %g degrees (--fov sets it)", photo.path, FIRST_FOV
    )
    return FIRST_FOV, {"fov": f"{FIRST_FOV:g} degrees: neither --fov nor EXIF says"}


def depth_source(asked: str | None, normals: str, fov: float | None) -> str:
    """Where depth comes from.

    Raises InputError for depth that is asked for without normals, and normals of a depth map that
    an orthographic camera does not tell.
    """
    if normals.startswith(DEPTH) and fov == 0:
        raise InputError(
            f"normals: expected a field of view above 0 for {normals}, found an orthographic one: "
            f"take flat ones first, and then `pbrfit normals SCENE --from {normals} --view-width "
            "WIDTH --overwrite`"
        )
    if asked is None:
        if normals.startswith(DEPTH):
            return normals.removeprefix(DEPTH)
        return "none" if normals == "flat" or fov == 0 else depths.NETWORKS[0]
    if asked != "none" and normals == "flat":
        raise InputError("depth: expected normals beside it, found flat ones; --depth none")
    return asked


def _known_surface(
    photo: Photo, fov: float, of: Normals, segments: NDArray[np.uint16] | None
) -> Surface:
    every = np.ones(photo.size, bool)
    return Surface(
        size=photo.size,
        fov=fov,
        normals=np.where((every if of.known is None else of.known)[..., None], of.normals, np.nan),
        mask=every if photo.mask is None else photo.mask,
        segments=segments,
    )


@contextmanager
def _or_instead(what: str, source: str, others: str, device: str) -> Iterator[dict[str, Any]]:
    """Give options for a source, and let the failure of a network say what does without one."""
    try:
        yield {"device": device} if source in NETWORKS else {}
    except InputError as error:
        if source not in NETWORKS:
            raise
        raise InputError(f"{what}: {error}; without a network: --{what} {others}") from error


@contextmanager
def _kept(journal: Journal, out: Path) -> Iterator[None]:
    """Let what stops a run say what it left behind."""
    try:
        yield
    except (KeyboardInterrupt, InputError, MemoryError) as error:
        count = len(journal)
        if not count:
            raise
        answers = "1 answer is" if count == 1 else f"{count} answers are"
        kept = f"{answers} kept in {out / FOLDER}, and --resume goes on from there"
        if isinstance(error, KeyboardInterrupt):
            raise KeyboardInterrupt(f"interrupted; {kept}") from None
        raise InputError(f"{str(error) or 'out of memory'}; {kept}") from error


def _too_few(report: GenerationReport) -> str:
    found = len(report.accepted) + report.with_photo
    with_photo = " with the photo" if report.with_photo else ""
    reasons = [f"{picture.request.name}: {picture.reason}" for picture in report.left_out]
    told = "; ".join(reasons[:2]) + (f"; and {len(reasons) - 2} more" if reasons[2:] else "")
    return (
        f"{report.out}: expected at least {PICTURES_MIN} pictures for a scene, found "
        f"{found}{with_photo}; left out were {told or 'none'}"
    )
