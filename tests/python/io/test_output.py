"""Output folders and files are whole or not there, and what was there before stays."""

from __future__ import annotations

import errno
import functools
import os
import re
from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path
from typing import NoReturn

import pytest

from pbrfit.io.output import FolderForm, check_free, new_file, new_folder
from scene_files import tree

FORM = FolderForm(contains=("old.txt",), holds=("*.txt",))

New = Callable[..., AbstractContextManager[Path]]


@pytest.fixture
def old(tmp_path: Path) -> Path:
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "old.txt").write_text("old")
    return tmp_path / "out"


def test_appears_when_done_with_new_parents(tmp_path: Path) -> None:
    path = tmp_path / "a" / "b" / "out"
    with new_folder(path) as folder:
        (folder / "new.txt").write_text("new")
        assert folder.parent == path.parent
        assert folder.name.startswith(".")
        assert not path.exists()
    assert tree(tmp_path) == {"a": "", "a/b": "", "a/b/out": "", "a/b/out/new.txt": "new"}
    assert path.stat().st_mode & 0o777 == path.parent.stat().st_mode & 0o777


def test_an_existing_folder_is_refused(old: Path) -> None:
    with pytest.raises(FileExistsError, match="out: expected a folder that does not exist yet"):
        new_folder(old).__enter__()
    assert tree(old.parent) == {"out": "", "out/old.txt": "old"}


def test_an_existing_folder_is_replaced_when_asked(old: Path) -> None:
    with new_folder(old, overwrite=True, form=FORM) as folder:
        (folder / "new.txt").write_text("new")
        assert (old / "old.txt").exists()
    assert tree(old.parent) == {"out": "", "out/new.txt": "new"}


@pytest.mark.parametrize("at", [1, 2])
def test_an_interrupt_between_the_renames_leaves_the_old_folder(
    old: Path, at: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    rename, calls = Path.rename, 0

    def interrupted(self: Path, target: Path) -> Path:
        nonlocal calls
        calls += 1
        if calls == at:
            raise KeyboardInterrupt
        return rename(self, target)

    monkeypatch.setattr(Path, "rename", interrupted)

    def replace() -> None:
        with new_folder(old, overwrite=True, form=FORM) as folder:
            (folder / "new.txt").write_text("new")

    with pytest.raises(KeyboardInterrupt):
        replace()
    assert tree(old.parent) == {"out": "", "out/old.txt": "old"}


@pytest.mark.parametrize("new", [new_file, new_folder])
def test_what_another_process_made_meanwhile_stays(tmp_path: Path, new: New) -> None:
    path = tmp_path / "out"

    def make() -> None:
        with new(path) as temporary:
            if new is new_folder:
                path.mkdir()
                (path / "theirs.txt").write_text("theirs")
            else:
                temporary.write_text("ours")
                path.write_text("theirs")

    with pytest.raises(FileExistsError):
        make()
    assert "theirs" in tree(tmp_path).values()
    assert not list(tmp_path.glob(".*"))


def test_the_folder_in_use_is_never_replaced(old: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(old)
    for path in (Path(), old, old.parent):
        with pytest.raises(FileExistsError, match="found the current one or one above it"):
            new_folder(path, overwrite=True).__enter__()
    assert tree(old.parent) == {"out": "", "out/old.txt": "old"}


def test_files_and_places_that_cannot_be_written_are_named(old: Path) -> None:
    file = old / "old.txt"
    (old / "dangling").symlink_to(old / "nowhere")
    for path in (file, old / "dangling"):
        with pytest.raises(FileExistsError, match=f"{path.name}: expected a folder or nothing"):
            new_folder(path, overwrite=True).__enter__()
    places = [file / "out", file / "a" / "b"]
    if Path("/proc/self").is_dir():
        places.append(Path("/proc/out"))
    for path in places:
        with pytest.raises(OSError, match="expected a place where a folder can be made, found"):
            new_folder(path).__enter__()
    assert sorted(tree(old)) == ["dangling", "old.txt"]


def test_a_file_appears_when_done_with_new_parents(tmp_path: Path) -> None:
    path = tmp_path / "a" / "b" / "out.txt"
    with new_file(path) as file:
        assert file.parent == path.parent
        assert file.name.startswith(".")
        assert file.suffix == ".txt"
        file.write_text("new")
        assert not path.exists()
    assert tree(tmp_path) == {"a": "", "a/b": "", "a/b/out.txt": "new"}


@pytest.mark.parametrize("new", [new_file, new_folder])
@pytest.mark.parametrize("error", [ValueError, KeyboardInterrupt, SystemExit])
@pytest.mark.parametrize("there", [True, False])
def test_a_failure_leaves_all_as_it_was(
    tmp_path: Path, new: New, error: type[BaseException], there: bool
) -> None:
    path = tmp_path / "a" / "b" / "out"
    if there:
        held = path / "old.txt" if new is new_folder else path
        held.parent.mkdir(parents=True)
        held.write_text("old")
    before = tree(tmp_path)

    def fail() -> None:
        replacing = {"form": FORM} if new is new_folder else {}
        with new(path, overwrite=True, **replacing) as temporary:
            (temporary / "half.txt" if new is new_folder else temporary).write_text("half")
            raise error

    with pytest.raises(error):
        fail()
    assert tree(tmp_path) == before


def test_an_existing_file_is_replaced_only_when_asked(old: Path) -> None:
    path = old / "old.txt"
    with pytest.raises(FileExistsError, match="expected a file that does not exist yet, found one"):
        new_file(path).__enter__()
    with pytest.raises(FileExistsError, match="expected a file or nothing, found a folder"):
        new_file(old, overwrite=True).__enter__()
    assert tree(old) == {"old.txt": "old"}
    with new_file(path, overwrite=True) as file:
        file.write_text("new")
        assert path.read_text() == "old"
    assert tree(old) == {"old.txt": "new"}


@pytest.mark.parametrize("name", ["old.txt", "", "nowhere"])
@pytest.mark.parametrize("overwrite", [False, True])
def test_a_link_is_refused_and_its_target_stays(old: Path, name: str, overwrite: bool) -> None:
    link = old.parent / "link"
    link.symlink_to(old / name)
    for new, what in ((new_file, "file"), (functools.partial(new_folder, form=FORM), "folder")):
        expected = re.escape(f"{link}: expected a {what} or nothing, found a link to {old / name}")
        with pytest.raises(FileExistsError, match=expected):
            new(link, overwrite=overwrite).__enter__()
    assert link.is_symlink()
    assert tree(old) == {"old.txt": "old"}


def test_a_link_that_comes_meanwhile_is_not_followed(old: Path) -> None:
    path = old.parent / "page"

    def make() -> None:
        with new_file(path, overwrite=True):
            path.symlink_to(old / "old.txt")

    with pytest.raises(FileExistsError, match="found a link to"):
        make()
    assert tree(old) == {"old.txt": "old"}


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no pipes")
@pytest.mark.parametrize("new", [new_file, new_folder])
def test_a_pipe_is_refused(tmp_path: Path, new: New) -> None:
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(FileExistsError, match="or nothing, found a pipe"):
        new(tmp_path / "pipe", overwrite=True).__enter__()


# What is not ours in a folder

OURS = FolderForm(
    contains=("a.txt",), holds=("a.txt", "in/*.exr", "in/deep/b.txt"), listed=lambda _: ["c[1].txt"]
)


def output(folder: Path, *more: str) -> Path:
    """A folder of that form, and some files."""
    for name in ("a.txt", "in/1.exr", "in/deep/b.txt", "c[1].txt", *more):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).touch()
    return folder


def test_an_earlier_output_is_replaced_with_what_systems_and_killed_runs_leave(
    tmp_path: Path,
) -> None:
    left = (".DS_Store", "in/Thumbs.db", "in/deep/._b.txt", ".pbrfit-0123456789ab.html")
    with new_folder(output(tmp_path / "out", *left), overwrite=True, form=OURS):
        pass
    assert tree(tmp_path) == {"out": ""}


@pytest.mark.parametrize(
    "name",
    ["notes.txt", "c1.txt", "in/notes.txt", "in/more/1.exr", "in/deep/deeper/b.txt", ".git/x"],
)
def test_what_somebody_else_put_there_keeps_a_folder(tmp_path: Path, name: str) -> None:
    folder = output(tmp_path / "out", name)
    told = name.rpartition("/")[0] if name.count("/") and "notes" not in name else name
    with pytest.raises(FileExistsError, match=rf"out: .*, found {re.escape(told)} besides; move"):
        new_folder(folder, overwrite=True, form=OURS).__enter__()
    assert name in tree(folder)


@pytest.mark.parametrize("kind", ["empty folder", "link for a file", "link for a folder", "folder"])
def test_what_has_our_name_and_is_something_else_keeps_a_folder(tmp_path: Path, kind: str) -> None:
    folder = output(tmp_path / "out")
    name = {"link for a file": "a.txt", "link for a folder": "in"}.get(kind, "renders")
    if kind.startswith("link"):
        (folder / name).rename(tmp_path / "elsewhere")
        (folder / name).symlink_to(tmp_path / "elsewhere")
    elif kind == "folder":
        name = "in/deep/b.txt"
        (folder / name).unlink()
        (folder / name).mkdir()
    else:
        (folder / name).mkdir()
    with pytest.raises(FileExistsError, match=rf"found {name} besides"):
        check_free(folder, overwrite=True, form=OURS)


def test_what_comes_into_a_folder_meanwhile_keeps_it(tmp_path: Path) -> None:
    folder = output(tmp_path / "out")

    def make() -> None:
        with new_folder(folder, overwrite=True, form=OURS):
            (folder / "notes.txt").write_text("mine")

    with pytest.raises(FileExistsError, match=r"found notes\.txt besides"):
        make()
    assert tree(tmp_path)["out/notes.txt"] == "mine"
    assert not list(tmp_path.glob(".*"))


@pytest.mark.parametrize("new", [new_file, new_folder])
@pytest.mark.parametrize("named", [False, True])
def test_a_full_disk_is_told_by_name_of_the_output(tmp_path: Path, new: New, named: bool) -> None:
    def write_to(temporary: Path) -> NoReturn:
        names = (str(temporary / "part" if new is new_folder else temporary),) if named else ()
        raise OSError(errno.ENOSPC, "No space left on device", *names)

    with (
        pytest.raises(OSError, match="No space left on device") as caught,
        new(tmp_path / "out") as temporary,
    ):
        write_to(temporary)
    assert caught.value.filename == str(tmp_path / "out")
    assert tree(tmp_path) == {}
