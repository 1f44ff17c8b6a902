"""The journal of a run: every picture that was received, so that none is asked for twice.

A folder with two files a request: `NAME-SEED.png`, the picture as it was received, and then
`NAME-SEED.json`, which says what was asked for. The second is written when the first is whole, so
what it speaks of is there; and the first holds the second's text too, so that a crash between the
two loses nothing. What a service answered is written before either, and before anything reads it:
`NAME-SEED.answer`, a line of JSON that says what was asked for, and the answer's bytes. Nothing in
this folder is ever deleted or written over.
"""

from __future__ import annotations

import dataclasses
import hashlib
import io
import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from PIL.PngImagePlugin import PngInfo

from pbrfit._core import InputError
from pbrfit.acquire.generators import Answer, Generated, Refused, Request
from pbrfit.acquire.photo import Photo
from pbrfit.acquire.received import opened, read_srgb8
from pbrfit.io.input_files import PICTURE_BYTES, open_file, read_bytes
from pbrfit.io.json_files import (
    UNFIT,
    json_text,
    number,
    read_json,
    seed,
    table,
    text,
    whole,
    words,
    write_json,
)
from pbrfit.io.output import new_file
from pbrfit.io.quoting import listed, quoted

FOLDER = "generation"
"""Its name in a scene folder."""

TEXT = "pbrfit"
"""Key of the text in a picture that says what its entry says."""

ENTRY = "an entry of a generation journal"

ANSWER = ".answer"
SUFFIXES = (".png", ".json", ANSWER)
"""Files of a request."""

ESCAPED = "backslashreplace"
"""How bytes in names of files that are no UTF-8 are written: in JSON they come back from it."""

MOST_HEAD = 2**20
"""Bytes of the line before an answer, which holds a prompt."""

RUN = "run.json"
"""What the last run was about: the photo and the generator's settings."""


@dataclass(frozen=True)
class Entry:
    """What came of one request."""

    stem: str
    """Of its files' names."""
    request: Request
    """What was asked for."""
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
        self._entries = {
            _key(entry.request): entry for run, entry in _read(folder) if run == self._about
        }
        self._answers = {
            _key(request): path for run, request, path in _unread(folder) if run == self._about
        }

    def __len__(self) -> int:
        return len(self._entries)

    def begin(self) -> None:
        """Make the folder, and note what this run is about."""
        self.folder.mkdir(parents=True, exist_ok=True)
        with new_file(self.folder / RUN, overwrite=True) as path:
            write_json(path, self._about, ESCAPED)

    def find(self, request: Request) -> Entry | None:
        """What came of an equal request, if it was made."""
        return self._entries.get(_key(request))

    def receive(self, request: Request, answer: Answer) -> None:
        """Write down what a service answered."""
        told = {
            "about": self._about,
            "request": dataclasses.asdict(request),
            "seconds": answer.seconds,
        }
        head = json.dumps(told, ensure_ascii=False).encode("utf-8", ESCAPED)
        path = self.folder / f"{self._free(request)}{ANSWER}"
        with new_file(path) as file:
            file.write_bytes(head + b"\n" + answer.body)
        self._answers[_key(request)] = path

    def answer(self, request: Request) -> Answer | None:
        """What a service answered that is not in an entry yet.

        Raises OSError if it cannot be read any more.
        """
        path = self._answers.get(_key(request))
        if path is None:
            return None
        head, _, body = read_bytes(path, PICTURE_BYTES).partition(b"\n")
        return Answer(body, number(json.loads(head)["seconds"]))

    def answer_file(self, request: Request) -> Path:
        """Where `answer` is."""
        return self._answers[_key(request)]

    def keep(self, request: Request, generated: Generated) -> Entry:
        """Write down a picture."""
        stem = self._stem(request)
        told = PngInfo()
        asked = {"request": dataclasses.asdict(request), "record": generated.record}
        entry = json_text({"about": self._about, **asked}).encode("utf-8", ESCAPED)
        told.add_itxt(TEXT, entry.decode(), zip=True)
        told.add(b"sRGB", b"\0")
        buffer = io.BytesIO()
        Image.fromarray(generated.pixels).save(buffer, "PNG", pnginfo=told)
        png = buffer.getvalue()
        with new_file(self.folder / f"{stem}.png") as path:
            path.write_bytes(png)
        digest = hashlib.sha256(png).hexdigest()
        return self._add(Entry(stem, request, "", generated.record, digest))

    def refuse(self, request: Request, refusal: Refused) -> Entry:
        """Write down that there will be none."""
        return self._add(Entry(self._stem(request), request, str(refusal), {}, None))

    def pixels(self, entry: Entry) -> NDArray[np.uint8]:
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
        return read_srgb8(data, ("PNG",))

    def _add(self, entry: Entry) -> Entry:
        content = {"about": self._about, **dataclasses.asdict(entry)}
        del content["stem"]
        with new_file(self.folder / f"{entry.stem}.json") as path:
            write_json(path, content, ESCAPED)
        self._entries[_key(entry.request)] = entry
        return entry

    def _stem(self, request: Request) -> str:
        """That of the answer, if there is one, or a free one."""
        path = self._answers.pop(_key(request), None)
        return self._free(request) if path is None else path.stem

    def _free(self, request: Request) -> str:
        """NAME-SEED, or NAME-SEED-2 and so on where that was of another prompt or photo."""
        stem = f"{request.name}-{request.seed}"
        k = 1
        while any((self.folder / f"{stem}{suffix}").exists() for suffix in SUFFIXES):
            k += 1
            stem = f"{request.name}-{request.seed}-{k}"
        return stem


def about(photo: Photo, settings: dict[str, Any]) -> dict[str, Any]:
    """What decides about all pictures of a run: the photo as it is shown to the model, settings."""
    height, width = photo.pixels.shape[:2]
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
    try:
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
    except UNFIT:
        raise _strange(path) from None


def holds_nothing(folder: Path) -> bool:
    """Whether a journal has no entry."""
    return all(path.name == RUN for path in folder.iterdir())


def _key(request: Request) -> tuple[str, str, str, int]:
    return request.name, request.prompt, request.negative, request.seed


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
        try:
            request, run, sha256 = _request(content["request"]), content["about"], content["sha256"]
            refused, record = words(content["refused"]), table(content["record"])
            sha256 = None if sha256 is None else text(sha256)
        except UNFIT:
            raise _strange(path) from None
        yield run, Entry(path.stem, request, refused, record, sha256)
    for path in sorted(folder.glob("*.png")) if folder.is_dir() else ():
        if not path.name.startswith(".") and not path.with_suffix(".json").exists():
            yield from _orphan(path)


def _orphan(path: Path) -> Iterator[tuple[object, Entry]]:
    """A picture whose entry was not written any more, or somebody's own, which is none."""
    data = read_bytes(path, PICTURE_BYTES)
    try:
        with opened(data, ("PNG",)) as picture:
            content = json.loads(picture.info[TEXT])
        request = _request(content["request"])
        run, record = content["about"], table(content["record"])
    except UNFIT:
        return
    yield run, Entry(path.stem, request, "", record, hashlib.sha256(data).hexdigest())


def _unread(folder: Path) -> Iterator[tuple[object, Request, Path]]:
    """Answers of which there is no entry, each with what its run was about."""
    for path in sorted(folder.glob(f"*{ANSWER}")) if folder.is_dir() else ():
        entered = any(path.with_suffix(suffix).exists() for suffix in (".png", ".json"))
        if path.name.startswith(".") or entered:
            continue
        try:
            with open_file(path) as file:
                content = json.loads(file.readline(MOST_HEAD))
            request, run = _request(content["request"]), content["about"]
            number(content["seconds"])
        except UNFIT:
            raise _strange(path) from None
        yield run, request, path


def _request(content: Any) -> Request:
    """Undo `asdict`; one of `UNFIT` if it is something else."""
    name, prompt, negative = (words(content[key]) for key in ("name", "prompt", "negative"))
    if content.keys() != {"name", "prompt", "negative", "seed"}:
        raise ValueError(f"request of {listed(content)}")
    return Request(name, prompt, negative, seed(content["seed"]))


def _strange(path: Path) -> InputError:
    return InputError(f"{path}: expected {ENTRY}, found something else")
