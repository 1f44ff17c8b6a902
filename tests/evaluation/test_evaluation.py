"""What suites share: records, folders, the report, recipes and scores."""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import pbrfit
from evaluation_tasks import Task, work
from pbrfit import InputError, Materials, Result, Scene
from pbrfit.synthetic import make_scene
from pbrfit_evaluation import jobs, recipes, scores
from pbrfit_evaluation.jobs import Record
from processes import alive, until
from scene_files import known, lights_of, truth_of


def attempts(folder: Path) -> dict[str, int]:
    return {p.stem: len(p.read_text("utf-8").splitlines()) for p in folder.glob("*.trace")}


@pytest.mark.parametrize("at_once", [1, 2])
def test_one_failure_does_not_stop_the_others(tmp_path: Path, at_once: int) -> None:
    tasks = [Task("a", tmp_path), Task("b", tmp_path, "raise"), Task("c", tmp_path)]
    told: list[Record] = []
    records = jobs.run(tasks, work, tmp_path, jobs=at_once, progress=told.append)
    assert [record.key for record in records] == ["a", "b", "c"]
    assert [record.error for record in records] == [None, "ValueError: two lines", None]
    threads = max(1, (os.cpu_count() or 1) // at_once)
    assert records[2].values == {"name": "c", "threads": threads}
    assert sorted(record.key for record in told) == ["a", "b", "c"]
    kept = sorted(p.name for p in (tmp_path / "records").iterdir())
    assert kept == ["a.json", "b.json", "c.json"]


def test_a_worker_that_dies_is_tried_once_more(tmp_path: Path) -> None:
    tasks = [Task("bad", tmp_path, "die"), *(Task(f"good{i}", tmp_path) for i in range(3))]
    records = jobs.run(tasks, work, tmp_path, jobs=2)
    assert [record.error for record in records] == ["its process died", None, None, None]
    assert attempts(tmp_path)["bad"] == 2


def test_workers_end_when_their_parent_is_killed(tmp_path: Path) -> None:
    program = (
        "import sys; from pathlib import Path; from evaluation_tasks import Task, work\n"
        "from pbrfit_evaluation.jobs import run\n"
        "if __name__ == '__main__':\n"
        "    folder = Path(sys.argv[1])\n"
        "    run([Task(key, folder, 'last') for key in 'ab'], work, folder, jobs=2)\n"
    )
    file = tmp_path / "program.py"
    file.write_text(program, "utf-8")
    path = os.pathsep.join([str(Path(__file__).parent), *sys.path])
    parent = subprocess.Popen(
        [sys.executable, str(file), str(tmp_path)], env={**os.environ, "PYTHONPATH": path}
    )
    try:
        until(lambda: len(attempts(tmp_path)) == 2 and all(attempts(tmp_path).values()))
    finally:
        parent.kill()
        parent.wait()
    workers = [int(trace.read_text("utf-8")) for trace in tmp_path.glob("*.trace")]
    until(lambda: not any(alive(worker) for worker in workers))


def test_finished_tasks_are_not_done_again(tmp_path: Path) -> None:
    tasks = [Task("a", tmp_path), Task("b", tmp_path, "raise")]
    first = jobs.run(tasks, work, tmp_path)
    again = jobs.run([*tasks, Task("c", tmp_path)], work, tmp_path)
    assert again[0] == first[0]
    assert attempts(tmp_path) == {"a": 1, "b": 2, "c": 1}  # a failure is tried again


def test_another_task_or_other_code_of_that_name_is_done_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    jobs.run([Task("a", tmp_path)], work, tmp_path)
    jobs.run([Task("a", tmp_path, "very well")], work, tmp_path)
    assert attempts(tmp_path) == {"a": 2}
    monkeypatch.setattr(jobs, "_code", lambda: "newer")
    jobs.run([Task("a", tmp_path, "very well")], work, tmp_path)
    assert attempts(tmp_path) == {"a": 3}
    record = tmp_path / "records" / "a.json"
    record.write_text(record.read_text("utf-8")[:40], "utf-8")
    jobs.run([Task("a", tmp_path, "very well")], work, tmp_path)
    assert attempts(tmp_path) == {"a": 4}  # a broken record is none


def test_an_interrupted_run_keeps_what_is_done(tmp_path: Path) -> None:
    tasks = [Task("a", tmp_path), Task("b", tmp_path, "interrupt"), Task("c", tmp_path)]
    with pytest.raises(KeyboardInterrupt):
        jobs.run(tasks, work, tmp_path)
    assert [p.name for p in (tmp_path / "records").iterdir()] == ["a.json"]
    jobs.run([tasks[0], Task("b", tmp_path), tasks[2]], work, tmp_path)
    assert attempts(tmp_path) == {"a": 1, "b": 2, "c": 1}


def test_folder_of_a_suite(tmp_path: Path) -> None:
    out = tmp_path / "a" / "out"
    jobs.prepare(out, resume=False, overwrite=False)
    jobs.run([Task("x", tmp_path)], work, out)
    (out / "summary.json").write_text("{}", "utf-8")
    with pytest.raises(FileExistsError, match="expected a folder that does not exist yet"):
        jobs.prepare(out, resume=False, overwrite=False)
    jobs.prepare(out, resume=True, overwrite=False)
    assert [path.name for path in out.iterdir()] == ["records"]  # it is not whole any more
    assert (out / "records" / "x.json").exists()
    jobs.prepare(out, resume=False, overwrite=True)
    assert list((out / "records").iterdir()) == []


@pytest.mark.parametrize(("resume", "overwrite"), [(True, False), (False, True), (True, True)])
@pytest.mark.parametrize("name", ["records/song.json", "records/blue.mp3", "thesis.txt", "a.jpg"])
def test_what_is_somebody_else_s_is_left_alone(
    tmp_path: Path, name: str, resume: bool, overwrite: bool
) -> None:
    if name != "a.jpg":
        (tmp_path / "records").mkdir()
    (tmp_path / name).write_text('{"title": "x"}', "utf-8")
    with pytest.raises(FileExistsError, match=r"suite, found|without records|exist yet"):
        jobs.prepare(tmp_path, resume=resume, overwrite=overwrite)
    assert (tmp_path / name).exists()


def test_what_is_not_a_suite_s_is_left_alone(tmp_path: Path) -> None:
    out = tmp_path / "out"
    jobs.prepare(out, resume=False, overwrite=False)
    jobs.run([Task("x", tmp_path)], work, out)
    link = tmp_path / "link"
    link.symlink_to(out, target_is_directory=True)
    with pytest.raises(FileExistsError, match=r"link: expected a folder or nothing, found a link"):
        jobs.prepare(link, resume=False, overwrite=True)
    (out / "report.html").write_text("old", "utf-8")
    (out / "notes.txt").write_text("mine", "utf-8")
    with pytest.raises(FileExistsError, match=r"out: .*, found notes\.txt besides"):
        jobs.prepare(out, resume=False, overwrite=True)
    assert (out / "records" / "x.json").exists()


def test_report_is_whole_or_marked_by_the_lack_of_a_summary(tmp_path: Path) -> None:
    jobs.prepare(tmp_path / "out", resume=False, overwrite=False)
    with jobs.publish(tmp_path / "out") as folder:
        (folder / "summary.json").write_text("1", "utf-8")
        (folder / "pictures").mkdir()
    with jobs.publish(tmp_path / "out") as folder:
        (folder / "summary.json").write_text("2", "utf-8")
        (folder / "pictures").mkdir()
        (folder / "pictures" / "new.png").write_bytes(b"")
    names = sorted(path.name for path in (tmp_path / "out").iterdir())
    assert names == ["pictures", "records", "summary.json"]
    assert (tmp_path / "out" / "summary.json").read_text("utf-8") == "2"
    assert (tmp_path / "out" / "pictures" / "new.png").exists()
    with pytest.raises(RuntimeError), jobs.publish(tmp_path / "out"):
        raise RuntimeError
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == ["pictures", "records"]


@pytest.fixture(scope="module")
def scene() -> Scene:
    return make_scene("room", size=16, lights=5, held_out=3, seed=2)


def at_the_truth(scene: Scene, iterations: int) -> Result:
    start = truth_of(scene).materials, lights_of(scene)
    return pbrfit.decompose(scene, start=start, iterations=iterations, priors=None)


def test_scores_of_known_errors(scene: Scene) -> None:
    """Albedo twice the truth under half the light."""
    true = truth_of(scene).materials
    wrong = Materials(0.5 * true.albedo, true.roughness + 0.125, 0.25 + 0.5 * true.metallic)
    found = scores.score(replace(at_the_truth(scene, 0), materials=wrong), scene)
    assert found["albedo"] == pytest.approx(0.5 * np.sqrt(np.mean(np.square(true.albedo))))
    assert known(found["albedo_scaled"]) <= 1e-12
    assert found["roughness"] == pytest.approx(0.125)
    assert found["metallic"] == pytest.approx(np.sqrt(np.mean((0.25 - 0.5 * true.metallic) ** 2)))
    assert known(found["relight"]) > known(found["relight_scaled"]) > 0


def test_pixels_outside_the_mask_never_enter(scene: Scene) -> None:
    mask = np.ones(scene.valid.shape, dtype=bool)
    mask[:, :9] = False
    ruined = scene.images.copy()
    ruined[:, :, :9] = np.nan
    masked = replace(scene, mask=mask, images=ruined)
    found = scores.score(at_the_truth(masked, 0), masked)
    assert max(known(found[name]) for name in ("recon", *scores.MAPS)) <= 1e-12
    assert known(found["relight"]) <= 1e-12


def test_constant_guess_and_paper_start_by_hand(scene: Scene) -> None:
    guess, true = recipes.constant_guess(scene), truth_of(scene).materials
    np.testing.assert_allclose(guess.albedo[3, 4], true.albedo.mean(axis=(0, 1)), rtol=1e-12)
    assert np.all(guess.roughness == 0.5)
    assert np.all(guess.metallic == 0.0)
    start = recipes.paper_start(scene)
    mean = scene.images.mean(axis=0)
    np.testing.assert_allclose(start.albedo, np.clip(mean * 0.4 / mean.mean(), 0, 1), rtol=1e-6)
    assert np.all(start.metallic == 0.1)
    with pytest.raises(InputError, match="expected ground truth"):
        recipes.constant_guess(replace(scene, truth=None))


def test_ways(scene: Scene) -> None:
    ways = (recipes.DEFAULT, recipes.PAPER, recipes.PAPER_REGULARIZED, recipes.GUESS)
    found = [way.explain(scene, iterations=5, sh_order=2, refine_normals="on") for way in ways]
    steps = [result.history.iterations for result in found]
    assert 0 < steps[0] <= 5  # it may need fewer
    assert steps[1:] == [5, 5, 0]
    for result in found:
        assert np.all(result.lighting[:, 9:] == 0)
    assert np.ptp(found[-1].albedo, axis=(0, 1)).max() == 0
    # The paper's recipe and guesses hold normals whatever is asked for.
    assert [result.refinement.asked for result in found] == ["on", "off", "off", "off"]
    assert recipes.DEFAULT.explain(scene, iterations=0).refinement.asked == "off"
