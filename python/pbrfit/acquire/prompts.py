"""Prompts: what a network is asked for, as a file that people edit.

A catalogue is a TOML file with ``preamble`` (what must not change, put before every lighting),
``negative`` (what is not wanted, for networks that take it) and a list ``[[lighting]]`` of
``name`` and ``text``. The first so many of the list are taken, so the order matters.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any

from pbrfit._core import InputError
from pbrfit.io.input_files import SETTINGS_BYTES, read_text
from pbrfit.io.json_files import toml_of
from pbrfit.io.quoting import listed, quoted

SHIPPED = "prompts.toml"
_SLUG = re.compile(r"[a-z0-9][a-z0-9_-]{0,63}")


@dataclass(frozen=True)
class Prompt:
    """A lighting condition: `name` is lower-case and safe in file names, `text` describes it."""

    name: str
    text: str


@dataclass(frozen=True)
class Catalogue:
    """Everything a generator is asked with; all texts are in one line."""

    preamble: str
    """What must stay as it is, before every lighting."""
    lighting: tuple[Prompt, ...]
    """Lighting conditions, the most telling first."""
    negative: str
    """What must not appear; may be empty."""

    def full(self, prompt: Prompt) -> str:
        """The whole text of a request: preamble and lighting."""
        return f"{self.preamble} {prompt.text}".strip()


def read_prompts(path: Path | None = None) -> Catalogue:
    """Read a catalogue; None is the one that ships with pbrfit.

    Raises InputError if the file is no such catalogue: one line with the key, and with the line
    where TOML is broken; OSError if it cannot be read.
    """
    name = str(path) if path is not None else SHIPPED
    content = toml_of(name, shipped_text() if path is None else read_text(path, SETTINGS_BYTES))
    _refuse_unknown(name, "", content, {"preamble", "negative", "lighting"})
    entries = content.get("lighting")
    if not isinstance(entries, list) or not entries:
        raise InputError(f"{name}: expected at least one [[lighting]], found none")
    return Catalogue(
        preamble=_text(name, "preamble", content.get("preamble", ""), empty=True),
        lighting=_lighting(name, entries),
        negative=_text(name, "negative", content.get("negative", ""), empty=True),
    )


def shipped_text() -> str:
    """The catalogue that ships, as the TOML text to start an own one from."""
    return files("pbrfit.acquire").joinpath(SHIPPED).read_text(encoding="utf-8")


def listing(catalogue: Catalogue) -> str:
    """The catalogue as people read it: a line a lighting, numbered as `--count` takes them."""
    width = max(len(prompt.name) for prompt in catalogue.lighting)
    lines = [
        f"{i + 1:3}  {prompt.name:{width}}  {prompt.text}"
        for i, prompt in enumerate(catalogue.lighting)
    ]
    return "\n".join(
        [f"before each: {catalogue.preamble}", "", *lines, "", f"negative: {catalogue.negative}"]
    )


def _lighting(name: str, entries: list[Any]) -> tuple[Prompt, ...]:
    prompts: list[Prompt] = []
    for i, entry in enumerate(entries):
        key = f"lighting {i + 1}"
        if not isinstance(entry, dict):
            raise InputError(f"{name}: {key}: expected name and text, found {quoted(entry)}")
        slug = entry.get("name")
        if not isinstance(slug, str) or not _SLUG.fullmatch(slug):
            raise InputError(
                f"{name}: {key}: name: expected up to 64 of a-z, 0-9, _ and -, found {quoted(slug)}"
            )
        key = f"{key} ({slug})"
        _refuse_unknown(name, f"{key}: ", entry, {"name", "text"})
        if slug in (prompt.name for prompt in prompts):
            raise InputError(f"{name}: {key}: expected a name of its own, found it twice")
        prompts.append(Prompt(slug, _text(name, f"{key}: text", entry.get("text"))))
    return tuple(prompts)


def _text(name: str, key: str, value: object, *, empty: bool = False) -> str:
    if not isinstance(value, str) or not (empty or value.strip()):
        raise InputError(f"{name}: {key}: expected a text, found {quoted(value)}")
    return " ".join(value.split())


def _refuse_unknown(name: str, where: str, table: dict[str, Any], known: set[str]) -> None:
    unknown = sorted(set(table) - known)
    if unknown:
        raise InputError(f"{name}: {where}expected only {listed(known)}, found {listed(unknown)}")
