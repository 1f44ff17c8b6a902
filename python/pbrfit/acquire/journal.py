"""The journal of a run: every picture that was received, so that none is asked for twice.

A folder with two files a request: `NAME-SEED.png`, the picture as it was received, and then
`NAME-SEED.json`, which says what was asked for. The second is written when the first is whole, so
what it speaks of is there. Nothing in this folder is ever deleted or written over.
"""

from __future__ import annotations

import hashlib
import itertools
import json
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from pbrfit._core import InputError
from pbrfit.acquire.generators import Generated, Refused, Request
from pbrfit.acquire.padding import read_srgb8
from pbrfit.acquire.photo import Photo
from pbrfit.io import images
from pbrfit.io.input_files import PICTURE_BYTES, read_bytes
from pbrfit.io.json_files import expecting, read_as, read_json, table, whole, words, write_json
from pbrfit.io.output import new_file
from pbrfit.values.arrays import Codes
from pbrfit.values.quoting import listed, quoted

FOLDER = "generation"
"""Its name in a scene folder."""

ENTRY = "an entry of a generation journal"

ESCAPED = "backslashreplace"
"""How bytes in names of files that are no UTF-8 are written: in JSON they come back from it."""

RUN = "run.json"
"""What the last run was about: the photo and the generator's settings."""


@dataclass(frozen=True)
class Entry:
    """What came of one request."""

    stem: str
    """Of its files' names."""
    request: Request
    refused: str
    """Why there is no picture; empty where there is one."""
    record: dict[str, Any]
    """What the generator noted."""
    sha256: str | None
    """Of the picture file."""


class Journal:
    """Entries of one photo and one generator's settings; those of others stay untouched."""

    def __init__(self, folder: Path, photo: Photo, settings: dict[str, Any]) -> None:
        """Read what is there; makes no file.

        Raises InputError if a file of the journal cannot be read.
        """
        self.folder = folder
        self._photo = photo
        self._about = about(photo, settings)
        self._entries = {entry.request: entry for run, entry in _read(folder) if run == self._about}

    def __len__(self) -> int:
        return len(self._entries)

    def begin(self) -> None:
        """Make the folder, and note what this run is about."""
        self.folder.mkdir(parents=True, exist_ok=True)
        with new_file(self.folder / RUN, overwrite=True) as path:
            write_json(path, self._about, ESCAPED)

    def find(self, request: Request) -> Entry | None:
        """What came of an equal request, if it was made."""
        return self._entries.get(request)

    def keep(self, request: Request, answer: Generated | Refused) -> Entry:
        """Write down a picture, or that there will be none."""
        stem = self._free(request)
        if isinstance(answer, Refused):
            entry = Entry(stem, request, str(answer), {}, None)
        else:
            png = images.encode_png(answer.pixels, tag="srgb")
            with new_file(self.folder / f"{stem}.png") as path:
                path.write_bytes(png)
            entry = Entry(stem, request, "", answer.record, hashlib.sha256(png).hexdigest())
        content = {"about": self._about, **asdict(entry)}
        del content["stem"]
        with new_file(self.folder / f"{stem}.json") as path:
            write_json(path, content, ESCAPED)
        self._entries[request] = entry
        return entry

    def pixels(self, entry: Entry) -> Codes:
        """Picture of an entry, (H, W, 3) sRGB.

        Raises InputError if the file is not the one that was received.
        """
        path = self.folder / f"{entry.stem}.png"
        data = read_bytes(path, PICTURE_BYTES) if path.is_file() else b""
        if hashlib.sha256(data).hexdigest() != entry.sha256:
            there = "another file" if data else "none"
            raise InputError(
                f"{path}: expected the picture as it was received, found {there}; without "
                f"{entry.stem}.json it is asked for anew"
            )
        return read_srgb8(data)

    def _free(self, request: Request) -> str:
        """NAME-SEED, or NAME-SEED-2 and so on where that was of another prompt or photo."""
        stem = f"{request.name}-{request.seed}"
        stems = itertools.chain([stem], (f"{stem}-{k}" for k in itertools.count(2)))
        files = [".png", ".json"]
        return next(s for s in stems if not any((self.folder / (s + f)).exists() for f in files))


def about(photo: Photo, settings: dict[str, Any]) -> dict[str, Any]:
    """What decides about all pictures of a run: the photo as it is shown to the model, settings."""
    height, width = photo.size
    shown = hashlib.sha256(photo.srgb8().tobytes()).hexdigest()
    return {
        "photo": {"sha256": photo.sha256, "size": [width, height], "pixels_sha256": shown},
        # What it will be when it has been through a file.
        "settings": json.loads(json.dumps(settings)),
    }


def differences(folder: Path, photo: Photo, settings: dict[str, Any]) -> list[str]:
    """What the last run in a journal was about that this one is not; empty if all is the same.

    Raises InputError if the folder does not say.
    """
    path = folder / RUN
    if not path.is_file():
        raise InputError(f"{path}: expected what an earlier run was about, found no such file")
    before, now = read_json(path, ENTRY), about(photo, settings)
    with expecting(path, ENTRY):
        was, is_now = before["photo"], now["photo"]
        if was["sha256"] != is_now["sha256"]:
            return ["another photo"]
        if was["size"] != is_now["size"]:
            sizes = [" × ".join(str(whole(side)) for side in one["size"]) for one in (was, is_now)]
            return [f"photo of {sizes[0]} pixels (now {sizes[1]})"]
        if was["pixels_sha256"] != is_now["pixels_sha256"]:
            return ["photo read in another colour space"]
        old, new = before["settings"], now["settings"]
        return [
            f"{listed([key])} {quoted(old.get(key))} (now {quoted(new.get(key))})"
            for key in sorted({*table(old), *new})
            if old.get(key) != new.get(key)
        ]


def names(folder: Path) -> set[str]:
    """Names of all pictures that were ever asked for, of any photo and settings.

    Raises InputError if a file of the journal cannot be read.
    """
    return {entry.request.name for _, entry in _read(folder)}


def _read(folder: Path) -> Iterator[tuple[object, Entry]]:
    """All entries, each with what its run was about."""
    for path in sorted(folder.glob("*.json")) if folder.is_dir() else ():
        if path.name == RUN or path.name.startswith("."):
            continue
        content = read_json(path, ENTRY)
        with expecting(path, ENTRY):
            request, run = read_as(Request, content["request"]), content["about"]
            refused, record = words(content["refused"]), table(content["record"])
            sha256 = read_as(str | None, content["sha256"])
        yield run, Entry(path.stem, request, refused, record, sha256)
