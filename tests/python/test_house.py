"""The house: rooms import downwards only, no circles, few loose files, sizes, words."""

from __future__ import annotations

import ast
import json
import re
from collections.abc import Iterator
from functools import cache
from graphlib import CycleError, TopologicalSorter
from itertools import pairwise
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PACKAGE = ROOT / "python" / "pbrfit"
EVALUATION = ROOT / "evaluation" / "pbrfit_evaluation"

FLOORS = (
    ("lazy", "ending", "threads", "steps", "address_space", "errors"),
    ("values",),
    ("io",),
    ("display",),
    ("model",),
    ("kernel",),
    ("scene",),
    ("registration",),
    ("transport",),
    ("result",),
    ("fit",),
    ("report", "export", "acquire", "synthetic", "batch"),
    ("commands",),
    ("cli",),
)
"""Rooms and loose modules, from the lowest: each imports only from its own floor and below."""

FLOOR = {room: number for number, rooms in enumerate(FLOORS) for room in rooms}

CORE = ROOT / "rust"

CORE_ROOMS = {
    "runtime": "",
    "reflectance": "runtime",
    "block": "runtime reflectance",
    "transport": "runtime reflectance block",
    "problem": "runtime reflectance block transport",
    "pixel": "runtime reflectance block problem",
    "schur": "runtime reflectance block problem pixel",
    "lamps": "runtime reflectance problem pixel",
    "environment": "runtime reflectance problem",
    "poisson": "runtime",
    "image_file": "runtime",
}
"""Rooms of the core, each with those that it may use."""
CORE_ROOMS["python"] = " ".join(CORE_ROOMS)

PRIVATE_WORDS = re.compile(
    r"\b(Asked|Taught|Lesson|Lit|Towards|HeldPull|MaterialPull|Pull|Needs|Units|Tame|judges|taught"
    r"|lesson|learns|learnt_by|pulled_steps|follow_lights)\b"
)
"""Names that the field has other words for."""


def modules(package: Path) -> dict[str, Path]:
    """Files of a package by dotted name."""
    found = {}
    for path in sorted(package.rglob("*.py")):
        parts = path.relative_to(package.parent).with_suffix("").parts
        found[".".join(parts).removesuffix(".__init__")] = path
    return found


@cache
def parsed(path: Path) -> ast.Module:
    """A file's code, which several tests read."""
    return ast.parse(path.read_text("utf-8"))


@cache
def nodes(path: Path) -> tuple[ast.AST, ...]:
    """All nodes of a file's code."""
    return tuple(ast.walk(parsed(path)))


def imports(path: Path, known: dict[str, Path]) -> Iterator[tuple[int, str]]:
    """Line and module of each import of a known module, in functions and for types too."""
    for node in nodes(path):
        if isinstance(node, ast.ImportFrom) and node.module:
            for one in node.names:
                full = f"{node.module}.{one.name}"
                found = full if full in known else node.module
                if found in known and found != "pbrfit":
                    yield node.lineno, found
        elif isinstance(node, ast.Import):
            yield from ((node.lineno, one.name) for one in node.names if one.name in known)


def room(module: str) -> str:
    """The room of a module of pbrfit, or its own name where it is loose."""
    return module.split(".")[1] if "." in module else ""


@pytest.mark.parametrize("package", [PACKAGE, EVALUATION], ids=["pbrfit", "evaluation"])
def test_no_circle_of_imports(package: Path) -> None:
    known = modules(package)
    graph = {
        module: {found for _, found in imports(path, known) if found != module}
        for module, path in known.items()
    }
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        raise AssertionError(" <- ".join(error.args[1])) from None


def test_rooms_import_from_their_own_floor_and_below() -> None:
    known = modules(PACKAGE)
    upwards = [
        f"{path.relative_to(ROOT)}:{line}: {room(module)} imports {found}"
        for module, path in known.items()
        if room(module) in FLOOR
        for line, found in imports(path, known)
        if FLOOR[room(found)] > FLOOR[room(module)]
    ]
    assert not upwards, "\n".join(upwards)


def test_every_room_has_a_floor() -> None:
    rooms = {room(module) for module in modules(PACKAGE)} - {"", "__main__"}
    assert rooms == set(FLOOR)


def test_few_files_lie_loose() -> None:
    loose = [path.name for path in PACKAGE.glob("*.py") if not path.name.startswith("__")]
    assert len(loose) <= 8, loose


def core_rooms_used(text: str) -> set[str]:
    """Rooms that a file of the core names, without its comments and the tests at its end."""
    code = re.sub("//.*", "", text.partition("\n#[cfg(test)]\n")[0])
    assert "crate::{" not in code, "expected one path a line"
    return set(re.findall(r"crate::(\w+)", code)) & CORE_ROOMS.keys()


def test_rooms_of_the_core_use_lower_ones_only() -> None:
    text = "use crate::lamps::b; // crate::block\n#[cfg(test)]\nuse crate::schur;"
    assert core_rooms_used(text) == {"lamps"}
    for path in CORE.glob("*/**/*.rs"):
        room = path.relative_to(CORE).parts[0]
        allowed = {room, *CORE_ROOMS[room].split()}
        assert core_rooms_used(path.read_text("utf-8")) <= allowed, path
    assert sum(path.is_file() for path in CORE.iterdir()) <= 8


def lines(folder: Path, *suffixes: str) -> int:
    """Lines of all files with these suffixes."""
    return sum(
        len(path.read_text("utf-8", "replace").splitlines())
        for path in folder.rglob("*")
        if path.suffix in suffixes
    )


def words(*paths: Path) -> int:
    """Words of some pages."""
    return sum(len(path.read_text("utf-8").split()) for path in paths)


def sizes() -> dict[str, int]:
    """Lines by room, numeric constants of the fit, words of the pages."""
    rooms = {f"python/pbrfit/{room}": PACKAGE / room for room in sorted(set(FLOOR))}
    others = {name: ROOT / name for name in ("python/pbrfit", "evaluation", "rust", "tests")}
    found = {
        f"lines in {name}": lines(folder, ".py", ".rs")
        for name, folder in (others | rooms).items()
        if folder.is_dir()
    }
    numeric = re.compile(r"^[A-Z][A-Z_0-9, ]* *(?::[^=]*)?= *[\[(]?[-\d]", re.MULTILINE)
    of_fit = [path.read_text("utf-8") for path in (PACKAGE / "fit").rglob("*.py")]
    found["numeric constants in python/pbrfit/fit"] = sum(len(numeric.findall(of)) for of in of_fit)
    found["words in docs"] = words(*(ROOT / "docs").rglob("*.md"))
    found["words in ARCHITECTURE.md"] = words(ROOT / "ARCHITECTURE.md")
    found["words in README.md"] = words(ROOT / "README.md")
    return found


SIZES = ROOT / "tests" / "data" / "sizes.json"


def test_nothing_grows() -> None:
    """Sizes only fall: `python tests/python/test_house.py` records them once they have fallen."""
    most = json.loads(SIZES.read_text("utf-8"))
    grown = {name: (most[name], size) for name, size in sizes().items() if size > most[name]}
    assert not grown, f"grown (recorded, found): {grown}"


def names(path: Path) -> Iterator[tuple[int, str]]:
    """Line and name of whatever a file defines or uses by name."""
    for node in nodes(path):
        for attribute in ("name", "id", "attr", "arg"):
            value = getattr(node, attribute, None)
            if isinstance(value, str):
                yield getattr(node, "lineno", 0), value


def test_names_are_the_fields_words() -> None:
    private = [
        f"{path.relative_to(ROOT)}:{line}: {name}"
        for path in modules(PACKAGE).values()
        for line, name in names(path)
        if PRIVATE_WORDS.fullmatch(name)
    ]
    assert not private, "\n".join(private)


def test_constants_state_their_quantity() -> None:
    vague = [
        f"{path.relative_to(ROOT)}:{line}: {text}"
        for path in modules(PACKAGE).values()
        for line, text in constants(parsed(path).body)
        if re.match(r"Of (a|an|the|all)\b", text)
    ]
    assert not vague, "\n".join(vague)


def constants(body: list[ast.stmt]) -> Iterator[tuple[int, str]]:
    """Line and text of the docstrings that follow assignments."""
    for statement, text in pairwise(body):
        if (
            isinstance(statement, (ast.Assign, ast.AnnAssign))
            and isinstance(text, ast.Expr)
            and isinstance(text.value, ast.Constant)
            and isinstance(text.value.value, str)
        ):
            yield text.lineno, text.value.value


if __name__ == "__main__":
    recorded = json.loads(SIZES.read_text("utf-8")) if SIZES.exists() else {}
    fallen = {name: min(size, recorded.get(name, size)) for name, size in sizes().items()}
    SIZES.write_text(json.dumps(fallen, indent=2) + "\n", "utf-8")
