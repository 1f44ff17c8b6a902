"""What goes wrong around a batch: its exit code, the one line, and that nothing else is lost."""

from __future__ import annotations

import os
import resource
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from batches import (
    DYING,
    content,
    ended,
    environment,
    faults_of,
    make_versions,
    mark,
    of_session,
    put_version,
    seconds_until,
    started,
    statuses,
    tiled_scene,
)
from processes import ROOT, as_nobody_special, closed, waiting_at

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="made for Linux")

NEEDS_ROOT = pytest.mark.skipif(not ROOT, reason="mounts a file system, which takes root")

COUNT = 6
OPTIONS = ("--iterations", 60, "--quiet")

NO_PLACE = "expected a place where a folder can be made, found: "


@pytest.fixture(scope="module")
def versions(tmp_path_factory: pytest.TempPathFactory) -> list[list[Path]]:
    return make_versions(tmp_path_factory.mktemp("versions"), COUNT, 2)


@pytest.fixture
def scenes(tmp_path: Path, versions: list[list[Path]]) -> Path:
    for number, row in enumerate(versions):
        put_version(tmp_path / "scenes" / f"s{number}", row[0])
    return tmp_path / "scenes"


NAMES = [f"s{number}" for number in range(COUNT)]


def arguments(scenes: Path, out: Path, *more: object, jobs: int = 2) -> list[object]:
    return ["decompose", scenes, "--out", out, *OPTIONS, "--jobs", jobs, *more]


def names(out: Path) -> list[str]:
    """All that is there; the results among it are whole."""
    found = sorted(path.name for path in out.iterdir()) if out.exists() else []
    assert [fault for name in found if name in NAMES for fault in faults_of(out / name)] == []
    return found


def contents(out: Path) -> dict[str, Any]:
    return {name: (content(out / name), mark(out / name)) for name in names(out)}


@contextmanager
def disk(path: Path, size: str) -> Iterator[Callable[[str], None]]:
    """A file system in memory; what is given can change its options."""
    path.mkdir()
    subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={size}", "disk", path], check=True)

    def remount(how: str) -> None:
        subprocess.run(["mount", "-o", f"remount,{how}", path], check=True)

    try:
        yield remount
    finally:
        subprocess.run(["umount", path], check=True)


def size_of(folder: Path) -> int:
    """Bytes in blocks of 4 KiB."""
    return sum(-(-p.stat().st_size // 4096) * 4096 + 4096 for p in folder.rglob("*") if p.is_file())


@NEEDS_ROOT
@pytest.mark.parametrize("jobs", [1, 2])
def test_a_disk_that_fills_up_costs_the_scenes_that_found_no_room(
    scenes: Path, tmp_path: Path, jobs: int
) -> None:
    assert ended(arguments(scenes, tmp_path / "whole"))[0] == 0
    a_result = size_of(tmp_path / "whole" / "s0")
    with disk(tmp_path / "disk", f"{int(3.5 * a_result / 1024)}k") as remount:
        out = tmp_path / "disk" / "out"
        code, _, errors = ended(arguments(scenes, out, jobs=jobs))
        lines = errors.splitlines()
        there = names(out)
        assert code == 1
        assert 1 <= len(there) < COUNT
        failed = [name for name in NAMES if name not in there]
        assert sorted(lines[:-1]) == [
            f"pbrfit: {out / name}: No space left on device" for name in failed
        ]
        assert lines[-1].startswith(f"pbrfit: {len(failed)} of {COUNT} scenes failed: ")
        before = contents(out)
        # Some of those that are there are to be replaced: what they had stays.
        code, _, errors = ended(arguments(scenes, out, "--overwrite", jobs=jobs))
        assert code in (1, 2)
        assert set(before) <= set(names(out))
        assert all(content(out / name) == what for name, (what, _) in before.items())
        # With room again it goes on.
        before = contents(out)
        remount("size=20m")
        code, told, errors = ended(arguments(scenes, out, "--resume", "--json", jobs=jobs))
        assert (code, errors) == (0, "")
        kept = {name for name, status in statuses(told) if status == "kept"}
        assert kept == set(before)
        after = contents(out)
        assert list(after) == NAMES
        assert all(after[name] == what for name, what in before.items())


def test_an_output_that_may_not_be_written_is_one_line_before_the_work(
    scenes: Path, tmp_path: Path
) -> None:
    (tmp_path / "out").mkdir()
    out = closed(tmp_path / "out")
    out.chmod(0o555)
    found = as_nobody_special(arguments(scenes, out))
    assert found == (2, "", f"pbrfit: {out}: {NO_PLACE}Permission denied\n")
    assert list(out.iterdir()) == []


def test_a_worker_that_dies_once_costs_nothing(scenes: Path, tmp_path: Path) -> None:
    died = tmp_path / "died"
    how = environment(
        tmp_path, DIE_AT=3, DIE_WHO="worker", DIE_UNDER=tmp_path / "out", DIE_ONCE=died
    )
    found = ended(arguments(scenes, tmp_path / "out"), program=[DYING], env=how)
    assert found == (0, "", "")
    assert died.exists()
    assert names(tmp_path / "out") == NAMES


def test_a_scene_whose_worker_dies_again_and_again_fails_alone(
    scenes: Path, tmp_path: Path
) -> None:
    waits = tmp_path / "waits"
    batch = started(
        arguments(scenes, tmp_path / "out", "--json"),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        env=waiting_at("s3/normals.exr", waits),
    )

    def waiting() -> list[int]:
        """Workers that wait before the normals of that scene."""
        return [one for one in of_session(batch.pid) if (waits / str(one)).exists()]

    seconds_until(lambda: bool(waiting()))
    [first] = waiting()
    os.kill(first, signal.SIGKILL)
    seconds_until(lambda: waiting() not in ([], [first]))
    [second] = waiting()
    os.kill(second, signal.SIGKILL)
    told, errors = batch.communicate(timeout=100)
    assert batch.returncode == 1
    assert errors == (
        f"pbrfit: {scenes / 's3'}: its process died\n"
        f"pbrfit: 1 of 6 scenes failed: {scenes / 's3'}\n"
    )
    assert sorted(statuses(told)) == [
        (name, "failed" if name == "s3" else "done") for name in NAMES
    ]
    assert names(tmp_path / "out") == [name for name in NAMES if name != "s3"]


def test_a_worker_that_gets_no_memory_costs_its_scene_alone(scenes: Path, tmp_path: Path) -> None:
    tiled_scene(scenes / "large", 1200, 4, tile=100)
    limit = 1100 * 2**20
    code, told, errors = ended(
        arguments(scenes, tmp_path / "out", "--json"),
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_AS, (limit, limit)),
        env=environment(tmp_path, OPENBLAS_NUM_THREADS=1),
    )
    assert code == 1
    first, last = errors.splitlines()
    assert first.startswith(f"pbrfit: {scenes / 'large'}: ")
    assert "memory" in first  # whichever step found too little
    assert last == f"pbrfit: 1 of 7 scenes failed: {scenes / 'large'}"
    assert dict(statuses(told)) == {**dict.fromkeys(NAMES, "done"), "large": "failed"}
    assert names(tmp_path / "out") == NAMES


def stopped_batch(scenes: Path, out: Path, least: int) -> None:
    """A batch that is told to end as soon as so many results are there, but not all."""
    batch = started(arguments(scenes, out), stderr=subprocess.PIPE)
    seconds_until(lambda: len(list(out.glob("s*"))) >= least)
    batch.send_signal(signal.SIGTERM)
    batch.communicate(timeout=60)
    assert batch.returncode == 128 + signal.SIGTERM


def test_what_changed_while_a_batch_was_stopped_is_done_again(
    scenes: Path, tmp_path: Path, versions: list[list[Path]]
) -> None:
    out = tmp_path / "out"
    stopped_batch(scenes, out, 3)
    before = contents(out)
    assert 3 <= len(before) < COUNT
    changed, damaged, emptied, *_ = before
    put_version(scenes / changed, versions[NAMES.index(changed)][1])
    flipped = bytearray((out / damaged / "materials.exr").read_bytes())
    flipped[len(flipped) // 2] ^= 1
    (out / damaged / "materials.exr").write_bytes(flipped)
    os.truncate(out / emptied / "result.json", 0)
    code, told, errors = ended(arguments(scenes, out, "--resume", "--json"))
    assert (code, errors) == (0, "")
    again = {changed, damaged, emptied}
    assert sorted(statuses(told)) == [
        (name, "kept" if name in set(before) - again else "done") for name in NAMES
    ]
    undisturbed = tmp_path / "undisturbed"
    assert ended(arguments(scenes, undisturbed))[0] == 0
    after = contents(out)
    for name in NAMES:
        assert after[name][0] == content(undisturbed / name)
        if name in set(before) - again:
            assert after[name] == before[name]
