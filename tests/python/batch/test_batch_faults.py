"""What a batch loses when something goes wrong at the worst moment: nothing.

Faults that take whole batches of processes are in `tests/reliability/`.
"""

from __future__ import annotations

import json
import multiprocessing
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from contextlib import AbstractContextManager
from multiprocessing import util
from pathlib import Path

import pytest

from command_runs import ran
from pbrfit.batch import heartbeat, place
from pbrfit.batch.executors import Processes
from pbrfit.result.result import RESULT_FOLDER
from processes import NOBODY, ROOT, alive, as_nobody_special, closed, until
from scene_files import write_folder

FEW = ("--iterations", 0, "--no-report")


def result_folder(path: Path, word: str) -> Path:
    """What looks like a result."""
    path.mkdir(parents=True)
    for name in RESULT_FOLDER.contains:
        (path / name).write_text(word)
    return path


def names(folder: Path) -> set[str]:
    """What is in it."""
    return {path.name for path in folder.iterdir()}


def set_aside(temporaries: Path, result: Path) -> None:
    """As a worker leaves it that is killed between the two renames of `new_folder`."""
    (temporaries / "123456789abc").mkdir()
    (temporaries / "123456789abc" / "result.json").write_text("new")
    (temporaries / "123456789abc-old").mkdir()
    result.rename(temporaries / "123456789abc-old" / result.name)


@pytest.mark.parametrize("of", [place.of_batch, place.of_one])
@pytest.mark.parametrize("there", ["old", "new"])
def test_a_worker_that_ends_between_two_renames_loses_no_result(
    tmp_path: Path, of: Callable[[Path], AbstractContextManager[Path]], there: str
) -> None:
    """Told to end, a batch kills its workers whatever they are doing."""
    out = tmp_path / "out"
    old = result_folder(out / "one" if of == place.of_batch else out, "old")
    with of(out) as temporaries:
        set_aside(temporaries, old)
        if there == "new":  # then nothing is put back
            result_folder(old, "new")
    assert [path.name for path in old.parent.iterdir()] == [old.name]
    assert (old / "result.json").read_text() == there


def test_what_cannot_be_put_back_stays_for_the_next_batch(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    old = result_folder(tmp_path / "out" / "one", "old")
    with monkeypatch.context() as patched, place.of_batch(tmp_path / "out") as temporaries:
        set_aside(temporaries, old)

        def rename(*_: object) -> None:
            raise PermissionError

        patched.setattr(Path, "rename", rename)
    assert (temporaries / "123456789abc-old" / "one" / "result.json").read_text() == "old"
    with place.of_batch(tmp_path / "out"):
        assert (old / "result.json").read_text() == "old"
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["one"]


def test_an_ended_batch_leaves_the_next(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Another may begin as soon as the lock is gone, before the folder is."""
    out = tmp_path / "out"
    unlinked = Path.unlink
    began: list[AbstractContextManager[Path]] = []

    def unlink(path: Path, missing_ok: bool = False) -> None:
        unlinked(path, missing_ok)
        if path.name == place.LOCK and not began:
            other = place.of_batch(out)
            began.append(other)
            (other.__enter__() / "0123456789ab").mkdir()

    with monkeypatch.context() as patched:
        patched.setattr(Path, "unlink", unlink)
        with place.of_batch(out):
            pass
    if sys.platform != "win32":  # no flock there
        with pytest.raises(FileExistsError, match="found one at work"), place.of_batch(out):
            pass
    assert (out / place.NAME / "0123456789ab").is_dir()
    began[0].__exit__(None, None, None)
    assert not list(out.iterdir())


POSIX = pytest.mark.skipif(sys.platform == "win32", reason="links need rights there")


@POSIX
def test_a_place_that_is_a_link_is_refused(tmp_path: Path) -> None:
    (tmp_path / "theirs" / "0123456789ab").mkdir(parents=True)
    out = tmp_path / "out"
    out.mkdir()
    (out / place.NAME).symlink_to(tmp_path / "theirs")
    expected = r"\.pbrfit: expected the folder of a batch or nothing, found a link to .*theirs$"
    with pytest.raises(FileExistsError, match=expected), place.of_batch(out):
        pass
    assert (tmp_path / "theirs" / "0123456789ab").is_dir()
    assert names(out) == {place.NAME}


@POSIX
@pytest.mark.parametrize("kind", ["pipe", "link", "folder"])
def test_a_lock_that_is_no_file_is_refused(tmp_path: Path, kind: str) -> None:
    lock = tmp_path / "out" / place.NAME / place.LOCK
    lock.parent.mkdir(parents=True)
    victim = tmp_path / "victim"
    victim.write_text("theirs")
    {"pipe": os.mkfifo, "link": lambda at: at.symlink_to(victim), "folder": Path.mkdir}[kind](lock)
    expected = rf"lock: expected a file or nothing, found a {kind}"
    with pytest.raises(FileExistsError, match=expected), place.of_batch(tmp_path / "out"):
        pass
    assert os.path.lexists(lock)
    assert victim.read_text() == "theirs"


@POSIX
def test_only_what_batches_make_is_removed_from_their_place(tmp_path: Path) -> None:
    held = tmp_path / "out" / place.NAME
    theirs = tmp_path / "theirs"
    result_folder(theirs / "one", "theirs")
    for name in ("mine", "x-old", "0123456789AB", "0123456789abc"):
        (held / name).mkdir(parents=True)
        (held / name / "notes.txt").write_text("mine")
    (held / "0123456789ab").write_text("a file of that name")
    (held / "abcdef012345").symlink_to(theirs)
    (held / "abcdef012345-old").symlink_to(theirs)
    before = names(held)
    (held / "fedcba987654" / "half").mkdir(parents=True)
    (held / "fedcba987654-ended").mkdir()
    with place.of_batch(tmp_path / "out") as temporaries:
        assert names(temporaries) == {*before, place.LOCK}
    assert names(held) == before
    assert (held / "mine" / "notes.txt").read_text() == "mine"
    assert (theirs / "one" / "result.json").read_text() == "theirs"
    assert names(tmp_path / "out") == {place.NAME}


@POSIX
@pytest.mark.skipif(not ROOT, reason="gives a folder to somebody else, which takes root")
def test_the_place_of_somebody_else_is_refused(tmp_path: Path) -> None:
    held = tmp_path / "out" / place.NAME
    (held / "0123456789ab").mkdir(parents=True)
    os.chown(held, NOBODY, NOBODY)
    expected = rf"\.pbrfit: expected your own folder or nothing, found one of user {NOBODY}; "
    with pytest.raises(FileExistsError, match=expected), place.of_batch(tmp_path / "out"):
        pass
    assert (held / "0123456789ab").is_dir()
    os.chown(held.parent, NOBODY, NOBODY)  # whose folder it is may have it there
    with place.of_batch(tmp_path / "out"):
        pass
    assert names(held.parent) == set()


@POSIX
@pytest.mark.parametrize("how", ["--resume", "--overwrite"])
def test_a_result_that_is_a_link_is_refused(tmp_path: Path, how: str) -> None:
    """What it leads to may be anybody's."""
    write_folder(tmp_path / "scenes" / "one")
    out, elsewhere = tmp_path / "out", result_folder(tmp_path / "elsewhere", "old")
    out.mkdir()
    (out / "one").symlink_to(elsewhere)
    found = ran("decompose", tmp_path / "scenes", "--out", out, *FEW, how, "--quiet")
    assert found.code == 2
    assert found.err == (
        f"pbrfit: {out / 'one'}: expected a folder or nothing, found a link to {elsewhere}\n"
    )
    assert (out / "one").is_symlink()
    assert (elsewhere / "result.json").read_text() == "old"


@pytest.mark.parametrize(("how", "one"), [("--resume", True), ("--overwrite", False)])
def test_what_somebody_put_into_a_result_is_not_lost(tmp_path: Path, how: str, one: bool) -> None:
    scenes, out = tmp_path / "scenes", tmp_path / "out"
    for name in ("one", "two"):
        write_folder(scenes / name)
    arguments = ("decompose", scenes, "--out", out, "--quiet", "--no-priors")
    assert ran(*arguments, "--iterations", 0).code == 0
    (out / "one" / "notes.txt").write_text("mine")
    (out / "one" / "renders").mkdir()
    (out / "one" / ".DS_Store").touch()  # of a system: no reason
    (out / "two" / ".DS_Store").touch()
    before = {path.name: (path / "result.json").read_bytes() for path in out.iterdir()}
    assert ran(*arguments, "--iterations", 0, "--resume").code == 0  # results that stay may have it
    if one:
        arguments = (*arguments[:1], scenes / "one", "--out", out / "one", *arguments[4:])
    found = ran(*arguments, "--iterations", 1, how)
    first, *others = found.err.splitlines()
    assert first == (
        f"pbrfit: {out / 'one'}: expected nothing but an earlier output to replace, found "
        "notes.txt, renders besides; move it away first"
    )
    assert others == ([] if one else [f"pbrfit: 1 of 2 scenes failed: {scenes / 'one'}"])
    assert found.code == (2 if one else 1)
    after = {path.name: (path / "result.json").read_bytes() for path in out.iterdir()}
    changed = {name for name in before if before[name] != after[name]}
    assert changed == (set() if one else {"two"})
    assert (out / "one" / "notes.txt").read_text() == "mine"
    assert (out / "one" / "renders").is_dir()


@pytest.mark.skipif(sys.platform == "win32", reason="rights are of another kind there")
def test_scenes_that_may_not_be_read_fail_alone(tmp_path: Path) -> None:
    scenes = tmp_path / "scenes"
    for name in ("one", "three", "two"):
        write_folder(scenes / name)
    (scenes / "lost+found").mkdir()
    closed(scenes / "lost+found")
    picture = closed(scenes / "three" / "images" / "light_00.exr")
    folder = closed(scenes / "two")
    arguments = ["decompose", scenes, "--out", tmp_path / "out", *FEW, "--quiet"]
    code, _, errors = as_nobody_special(arguments)
    for path in (picture, folder):
        path.chmod(0o755)
    assert code == 1
    assert errors == (
        f"pbrfit: {picture}: Permission denied\n"
        f"pbrfit: {folder / 'images'}: Permission denied\n"
        f"pbrfit: 2 of 3 scenes failed: {folder.parent / 'three'}, {folder}\n"
    )
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["one"]


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full")
@pytest.mark.parametrize("how", ["full", "closed"])
def test_a_batch_goes_on_where_nobody_can_be_told_of_a_failure(tmp_path: Path, how: str) -> None:
    """Its messages go to a disk that is full, or nowhere."""
    for name in ("one", "two"):
        write_folder(tmp_path / "scenes" / name)
    (tmp_path / "scenes" / "one" / "normals.png").touch()
    arguments = ["decompose", tmp_path / "scenes", "--out", tmp_path / "out", *FEW, "--json"]
    with Path("/dev/full").open("w") as full:
        found = subprocess.run(
            [sys.executable, "-m", "pbrfit", *map(str, arguments), "--quiet"],
            stdout=subprocess.PIPE,
            stderr=full,
            text=True,
            check=False,
            preexec_fn=(lambda: os.close(2)) if how == "closed" else None,
        )
    assert found.returncode == 1
    assert [json.loads(line)["status"] for line in found.stdout.splitlines()] == ["failed", "done"]
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["two"]


@pytest.mark.skipif(sys.platform == "win32", reason="signals are of another kind there")
def test_a_signal_while_a_worker_starts_waits_until_somebody_knows_of_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Another thread gets it, though this one has blocked it."""
    over = threading.Event()
    other = threading.Thread(target=over.wait)
    other.start()
    processes: list[int] = []
    spawn = util.spawnv_passfds

    def spawn_and_tell(path: bytes, arguments: list[bytes], files: list[int]) -> int:
        process: int = spawn(path, arguments, files)
        if any(b"spawn_main" in os.fsencode(one) for one in arguments):
            processes.append(process)
            signal.pthread_kill(other.ident or 0, signal.SIGINT)
            for _ in range(100):
                time.sleep(0.001)  # here Python would raise
        return process

    monkeypatch.setattr(util, "spawnv_passfds", spawn_and_tell)
    workers = Processes(2)
    pool = workers.start()
    before = signal.signal(signal.SIGINT, signal.default_int_handler)  # ignored in background jobs
    try:
        with pytest.raises(KeyboardInterrupt):
            pool.submit(os.getpid)
    finally:
        signal.signal(signal.SIGINT, before)
        over.set()
    known = [process.pid for process in multiprocessing.active_children()]
    assert len(processes) == 1
    assert set(processes) <= set(known)
    workers.stop()
    until(lambda: not any(alive(process) for process in processes))


def test_time_in_which_the_parent_was_stopped_is_no_silence_of_its_workers(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    now, ended = [0.0], list[int]()
    monkeypatch.setattr(time, "monotonic", lambda: now[0])
    monkeypatch.setattr(os, "kill", lambda process, _: ended.append(process))
    watch = heartbeat.Watch(1, patience=60.0)
    slot = watch.begin()
    watch.rows[:] = [NOBODY, 1]

    def passes(seconds: float) -> set[int | None]:
        now[0] += seconds
        return watch.kill_stalled()

    assert not passes(1.0)
    assert not passes(86400.0)  # Ctrl-Z, and fg on the next day
    assert not any(passes(1.0) for _ in range(49))
    assert not ended
    assert passes(5.0) == {slot}
    assert ended == [NOBODY]
