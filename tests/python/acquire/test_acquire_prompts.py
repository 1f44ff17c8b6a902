"""The catalogue of lights: the one that ships, and what people write."""

from __future__ import annotations

from pathlib import Path

import pytest

from pbrfit._core import InputError
from pbrfit.acquire.prompts import Prompt, listing, read_prompts, shipped_text

SIDES = {
    "left": ("left",),
    "right": ("right",),
    "above": ("above", "ceiling", "roof"),
    "front": ("camera lights", "behind the camera", "beside the camera", "front of the scene"),
    "behind": ("far side", "far end", "behind the scene"),
    "below": ("below", "floor in front"),
}
COLORS = {
    "warm": ("warm", "orange", "golden", "amber"),
    "cool": ("cool", "blue", "bluish"),
    "neutral": ("neutral",),
    "saturated": ("saturated",),
}


def kinds(texts: list[str], words: dict[str, tuple[str, ...]]) -> set[str]:
    return {
        kind
        for kind, of_kind in words.items()
        if any(word in text.lower() for text in texts for word in of_kind)
    }


def test_the_catalogue_that_ships_has_enough_lights() -> None:
    catalogue = read_prompts()
    assert len(catalogue.lighting) == 32
    assert len({prompt.text for prompt in catalogue.lighting}) == 32
    for word in ("geometry", "material", "camera", "framing", "Add nothing", "colour grading"):
        assert word in catalogue.preamble
    for word in ("changed geometry", "moved objects", "added objects", "lens flare", "added text"):
        assert word in catalogue.negative
    full = catalogue.full(catalogue.lighting[0])
    assert full == f"{catalogue.preamble} {catalogue.lighting[0].text}"
    assert "\n" not in full + catalogue.negative
    assert len(full) < 1500  # tokens of English have 3 letters and more, and 512 are read


def test_few_lights_already_come_from_all_sides_and_in_many_colours() -> None:
    texts = [prompt.text for prompt in read_prompts().lighting]
    assert kinds(texts[:2], SIDES) >= {"left", "right"}
    assert kinds(texts[:2], COLORS) >= {"warm", "cool"}
    assert kinds(texts[:8], SIDES) == set(SIDES)
    assert kinds(texts[:8], COLORS) >= {"warm", "cool", "neutral"}
    assert kinds(texts[:16], COLORS) == set(COLORS)


def test_the_shipped_file_is_one_to_start_from(tmp_path: Path) -> None:
    own = tmp_path / "own.toml"
    own.write_text(shipped_text(), encoding="utf-8")
    assert read_prompts(own) == read_prompts()


def test_an_own_catalogue_may_leave_out_all_but_the_lights(tmp_path: Path) -> None:
    own = tmp_path / "own.toml"
    own.write_text('[[lighting]]\nname = "dusk"\ntext = """\nBlue\n  dusk."""\n')
    catalogue = read_prompts(own)
    assert catalogue.lighting == (Prompt("dusk", "Blue dusk."),)
    assert catalogue.full(catalogue.lighting[0]) == "Blue dusk."
    assert catalogue.negative == ""


def test_the_listing_numbers_lights_as_count_takes_them() -> None:
    catalogue = read_prompts()
    lines = listing(catalogue).splitlines()
    assert catalogue.preamble in lines[0]
    assert lines[2].split()[:2] == ["1", catalogue.lighting[0].name]
    assert lines[33].split()[:2] == ["32", catalogue.lighting[31].name]
    assert catalogue.negative in lines[-1]


GOOD = '[[lighting]]\nname = "dusk"\ntext = "Blue dusk."\n'


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        ("", r"expected at least one \[\[lighting\]\], found none"),
        ("lighting = []", r"expected at least one \[\[lighting\]\], found none"),
        ("preamble = 3\n" + GOOD, "preamble: expected a text, found 3"),
        ("preambel = ''\n" + GOOD, "expected only lighting, negative, preamble, found preambel"),
        (GOOD + GOOD, r"lighting 2 \(dusk\): expected a name of its own, found it twice"),
        (GOOD + "[[lighting]]\ntext = 'x'", "lighting 2: name: expected .*, found None"),
        ("[[lighting]]\nname = 'a/b'\ntext = 'x'", "lighting 1: name: expected .*, found 'a/b'"),
        ("[[lighting]]\nname = 'a'", r"lighting 1 \(a\): text: expected a text, found None"),
        ("[[lighting]]\nname = 'a'\ntext = ' '", r"lighting 1 \(a\): text: expected a text"),
        (GOOD + "side = 'left'", r"lighting 1 \(dusk\): expected only name, text, found side"),
        ("lighting = ['dusk']", "lighting 1: expected name and text, found 'dusk'"),
        ("\n\npreamble = left", r"expected TOML: .*line 3"),
    ],
)
def test_a_broken_catalogue_is_refused_with_the_place(
    content: str, expected: str, tmp_path: Path
) -> None:
    (tmp_path / "own.toml").write_text(content)
    with pytest.raises(InputError, match=rf"own\.toml: {expected}"):
        read_prompts(tmp_path / "own.toml")


def test_a_catalogue_in_another_encoding_is_refused_with_the_line(tmp_path: Path) -> None:
    (tmp_path / "own.toml").write_bytes(GOOD.encode() + b"# d\xe4mmrig\n")
    with pytest.raises(
        InputError, match=r"own\.toml: expected UTF-8, found another byte in line 4"
    ):
        read_prompts(tmp_path / "own.toml")
