"""The place of a generated scene: whether it is free, and how a scene gets there.

The folder holds the journal, which only grows, and the scene, which is made anew by every run that
ends well. `images/` is moved out of the way first and put in place last: without it no folder is
taken for a scene, so nobody reads half of one.
"""

from __future__ import annotations

import os
import re
import secrets
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from pbrfit._core import InputError
from pbrfit.acquire import journal
from pbrfit.acquire.photo import Photo
from pbrfit.io.output import FolderForm, making, naming, undisturbed, unfinished

PICTURES = "images"

PHOTO = "photo"
"""Name of the photograph among the pictures."""

PARTS = (
    "normals.exr",
    "normals.png",
    "segments.png",
    "depth.exr",
    "mask.png",
    "weights.exr",
    "scene.toml",
    "review.json",
    "review.png",
    PICTURES,
)
"""What a run puts in place or takes away, in this order. Nothing else in the folder is touched."""

_TEMPORARY = ".pbrfit-generate-"
"""What the folder's name starts with that a run works in; one that was killed leaves it."""

_LEFT = re.compile(rf"{re.escape(_TEMPORARY)}[0-9a-f]{{12}}")


def check_place(
    out: Path, photo: Photo, settings: dict[str, object], *, resume: bool, overwrite: bool
) -> None:
    """Check that a scene may be made at `out`.

    Raises FileExistsError if something is there that neither flag is for, or somebody put files
    among the pictures; InputError if `resume` is asked for, and what is there was of another photo
    or other settings.
    """
    if not out.is_dir():
        if out.exists() or out.is_symlink():
            raise FileExistsError(f"{out}: expected a folder or nothing, found a file")
        return
    folder = out / journal.FOLDER
    if not (folder / journal.RUN).is_file():
        if any(not path.name.startswith(_TEMPORARY) for path in out.iterdir()):
            raise FileExistsError(
                f"{out}: expected an empty folder, or one of `pbrfit generate`, found one without "
                f"{journal.FOLDER}/{journal.RUN}"
            )
        return
    if resume:
        different = journal.differences(folder, photo, settings)
        if different:
            raise InputError(
                f"{out}: expected a run of the same photo and settings to go on with, found "
                f"{', '.join(different)}; --overwrite starts anew and keeps {journal.FOLDER}/"
            )
    elif not overwrite:
        there = "a scene" if (out / PICTURES).is_dir() else "a run that has not ended"
        raise FileExistsError(
            f"{out}: expected a folder that does not exist yet, found {there}; --resume goes on "
            "with it, --overwrite makes it anew from what the journal holds and what it lacks"
        )
    if (out / PICTURES).is_dir():
        made = [f"{name}.png" for name in (PHOTO, *journal.names(folder))]
        for path in FolderForm(listed=lambda _: made).foreign(out / PICTURES):
            raise FileExistsError(
                f"{path}: expected only pictures that `pbrfit generate` put there, because all are "
                "replaced, found another; move it away first"
            )


@contextmanager
def place(out: Path) -> Iterator[Path]:
    """Make the folder, or the right to write in it sure, and give a temporary one inside.

    What the block leaves there under the names of `PARTS` is put in place when it ends well. The
    temporary folder goes away in any case, and so does all that was made if the journal is empty.
    Raises InputError if another run is at work there: both would ask for the same pictures; OSError
    if nothing can be written there.
    """
    out_at = out.resolve()
    temporary = out_at / f"{_TEMPORARY}{secrets.token_hex(6)}"
    new = [folder for folder in (out_at, *out_at.parents) if not folder.exists()]
    with unfinished(temporary, parents=new):
        with making(out, "folder"):
            out_at.mkdir(parents=True, exist_ok=True)
        with _alone(out_at, out):
            try:
                with making(out, "folder"):
                    temporary.mkdir()
                with naming(out, temporary):
                    yield temporary
                    with undisturbed():
                        _put(temporary, out_at)
            finally:
                shutil.rmtree(temporary, ignore_errors=True)
                kept = out_at / journal.FOLDER
                with suppress(OSError):
                    if all(path.name == journal.RUN for path in kept.iterdir()):
                        shutil.rmtree(kept)


@contextmanager
def _alone(folder: Path, out: Path) -> Iterator[None]:
    """Keep other runs out of a folder, and take away what killed ones left there.

    The system forgets the lock when the process ends, however it ends. Where there are no such
    locks, as on Windows and some network drives, nobody is kept out.
    """
    try:
        import fcntl
    except ImportError:
        yield
        return
    opened = os.open(folder, os.O_RDONLY)
    try:
        locked = True
        try:
            fcntl.flock(opened, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise InputError(
                f"{out}: expected no other run at work there, found one; --resume goes on with "
                "what it leaves when it has ended"
            ) from None
        except OSError:
            locked = False
        for left in folder.iterdir() if locked else ():
            if _LEFT.fullmatch(left.name):
                shutil.rmtree(left, ignore_errors=True)  # which follows no link
        yield
    finally:
        os.close(opened)


def _put(made: Path, out: Path) -> None:
    """Put a new scene in place; of a run that made none its review, where there is no scene yet."""
    before = out / PICTURES
    if (made / PICTURES).is_dir():
        if before.is_dir():
            before.rename(made / "before")
        for name in PARTS:
            if (made / name).exists():
                (made / name).replace(out / name)
            else:
                (out / name).unlink(missing_ok=True)
    elif not before.is_dir():
        for path in made.iterdir():
            path.replace(out / path.name)
