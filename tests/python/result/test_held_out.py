"""What left-out pictures say of a fit: in words, in files, and against the nearest picture."""

from __future__ import annotations

import json
import math
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import pytest

from left_out_pictures import EXCUSE, EXPLAINED, SENTENCE, UNEXPLAINED
from pbrfit import InputError, Result, decompose
from pbrfit.io.json_files import UNFIT, read_as
from pbrfit.result.held_out import HeldOut
from pbrfit.synthetic import make_scene


@pytest.fixture(scope="module")
def result() -> Result:
    return decompose(make_scene("room", size=8, lights=3, held_out=1), iterations=1)


def test_a_fit_explains_what_it_explains_better_than_the_nearest_picture() -> None:
    nearest = EXPLAINED.nearest_picture
    assert replace(EXPLAINED, error=math.nextafter(nearest, 0)).explains
    assert not replace(EXPLAINED, error=nearest).explains


def test_it_is_said_in_a_sentence() -> None:
    assert EXPLAINED.in_words() == SENTENCE
    assert UNEXPLAINED.in_words() == EXCUSE
    same = replace(EXPLAINED, error=EXPLAINED.nearest_picture)
    assert "only within 8.4 %, no better than" in same.in_words()


@pytest.mark.parametrize(
    ("error", "words"),
    [
        (0.0, "0 %"),
        (9e-6, "< 0.001 %"),
        (1e-5, "0.001 %"),
        (0.000123, "0.012 %"),
        (0.0391, "3.9 %"),
        (0.0996, "10 %"),
        (0.123, "12 %"),
        (0.999, "100 %"),
        (1.23, "123 %"),
    ],
)
def test_errors_have_few_digits(error: float, words: str) -> None:
    assert replace(EXPLAINED, error=error).error_in_words == words


def test_what_is_exact_is_within_the_least_that_is_told() -> None:
    for error in (0.0, 1e-9):
        assert "to within 0.001 % (the" in replace(EXPLAINED, error=error).in_words()


WRONG: list[dict[str, Any]] = [
    {"error": "small"},
    {"error": math.nan},
    {"pictures": 2.5},
    {"chosen": None},
    {"candidates": None},
    {"candidates": ["one"]},
    {"candidates": [{"what": "one", "score": 1.0}]},
]


@pytest.mark.parametrize("wrong", WRONG, ids=str)
def test_other_content_is_refused(wrong: dict[str, Any]) -> None:
    with pytest.raises(UNFIT):
        read_as(HeldOut, json.loads(json.dumps(asdict(EXPLAINED))) | wrong)


@pytest.mark.parametrize("held_out", [EXPLAINED, None])
def test_a_result_keeps_it(result: Result, held_out: HeldOut | None, tmp_path: Path) -> None:
    replace(result, held_out=held_out).save(tmp_path / "out")
    file = tmp_path / "out" / "result.json"
    content = json.loads(file.read_text("utf-8"))
    assert read_as(HeldOut | None, content["held_out"]) == held_out
    assert result.uncertainty is not None
    assert content["verdicts"] == {
        name: one.level for name, one in result.uncertainty.verdicts.items()
    }
    loaded = Result.load(tmp_path / "out")
    assert loaded.held_out == held_out
    loaded.save(tmp_path / "again")
    assert (tmp_path / "again" / "result.json").read_bytes() == file.read_bytes()
    file.write_text(json.dumps(content | {"held_out": {"error": 1.0}}), "utf-8")
    with pytest.raises(InputError, match=r"result\.json: expected what pbrfit writes"):
        Result.load(tmp_path / "out")
