"""`pbrfit completion`: scripts that know what the parsers know, tried in the shells themselves."""

from __future__ import annotations

import argparse
import re
import shutil
import subprocess
from pathlib import Path

import pytest

from command_runs import done, refused
from pbrfit import commands
from pbrfit.commands import SUMMARIES, completion
from pbrfit.commands.completion import known_commands

SHELLS = ("bash", "zsh", "fish")


def needs(shell: str) -> pytest.MarkDecorator:
    return pytest.mark.skipif(shutil.which(shell) is None, reason=f"needs {shell}")


@pytest.fixture(scope="module")
def scripts(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("scripts")
    for shell in SHELLS:
        (folder / shell).write_text(done("completion", shell), encoding="utf-8")
    return {shell: folder / shell for shell in SHELLS}


def test_all_that_the_parsers_know_is_known() -> None:
    known = {one.name: one for one in known_commands()}
    assert set(SUMMARIES) <= set(known)
    for name in SUMMARIES:
        if name == "evaluate":
            continue  # what it takes are suites
        parser = argparse.ArgumentParser()
        commands.add_options_of(name, parser)
        assert known[name].options == [
            text for action in parser._actions for text in action.option_strings
        ]
    assert "--solver" in known["decompose"].options
    assert "--out" in known["evaluate table1"].options


@pytest.mark.parametrize("shell", SHELLS)
def test_a_script_has_every_command_option_and_choice(shell: str, scripts: dict[str, Path]) -> None:
    text = scripts[shell].read_text("utf-8")
    for one in known_commands():
        for word in one.name.split():
            assert re.search(rf"\b{word}\b", text)
        for taken in one.taken:
            for name in taken.names:
                long = name.startswith("--")
                shown = name if shell != "fish" else f"-l {name[2:]}" if long else f"-s {name[1:]}"
                assert shown in text
            assert all(choice in text for choice in taken.choices)
            # What scripts quote nowhere else.
            assert all(re.fullmatch(r"[\w.-]+", choice) for choice in taken.choices)


@pytest.mark.parametrize("shell", [pytest.param(name, marks=needs(name)) for name in SHELLS])
def test_a_script_is_one_of_its_shell(shell: str, scripts: dict[str, Path]) -> None:
    subprocess.run([shell, "-n", scripts[shell]], check=True, capture_output=True)


TRIED = [
    ("de", {"decompose", "depth", "demo"}),
    ("decompose --so", {"--solver"}),
    ("decompose s --solver ", {"gauss-newton", "lbfgsb"}),
    ("export r --preset u", {"unreal", "unity"}),
    ("evaluate tab", {"table1"}),
    ("evaluate table1 --ov", {"--overwrite"}),
    ("completion ", set(SHELLS)),
]


@needs("bash")
@pytest.mark.parametrize(("typed", "offered"), TRIED)
def test_bash_offers(typed: str, offered: set[str], scripts: dict[str, Path]) -> None:
    assert bash(["pbrfit", *typed.split(" ")], scripts) == offered


@needs("bash")
def test_bash_completes_what_is_tied_to_an_option_and_leaves_files_to_readline(
    scripts: dict[str, Path],
) -> None:
    assert bash(["pbrfit", "decompose", "--solver", "=", "l"], scripts) == {"lbfgsb"}
    assert bash(["pbrfit", "decompose", "--solver", "="], scripts) == {"gauss-newton", "lbfgsb"}
    assert bash(["pbrfit", "decompose", "--out", ""], scripts) == set()
    assert "complete -o default -F _pbrfit pbrfit" in scripts["bash"].read_text("utf-8")


def bash(words: list[str], scripts: dict[str, Path]) -> set[str]:
    program = (
        'source "$0"; COMP_WORDS=("$@"); COMP_CWORD=$(($# - 1)); _pbrfit; '
        'printf "%s\\n" "${COMPREPLY[@]}"'
    )
    run = subprocess.run(
        ["bash", "-c", program, scripts["bash"], *words], check=True, capture_output=True, text=True
    )
    assert run.stderr == ""
    return set(run.stdout.split())


@needs("fish")
@pytest.mark.parametrize(("typed", "offered"), TRIED)
def test_fish_offers(
    typed: str, offered: set[str], scripts: dict[str, Path], tmp_path: Path
) -> None:
    program = f"source {scripts['fish']}; complete -C 'pbrfit {typed}'"
    run = subprocess.run(
        ["fish", "-c", program], check=True, capture_output=True, text=True, cwd=tmp_path
    )
    assert {line.split("\t")[0] for line in run.stdout.splitlines()} == offered


def test_values_that_are_files_are_told_from_others() -> None:
    known = {one.name: one for one in known_commands()}
    taken = {name: one for one in known["normals"].taken for name in one.names}
    assert (taken["--from"].choices, taken["--from"].files) == (
        ("marigold", "pictures", "flat"),
        True,
    )
    assert (taken["--fov"].choices, taken["--fov"].files) == ((), False)
    assert not taken["--overwrite"].valued
    positional = known["normals"].positional
    assert positional is not None
    assert positional.files


def test_helps_are_cut_to_a_line() -> None:
    for one in known_commands():
        assert all(len(taken.said) <= completion.BRIEF + 2 for taken in one.taken)


def test_without_the_evaluation_there_are_no_suites(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("pbrfit.commands.evaluate.entry_points", lambda **_: ())
    names = [one.name for one in known_commands()]
    assert "evaluate" in names
    assert not any(" " in name for name in names)


def test_an_unknown_shell_is_refused() -> None:
    assert "choose from bash, zsh, fish" in refused("completion", "tcsh")
