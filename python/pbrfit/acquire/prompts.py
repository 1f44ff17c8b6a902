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

from pbrfit.io.input_files import SETTINGS_BYTES, read_text
from pbrfit.io.json_files import expecting, read_as, toml_of
from pbrfit.values.quoting import quoted

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

    Raises InputError if the file is no such catalogue: one line, with that where TOML is broken;
    OSError if it cannot be read.
    """
    name = str(path) if path is not None else SHIPPED
    content = toml_of(name, shipped_text() if path is None else read_text(path, SETTINGS_BYTES))
    with expecting(name, "[[lighting]] with name and text, preamble, negative"):
        found = read_as(Catalogue, {"preamble": "", "negative": "", "lighting": []} | content)
        if not found.lighting:
            raise ValueError("no lighting")
        prompts: dict[str, Prompt] = {}
        for prompt in found.lighting:
            if not _SLUG.fullmatch(prompt.name) or prompt.name in prompts:
                expected = "up to 64 of a-z, 0-9, _ and -, another name for each"
                raise ValueError(f"lighting: name {quoted(prompt.name)} in place of {expected}")
            prompts[prompt.name] = Prompt(prompt.name, _line(prompt.text))
            if not prompts[prompt.name].text:
                raise ValueError(f"lighting: {prompt.name} without a text")
    return Catalogue(_line(found.preamble), tuple(prompts.values()), _line(found.negative))


def _line(text: str) -> str:
    return " ".join(text.split())


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
