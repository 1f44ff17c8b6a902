"""Renders by Cycles: what leaves for the renderer, what is kept, and, where it is, what comes back.

Tests that render need a Python with bpy (`make cycles-env`, or PBRFIT_CYCLES_PYTHON) and skip
without.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from cycles_sphere import FOV, relative_rmse, render_sphere, under, where_met
from evaluation_tasks import normals_off
from pbrfit import InputError, Scene
from pbrfit.kernel import render, sh_basis, shade, view_directions
from pbrfit.model.reflection import MODELS
from pbrfit.synthetic import World, draw, random_lights
from pbrfit.synthetic.geometry import trace
from pbrfit.synthetic.surfaces import Paint
from pbrfit_evaluation.cycles import (
    CyclesError,
    CyclesNotFoundError,
    Light,
    Transport,
    job,
    process,
    render_scene,
    why_not,
)
from pbrfit_evaluation.cycles.export import export
from pbrfit_evaluation.cycles.job import Job, basis_polynomials, rendered
from pbrfit_evaluation.cycles.scene import inner_pixels, random_point_lights
from scene_files import known, lights_of, truth_of

SIZE = 24
REPOSITORY = Path(__file__).resolve().parents[2]


def world(kind: str = "room", seed: int = 1) -> World:
    return draw(kind, np.random.default_rng(seed))


def test_polynomials_are_the_sh_basis() -> None:
    d = np.random.default_rng(0).normal(size=(100, 3))
    d /= np.linalg.norm(d, axis=-1, keepdims=True)
    found = [
        sum(factor * np.prod(d ** np.array(powers), axis=-1) for factor, powers in terms)
        for terms in basis_polynomials()
    ]
    np.testing.assert_allclose(np.stack(found, axis=-1), sh_basis(d), atol=1e-14)


@pytest.mark.parametrize("kind", ["room", "spheres", "furnished"])
def test_triangles_lie_on_the_surfaces_that_rays_meet(kind: str) -> None:
    of = world(kind)
    stage = export(of, SIZE, 60.0)
    for i, mesh in enumerate(stage.meshes):
        toward = mesh.vertices[np.linalg.norm(mesh.vertices, axis=-1) > 0.1]
        distance = np.linalg.norm(toward, axis=-1)
        hits = trace([of.primitives[i]], of.eye, toward / distance[:, None] @ of.turn.T)
        met = np.isfinite(hits.distance)
        # A ray to a vertex meets the primitive there, or before it if it is on the far side.
        assert np.all(hits.distance[met] <= distance[met] * (1 + 1e-9) + 1e-9)
        front = met & (hits.distance > distance * (1 - 1e-6))
        assert front.sum() >= 0.15 * len(distance)


GOOD = """
import json, sys, numpy as np
from pathlib import Path
folder = Path(sys.argv[1])
job = json.loads((folder / "job.json").read_text())
n = job["size"]
k = len(job["light"].get("basis") or job["light"]["positions"])
(folder.parent / "runs.txt").open("a").write("run\\n")
radiance = np.ones((k, n, n, 3), np.float32)
flat, normals = np.full((n, n), 0.5, np.float32), np.zeros((n, n, 3), np.float32)
normals[..., 2] = 1
np.save(folder / "radiance.npy", radiance)
np.savez(folder / "truth.npz", albedo=0.5 * radiance[0], roughness=flat, metallic=flat,
         normals=normals, positions=-2 * normals, segments=np.ones((n, n), np.uint16))
(folder / "outcome.json").write_text('{"cpu_seconds": 3}')
"""
"""A worker that renders nothing stands in for bpy."""

Fake = Callable[[str], None]


@pytest.fixture
def fake_worker(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Fake:
    """Install a source text as the worker, to be run by our own Python."""
    monkeypatch.setenv(process.VARIABLE, sys.executable)
    monkeypatch.setattr(job, "blender_version", lambda _: "0.0.0")

    def install(source: str) -> None:
        path = tmp_path / "worker.py"
        path.write_text(source, encoding="utf-8")
        monkeypatch.setattr(job, "WORKER", path)
        monkeypatch.setattr(process, "WORKER", path)

    return install


def small_job() -> Job:
    return Job(export(world(), 8, 60.0), None, "full", samples=4)


def test_a_render_is_kept_and_used_again(fake_worker: Fake, tmp_path: Path) -> None:
    fake_worker(GOOD)
    cache = tmp_path / "deep" / "cache"
    first = rendered(small_job(), cache=cache)
    again = rendered(small_job(), cache=cache, threads=1)
    assert (cache / "runs.txt").read_text() == "run\n"
    np.testing.assert_array_equal(first.radiance, again.radiance)
    assert first.radiance.shape == (16, 8, 8, 3)
    assert again.cpu_seconds == 3
    [kept] = [path for path in cache.iterdir() if path.is_dir()]
    assert {path.name for path in kept.iterdir()} == {
        "job.json", "log.txt", "outcome.json", "radiance.npy", "truth.npz",
    }  # fmt: skip


def test_the_key_depends_on_all_that_matters(fake_worker: Fake) -> None:
    fake_worker(GOOD)
    same, key = small_job(), small_job().key("5.0.1")
    assert same.key("5.0.1") == key
    of = world()
    other_eye = replace(of, eye=of.eye + np.array([0.0, 1e-6, 0.0]))
    painted = replace(of, surfaces=(*of.surfaces[1:], of.surfaces[0]))
    others = [
        replace(same, samples=5),
        replace(same, seed=1),
        replace(same, transport="shadows"),
        replace(same, specular=0.0),
        replace(same, distribution="GGX"),
        replace(same, positions=np.zeros((1, 3))),
        replace(same, stage=export(of, 9, 60.0)),
        replace(same, stage=export(of, 8, 50.0)),
        replace(same, stage=export(other_eye, 8, 60.0)),
        replace(same, stage=export(painted, 8, 60.0)),
    ]
    keys = {key, same.key("5.0.2"), *(other.key("5.0.1") for other in others)}
    fake_worker(GOOD + "#")
    keys.add(same.key("5.0.1"))
    assert len(keys) == len(others) + 3


@pytest.mark.parametrize(
    ("source", "message"),
    [
        ("print('rendering'); raise ValueError('no such node')", "exit code 1; .*no such node$"),
        ("import os; print('tile 3', flush=True); os.abort()", "signal 6; its last line: tile 3$"),
        ("pass", "expected radiance.npy from the renderer, found none$"),
        (
            GOOD.replace("np.ones((k", "np.nan * np.ones((k"),
            "finite radiance, found NaN or infinity$",
        ),
        ("import time; print('slow', flush=True); time.sleep(60)", "stopped after 1 s; .*: slow$"),
    ],
    ids=["error", "crash", "silent", "not finite", "too slow"],
)
def test_a_failure_says_why_and_leaves_nothing(
    fake_worker: Fake, tmp_path: Path, source: str, message: str
) -> None:
    if "signal" in message and sys.platform == "win32":
        pytest.skip("no signals")
    fake_worker(source)
    cache = tmp_path / "cache"
    with pytest.raises(CyclesError, match=message):
        rendered(small_job(), cache=cache, timeout=1 if "time" in source else 60)
    assert not [path for path in tmp_path.glob("cache/*") if path.name != "runs.txt"]


@pytest.mark.parametrize("light", ["panorama", "points"])
def test_a_scene_from_renders(fake_worker: Fake, tmp_path: Path, light: Light) -> None:
    fake_worker(GOOD)
    cache = tmp_path / "cache"
    scene = render_scene(world(), 8, light=light, lights=3, held_out=2, cache=cache)
    assert scene.images.shape == (3, 8, 8, 3)
    assert scene.images.mean() == pytest.approx(0.4)
    truth = truth_of(scene)
    np.testing.assert_array_equal(truth.materials.albedo, 0.5)
    np.testing.assert_array_equal(scene.depth, np.full((8, 8), 2, np.float32))
    if light == "points":
        assert truth.lighting is None
        assert truth.relight_images is None
    else:
        expected = lights_of(scene).sum(axis=1)  # radiance 1 under each basis function
        np.testing.assert_allclose(scene.images, np.tile(expected[:, None, None], (1, 8, 8, 1)))
        ours = random_lights(3, np.random.default_rng(np.random.SeedSequence(0).spawn(4)[1]))
        ratio = lights_of(scene) / ours
        np.testing.assert_allclose(ratio, np.broadcast_to(ratio[:, :1, :1], ratio.shape))
    scene.save(tmp_path / "scene")
    assert Scene.load(tmp_path / "scene").truth is not None


def test_without_bpy_there_is_a_reason(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv(process.VARIABLE, raising=False)
    assert "no .venv-cycles in" in (why_not() or "")
    assert "make cycles-env" in (why_not() or "")
    with pytest.raises(CyclesNotFoundError, match="cycles-env"):
        render_scene(world(), 8, cache=tmp_path / "cache")
    monkeypatch.setenv(process.VARIABLE, str(tmp_path / "nowhere"))
    assert "which is no file" in (why_not() or "")
    monkeypatch.setenv(process.VARIABLE, sys.executable)
    assert "No module named" in (why_not() or "")
    assert not (tmp_path / "cache").exists()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"light": "sun"}, "^light: expected one of panorama, points, found 'sun'"),
        ({"transport": "all"}, "^transport: expected one of brdf, shadows, full, found 'all'"),
        ({"lights": 0}, "^lights, held_out: expected 1 or more, found 0 and 16"),
        ({"samples": 0}, "^samples: expected a number from 1, found 0"),
        ({"seed": -1}, "^seed: expected a non-negative integer, found -1"),
        ({"fov": 180.0}, "^fov: expected degrees between 0 and 180, found 180"),
        ({"size": 0}, "^size: expected at least 1 pixel, found 0"),
    ],
)
def test_arguments_out_of_range(options: dict[str, object], message: str) -> None:
    with pytest.raises(InputError, match=message):
        render_scene(world(), **options)  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def bpy_cache(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Empty cache folder; skips where Cycles cannot run."""
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(REPOSITORY)
        reason = why_not()
    if reason is not None:
        pytest.skip(reason)
    return tmp_path_factory.mktemp("cycles")


@pytest.fixture(autouse=True)
def _beside_the_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(REPOSITORY)


def sphere_errors(
    size: int, samples: int, cache: Path | None, threads: int = 2
) -> dict[str, float]:
    """Relative RMSE of spheres whose pictures are known exactly; three of them are white.

    A sphere sees every direction, so a light with all 16 coefficients leaves no reflection or turn
    of an axis unnoticed.

    - "diffuse": radiance is the irradiance over π, Σ A_l L_lm Y_lm(n) / π, with the clamped
      cosine's A = π, 2π/3, π/4, 0.
    - "metal", polished: it mirrors, radiance is L(2 (n·v) n - v), in all four bands.
    - "point light", diffuse: radiance is cos θ / d² in `Rendered`'s unit.
    - "mirrored": the smallest error of the first two if the light is mirrored in x, y or z.
    - by model: plastic, where what remains is a difference of models and not an error.
    - "normals": the largest angle between Cycles' normals and the sphere's, in degrees.
    """
    lights = random_lights(4, np.random.default_rng(0))
    white = Paint(np.ones(3), roughness=1.0, metallic=0.0)
    chrome = Paint(np.ones(3), roughness=0.05, metallic=1.0)  # spreads by half a degree
    plastic = Paint(np.array([0.6, 0.3, 0.1]), roughness=0.5, metallic=0.0)
    lamp = np.array([1.5, 1.0, -0.5])
    picture = partial(render_sphere, size=size, cache=cache, threads=threads)
    diffuse = picture(white, samples=samples, specular=0.0)
    seen = inner_pixels(diffuse.segments, diffuse.normals, FOV)
    views = view_directions(size, size, FOV)[seen]
    normals, points = where_met(views)
    mirror = 2 * np.einsum("pi,pi->p", normals, views)[:, None] * normals - views
    bands = np.repeat([np.pi, 2 * np.pi / 3, np.pi / 4, 0.0], [1, 3, 5, 7])
    expected = {"diffuse": sh_basis(normals) * bands / np.pi, "metal": sh_basis(mirror)}
    pictures = {"diffuse": diffuse, "metal": picture(chrome, samples=samples)}
    found = {name: under(of, lights)[:, seen] for name, of in pictures.items()}
    errors = {name: relative_rmse(found[name], of @ lights) for name, of in expected.items()}
    # Y(±x, ±y, ±z): a mirrored axis changes the sign of some basis functions and of no other.
    probe = np.array([[0.36, 0.48, 0.8]])
    errors["mirrored"] = min(
        relative_rmse(found[name], of * sh_basis(probe * (1 - 2 * axis)) / sh_basis(probe) @ lights)
        for name, of in expected.items()
        for axis in np.eye(3)
    )
    towards = lamp - points
    distance = np.linalg.norm(towards, axis=-1)
    radiance = np.maximum(np.einsum("pi,pi->p", normals, towards), 0.0) / distance**3
    lit = picture(white, samples=1, specular=0.0, lamp=lamp).radiance[0][seen][:, 0]
    errors["point light"] = relative_rmse(lit, radiance)
    rendered_plastic = under(picture(plastic, samples=samples), lights)[:, seen]
    material = (plastic.albedo, plastic.roughness, plastic.metallic)
    for model in MODELS:
        weights = shade(normals, views, *material, model=model)
        closed = np.einsum("pck,nkc->npc", weights, lights)
        errors[model] = relative_rmse(closed, rendered_plastic)
    cosines = np.einsum("pi,pi->p", diffuse.normals[seen], normals)
    errors["normals"] = float(np.degrees(np.arccos(np.minimum(cosines, 1.0)).max()))
    return errors


def test_spheres_are_as_light_and_material_demand(bpy_cache: Path) -> None:
    found = sphere_errors(24, 128, bpy_cache)
    assert found["diffuse"] < 0.004
    assert found["metal"] < 0.004
    assert found["point light"] < 0.002
    assert found["mirrored"] > 0.2
    assert found["principled"] < found["paper"] < 0.05
    assert found["normals"] < 0.1


def truth_errors(of: World, size: int, cache: Path | None, threads: int = 2) -> dict[str, float]:
    """Cycles' maps against those of our own rays, away from edges.

    Largest differences of the materials; the root mean square angle of the normals in degrees; the
    shares of all pixels whose object is another ("segments") and that are away from edges
    ("pixels").
    """
    job = Job(export(of, size, FOV), None, "brdf", samples=1)
    found = rendered(job, cache=cache, threads=threads)
    ours = of.cast(size, FOV)
    inner = inner_pixels(found.segments, found.normals, FOV)
    cosines = np.einsum("pi,pi->p", found.normals[inner], ours.normals[inner])
    angles = np.degrees(np.arccos(np.minimum(cosines, 1.0)))
    errors = {
        name: float(np.abs(getattr(found, name) - getattr(ours.materials, name))[inner].max())
        for name in ("albedo", "roughness", "metallic")
    }
    return errors | {
        "normals": float(np.sqrt(np.mean(angles**2))),
        "segments": float(np.mean(found.segments != ours.segments)),
        "pixels": float(np.mean(inner)),
    }


def test_maps_are_those_of_our_own_rays(bpy_cache: Path) -> None:
    found = truth_errors(world("detailed"), 48, bpy_cache)
    assert found["normals"] < 0.05
    assert max(found["albedo"], found["roughness"], found["metallic"]) < 1e-6
    assert found["segments"] < 0.005
    assert found["pixels"] > 0.5


def test_depth_is_that_of_our_own_rays(bpy_cache: Path) -> None:
    of = world("furnished")
    scene = render_scene(of, 48, FOV, lights=2, held_out=1, samples=1, cache=bpy_cache)
    depth = known(scene.depth)
    assert np.isfinite(depth).all()  # a room is all around
    views = scene.views
    hits = trace(of.primitives, of.eye, -views.reshape(-1, 3) @ of.turn.T)
    ours = hits.distance.reshape(48, 48) * views[..., 2]
    # Facets are within 3e-4 radii of what is round.
    np.testing.assert_allclose(depth[scene.valid], ours[scene.valid], rtol=1e-3)
    assert normals_off(depth, scene.normals, FOV, scene.valid) < 0.01


def test_pictures_come_close_to_the_models_only_without_shadows(bpy_cache: Path) -> None:
    error = {}
    picture = partial(
        render_scene, world("textured"), SIZE, lights=4, held_out=1, samples=32, cache=bpy_cache
    )
    transports: tuple[Transport, ...] = ("brdf", "full")
    for transport in transports:
        scene = picture(transport=transport)
        of = scene.valid
        for model in MODELS:
            given = truth_of(scene).materials, scene.normals, lights_of(scene), scene.fov
            ours = render(*given, model=model)
            error[model, transport] = relative_rmse(ours[:, of], scene.images[:, of])
    assert 0 < error["principled", "brdf"] < error["paper", "brdf"] < 0.15
    for model in MODELS:
        assert error[model, "full"] > 2 * error[model, "brdf"]


def test_shadows_of_point_lights_only_take_light_away(bpy_cache: Path) -> None:
    of = world()
    stage = export(of, SIZE, 60.0)
    places, _ = random_point_lights(stage, of.walls, 3, np.random.default_rng(0))
    jobs = [Job(stage, places, transport, samples=1) for transport in ("brdf", "shadows")]
    lit, shadowed = (rendered(j, cache=bpy_cache).radiance for j in jobs)
    differ: NDArray[np.bool_] = np.abs(lit - shadowed).max(axis=-1) > 1e-5 * lit.max()
    assert np.all(shadowed[differ] < 1e-6)  # a point light is seen or not
    assert 0.01 < differ.mean() < 0.7
