"""The catalogue of lights: the one that ships, and what people write."""

from __future__ import annotations

from pathlib import Path

import pytest

from pbrfit._core import InputError
from pbrfit.acquire.prompts import Prompt, read_prompts


def test_the_catalogue_that_ships_has_enough_lights() -> None:
    catalogue = read_prompts()
    assert len(catalogue.lighting) == 32
    assert len({prompt.text for prompt in catalogue.lighting}) == 32
    full = catalogue.full(catalogue.lighting[0])
    assert full == f"{catalogue.preamble} {catalogue.lighting[0].text}"
    assert "\n" not in full + catalogue.negative
    assert len(full) < 1500  # tokens of English have 3 letters and more, and 512 are read


def test_an_own_catalogue_may_leave_out_all_but_the_lights(tmp_path: Path) -> None:
    own = tmp_path / "own.toml"
    own.write_text('[[lighting]]\nname = "dusk"\ntext = """\nBlue\n  dusk."""\n')
    catalogue = read_prompts(own)
    assert catalogue.lighting == (Prompt("dusk", "Blue dusk."),)
    assert catalogue.full(catalogue.lighting[0]) == "Blue dusk."
    assert catalogue.negative == ""


GOOD = '[[lighting]]\nname = "dusk"\ntext = "Blue dusk."\n'


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        ("", "expected .*: no lighting"),
        ("lighting = []", "expected .*: no lighting"),
        ("preamble = 3\n" + GOOD, "expected .*: preamble: 3 in place of a text"),
        ("preambel = ''\n" + GOOD, "expected .*: Catalogue with or without preambel"),
        (GOOD + GOOD, "expected .*: lighting: name 'dusk' in place of .*, another name"),
        (GOOD + "[[lighting]]\ntext = 'x'", "expected .*: Prompt with or without name"),
        ("[[lighting]]\nname = 'a/b'\ntext = 'x'", "expected .*: lighting: name 'a/b' in place"),
        ("[[lighting]]\nname = 'a'", "expected .*: Prompt with or without text"),
        ("[[lighting]]\nname = 'a'\ntext = ' '", "expected .*: lighting: a without a text"),
        (GOOD + "side = 'left'", "expected .*: Prompt with or without side"),
        ("lighting = ['dusk']", "expected .*: lighting: 'dusk' in place of an object"),
        ("\n\npreamble = left", r"expected TOML, found .*line 3"),
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
    with pytest.raises(InputError, match=r"own\.toml: .* found another byte in line 4"):
        read_prompts(tmp_path / "own.toml")
