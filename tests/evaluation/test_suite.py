"""The machinery that every suite is: a command made from data, its report."""

from __future__ import annotations

import argparse
import csv
import json
import math
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import replace
from datetime import UTC, datetime
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest

import scene_files
from evaluation_tasks import Task, work
from page_reader import Page
from pbrfit.commands.arguments import value
from pbrfit_evaluation import commands, options, report
from pbrfit_evaluation.suite import (
    Options,
    Results,
    Row,
    Section,
    Suite,
    Table,
    Verdict,
)


def cases(asked: Options) -> list[Task]:
    acts = asked.acts or ["well"] * asked.scenes
    return [Task(f"quiet{i}", asked.data, act) for i, act in enumerate(acts)]


def rows(results: Results[Task]) -> list[Row]:
    threads = results.mean("threads")
    return [Row("quiet", threads.count, None, {"threads": threads.mean}, status=results.status())]


def verdicts(_: Results[Task], rows: Sequence[Row]) -> list[Verdict]:
    value = rows[0].metrics["threads"] or math.nan
    return [Verdict("threads", value, 1, at_least=True, part="quiet"), Verdict("more", 0.0, None)]


SUITE = Suite(
    name="nothing",
    title="A suite of nothing",
    protocol="nothing-1, {scenes} scenes, {effort}",
    cases=cases,
    run=work,
    rows=rows,
    verdicts=verdicts,
    settings={
        "scenes": options.count("K", "how many", 3, 1),
        "acts": options.fixed(None, value("ACT", str, "what each does", nargs="+")),
        "data": options.fixed(None, value("DIR", Path, "of traces")),
        "threads": options.threads,
        "hidden": options.Setting((1, 2), (1,)),
    },
    folders="pictures",
    about=("It measures nothing.",),
)

OPTIONS = argparse.Namespace(
    scenes=2,
    acts=None,
    data=None,
    threads=0,
    hidden=(1, 2),
    effort="full",
    quick=False,
    folders=[Path("somewhere/pictures")],
)


def run(suite: Suite[Any], monkeypatch: pytest.MonkeyPatch, *arguments: object) -> int:
    module = type("Module", (), {"SUITE": suite})
    monkeypatch.setattr(commands, "import_module", lambda _: module)
    parser = argparse.ArgumentParser(prog="pbrfit evaluate nothing")
    commands._complete("nothing", parser)
    try:
        asked = parser.parse_args([str(argument) for argument in arguments])
    except SystemExit as ended:
        return int(ended.code or 0)
    return int(asked.command(asked))


def summary(folder: Path) -> dict[str, Any]:
    found: dict[str, Any] = json.loads((folder / "summary.json").read_text("utf-8"))
    return found


def test_options_and_files(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    command = ("--out", out, "--data", tmp_path, "--threads", 2, "--jobs", 1)
    assert run(SUITE, monkeypatch, *command, "--quick") == 0
    printed = capsys.readouterr()
    assert printed.out.count("holds") == 2
    assert f"Look at {out / 'report.html'}" in printed.out
    assert {path.name for path in out.iterdir()} == {
        "records", "report.html", "nothing.md", "scenes.csv", "summary.json",
    }  # fmt: skip
    content = summary(out)
    assert content["protocol"] == "nothing-1, 1 scenes, quick"
    assert (
        content["command"] == f"pbrfit evaluate nothing --quick --data {tmp_path.name} --threads 2"
    )
    assert set(content) == {
        "protocol", "command", "date", "version", "machine", "rows", "tables",
    }  # fmt: skip
    assert [row["name"] for row in content["rows"]] == ["quiet: threads", "more", "quiet"]
    assert content["rows"][0]["metrics"] == {"value": 2, "bar": 1, "at_least": 1}
    assert content["rows"][2]["scenes"] == 1
    assert set(content["rows"][0]) == {"name", "scenes", "solver", "metrics", "paper", "status"}
    with (out / "scenes.csv").open(newline="", encoding="utf-8") as file:
        lines = list(csv.DictReader(file))
    [line] = lines
    assert line == {"key": "quiet0", "act": "well", "name": "quiet0", "threads": "2"}
    page = Page((out / "report.html").read_text("utf-8"))
    assert [element.text for element in page.all("h2")] == ["What must hold", "Figures"]
    said = [element.text for element in page.all("p")]
    assert said[:2] == ["1 of 1 demands hold.", "It measures nothing."]

    assert run(SUITE, monkeypatch, *command, "--resume", "--quiet") == 0
    assert [row["scenes"] for row in summary(out)["rows"]] == [0, 0, 3]
    assert len((tmp_path / "quiet0.trace").read_text("utf-8").splitlines()) == 1


@pytest.mark.parametrize(
    ("acts", "code", "said"),
    [
        (("well", "raise"), 1, "1 of 2 failed: quiet1"),
        (("raise", "raise"), 2, "2 of 2 failed: quiet0, quiet1"),
    ],
)
def test_failures(
    acts: tuple[str, ...],
    code: int,
    said: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    out = tmp_path / "out"
    command = ("--out", out, "--data", tmp_path, "--jobs", 1, "--acts", *acts)
    assert run(SUITE, monkeypatch, *command) == code
    errors = capsys.readouterr().err
    assert said in errors
    assert errors.count("two lines") == 1  # one reason is told once
    assert "two lines" in (out / "report.html").read_text("utf-8")
    failed = acts.count("raise")
    assert summary(out)["rows"][-1]["status"] == f"{failed} of 2 cases failed"


def test_what_does_not_hold_is_a_failure(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    found = [Verdict("a", 2.0, 1.0, "there"), Verdict("b", 3.0, None)]
    suite = replace(SUITE, verdicts=lambda *_: found)
    command = ("--data", tmp_path, "--quick", "--jobs", 1)
    assert run(suite, monkeypatch, "--out", tmp_path / "a", *command) == 1
    assert "FAILS" in capsys.readouterr().out
    assert "0 of 1 demands hold." in (tmp_path / "a" / "report.html").read_text("utf-8")
    assert [row["status"] for row in summary(tmp_path / "a")["rows"]] == ["not held", "ok", "ok"]


def test_help_of_all_suites_imports_none() -> None:
    program = (
        "import sys; sys.argv[1:] = ['evaluate', '--help']\n"
        "import pbrfit.cli, atexit\n"
        "atexit.register(lambda: print(sorted(n for n in sys.modules if 'evaluation' in n)))\n"
        "pbrfit.cli.main()"
    )
    told = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True
    ).stdout
    for name, said in commands.SUITES.items():
        assert f"pbrfit_evaluation.{name}'" not in told
        assert " ".join(said.split()[:3]) in " ".join(told.split())
    for name in ("suite", "report"):
        assert f"'pbrfit_evaluation.{name}'" not in told


FIRST_SEEDS = {
    "ablation": 3000, "convergence": 100, "everyday": 2000, "generated": 9700, "lamps": 8200,
    "normals": 7000, "peers": 6000, "review": 6000, "solvers": 1000, "table1": 1000,
    "transport": 8100, "uncertainty": 9300,
}  # fmt: skip
"""Where scenes begin that the documentation reports; others were those of development."""


@pytest.mark.parametrize("quick", [False, True])
@pytest.mark.parametrize("name", FIRST_SEEDS)
def test_cases_have_names_of_their_own_and_the_seeds_that_are_reported(
    name: str, quick: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("pbrfit_evaluation.cycles.why_not", lambda: None)
    parser = argparse.ArgumentParser()
    commands._complete(name, parser)
    suite = import_module(f"pbrfit_evaluation.{name}.figures").SUITE
    asked = parser.parse_args(["--out", "x", *["--quick"] * quick])
    suite.settle(asked)
    cases = suite.cases(asked)
    assert len({case.key for case in cases}) == len(cases)
    assert min(case.seed for case in cases) == FIRST_SEEDS[name]


@pytest.mark.parametrize(
    ("name", "arguments", "message"),
    [
        ("table1", ("--rows", "base", "nonsense"), "argument --rows: invalid choice: 'nonsense'"),
        ("table1", ("--scenes", "0"), "expected 1 or more, found 0"),
        ("table1", ("--scenes", "101"), "--scenes: expected at most 100, found 101"),
        ("table1", ("--lights", "1"), "--lights: expected at least 2, found 1"),
        ("table1", ("--textures", "nowhere"), "nowhere: expected a folder, found none"),
        ("convergence", ("--seeds", "101"), "--seeds: expected at most 100, found 101"),
        ("generated", ("--pictures", "5"), "--pictures: expected at least 6"),
        ("generated", ("--size", "63"), "--size: expected at least 64"),
        ("transport", ("--lights", "1"), "--lights: expected at least 2, found 1"),
        *(
            ("normals", (f"--degrees={theta}",), "--degrees: expected more than 0 and at most 45")
            for theta in ("0", "-3", "46", "nan")
        ),
    ],
)
def test_options_out_of_range_are_refused_before_anything_is_written(
    name: str,
    arguments: tuple[str, ...],
    message: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert scene_files.run("evaluate", name, "--out", tmp_path / "out", *arguments) == 2
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


def test_a_summary_says_how_to_make_it_again_and_holds_the_tables(tmp_path: Path) -> None:
    sections = [Section("A & B", tables=[Table(["n"], [[1.0]]), Table(["m"], [[0.25]])])]
    report.write(tmp_path, SUITE, OPTIONS, report.Outcome([], [], sections, {}, []))
    summary = json.loads((tmp_path / "summary.json").read_text("utf-8"))
    assert summary["command"] == "pbrfit evaluate nothing pictures --scenes 2"
    assert summary["date"] == f"{datetime.now(UTC):%Y-%m-%d}"
    assert [table["title"] for table in summary["tables"]] == ["A & B", "A & B 2"]
    assert summary["tables"][1]["markdown"] == "| m |\n| ---: |\n| 0.250 |\n"
