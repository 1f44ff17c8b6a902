"""`pbrfit completion`: scripts that know what the parsers know, tried in the shells themselves."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest

from command_runs import done
from pbrfit.commands import SUMMARIES
from pbrfit.commands.completion import SHELLS, subcommands, whole_parser


def needs(shell: str) -> pytest.MarkDecorator:
    return pytest.mark.skipif(shutil.which(shell) is None, reason=f"needs {shell}")


@pytest.fixture(scope="module")
def scripts(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("scripts")
    for shell in SHELLS:
        (folder / shell).write_text(done("completion", shell), encoding="utf-8")
    return {shell: folder / shell for shell in SHELLS}


def test_all_commands_are_known_with_their_options() -> None:
    known = subcommands(whole_parser())
    assert set(known) == set(SUMMARIES)
    assert "--solver" in known["decompose"]._option_string_actions
    assert "--out" in subcommands(known["evaluate"])["table1"]._option_string_actions


@pytest.mark.parametrize("shell", [pytest.param(name, marks=needs(name)) for name in SHELLS])
def test_a_script_is_one_of_its_shell(shell: str, scripts: dict[str, Path]) -> None:
    subprocess.run([shell, "-n", scripts[shell]], check=True, capture_output=True)


@needs("bash")
@pytest.mark.parametrize(
    ("typed", "offered"),
    [
        ("de", {"decompose", "depth", "demo"}),
        ("decompose --so", {"--solver"}),
        ("decompose s --solver ", {"gauss-newton", "lbfgsb"}),
        ("evaluate tab", {"table1"}),
    ],
)
def test_bash_offers(typed: str, offered: set[str], scripts: dict[str, Path]) -> None:
    program = (
        'source "$0"; COMP_WORDS=("$@"); COMP_CWORD=$(($# - 1)); '
        '_shtab_pbrfit pbrfit "${COMP_WORDS[COMP_CWORD]}" "${COMP_WORDS[COMP_CWORD - 1]}"; '
        'printf "%s\\n" "${COMPREPLY[@]}"'
    )
    words = ["pbrfit", *typed.split(" ")]
    run = subprocess.run(
        ["bash", "-c", program, scripts["bash"], *words], check=True, capture_output=True, text=True
    )
    assert offered <= set(run.stdout.split())


def test_without_the_evaluation_there_are_no_suites(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("pbrfit.commands.evaluate.entry_points", lambda **_: ())
    assert subcommands(subcommands(whole_parser())["evaluate"]) == {}
