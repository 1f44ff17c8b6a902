"""Scenes handed to dask: schedulers and workers are processes of their own on this machine."""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest

from pbrfit._core import InputError
from pbrfit.batch.cluster import Cluster, _checked
from pbrfit.batch.driver import Attempt, drive
from pbrfit.cli import main
from pbrfit.synthetic import make_scene
from processes import until

pytestmark = pytest.mark.filterwarnings("default")  # those of dask are its own

SCENES = 6
FEW = ("--iterations", "30", "--refine-normals", "off")


def started(*arguments: object, **how: Any) -> subprocess.Popen[str]:
    command = [sys.executable, "-m", *map(str, arguments)]
    return subprocess.Popen(command, text=True, **how)


class Machines:
    """A scheduler and workers; what is still there at the end is killed."""

    def __init__(self, folder: Path, stack: ExitStack) -> None:
        self._folder, self._stack = folder, stack
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            self.address = f"tcp://127.0.0.1:{free.getsockname()[1]}"
        self.workers: list[subprocess.Popen[str]] = []
        self.scheduler = self._keep(
            "distributed.cli.dask_scheduler",
            *("--host", "127.0.0.1", "--port", self.address.rpartition(":")[2]),
            "--no-dashboard",
        )

    def add_worker(self, threads: int = 1) -> None:
        self.workers.append(
            self._keep(
                "distributed.cli.dask_worker",
                *(self.address, "--nthreads", threads, "--no-nanny", "--no-dashboard"),
                *("--local-directory", self._folder / f"worker{len(self.workers)}"),
            )
        )

    def _keep(self, *arguments: object) -> subprocess.Popen[str]:
        with (self._folder / "machines.log").open("a") as log:
            process = started(*arguments, stdout=log, stderr=log, cwd="/")

        def end() -> None:
            process.kill()
            process.wait()

        self._stack.callback(end)
        return process


@pytest.fixture
def machines(tmp_path: Path) -> Iterator[Machines]:
    with ExitStack() as stack:
        yield Machines(tmp_path, stack)


@pytest.fixture(scope="module")
def scenes(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("scenes")
    for seed in range(SCENES):
        make_scene("room", size=24, lights=5, seed=seed).save(folder / f"raum ä {seed}")
    return folder


@pytest.fixture(scope="module")
def alone(scenes: Path) -> Path:
    """Results of this process."""
    out = scenes.parent / f"{scenes.name}-alone"
    assert main(["decompose", str(scenes), "--out", str(out), *FEW, "--quiet"]) == 0
    return out


def assert_equal(out: Path, expected: Path) -> None:
    names = sorted(path.name for path in expected.iterdir())
    assert sorted(path.name for path in out.iterdir()) == names
    for name in names:
        for file in ("materials.exr", "lighting.json"):
            assert (out / name / file).read_bytes() == (expected / name / file).read_bytes(), name


def batch(scenes: Path, out: Path, *arguments: object) -> subprocess.Popen[str]:
    """A batch that tells of each scene on its stdout."""
    return started(
        *("pbrfit", "decompose", scenes, "--out", out, *arguments, "--json"),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        # A shell gives processes in the background SIGINT ignored, which would be inherited.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )


def finished(run: subprocess.Popen[str], code: int = 0) -> tuple[str, str]:
    """What a batch says on stdout and on stderr until it ends."""
    told, errors = run.communicate(timeout=900)
    assert run.returncode == code, errors
    return told, errors


def test_a_worker_killed_in_the_middle_changes_no_result(
    scenes: Path, alone: Path, machines: Machines, tmp_path: Path
) -> None:
    machines.add_worker()
    machines.add_worker()
    out = tmp_path / "out"
    run = batch(scenes, out, *FEW, "--cluster", machines.address)
    assert run.stdout is not None
    first = json.loads(run.stdout.readline())
    os.kill(machines.workers[0].pid, signal.SIGKILL)
    told, _ = finished(run)
    found = [first, *map(json.loads, told.splitlines())]
    assert sorted(Path(line["scene"]).name for line in found) == sorted(
        path.name for path in scenes.iterdir()
    )
    assert {line["status"] for line in found} == {"done"}
    assert_equal(out, alone)
    assert machines.workers[0].wait() == -signal.SIGKILL


def test_workers_that_come_later_are_used(
    scenes: Path, alone: Path, machines: Machines, tmp_path: Path
) -> None:
    machines.add_worker()
    run = batch(scenes, tmp_path / "out", *FEW, "--cluster", machines.address)
    assert run.stdout is not None
    run.stdout.readline()
    machines.add_worker()
    os.kill(machines.workers[0].pid, signal.SIGKILL)  # then the second has to do the rest
    finished(run)
    assert_equal(tmp_path / "out", alone)


def test_a_single_scene_and_what_was_finished(
    scenes: Path, alone: Path, machines: Machines, tmp_path: Path
) -> None:
    machines.add_worker(threads=2)
    name = "raum ä 0"
    arguments = (*FEW, "--cluster", machines.address, "--resume")
    for status in ("done", "kept"):
        run = batch(scenes / name, tmp_path / "out" / name, *arguments)
        told, errors = finished(run)
        assert errors == ""
        assert json.loads(told)["status"] == status
    assert [path.name for path in (tmp_path / "out").iterdir()] == [name]
    first = (tmp_path / "out" / name / "materials.exr").read_bytes()
    assert first == (alone / name / "materials.exr").read_bytes()


def test_a_failing_scene_is_told_of_with_its_warnings(machines: Machines, tmp_path: Path) -> None:
    machines.add_worker()
    for name in ("one", "two"):
        make_scene("room", size=12, lights=3).save(tmp_path / "scenes" / name)
    (tmp_path / "scenes" / "one" / "normals.png").touch()
    (tmp_path / "scenes" / "two" / "Mask.tif").touch()
    run = batch(tmp_path / "scenes", tmp_path / "out", *FEW, "--cluster", machines.address)
    told, errors = finished(run, 1)
    status = {Path(one["scene"]).name: one["status"] for one in map(json.loads, told.splitlines())}
    assert status == {"one": "failed", "two": "done"}
    assert f"pbrfit: {tmp_path / 'scenes' / 'one'}: expected normals.exr" in errors
    assert "WARNING" in errors
    assert "Mask.tif: not read" in errors
    assert errors.splitlines()[-1].startswith("pbrfit: 1 of 2 scenes failed")


def test_workers_give_up_what_nobody_waits_for(
    scenes: Path, machines: Machines, tmp_path: Path
) -> None:
    """Ctrl-C ends the batch at once, and its workers see to it soon."""
    from distributed import Client

    machines.add_worker()
    out = tmp_path / "out"
    endless = ("--solver", "lbfgsb", "--iterations", 10**8, "--time-limit", 600)
    run = batch(scenes, out, *endless, "--cluster", machines.address)
    with Client(machines.address, set_as_default=False) as client:
        until(lambda: any((out / ".pbrfit").glob("*/")) and any(client.processing().values()))
        run.send_signal(signal.SIGINT)
        _, errors = run.communicate(timeout=30)
        assert run.returncode == 130
        assert "interrupted after 0 of 6 scenes" in errors
        assert not out.exists()
        until(
            lambda: (
                not any(client.run(lambda dask_worker: len(dask_worker.state.executing)).values())
            )
        )
    assert not out.exists()


def test_a_scheduler_that_goes_ends_the_batch_in_one_line(
    scenes: Path, machines: Machines, tmp_path: Path
) -> None:
    machines.add_worker()
    run = batch(scenes, tmp_path / "out", *FEW, "--quiet", "--cluster", machines.address)
    assert run.stdout is not None
    run.stdout.readline()
    machines.scheduler.kill()
    _, errors = finished(run, 1)
    lines = [line for line in errors.splitlines() if line.startswith("pbrfit: ")]
    assert len(lines) == 1
    assert "expected the scheduler to stay, found it gone; --resume goes on" in lines[0]
    assert not (tmp_path / "out" / ".pbrfit").exists()


@pytest.mark.parametrize(
    ("address", "expected"),
    [
        ("", "a worker that answers within 10 s"),  # a scheduler without workers
        ("tcp://127.0.0.1:9", "a dask scheduler that answers within 10 s"),
        ("what:is:this", "a dask scheduler"),
    ],
)
def test_nobody_who_works_is_one_line(
    scenes: Path, tmp_path: Path, request: pytest.FixtureRequest, address: str, expected: str
) -> None:
    address = address or request.getfixturevalue("machines").address
    run = batch(scenes, tmp_path / "out", "--cluster", address)
    told, errors = finished(run, 2)
    assert told == ""
    assert errors.startswith(f"pbrfit: --cluster {address}: expected {expected}")
    assert errors.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_workers_of_another_version_do_nothing() -> None:
    with pytest.raises(InputError, match=r"expected pbrfit 0\.0\.0 on all workers, found"):
        _checked("0.0.0", print, "never")


def _die_or_not(task: int, threads: int) -> int:
    if task == 1:
        os._exit(7)
    return 10 * task + threads


def test_whose_worker_dies_fails_alone() -> None:
    import dask
    from distributed import LocalCluster

    found: dict[int, Attempt[int]] = {}

    def keep(task: int, attempt: Attempt[int]) -> None:
        found[task] = attempt

    with (
        dask.config.set({"distributed.scheduler.allowed-failures": 0}),
        LocalCluster(2, threads_per_worker=1, dashboard_address=None) as workers,
    ):
        drive([1, 2, 3], _die_or_not, Cluster(workers.scheduler_address), ended=keep)
    assert found[1].error == "its process died"
    assert {task: one.value for task, one in found.items() if task != 1} == {2: 21, 3: 31}


def test_a_suite_on_a_cluster_finds_what_it_finds_alone(machines: Machines, tmp_path: Path) -> None:
    machines.add_worker()
    machines.add_worker()
    figures = {}
    quick = ("--quick", "--scenes", "1", "--size", "16", "--rows", "base", "--quiet")
    for name, where in (("alone", ("--jobs", "1")), ("far", ("--cluster", machines.address))):
        out = str(tmp_path / name)
        run = started("pbrfit", "evaluate", "table1", "--out", out, *quick, *where)
        assert run.wait(timeout=900) == 0
        rows = json.loads((tmp_path / name / "summary.json").read_text("utf-8"))["rows"]
        figures[name] = [
            {key: value for key, value in row["metrics"].items() if "seconds" not in key}
            for row in rows
        ]
    assert figures["far"] == figures["alone"]
