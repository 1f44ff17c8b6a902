"""Output folders and files are whole or not there, and what was there before stays."""

from __future__ import annotations

import errno
from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path
from typing import NoReturn

import pytest

from pbrfit.io.output import new_file, new_folder
from scene_files import tree

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
    with new_folder(old, overwrite=True) as folder:
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
        with new_folder(old, overwrite=True) as folder:
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


# Files


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
        with new(path, overwrite=True) as temporary:
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


@pytest.mark.parametrize("name", ["old.txt", ""])
def test_a_link_stays_one_and_what_it_leads_to_is_replaced(old: Path, name: str) -> None:
    link = old.parent / "link"
    link.symlink_to(old / name)
    with (new_file if name else new_folder)(link, overwrite=True) as temporary:
        (temporary if name else temporary / "old.txt").write_text("new")
    assert link.is_symlink()
    assert tree(old) == {"old.txt": "new"}


def test_a_place_where_no_file_can_be_made(old: Path) -> None:
    with pytest.raises(OSError, match=r"expected a place where a file can be made, found: "):
        new_file(old / "old.txt" / "out.txt").__enter__()
    assert tree(old) == {"old.txt": "old"}


@pytest.mark.parametrize("new", [new_file, new_folder])
@pytest.mark.parametrize("named", [False, True])
def test_a_full_disk_is_told_by_the_name_of_the_output(
    tmp_path: Path, new: New, named: bool
) -> None:
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


def test_other_failures_keep_the_names_they_have(tmp_path: Path) -> None:
    with pytest.raises(OSError, match="refused") as refused, new_folder(tmp_path / "out"):
        raise ConnectionRefusedError(errno.ECONNREFUSED, "refused")
    assert refused.value.filename is None
    with pytest.raises(FileNotFoundError) as missing, new_folder(tmp_path / "out"):
        (tmp_path / "nothing").read_text()
    assert missing.value.filename == str(tmp_path / "nothing")
