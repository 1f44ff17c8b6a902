"""Measured numbers of README and documentation: as the summaries of their commands say."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Iterator
from importlib.metadata import version
from pathlib import Path
from typing import Any

import pytest

from pbrfit._core import InputError
from pbrfit_evaluation.report import evidence, markdown, write_summary
from pbrfit_evaluation.suite import Row, Table

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"

SUMMARY: dict[str, Any] = {
    "protocol": "p-1",
    "command": "pbrfit evaluate race",
    "date": "2026-11-25",
    "version": "0.1.0",
    "machine": {"processor": "A processor", "cores": 2},
    "rows": [{"name": "a", "metrics": {"x": 0.12345, "none": None}, "paper": {"x": 0.5}}],
    "tables": [{"title": "Times", "markdown": "| ms |\n| ---: |\n| 3.25 |\n"}],
}

PAGE = """# A page

Before.

<!-- evidence: race/Times -->
old
<!-- /evidence -->

![Curve](evidence/race-curve.png) and [lines](evidence/race-all.csv)
"""


@pytest.fixture
def docs(tmp_path: Path) -> Path:
    """Documentation of one page, and a README."""
    docs = tmp_path / "docs"
    docs.mkdir()
    (docs / "race.md").write_text(PAGE, encoding="utf-8")
    (tmp_path / "README.md").write_text("# r\n", encoding="utf-8")
    return docs


@pytest.fixture
def out(tmp_path: Path) -> Path:
    """What a suite wrote."""
    out = tmp_path / "out"
    out.mkdir()
    (out / "summary.json").write_text(json.dumps(SUMMARY), encoding="utf-8")
    for name in ("curve.png", "all.csv", "unseen.png"):
        (out / name).write_bytes(name.encode())
    return out


def test_pages_are_filled_with_the_table_and_its_provenance(docs: Path, out: Path) -> None:
    evidence.publish(docs, "race", out)
    page = (docs / "race.md").read_text("utf-8")
    line = "*`pbrfit evaluate race`, 2026-11-25, pbrfit 0.1.0, A processor, 2 cores.*"
    assert f"-->\n\n| ms |\n| ---: |\n| 3.25 |\n\n{line}\n\n<!-- /" in page
    assert page.startswith("# A page\n\nBefore.\n")
    assert list(evidence.differences(docs)) == []
    kept = sorted(path.name for path in (docs / "evidence").iterdir())
    assert kept == ["race-all.csv", "race-curve.png", "race.json"]
    # A number that was changed by hand is found; tables of other summaries stay.
    (docs / "race.md").write_text(page.replace("3.25", "2.25"), encoding="utf-8")
    assert list(evidence.differences(docs)) == ["race.md: race/Times is not as measured"]
    evidence.publish(docs, "walk", out)
    assert "2.25" in (docs / "race.md").read_text("utf-8")


def test_a_page_shows_the_columns_and_rows_it_names(docs: Path) -> None:
    page = docs / "race.md"
    page.write_text(PAGE.replace("race/Times", "race/Times | s | MiB"), encoding="utf-8")
    rows: list[list[Any]] = [["a|b", 1.5, 2.5, 3.5], ["c", 4.5, 5.5, None], ["", 1, 2, 6.5]]
    table = Table(["", "s", "s", "MiB"], rows)
    evidence.record(docs, "race", command="race", protocol="p", tables={"Times": table})
    text = page.read_text("utf-8")
    assert r"| a\|b | 1.50 | 3.50 |" in text
    assert "| 2.50 |" not in text
    assert list(evidence.differences(docs)) == []
    page.write_text(text.replace("Times | s", "Times | h"), encoding="utf-8")
    with pytest.raises(InputError, match=r"race/Times: expected a column \(s, MiB\), found h"):
        evidence.record(docs, "race", command="race", protocol="p", tables={"Times": table})
    page.write_text(PAGE.replace("Times", "Times | MiB | rows: c"), encoding="utf-8")
    evidence.record(docs, "race", command="race", protocol="p", tables={"Times": table})
    assert "| --- | ---: |\n| c | – |\n|  | 6.50 |\n\n" in page.read_text("utf-8")
    page.write_text(PAGE.replace("Times", "Times | rows: d"), encoding="utf-8")
    with pytest.raises(InputError, match=r"expected a row \(a\\\|b, c\), found d"):
        evidence.record(docs, "race", command="race", protocol="p", tables={"Times": table})


def test_a_benchmark_records_its_tables(docs: Path) -> None:
    tables = {"Times": Table(["ms"], [[4.5]])}
    files = {"curve.png": b"curve"}
    evidence.record(docs, "race", command="make race", protocol="p", tables=tables, files=files)
    assert "| 4.50 |\n\n*`make race`, " in (docs / "race.md").read_text("utf-8")
    assert (docs / "evidence" / "race-curve.png").read_bytes() == b"curve"


def test_private_rows_stay_out(docs: Path, out: Path) -> None:
    rows = [Row("secret", 1, None, {"x": 1.0}, private=True), Row("open", 1, None, {"x": 2.0})]
    times: list[list[Any]] = [
        ["secret", 3.25],
        ["", 1.25],
        ["secret-2", 0.25],
        ["open", 4.5],
        ["mean of 2", 3.75],
    ]
    table = markdown(Table(["set", "ms"], times))
    write_summary(out, "p", rows, command="race", tables={"Times": table})
    assert json.loads((out / "summary.json").read_text("utf-8"))["private"] == ["secret"]
    evidence.publish(docs, "race", out)
    page, kept = ((docs / name).read_text("utf-8") for name in ("race.md", "evidence/race.json"))
    assert "secret" not in page + kept
    assert "1.25" not in page + kept
    assert "| open | 4.50 |\n| mean of 2 | 3.75 |" in page
    assert [row["name"] for row in json.loads(kept)["rows"]] == ["open"]
    assert list(evidence.differences(docs)) == []


def test_what_is_absent_is_an_error(docs: Path, out: Path) -> None:
    assert list(evidence.differences(docs)) == ["race.md: race/Times is not as measured"]
    (docs / "race.md").write_text(PAGE.replace("old\n", evidence.ABSENT), encoding="utf-8")
    assert list(evidence.differences(docs)) == []
    (docs / "race.md").write_text(PAGE.replace("/Times", "/Speeds"), encoding="utf-8")
    with pytest.raises(InputError, match=r"expected a table of race \(Times\), found Speeds"):
        evidence.publish(docs, "race", out)
    assert not (docs / "evidence").exists()  # nothing is half done
    shutil.rmtree(docs)
    with pytest.raises(InputError, match="expected the documentation's folder, found none"):
        evidence.publish(docs, "race", out)


GIVEN = {
    "conventions.md": "constants of colour spaces and of geometry",
    "formats.md": "examples of files",
    "generate-models.md": "sizes and terms of models, from their makers",
    "model.md": "the paper's constants",
    "tutorials/one-photograph.md": "prices, from the service",
}
"""Pages whose numbers are definitions or quotations, and why."""

SETTINGS = {
    "README.md": ("3.11",),
    "ablation.md": ("0.01", "0.03", "0.08", "0.12", "1.25"),
    "benchmarks/normals.md": ("0.01", "0.79", "1.03", "1.25"),
    "cycles.md": ("3.11",),
    "everyday.md": ("0.01",),
    "fit.md": ("0.001", "0.05", "0.22", "0.25", "0.45", "0.82", "1.4826", "2.385"),
    "report.md": ("0.001", "0.083", "0.19", "0.21", "0.25"),
    "solvers.md": ("0.004", "0.01", "1.001", "1.02"),
    "tutorials/renders.md": ("0.12",),
}
"""Versions, constants, sizes of scenes and bars that pages state beside what was measured."""

DATED = "decisions"
"""Page of records of a day, which keep what was found then."""


NUMBER = re.compile(r"(?<![\w.])-?\d+(?:\.\d+)?(?!\w)")


def figures(summary: Any) -> list[float]:
    """Every number that a summary has, in its rows and in its tables."""
    of_rows = [of for row in summary["rows"] for of in (row["metrics"], row["paper"] or {})]
    numbers = [value for of in of_rows for value in of.values() if value is not None]
    texts = (table["markdown"] for table in summary["tables"])
    return numbers + [float(number) for text in texts for number in NUMBER.findall(text)]


def our_pages() -> Iterator[tuple[str, str]]:
    """Name and text of every page whose numbers are of today."""
    for page in evidence.pages(DOCS):
        name = page.relative_to(ROOT if page.name == "README.md" else DOCS).as_posix()
        if not name.startswith(DATED):
            yield name, page.read_text(encoding="utf-8")


def cited(text: str) -> set[str]:
    """Names of the summaries of which a page shows a table, or to which it links."""
    linked = re.findall(rf"{evidence.FOLDER}/([a-z0-9-]+)\.json\)", text)
    return {block["name"] for block in evidence.BLOCK.finditer(text)}.union(linked)


def test_tables_are_as_measured() -> None:
    assert list(evidence.differences(DOCS)) == []


def test_summaries_are_of_this_version_and_shown_somewhere() -> None:
    shown = {name for _, text in our_pages() for name in cited(text)}
    for path in (DOCS / evidence.FOLDER).glob("*.json"):
        assert path.stem in shown, path.name
        assert evidence.read(DOCS, path.stem)["version"] == version("pbrfit"), path.name


def test_no_page_excuses_its_figures() -> None:
    for name, text in our_pages():
        assert not re.search(r"measured\s+(on\s+\S+,\s+)?before|It was before", text, re.I), name


DECIMAL = re.compile(r"(?<![\w.·^-])\d*\.\d{2,}(?!\w|\.\d|·10)")


def _prose(text: str) -> str:
    """Without code, filled tables, comments and addresses."""
    text = evidence.BLOCK.sub("", text)
    text = re.sub(r"^```.*?^```|^    .*?$", "", text, flags=re.DOTALL | re.MULTILINE)
    return re.sub(r"`[^`]*`|\]\([^)]*\)|<!--.*?-->|\$[^$]*\$", "", text)


def test_numbers_in_tables_and_text_are_measured() -> None:
    """Two decimals or more: each a rounding of a figure of a summary that the page shows."""
    strange = []
    for name, text in our_pages():
        if name in GIVEN:
            continue
        there = cited(text) & {path.stem for path in (DOCS / evidence.FOLDER).glob("*.json")}
        known = [f for of in there for f in figures(evidence.read(DOCS, of))]
        for found in set(DECIMAL.findall(_prose(text))) - set(SETTINGS.get(name, ())):
            digits = len(found.partition(".")[2])
            if not any(abs(abs(figure) - float(found)) <= 0.501 * 10**-digits for figure in known):
                strange.append(f"{name}: {found}")
    assert strange == []
