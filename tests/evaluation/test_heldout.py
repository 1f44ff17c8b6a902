"""Held-out pictures: baselines, sets, figures and command."""

from __future__ import annotations

import json
import math
import shutil
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, get_args

import numpy as np
import pytest
from scipy.io import loadmat, savemat

from evaluation_tasks import recorded
from pbrfit._core import InputError
from pbrfit.io import images
from pbrfit.io.color import encode_srgb
from pbrfit.model.geometry import angles_between, unit
from pbrfit.model.materials import Materials
from pbrfit.scene.correction import Correction
from pbrfit.scene.scene import Scene
from pbrfit.synthetic import make_scene
from pbrfit.values.arrays import Array
from pbrfit_evaluation import recipes
from pbrfit_evaluation.heldout import figures, measure, sources
from pbrfit_evaluation.heldout.baselines import Baseline, explained_by_kept
from pbrfit_evaluation.heldout.light import (
    explained_by,
    relative_error,
)
from pbrfit_evaluation.heldout.measure import Task, split
from pbrfit_evaluation.heldout.sources import SETS, Source
from scene_files import known, run, truth_of

SIZE, LAMPS = 20, 8


def lamps() -> Array:
    """Unit vectors about the view direction, of two slants."""
    angle = 2 * np.pi * np.arange(LAMPS) / LAMPS
    slant = np.radians(np.where(np.arange(LAMPS) % 2, 20.0, 35.0))
    across = [np.sin(slant) * np.cos(angle), np.sin(slant) * np.sin(angle), np.cos(slant)]
    return np.stack(across, axis=-1)


def cap() -> Array:
    """Normals (H, W, 3) of a bump that all lamps reach."""
    y, x = np.indices((SIZE, SIZE)) / (SIZE - 1) * 2 - 1
    return unit(np.stack([0.5 * x, -0.5 * y, np.ones_like(x)], axis=-1))


def matt() -> Array:
    """(N, H, W, 3) radiance of a matt bump under lamps that are not equally strong."""
    albedo = np.random.default_rng(0).uniform(0.2, 0.8, (SIZE, SIZE, 3))
    strengths = np.linspace(0.6, 1.1, LAMPS)[:, None, None]
    shading = strengths * np.einsum("hwi,ni->nhw", cap(), lamps())
    return np.asarray(shading[..., None] * albedo)


def write_set(folder: Path, licence: str, *, linear: bool = False) -> Path:
    """A scene folder of 16-bit pictures of the bump, and what is known of it."""
    (folder / "images").mkdir(parents=True)
    for i, radiance in enumerate(matt()):
        values = radiance if linear else encode_srgb(radiance)
        pixels = np.rint(65535 * values).astype(np.uint16)
        images.write_png(folder / "images" / f"{i}.png", pixels, tag=None)
    said = {"what": "a bump", "licence": licence, "directions": lamps().tolist()}
    (folder / "set.json").write_text(json.dumps(said), encoding="utf-8")
    np.savez(folder / "normals.npz", normals=cap())
    return folder


def stand_in(scene: Scene, **more: Any) -> Any:
    """A result that says the truth of a scene."""
    maps = truth_of(scene).materials
    known = {"albedo": maps.albedo, "roughness": maps.roughness, "metallic": maps.metallic}
    found = {"materials": maps, "normals": scene.normals, "mask": scene.valid, "fov": scene.fov}
    rest = {"model": "paper", "lamps": None, "camera": None, "lighting": np.ones((2, 1, 3))}
    return SimpleNamespace(**{**known, **found, **rest, **more})


@pytest.fixture(scope="module")
def room() -> Scene:
    made = make_scene("room", size=SIZE, lights=5, held_out=1, model="paper")
    return replace(made, images=made.images / (1.2 * made.images.max()))


def test_true_materials_explain_pictures(room: Scene) -> None:
    assert relative_error(explained_by(stand_in(room), room, (1, 4))) < 1e-5
    wrong = stand_in(room, model="principled")
    assert relative_error(explained_by(wrong, room, (1, 4))) > 1e-3
    half = stand_in(room, mask=room.valid & (np.arange(SIZE) < SIZE // 2))
    assert 0.3 < relative_error(explained_by(half, room, (1, 4))) < 1


@pytest.mark.parametrize("linear", [False, True])
def test_matt_pictures_are_explained_however_their_files_are_encoded(
    tmp_path: Path, linear: bool
) -> None:
    [source] = sources.find_sources(write_set(tmp_path / "bump", "MIT", linear=linear))
    found = sources.opened(source, SIZE)
    which = split(LAMPS, folds=4, fold=1)
    errors = {}
    for way in get_args(Baseline):
        scores, normals = explained_by_kept(
            way, found.scene, which.kept, which.held_out, found.lamps
        )
        errors[way] = relative_error(scores)
        if normals is not None:
            assert np.median(angles_between(normals, known(found.normals))) < 0.05
    # Of lamps of two slants l_w is a sum of the squares of l_u and l_v, and 1.
    exact = ("lambert", "lambert-known", "lambert-trimmed", "sum", "ptm")
    assert max(errors[way] for way in exact) < 1e-3
    assert max(errors["hsh"], errors["pca"]) < errors["nearest"] < 0.5


def test_sets_are_found_below_a_folder(tmp_path: Path) -> None:
    write_set(tmp_path / "data" / "photographs" / "open", "MIT")
    write_set(tmp_path / "data" / "photographs" / "closed", "none stated: look at it alone")
    found = sources.find_sources(tmp_path / "data")
    assert [(one.name, one.private) for one in found] == [("closed", True), ("open", False)]
    with pytest.raises(InputError, match="expected different names, found open twice"):
        sources.asked_sources([found[1].folder] * 2, {})
    with pytest.raises(FileNotFoundError, match="expected a folder of pictures, found nothing"):
        sources.find_sources(tmp_path / "nowhere")
    with pytest.raises(InputError, match=r"FOLDER: expected .* PBRFIT_DATA is not set"):
        sources.asked_sources([], {})
    folder = found[1].folder
    (folder / "set.json").write_text('{"directions": [[0, 0, 1]]}', encoding="utf-8")
    with pytest.raises(InputError, match="expected a lamp for each of 8 pictures, found 1"):
        sources.opened(found[1], SIZE)
    (folder / "set.json").write_text("[]", encoding="utf-8")
    with pytest.raises(InputError, match=r"set\.json: expected an object, found list"):
        sources.find_sources(folder)


@pytest.mark.parametrize(
    ("kind", "pictures", "degrees"),
    [
        ("bunny_ps", (12, 25), 0.5),
        ("visiont3lab_shrek", (8,), 15.0),
        ("visiont3lab_ball3", (8,), 15.0),
        ("maxcrous_sphere_color", (25,), 2.0),
        ("mit_multi_illumination", (25,), None),
    ],
)
def test_public_sets_and_their_lamps_are_read(
    shared_data: Path, kind: str, pictures: tuple[int, ...], degrees: float | None
) -> None:
    if not (shared_data / kind).is_dir():
        pytest.skip(f"no {kind} in the shared data")
    found = SETS[kind].find(shared_data / kind)
    assert tuple(source.pictures for source in found) == pictures
    opened = sources.opened(found[0], 40)
    scene = opened.scene
    assert (max(scene.width, scene.height), len(scene.images)) == (40, pictures[0])
    assert scene.normals_known == (degrees is not None) == (opened.lamps is not None)
    if degrees is not None:
        every = tuple(range(pictures[0]))
        _, normals = explained_by_kept("lambert-known", scene, every, (0,), opened.lamps)
        assert np.nanmedian(angles_between(known(normals), scene.normals)) < degrees


def as_published(kind: str, folder: Path) -> Path:
    """The bump as a benchmark publishes its objects, and the folder that is named."""
    strengths = np.linspace(0.6, 1.1, LAMPS)[:, None] * np.ones(3)
    folder = folder / kind
    to = folder / ("cat/Objects" if kind == "Harvard" else "catPNG")
    shutil.copytree(write_set(folder / "made", "MIT", linear=True) / "images", to)
    shutil.rmtree(folder / "made")
    normals = cap() * ([1, -1, -1] if kind == "LUCES" else [1, 1, 1])
    if kind == "Harvard":
        np.savetxt(to.parent / "refined_light.txt", lamps())
    else:
        savemat(to / ("normals.mat" if kind == "LUCES" else "Normal_gt.mat"), {"n": normals})
    if kind == "DiLiGenT":
        (to / "filenames.txt").write_text("".join(f"{i}.png\n" for i in range(LAMPS)))
        np.savetxt(to / "light_directions.txt", lamps())
        np.savetxt(to / "light_intensities.txt", strengths)
    return folder


@pytest.mark.parametrize("kind", ["DiLiGenT", "Harvard", "LUCES"])
def test_objects_of_benchmarks_are_read_as_they_are_published(kind: str, tmp_path: Path) -> None:
    [source] = sources.find_sources(as_published(kind, tmp_path))
    assert (source.name, source.pictures) == ("cat" if kind == "Harvard" else "catPNG", LAMPS)
    found = sources.opened(source, SIZE)
    assert (found.scene.lamps, found.scene.normals_known) == (None, False)
    assert (found.normals is None, found.lamps is None) == (kind == "Harvard", kind == "LUCES")
    if found.normals is not None:
        np.testing.assert_allclose(found.normals, cap(), atol=1e-6)
    if found.lamps is not None:
        np.testing.assert_allclose(found.lamps.places, lamps(), atol=1e-6)
        assert found.lamps.colored == (kind == "DiLiGenT")
    if kind == "DiLiGenT":
        for name, wrong in (("Normal_gt.mat", "an array"), ("light_intensities.txt", "three num")):
            (source.folder / name).write_text("x y z\n" * LAMPS)
            with pytest.raises(InputError, match=f"{name}: expected {wrong}"):
                sources.opened(source, SIZE)
            savemat(source.folder / name, {"n": cap()}, appendmat=False)


def task(source: Source, way: str, fold: int = 0, **more: Any) -> Task:
    return Task(source, way, fold, "", 1, 4, 6, SIZE, **more)


def test_a_fit_is_told_nothing_and_sees_no_held_out_picture(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    [source] = sources.find_sources(write_set(tmp_path / "bump", "MIT"))
    seen: list[tuple[Scene, dict[str, Any]]] = []

    def decompose(scene: Scene, *, threads: int, **options: Any) -> Any:
        seen.append((scene, options))
        ones = np.ones((SIZE, SIZE))
        truth = SimpleNamespace(materials=Materials(np.full((SIZE, SIZE, 3), 0.5), ones, 0 * ones))
        chosen = Correction(threads)  # whatever dataclass
        given = SimpleNamespace(truth=truth, normals=cap(), valid=scene.valid, fov=0.0)
        return stand_in(given, held_out=chosen, assumed={"light": "so"})  # type: ignore[arg-type]

    monkeypatch.setattr(recipes, "decompose", decompose)
    values = json.loads(json.dumps(measure.run(task(source, "default", 1), 1)))
    scene, options = seen[0]
    assert options == {
        "refine_normals": "auto",
        "start": None,
    }  # the default, which suites have to name
    assert scene.names == ("0", "3", "4", "6", "7")  # of six, 1 is held out
    assert (scene.normals_known, scene.lamps, scene.response) == (False, None, "srgb")
    assert [one["name"] for one in values["own"]] == ["1"]
    assert values["lamp"][0]["rmse"] != values["own"][0]["rmse"]
    assert values["normals"]["mean"] < 0.01
    assert values["chosen"]["held_out"]["reference"] == 1
    measure.run(task(source, "directions", keep=3), 1)
    scene = seen.pop()[0]
    assert scene.names == ("0", "3", "7")
    np.testing.assert_allclose(known(scene.lamps).places, lamps()[[0, 3, 7]])
    assert not known(scene.lamps).colored
    measure.run(task(source, "lamps-linear", 1), 1)
    scene, options = seen[1]
    assert (options["light"], scene.response) == ("lamps", None)
    np.testing.assert_allclose(scene.images[0], encode_srgb(matt()[0]), atol=1e-4)


def found(error: float) -> dict[str, Any]:
    chosen = {"light": "lamps", "response": None}
    scores = [{"name": "0", "samples": 4, "rms": 1.0, "rmse": error}]
    return {"own": scores, "lamp": scores, "chosen": chosen, "normals": None, "seconds": 2.0}


def test_regret_is_beside_the_best_of_ours() -> None:
    a, b = (Source(name, Path(name), "scene", 8, name == "b") for name in "ab")
    errors: dict[Source, dict[str, float]] = {
        a: {"default": 0.11, "lamps": 0.10, "paper": 0.2, "lambert": 0.05, "nearest": 0.11},
        b: {"default": 0.2, "lamps": 0.3, "paper": 0.19, "lambert": 0.4, "nearest": 0.1},
    }
    pairs = [(task(of, way), found(e)) for of, ways in errors.items() for way, e in ways.items()]
    results = recorded(*pairs, (task(b, "linear"), "failed"), effort="full")
    assert [one.regret for one in figures.sets(results)] == pytest.approx([1.1, 0.2 / 0.19])
    mean, worst = figures.verdicts(results, None)
    assert mean.value == pytest.approx(math.sqrt(1.1 * 0.2 / 0.19))
    assert (mean.holds, worst.holds, worst.where) == (False, True, "a")
    assert not list(figures.verdicts(recorded(*pairs, effort="quick"), None))
    rows = {(row.name, row.solver): row for row in figures.rows(results)}
    assert rows["a", "default"].metrics["regret"] == pytest.approx(1.1)
    assert (rows["b", "linear"].status, rows["b", "linear"].private) == ("failed", True)
    short = next(iter(figures.sections(results, [])))
    told = {str(line[0]).partition(": ")[2] or line[0]: line[1] for line in short.tables[0].rows}
    assert told["Lambert, rank 3"] == "1 of 2"
    assert told["nearest picture"] == "1 of 2"
    assert [line[1] for line in short.tables[0].rows][2:4] == ["1 of 2", "2 of 2"]


def test_command_reports_resumes_and_keeps_private_sets_out_of_documentation(
    tmp_path: Path,
) -> None:
    data, out, docs = (tmp_path / name for name in ("data", "out", "docs"))
    write_set(data / "sets" / "open", "MIT")
    write_set(data / "sets" / "closed", "none stated")
    docs.mkdir()
    page = docs / "page.md"
    page.write_text("<!-- evidence: heldout/Errors -->\n<!-- /evidence -->\n", encoding="utf-8")
    (tmp_path / "README.md").write_text("", encoding="utf-8")
    said = ("evaluate", "heldout", data, "--out", out, "--quick", "--jobs", 1, "--docs", docs)
    assert run(*said, "--ways", "lambert", "sum") == 0
    summary = json.loads((out / "summary.json").read_text("utf-8"))
    assert {row["name"] for row in summary["rows"]} == {"open", "closed"}
    assert "closed" in (out / "report.html").read_text("utf-8")
    published = page.read_text("utf-8") + (docs / "evidence" / "heldout.json").read_text("utf-8")
    assert "closed" not in published
    assert "| open |" in published
    assert "geometric mean of 2 sets" in published
    record = out / "records" / "open-sum-0.json"
    written = record.stat().st_mtime_ns
    assert run(*said, "--ways", "lambert", "sum", "--resume") == 0
    assert record.stat().st_mtime_ns == written


def test_diligent_writes_normals_and_holds_ways_against_each_other(tmp_path: Path) -> None:
    data, out = as_published("DiLiGenT", tmp_path), tmp_path / "out"
    ways = ("--ways", "lambert-known", "lambert-trimmed", "--pictures", 4, 99, "--mat")
    assert run("evaluate", "diligent", data, "--out", out, "--jobs", 1, "--quick", *ways) == 0
    rows = json.loads((out / "summary.json").read_text("utf-8"))["rows"]
    assert [row["metrics"]["pictures"] for row in rows] == [4, 4, 8, 8]
    assert max(row["metrics"]["mean"] for row in rows) < 0.05
    assert rows[0]["metrics"]["relighting"] < 1e-3
    assert "relighting" not in rows[2]["metrics"]  # all pictures were fitted
    written = loadmat(out / "catPNG-lambert-known.mat")["Normal_est"]
    np.testing.assert_allclose(written, cap(), atol=1e-3)
    assert (out / "errors-catPNG.png").is_file()
