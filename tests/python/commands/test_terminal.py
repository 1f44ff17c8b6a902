"""What people see: verdicts and tables in a terminal and in a pipe, and how work goes on."""

from __future__ import annotations

import io
import json
import re
import shutil
from collections.abc import Callable
from contextlib import redirect_stdout
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

import pbrfit
from command_runs import done, ran
from left_out_pictures import DECISION, EXPLAINED, SENTENCE
from pbrfit.commands import progress
from pbrfit.commands.completion import subcommands, whole_parser
from pbrfit.commands.messages import OPTIONS, complain, in_flags
from pbrfit.commands.scene_display import Row, batch_table
from pbrfit.commands.terminal import verdict_lines
from pbrfit.fit.decompose import decompose
from pbrfit.fit.run import Progress
from pbrfit.io.json_files import read_as
from pbrfit.result.held_out import HeldOut
from pbrfit.result.result import Result
from pbrfit.result.verdict import LEVELS, Verdict
from pbrfit.steps import step
from pbrfit.synthetic import make_scene
from scene_files import write_folder

VERDICTS = {
    "albedo": Verdict("usable", 0.031),
    "roughness": Verdict("rough guide", 0.12, "noise", "more pictures would help"),
    "metallic": Verdict("not determined", 0.31),
}
STEPS = ("noise: more pictures would help roughness", "it is a guess: another (option fov) would")


class Stream(io.StringIO):
    """A stream that may be a terminal, of an encoding."""

    def __init__(self, *, terminal: bool, encoding: str = "utf-8") -> None:
        super().__init__()
        self._terminal, self._encoding = terminal, encoding

    @property
    def encoding(self) -> str:  # type: ignore[override]
        return self._encoding

    def isatty(self) -> bool:
        return self._terminal


def on(stream: Stream, lines: Callable[..., list[str]], *arguments: object) -> list[str]:
    """What is made for a stream in the place of stdout."""
    with redirect_stdout(stream):
        return lines(*arguments)


@pytest.fixture(autouse=True)
def colors(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("NO_COLOR", raising=False)
    monkeypatch.setenv("TERM", "xterm-256color")
    monkeypatch.setenv("COLUMNS", "80")


def test_three_lines_and_what_to_do_next() -> None:
    assert on(Stream(terminal=False), verdict_lines, VERDICTS, STEPS) == [
        "● albedo:    usable          expected error ± 0.03",
        "◐ roughness: rough guide     expected error ± 0.12",
        "○ metallic:  not determined  expected error ± 0.31",
        "next: noise: more pictures would help roughness",
        "also: it is a guess: another (--fov) would",
    ]
    assert on(Stream(terminal=False), verdict_lines, {}, ()) == []


def test_colors_are_for_terminals_that_want_them(monkeypatch: pytest.MonkeyPatch) -> None:
    plain = on(Stream(terminal=False), verdict_lines, VERDICTS, STEPS)
    colored = on(Stream(terminal=True), verdict_lines, VERDICTS, STEPS)
    assert "\x1b[38;5;32m●\x1b[0m" in colored[0]
    assert [re.sub(r"\x1b\[[0-9;]*m", "", line) for line in colored] == plain
    for name, value in (("NO_COLOR", "1"), ("TERM", "dumb")):
        with monkeypatch.context() as patch:
            patch.setenv(name, value)
            assert on(Stream(terminal=True), verdict_lines, VERDICTS, STEPS) == plain
    monkeypatch.setenv("NO_COLOR", "")  # which asks for nothing (no-color.org)
    assert on(Stream(terminal=True), verdict_lines, VERDICTS, STEPS) == colored


def test_levels_differ_without_colors_and_without_the_discs() -> None:
    for encoding in ("utf-8", "ascii"):
        lines = on(Stream(terminal=False, encoding=encoding), verdict_lines, VERDICTS, ())
        assert len({line[0] for line in lines}) == len(LEVELS)
        assert all(line[0].encode(encoding) for line in lines)


@pytest.mark.parametrize(
    ("said", "in_words"),
    [
        ("overwrite=True replaces it", "--overwrite replaces it"),
        ("more (option time_limit) would", "more (--time-limit) would"),
        ("code_range=(0, 255) keeps them", "--code-range 0,255 keeps them"),
        ("an option that is none, x_overwrite=True", "an option that is none, x_overwrite=True"),
    ],
)
def test_python_is_said_in_flags(
    said: str, in_words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert in_flags(said) == in_words
    complain(said)
    assert capsys.readouterr().err == f"pbrfit: {in_words}\n"


def test_options_that_the_library_speaks_of_are_flags() -> None:
    known = subcommands(whole_parser())["decompose"]._option_string_actions
    assert {f"--{name.replace('_', '-')}" for name in OPTIONS} <= set(known)
    said = {
        name
        for path in (Path(pbrfit.__path__[0]) / "result", Path(pbrfit.__path__[0]) / "fit")
        for file in path.rglob("*.py")
        for name in re.findall(r"\(option ([a-z_]+)\)", file.read_text("utf-8"))
    }
    assert said <= set(OPTIONS)


ROWS = [
    Row("room", "done", "0.0262", "3.9 %", ("usable", "rough guide", "not determined"), 9.14),
    Row("hall", "kept", "1.1e-08", "", (None, None, None), 0.0),
    Row("attic", "failed", "", "", (None, None, None), 0.4),
]


def test_a_batch_is_one_table() -> None:
    assert batch_table(ROWS, 9.6) == [
        "scene  status  residual  held out  "
        "albedo            roughness         metallic          seconds",
        "attic  failed                      " + " " * 54 + "    0.4",
        "hall   kept     1.1e-08            " + " " * 54 + "    0.0",
        "room   done      0.0262     3.9 %  "
        "● usable          ◐ rough guide     ○ not determined      9.1",
        "\n3 scenes in 9.6 s: 1 done, 1 kept, 1 failed, 1 with a usable map",
    ]


def test_the_table_fits_into_a_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("NO_COLOR", "1")
    monkeypatch.setattr("sys.stdout", Stream(terminal=True))
    head, *_, room, _ = batch_table(ROWS, 9.6)
    assert max(len(head), len(room)) <= 80
    assert re.split(" +", room) == re.split(
        " ", "room done 0.0262 3.9 % ● usable ◐ rough ○ not 9.1"
    )
    assert [room.index(sign) for sign in "●◐○"] == [
        head.index(name) for name in ("albedo", "roughness", "metallic")
    ]


def test_scenes_share_a_table_and_a_single_one_has_its_own(tmp_path: Path) -> None:
    for name in ("one", "two"):
        write_folder(tmp_path / "scenes" / name)
    fit = ("decompose", tmp_path / "scenes", "--out", tmp_path / "out", "--iterations", 1)
    said = done(*fit).splitlines()
    assert [line.split()[:2] for line in said[1:3]] == [["one", "done"], ["two", "done"]]
    assert re.fullmatch(r"2 scenes in [0-9.]+ s: 2 done, \d with a usable map", said[-1])
    assert len(said) == 5
    assert done(*fit, "--resume", "--quiet") == ""
    (tmp_path / "scenes" / "two" / "normals.exr").write_bytes(b"")
    found = ran(*fit, "--resume")
    assert found.code == 1
    assert [line.split()[:2] for line in found.out.splitlines()[1:3]] == [
        ["one", "kept"],
        ["two", "failed"],
    ]
    alone = ("decompose", tmp_path / "scenes" / "one", "--out", tmp_path / "alone")
    own = done(*alone, "--iterations", 1)
    assert re.search("\n[●◐○] albedo: ", own)
    assert "next: the fit was stopped after 1 iteration: more of them (--iterations)" in own


def test_a_scene_says_how_its_left_out_pictures_are_explained(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fit(*arguments: Any, **options: Any) -> Result:
        return replace(decompose(*arguments, **options), held_out=EXPLAINED)

    monkeypatch.setattr("pbrfit.fit.decompose.decompose", fit)
    scene, out = write_folder(tmp_path / "scenes" / "one"), tmp_path / "out"
    fit_of_one = ("decompose", scene, "--out", out, "--iterations", 1)
    for how in ((), ("--resume",)):  # a result that is kept says the same
        assert f"\n\n{SENTENCE}\n\n" in done(*fit_of_one, *how)
        assert f"\n\n{SENTENCE}\n{DECISION}\n" in done(*fit_of_one, "--resume", "--verbose")
    assert done(*fit_of_one, "--resume", "--quiet") == ""
    for again in ("--overwrite", "--resume"):
        [line] = done(*fit_of_one, "--json", again).splitlines()
        assert read_as(HeldOut, json.loads(line)["held_out"]) == EXPLAINED
    write_folder(tmp_path / "scenes" / "two")
    (tmp_path / "scenes" / "two" / "normals.exr").write_bytes(b"")
    fit_of_all = ("decompose", tmp_path / "scenes", "--out", tmp_path / "all", "--iterations", 1)
    _, one, two, *_ = ran(*fit_of_all).out.splitlines()
    assert one.split()[:5] == ["one", "done", one.split()[2], "3.9", "%"]
    assert two.split() == ["two", "failed", two.split()[-1]]
    lines = [json.loads(line) for line in ran(*fit_of_all, "--json", "--resume").out.splitlines()]
    assert [line["held_out"] is None for line in lines] == [False, True]


def test_progress_in_a_pipe_is_a_line_now_and_then(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    lines, now = progress._Lines(), progress.LINE_EVERY - 0.1
    began = lines._told
    monkeypatch.setattr("time.monotonic", lambda: began + now)
    lines.write("\rscenes: 0/40")
    assert capsys.readouterr().err == ""  # what is quick needs no words
    now = progress.LINE_EVERY
    for written in ("\rscenes: 1/40", "\rscenes: 2/40", "\r   \r"):
        lines.write(written)
    assert capsys.readouterr().err == "pbrfit: scenes: 1/40\n"
    with progress.progress_bar(40, quiet=False, unit="scene", name="scenes") as bar:
        bar.update(20)
        now += progress.LINE_EVERY
        with bar.external_write_mode():
            bar.set_postfix_str("2 at work")
    said = capsys.readouterr().err
    assert said.startswith("pbrfit: scenes:  50% 20/40 [")
    assert said.endswith("2 at work]\n")


def steps_of_a_fit(now: list[float]) -> None:
    """A long step that says how far it is, and a short one."""
    state: Any = None
    at = Progress(1, 9, 1, 0.0123, 1.0, state)
    with progress.fit_steps(quiet=False) as show:
        assert show is not None
        with step("lamps"):
            now[0] += 6.0
            show(replace(at, tiles=(1, 4)))
            now[0] += 6.0
        show(at)  # between two steps
        with step("writing"):
            now[0] += 1.0


def test_steps_of_a_fit_are_told_as_they_end(monkeypatch: pytest.MonkeyPatch) -> None:
    now = [0.0]
    for clock in ("monotonic", "perf_counter"):
        monkeypatch.setattr(f"time.{clock}", lambda: now[0])
    terminal, pipe = Stream(terminal=True), Stream(terminal=False)
    for stream in (terminal, pipe):
        monkeypatch.setattr("sys.stderr", stream)
        steps_of_a_fit(now)
        with step("nobody listens"):
            pass
    shown = terminal.getvalue().replace(progress.CLEAR, "").replace("\r", "\n").splitlines()
    assert shown == [
        "… lamps",
        "… lamps: tile 1 of 4, 6 s",
        "✓ lamps                         12.0 s",
        "… writing",
        "✓ writing                        1.0 s",
    ]
    assert pipe.getvalue().splitlines() == [
        "pbrfit: lamps: tile 1 of 4, 6 s",
        "pbrfit: lamps: done in 12.0 s",
    ]


def test_a_terminal_has_a_bar_and_quiet_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    stream = Stream(terminal=True)
    monkeypatch.setattr("sys.stderr", stream)
    with progress.progress_bar(4, quiet=False, name="scenes") as bar:
        bar.update(2)
    assert "scenes: " in stream.getvalue()
    assert "2/4" in stream.getvalue()
    for is_terminal in (True, False):
        stream = Stream(terminal=is_terminal)
        monkeypatch.setattr("sys.stderr", stream)
        monkeypatch.setattr(progress, "LINE_EVERY", 0.0)
        with progress.progress_bar(4, quiet=True) as bar:
            bar.update(2)
        assert stream.getvalue() == ""


def test_names_steer_no_terminal(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    """A name with escapes clears no screen, and one with U+202E reads as what it is."""
    name = "\x1b[2J\u202egnp.exe\u2067\x9b"
    complain(f"{name}: expected a scene")
    scene = tmp_path / "scene"
    make_scene("room", size=12, lights=2).save(scene)
    shutil.rmtree(scene / "truth")
    first = min((scene / "images").iterdir())
    first.rename(first.with_stem(name))
    inspected = ran("inspect", scene)
    assert inspected.code == 0
    rows = [Row(name, "done", "0.1", "", (None,) * 3, 1.0)]
    for said in (capsys.readouterr().err, inspected.out, "\n".join(batch_table(rows, 1.0))):
        assert "gnp.exe" in said
        assert not set(said) & set("\x1b\u202e\u2067\x9b")
