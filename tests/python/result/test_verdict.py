"""Verdicts: their thresholds, their words, and that they are the same wherever they are shown."""

from __future__ import annotations

import dataclasses
import json
import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from left_out_pictures import EXPLAINED, UNEXPLAINED
from page_reader import Element, Page
from pbrfit import Materials, Result, decompose
from pbrfit.commands.terminal import verdict_lines
from pbrfit.fit import compare
from pbrfit.io.json_files import read_as
from pbrfit.report import write_report
from pbrfit.result import preview, verdict
from pbrfit.result.advice import of_verdicts
from pbrfit.result.sheet import Panel, Row, sheet
from pbrfit.result.verdict import LEVELS, PARAMETERS, ROUGH_MAX, USABLE_MAX, Verdict
from pbrfit.synthetic import make_scene
from scene_files import known, truth_of

SIZE = 8
VERDICTS = {
    "albedo": Verdict("usable", 0.0312),
    "roughness": Verdict("rough guide", 0.154, "few highlights", "more lights would help"),
    "metallic": Verdict("not determined", 0.31, "few lights from one side"),
}


def deviating(value: float) -> Materials:
    """Deviations of one value in all maps."""
    return Materials(np.full((2, 2, 3), value), np.full((2, 2), value), np.full((2, 2), value))


def chips_of(result: Result, path: Path) -> tuple[Page, list[Element]]:
    """The page about a result, and its verdicts."""
    write_report(result, path)
    page = Page(path.read_text("utf-8"))
    chips = page.all("details")
    return page, [one for one in chips if "verdict" in one.attributes.get("class", "").split()]


@pytest.fixture(scope="module")
def result() -> Result:
    found = decompose(make_scene("room", size=SIZE, lights=3, noise=0.01), iterations=2)
    uncertainty = dataclasses.replace(known(found.uncertainty), verdicts=VERDICTS)
    return dataclasses.replace(found, uncertainty=uncertainty)


@pytest.mark.parametrize("name", PARAMETERS)
def test_levels_change_at_their_thresholds(name: str) -> None:
    usable, rough = USABLE_MAX[name], ROUGH_MAX[name]
    assert 0 < usable < rough < 1
    above_usable, above_rough = math.nextafter(usable, 1), math.nextafter(rough, 1)
    limits = ((0.0, usable), (above_usable, rough), (above_rough, 1.0))
    for level, errors in zip(LEVELS, limits, strict=True):
        for error in errors:
            assert verdict.level_of(name, error) == level
            of_pixels = verdict.levels(deviating(error))[name]
            assert (of_pixels == LEVELS.index(level)).all()


@pytest.mark.parametrize("name", PARAMETERS)
def test_errors_may_be_off_by_the_margin(name: str) -> None:
    """On the safe side of a threshold: never usable, nor not determined, by a hair's breadth."""
    usable, rough = USABLE_MAX[name], ROUGH_MAX[name]
    assert verdict.deserved(name, 0.999 * verdict.MARGIN * usable) == "usable"
    assert verdict.deserved(name, 1.001 * verdict.MARGIN * usable) == "rough guide"
    assert verdict.deserved(name, 0.999 * rough / verdict.MARGIN) == "rough guide"
    assert verdict.deserved(name, 1.001 * rough / verdict.MARGIN) == "not determined"


def test_no_map_is_usable_where_left_out_pictures_are_not_explained() -> None:
    at = EXPLAINED.nearest_picture
    better = dataclasses.replace(EXPLAINED, error=math.nextafter(at, 0))
    assert verdict.capped(VERDICTS, better) == verdict.capped(VERDICTS, None) == VERDICTS
    for error in (at, math.nextafter(at, 1)):
        found = verdict.capped(VERDICTS, dataclasses.replace(EXPLAINED, error=error))
        assert found["albedo"] == Verdict(
            "rough guide", 0.0312, verdict.UNEXPLAINED, verdict.MORE_TOLD
        )
        # What is no better anyhow keeps its own cause.
        assert {name: found[name] for name in PARAMETERS[1:]} == {
            name: VERDICTS[name] for name in PARAMETERS[1:]
        }


def test_a_fit_has_its_verdicts_capped(monkeypatch: pytest.MonkeyPatch) -> None:
    made = make_scene("room", size=12, lights=6, noise=0.001)
    scene = dataclasses.replace(made, lighting=truth_of(made).lighting)
    plain: dict[str, Any] = {"priors": None, "robust": "none", "refine_normals": "off"}
    choose = compare.choose
    found = []
    for held_out in (EXPLAINED, UNEXPLAINED):

        def choice(*given: Any, held_out: Any = held_out, **options: Any) -> compare.Choice:
            return dataclasses.replace(choose(*given, **options), held_out=held_out)

        monkeypatch.setattr(compare, "choose", choice)
        found.append(known(decompose(scene, **plain).uncertainty).verdicts)
    free, capped = found
    assert not verdict.nothing_usable(free)
    assert capped == verdict.capped(free, UNEXPLAINED)
    assert verdict.nothing_usable(capped)


@pytest.mark.parametrize(
    ("error", "words"),
    [
        (0.0, "± 0"),
        (0.0009, "< 0.001"),
        (0.004, "± 0.004"),
        (0.0312, "± 0.03"),
        (0.1, "± 0.10"),
        (0.31, "± 0.31"),
    ],
)
def test_errors_have_as_many_digits_as_mean_something(error: float, words: str) -> None:
    assert Verdict("usable", error).error_in_words == words


def test_the_thresholds_are_said_in_full() -> None:
    said = verdict.thresholds()
    for limit in (*USABLE_MAX.values(), *ROUGH_MAX.values()):
        assert re.search(rf"\b{limit:.2g}\b", said)


def test_verdicts_are_saved_and_read_again(result: Result, tmp_path: Path) -> None:
    result.save(tmp_path / "out")
    assert known(Result.load(tmp_path / "out").uncertainty).verdicts == VERDICTS
    content = json.loads((tmp_path / "out" / "result.json").read_text("utf-8"))
    assert verdict.verdicts_of(content["uncertainty"]) == VERDICTS
    for wrong in ({"level": "good"}, {"expected_error": "small"}, {"cause": None}):
        changed = content["uncertainty"]["verdicts"]["albedo"] | wrong
        with pytest.raises((ValueError, TypeError)):
            read_as(Verdict, changed)
    for level, error in (("usable", 1.1), ("usable", 0.09), ("rough guide", 0.3)):
        changed |= {"level": level, "expected_error": error, "cause": ""}
        with pytest.raises(ValueError, match="in place of"):
            verdict.verdicts_of({"verdicts": dict.fromkeys(PARAMETERS, changed)})


def test_one_verdict_everywhere(
    result: Result, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    terminal = verdict_lines(VERDICTS, of_verdicts(VERDICTS))
    panels: list[Panel] = []

    def keep(rows: list[Row], **options: Any) -> Any:
        panels.extend(panel for row in rows for panel in row if panel is not None)
        return sheet(rows, **options)

    monkeypatch.setattr(preview, "sheet", keep)
    preview.preview(result)
    page, chips = chips_of(result, tmp_path / "page.html")
    for (name, one), chip in zip(VERDICTS.items(), chips, strict=True):
        why = "; ".join(filter(None, (one.cause, one.remedy)))
        error = f"± {one.expected_error:.2f}"
        [line] = [line for line in terminal if f" {name}: " in line]
        assert re.split(" +", line, maxsplit=2)[1:] == [
            f"{name}:",
            f"{one.level:<14}  expected error {error}",
        ]
        assert not one.cause or any(one.cause in line and one.remedy in line for line in terminal)
        [panel] = [p for p in panels if p.caption.startswith(name)]
        assert panel.note == f"{one.level}, {error}" + (f": {why}" if why else "")
        assert panel.mark == verdict.MARKS[one.level]
        assert f"{name}: {one.level}" in chip.text
        assert error in chip.text
        for words in filter(None, (one.cause, one.remedy)):
            assert f"{words[0].upper()}{words[1:]}." in chip.text
        assert one.expected_error in page.values
    assert verdict.thresholds()[1:] in page.text
