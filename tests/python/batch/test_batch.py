"""Many scenes at once: in processes, resumed, on one output at a time, told as JSON."""

from __future__ import annotations

import importlib.util
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from command_runs import done, ran, refused
from evaluation_tasks import Task, work
from pbrfit import Scene
from pbrfit.batch import place, scenes
from pbrfit.batch.driver import Attempt, drive
from pbrfit.batch.executors import Processes
from pbrfit.batch.prediction import of_scene
from pbrfit.batch.scenes import SceneTask, decompose_scene
from pbrfit.batch.unchanged import kept
from pbrfit.fit import memory
from pbrfit.fit.parameters import ParameterLayout
from pbrfit.io import images
from pbrfit.io.weight_files import write_weights
from pbrfit.model.lighting import Lighting
from pbrfit.result.options import FitOptions, Priors
from pbrfit.result.result import FILES, RESULT_FOLDER, Result
from pbrfit.scene.options import ReadOptions
from pbrfit.synthetic import make_scene
from processes import alive, until, waiting_at
from scene_files import FORMATS, SIZE, known, lights_of, run, write_folder

FEW = ("--iterations", 0, "--no-report")

NAMES = ("one", "two", "drei ä 面")


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Scenes of which the second differs from the others."""
    for name in NAMES:
        write_folder(tmp_path / "scenes" / name)
    (tmp_path / "scenes" / "two" / "images" / "light_02.exr").unlink()
    return tmp_path / "scenes"


def told(text: str) -> dict[str, dict[str, Any]]:
    """The lines of JSON, by the scene's name."""
    return {Path(line["scene"]).name: line for line in map(json.loads, text.splitlines())}


def statuses(text: str) -> dict[str, str]:
    return {name: line["status"] for name, line in told(text).items()}


def marks(out: Path) -> dict[str, tuple[int, int]]:
    """By which it shows whether a result was written again."""
    return {
        path.parent.name: (path.stat().st_ino, path.stat().st_mtime_ns)
        for path in out.glob("*/result.json")
    }


@pytest.mark.skipif(sys.platform != "linux", reason="file systems there refuse such names")
def test_names_that_are_no_utf_8_come_back_as_they_were(tmp_path: Path) -> None:
    names = [os.fsdecode(b"bad \xff\xfe"), "new\nline", "-dash", "%s {x}"]
    for name in names:
        write_folder(tmp_path / "scenes" / name)
    arguments = ("decompose", tmp_path / "scenes", "--out", tmp_path / "o o", *FEW, "--resume")
    for status in ("done", "kept"):
        assert statuses(done(*arguments, "--json")) == dict.fromkeys(names, status)
    source = known(Result.load(tmp_path / "o o" / names[0]).source)
    assert source.path == tmp_path / "scenes" / names[0]


def test_processes_give_the_same_bits_as_one_after_the_other(folder: Path, tmp_path: Path) -> None:
    for out, how in (("alone", ()), ("pool", ("--jobs", 2))):
        done("decompose", folder, "--out", tmp_path / out, *FEW, *how)
        assert sorted(path.name for path in (tmp_path / out).iterdir()) == sorted(NAMES)
    for name in NAMES:
        source = known(Result.load(tmp_path / "pool" / name).source)
        assert source.path == folder / name
        for file in ("materials.exr", "lighting.json"):
            found = (tmp_path / out / name / file for out in ("alone", "pool"))
            assert next(found).read_bytes() == next(found).read_bytes(), (name, file)


def test_a_failing_scene_stops_no_process_and_is_told_of(
    folder: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    (folder / "one" / "normals.png").touch()
    shutil.rmtree(folder / "two")
    (folder / "drei ä 面" / "Mask.tif").touch()
    given, out = [folder / name for name in NAMES], tmp_path / "out"
    found = ran("decompose", *given, "--out", out, *FEW, "--jobs", 3, "--json")
    by_name = told(found.out)
    assert found.code == 1
    assert {name: one["status"] for name, one in by_name.items()} == {
        "one": "failed",
        "two": "failed",
        "drei ä 面": "done",
    }
    expected = f"{folder / 'one'}: expected normals.exr or normals.png"
    assert by_name["one"]["error"].startswith(expected)
    gone = f"{folder / 'two'}: expected a scene folder, found nothing of that name"
    assert by_name["two"]["error"] == gone
    whole = by_name["drei ä 面"]
    assert whole["error"] is None
    assert whole["metrics"]["recon_rmse"] > 0
    assert whole["stop_reason"]
    assert whole["output"] == str(out / "drei ä 面")
    last = found.err.splitlines()[-1]
    assert last.startswith("pbrfit: 2 of 3 scenes failed: ")
    assert all(str(folder / name) in last for name in ("one", "two"))
    assert f"pbrfit: {expected}" in found.err
    # Warnings come out of the process, and nothing else does.
    [record] = caplog.records
    assert f"{folder / 'drei ä 面' / 'Mask.tif'}: not read" in record.message
    assert record.levelname == "WARNING"
    assert [path.name for path in out.iterdir()] == ["drei ä 面"]


@pytest.mark.slow
@pytest.mark.parametrize("signal_number", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupted_batch_leaves_whole_results_and_no_process(
    folder: Path, tmp_path: Path, signal_number: int
) -> None:
    """One scene waits for ever for its mask."""
    out = tmp_path / "out"
    assert run("decompose", folder / "one", folder / "two", "--out", out, *FEW, "--quiet") == 0
    shutil.rmtree(out / "two")
    images.write_png(folder / "two" / "mask.png", np.full((SIZE, SIZE), 255, np.uint8), None)
    arguments = ["decompose", folder, "--out", out, *FEW, "--jobs", 2, "--resume", "--json"]
    batch = subprocess.Popen(
        [sys.executable, "-m", "pbrfit", *map(str, arguments)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        env=waiting_at("two/mask.png", tmp_path / "waiting"),
    )
    ended = [json.loads(known(batch.stdout).readline())["status"] for _ in range(2)]
    assert sorted(ended) == ["done", "kept"]
    children = Path(f"/proc/{batch.pid}/task/{batch.pid}/children")
    workers = [int(one) for one in children.read_text().split()] if children.exists() else []
    os.killpg(batch.pid, signal_number)  # as a terminal does: all of them
    _, errors = batch.communicate(timeout=60)
    assert batch.returncode == 128 + signal_number
    if signal_number == signal.SIGINT:
        assert errors.endswith(  # after lines of progress, where it took long
            "pbrfit: interrupted after 2 of 3 scenes; no unfinished result was left behind; "
            "--resume goes on from there\n"
        )
    until(lambda: not any(alive(worker) for worker in workers))
    assert sorted(path.name for path in out.iterdir()) == sorted(set(NAMES) - {"two"})


@pytest.mark.parametrize("act", ["no pickle", "no pickle raised"])
def test_what_no_process_can_send_fails_its_task_alone(tmp_path: Path, act: str) -> None:
    tasks = [Task("a", tmp_path, act), Task("b", tmp_path), Task("c", tmp_path)]
    found: dict[str, Attempt[Any]] = {}

    def keep(task: Task, one: Attempt[Any]) -> None:
        found[task.key] = one

    drive(tasks, work, Processes(2), ended=keep)
    assert {key: one.error is None for key, one in found.items()} == {
        "a": False,
        "b": True,
        "c": True,
    }
    words = "TypeError: cannot pickle" if act == "no pickle" else "StrangeError: as it is"
    assert str(found["a"].error).startswith(words)


def test_a_cluster_needs_dask(folder: Path, tmp_path: Path) -> None:
    if importlib.util.find_spec("distributed") is not None:
        pytest.skip("it is there; tests/cluster uses it")
    line = refused("decompose", folder, "--out", tmp_path / "out", "--cluster", "tcp://head:8786")
    assert line.startswith("pbrfit: --cluster: expected dask.distributed, found ")
    assert line.endswith("pip install 'pbrfit[cluster]' gets it\n")
    assert line.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_what_is_finished_is_kept_and_the_rest_is_done(folder: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    arguments = ("decompose", folder, "--out", out, *FEW, "--resume", "--json")
    assert statuses(done(*arguments)) == dict.fromkeys(NAMES, "done")
    before = marks(out)
    shutil.rmtree(out / "one")
    said = done(*arguments, "--threads", 1, "--quiet")
    assert statuses(said) == {"one": "done", "two": "kept", "drei ä 面": "kept"}
    after = marks(out)
    assert after.pop("one") != before.pop("one")
    assert after == before
    stored = json.loads((out / "two" / "result.json").read_text("utf-8"))
    two = told(said)["two"]
    assert {key: two[key] for key in ("metrics", "stop_reason")}.items() <= stored.items()


def test_a_single_scene_is_kept_too(folder: Path, tmp_path: Path) -> None:
    arguments = ("decompose", folder / "one", "--out", tmp_path / "out", *FEW, "--resume")
    before = done(*arguments)
    kept, _, *said = done(*arguments).splitlines()
    assert kept == f"{tmp_path / 'out'}: kept, nothing has changed"
    verdicts = [line for line in said if "expected error" in line]
    assert [line.split()[1] for line in verdicts] == ["albedo:", "roughness:", "metallic:"]
    steps = [line for line in said if line.startswith(("next: ", "also: "))]
    assert all(line in before for line in said if line not in steps)
    # The causes are those of its verdicts; why that fit ended is no longer told.
    assert steps[0][len("next: ") :] in before
    assert statuses(done(*arguments, "--json", "--sh-order", 2)) == {"one": "done"}


def test_resuming_replaces_only_results(folder: Path, tmp_path: Path) -> None:
    command = ("decompose", folder, "--out", tmp_path / "out", *FEW, "--resume")
    (tmp_path / "out" / "two").mkdir(parents=True)
    (tmp_path / "out" / "two" / "thesis.txt").write_text("three years")
    assert "expected an earlier output to replace" in refused(*command)
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["two"]
    both = "pbrfit: expected --resume or --overwrite, found both\n"
    assert refused(*command, "--overwrite") == both


READING = ReadOptions(fov=60.0)
OPTIONS = FitOptions(iterations=1, refine_normals="off")


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A scene folder with everything that can be in one, and its result beside."""
    folder = tmp_path_factory.mktemp("whole")
    scene = make_scene("room", size=SIZE, lights=4, held_out=2)
    mask = np.ones((SIZE, SIZE), bool)
    mask[3] = False
    weights = np.linspace(1, 2, scene.images[..., 0].size).reshape(scene.images.shape[:3])
    replace(scene, mask=mask, weights=weights.astype(np.float32)).save(folder / "scene")
    write_weights(folder / "scene" / "weights.exr", weights.astype(np.float32), scene.names)
    Lighting(scene.names, lights_of(scene)).save(folder / "scene" / "lighting.json")
    decompose_scene(SceneTask(folder / "scene", folder / "out", READING, OPTIONS), 0)
    return folder


@pytest.fixture
def result(whole: Path, tmp_path: Path) -> Path:
    shutil.copytree(whole, tmp_path / "copy")
    return tmp_path / "copy"


def changed(file: Path, change: Callable[[Any], object]) -> None:
    """Write a JSON file again after a change of its content."""
    content = json.loads(file.read_text("utf-8"))
    change(content)
    file.write_text(json.dumps(content), "utf-8")


def is_kept(folder: Path, reading: ReadOptions = READING, options: FitOptions = OPTIONS) -> bool:
    return kept(folder / "out", folder / "scene", reading, options) is not None


FILES_OF_A_SCENE = (
    *("images/light_01.exr", "mask.png", "normals.exr", "weights.exr", "segments.png"),
    *("lighting.json", "scene.toml", "truth/materials.exr", "truth/lighting.json"),
    *("truth/relight/lighting.json", "truth/relight/relight_00.exr"),
)


@pytest.mark.parametrize("name", FILES_OF_A_SCENE)
@pytest.mark.parametrize("what", ["changed", "gone", "came"])
def test_a_scene_that_changed_is_done_again(result: Path, name: str, what: str) -> None:
    path = result / "scene" / name
    if what == "changed":
        content = bytearray(path.read_bytes())
        content[len(content) // 2] ^= 1
        path.write_bytes(content)
    elif what == "gone":
        path.unlink()
    else:  # as of a result that was made before the part was there
        changed(result / "out" / "result.json", lambda content: content["inputs"].pop(name))
    assert not is_kept(result)


OTHERWISE: dict[str, Any] = {
    "solver": "lbfgsb",
    "iterations": 2,
    "time_limit": 9.0,
    "sh_order": 2,
    "metallic": 0.0,
    "mono_light": True,
    "priors": Priors.none(),
    "robust": "none",
    "equal_exposures": True,
    "refine_normals": "on",
}


def test_read_or_fitted_in_another_way_is_done_again(whole: Path) -> None:
    assert is_kept(whole)
    for reading in (
        ReadOptions(fov=61.0),
        ReadOptions(fov=None),  # the folder says another one
        ReadOptions(fov=60.0, color_space="linear"),
        ReadOptions(fov=60.0, max_size=SIZE),  # it is of this size, but others may come
        ReadOptions(fov=60.0, code_range=(0, 255)),
    ):
        assert not is_kept(whole, reading), reading
    for name, value in OTHERWISE.items():
        assert not is_kept(whole, options=replace(OPTIONS, **{name: value})), name


@pytest.mark.parametrize("name", [*FILES, "result.json"])
@pytest.mark.parametrize("what", ["cut", "gone"])
def test_a_result_that_is_not_whole_is_made_again(result: Path, name: str, what: str) -> None:
    path = result / "out" / name
    content = path.read_bytes()
    path.unlink()
    if what == "cut":
        path.write_bytes(content[:-9])
    assert not is_kept(result)


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("version", "0.0.1"),
        ("held_out", {"error": "small"}),
        ("metrics", {"recon_rmse": "low"}),
        ("transport", {"kind": "none", "why": "", "extents": {}, "figures": {}}),
        *((key, None) for key in ("files", "scene", "inputs", "options", "uncertainty")),
        *((key, None) for key in ("status", "stop_reason", "left_out", "assumed", "stages")),
    ],
)
def test_a_damaged_or_outdated_result_is_made_again(result: Path, key: str, value: Any) -> None:
    file = result / "out" / "result.json"
    changed(file, lambda content: content.update({key: value}))
    assert not is_kept(result)
    for strange in ("[]", "3", "", "{}", '{"version": 1'):
        file.write_text(strange, "utf-8")
        assert not is_kept(result)


def test_two_batches_do_not_write_to_one_place(folder: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    with place.of_batch(out) as temporaries:
        (temporaries / "0123456789ab").mkdir()
        assert refused("decompose", folder, "--out", out, *FEW, "--resume") == (
            f"pbrfit: {out}: expected no other batch that writes there, found one at work\n"
        )
        assert (temporaries / "0123456789ab").is_dir()
    assert not out.exists()
    assert run("decompose", folder, "--out", out, *FEW, "--quiet") == 0


def test_a_scene_that_is_no_longer_wanted_is_given_up(folder: Path, tmp_path: Path) -> None:
    """Workers of a cluster outlive the batch; what they wait for is the folder it removes."""
    temporaries = tmp_path / "out" / ".pbrfit"
    temporaries.mkdir(parents=True)
    told = 0

    def show(_: object) -> None:
        nonlocal told
        told += 1
        time.sleep(0.001)  # a thousand of them take longer than it takes to look
        if told == 1:
            shutil.rmtree(temporaries)
        if told > 1000:
            raise AssertionError("it went on")

    task = SceneTask(
        folder / "one",
        tmp_path / "out" / "one",
        ReadOptions(),
        FitOptions(iterations=10**6, refine_normals="off", solver="lbfgsb"),
        temporaries=temporaries,
    )
    with pytest.raises(OSError, match="which a running batch has and all its workers see"):
        decompose_scene(replace(task), 0, show)
    assert not (tmp_path / "out" / "one").exists()


def as_it_is(_: Path) -> None:
    pass


def of_grey(folder: Path) -> None:
    for path in (folder / "images").iterdir():
        plane = images.read_channels(path)["G"]
        images.write_exr(path, dict.fromkeys("RGB", plane))


def half_masked(folder: Path) -> None:
    mask = np.zeros((SIZE, SIZE), np.uint8)
    mask[: SIZE // 2] = 255
    images.write_png(folder / "mask.png", mask, tag=None)


@pytest.mark.parametrize("spoil", [as_it_is, of_grey, half_masked])
@pytest.mark.parametrize("form", FORMATS)
@pytest.mark.parametrize("max_size", [None, 9])
def test_memory_is_predicted_as_inspect_does(
    tmp_path: Path, spoil: Callable[[Path], None], form: str, max_size: int | None
) -> None:
    if form != "float EXR" and spoil is of_grey:
        pytest.skip("one format tells it")
    folder = write_folder(tmp_path / "scene", form)
    spoil(folder)
    scene = Scene.load(folder, max_size=max_size)
    layout = ParameterLayout.of(scene)
    held = memory.bytes_of(scene)
    told = memory.of_fit(layout, "gauss-newton", held=held, refine_normals=True).peak
    predicted = of_scene(folder, ReadOptions(max_size=max_size), FitOptions()).peak
    reading = 48 * SIZE * SIZE
    if spoil is as_it_is and form == "float EXR":
        assert told <= predicted <= max(1.02 * told, reading)
    else:
        assert told <= predicted


def test_scenes_wait_for_memory(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """More processes than there is room for: then they are not all used at once."""
    needed = scenes.memory_of(SceneTask(folder / "one", tmp_path, ReadOptions(), FitOptions()), 1)
    assert needed > scenes.LIBRARIES_BYTES
    monkeypatch.setattr(memory, "available", lambda: 0)
    arguments = ("decompose", folder, "--out", tmp_path / "out", *FEW, "--quiet", "--jobs", 3)
    assert run(*arguments) == 0
    assert all((tmp_path / "out" / name / RESULT_FOLDER.contains[0]).exists() for name in NAMES)
    seconds = [
        (path.stat().st_mtime - Result.load(path.parent).seconds, path.stat().st_mtime)
        for path in (tmp_path / "out").glob("*/result.json")
    ]
    seconds.sort()
    assert all(end <= begin for (_, end), (begin, _) in pairwise(seconds))
