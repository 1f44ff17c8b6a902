"""Reads a page as strictly as it should be written: every tag closed, in order, nothing unknown."""

from __future__ import annotations

import base64
import io
from dataclasses import dataclass, field
from html.parser import HTMLParser
from pathlib import Path

from PIL import Image

from pbrfit import Result, Scene
from pbrfit.report import write_report

VOID = {"br", "img", "input", "link", "meta", "hr"}


@dataclass
class Element:
    """A tag with its attributes, and the text inside it."""

    tag: str
    attributes: dict[str, str]
    text: str = ""


@dataclass
class Page(HTMLParser):
    """All elements of a page, in order.

    Raises AssertionError where tags do not match, an attribute comes twice or an entity is missing.
    """

    content: str
    elements: list[Element] = field(default_factory=list)
    open: list[Element] = field(default_factory=list)

    def __post_init__(self) -> None:
        super().__init__(convert_charrefs=True)
        assert self.content.startswith("<!doctype html>\n")
        self.feed(self.content)
        self.close()
        assert not self.open, f"not closed: {self.open[-1]}"

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        names = [name for name, _ in attrs]
        assert len(set(names)) == len(names), f"attribute twice in {tag}: {names}"
        element = Element(tag, {name: value or "" for name, value in attrs})
        self.elements.append(element)
        if tag not in VOID:
            self.open.append(element)

    def handle_endtag(self, tag: str) -> None:
        assert self.open, f"closed but never opened: {tag}"
        assert self.open[-1].tag == tag, f"expected </{self.open[-1].tag}>, found </{tag}>"
        self.open.pop()

    def handle_data(self, data: str) -> None:
        for element in self.open:
            element.text += data

    def all(self, tag: str) -> list[Element]:
        """Elements of a tag."""
        return [element for element in self.elements if element.tag == tag]

    @property
    def text(self) -> str:
        """What people read, white space made single."""
        [body] = self.all("body")
        for script in self.all("script") + self.all("style"):
            body.text = body.text.replace(script.text, " ")
        return " ".join(body.text.split())

    @property
    def values(self) -> list[float]:
        """Numbers in full that stand in `data` elements."""
        return [float(element.attributes["value"]) for element in self.all("data")]

    def picture(self, alt: str) -> Image.Image:
        """Decode the picture inside the page with this text."""
        [found] = [e for e in self.all("img") if e.attributes["alt"] == alt]
        return decoded(found)


def written(result: Result, path: Path, scene: Scene | Path | None = None) -> Page:
    """The page about a result, written to a file and read."""
    write_report(result, path, scene, overwrite=True)
    return Page(path.read_text("utf-8"))


def decoded(element: Element) -> Image.Image:
    """Decode a PNG inside an `img`."""
    head, _, data = element.attributes["src"].partition(",")
    assert head == "data:image/png;base64"
    image = Image.open(io.BytesIO(base64.b64decode(data, validate=True)))
    image.load()
    return image
