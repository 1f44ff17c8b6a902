"""Tutorials: what they show runs, in order, on small pictures of the names that they use."""

from __future__ import annotations

import argparse
import re
import shlex
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import ArrayLike

from lamp_scenes import around, relief
from pbrfit import cli
from pbrfit.commands.completion import subcommands, whole_parser
from pbrfit.io import images
from pbrfit.io.color import encode_srgb
from pbrfit.synthetic import make_scene

ROOT = Path(__file__).resolve().parents[2]
TUTORIALS = sorted((ROOT / "docs" / "tutorials").glob("*.md"))
BLOCK = re.compile(r"^```(sh|python)\n(.*?)^```", re.DOTALL | re.MULTILINE)

OTHERS = "bench height memory-limit nthreads nworkers page port replay samples side"  # not ours


def write(path: str, picture: ArrayLike) -> None:
    codes = 255 * encode_srgb(np.clip(picture, 0, 1)) + 0.5
    images.write_png(Path(path), codes.astype(np.uint8), tag="srgb")


def options(parser: argparse.ArgumentParser) -> set[str]:
    """Those of a parser, and of the commands below it."""
    below = map(options, subcommands(parser).values())
    return set(parser._option_string_actions).union(*below)


def test_pages_name_options_that_there_are() -> None:
    there = options(whole_parser()) | {f"--{name}" for name in OTHERS.split()}
    for page in (ROOT / "README.md", *(ROOT / "docs").rglob("*.md")):
        named = re.findall(r"(?<![\w-])--[a-z][a-z-]*(?![\w-])", page.read_text("utf-8"))
        assert set(named) <= there, f"{page.name}: {set(named) - there}"


@pytest.mark.slow
@pytest.mark.parametrize("page", TUTORIALS, ids=lambda page: page.stem)
def test_a_tutorial_runs(page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    for folder in ("photos", "coin", "relit"):
        Path(folder).mkdir()
    lamps = around(8, 40, 15)
    for i, picture in enumerate(relief(lamps, size=40, fov=30).samples):
        write(f"photos/{i}.png", picture)
        write(f"coin/{i}.png", picture)
    rows = (f"{i}.png {x} {y} {z}" for i, (x, y, z) in enumerate(lamps))
    Path("dome.lp").write_text("\n".join((str(len(lamps)), *rows)), "utf-8")
    for i, picture in enumerate(make_scene("room", size=64, lights=4).images):
        write(f"relit/{i}.png" if i else "kitchen.png", picture)
    names: dict[str, object] = {}
    for language, text in BLOCK.findall(page.read_text("utf-8")):
        if language == "python":
            exec(text, names)
        for command in text.splitlines() if language == "sh" else ():
            assert cli.main(shlex.split(command)[1:]) == 0, command
