"""One room, damaged to a level and handled in a way: errors of what is found."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from pbrfit.acquire.review import Reviewer
from pbrfit.cli import main
from pbrfit.export.lights import write_lights
from pbrfit.io.json_files import read_json
from pbrfit.io.normal_files import write_normals
from pbrfit.model.materials import Materials
from pbrfit.result import metrics
from pbrfit.result.relighting import relight
from pbrfit.result.result import Result
from pbrfit.result.sheet import displayed
from pbrfit.scene.scene import Scene
from pbrfit.synthetic import make_scene
from pbrfit_evaluation import cycles, map_errors
from pbrfit_evaluation.cycles.blender import rendered_export
from pbrfit_evaluation.depth_errors import estimated
from pbrfit_evaluation.everyday.disturbances import read_back, write_png
from pbrfit_evaluation.generated.stand_ins import (
    KIND,
    OTHER_SEED,
    Array,
    room,
    segments_of,
    stand_ins,
)
from pbrfit_evaluation.generated.ways import NORMALS_OFF, WAYS
from pbrfit_evaluation.grid import Case
from pbrfit_evaluation.jobs import Values
from pbrfit_evaluation.normal_errors import filled
from pbrfit_evaluation.normals.disturbances import disturbed
from pbrfit_evaluation.panels import of_result, packed
from pbrfit_evaluation.review.measure import review
from pbrfit_evaluation.review.pictures import codes
from pbrfit_evaluation.scores import score


def run(case: Case, threads: int) -> Values:
    """Damage, review, fit, compare.

    Returns
    -------
    `scores`; `kept`, of how many pictures the fit was; `honest_refused`, `damaged_kept`, of whole
    pictures by the review; of a path, `blender` with the error of the relit picture in Blender and
    of the same by pbrfit; for some, panels.
    """
    way = WAYS[case.condition]
    truth = room(case.seed, case.size, case.lights, by_cycles=case.kind == "cycles")
    pictures, kinds = stand_ins(truth, way.level, case.seed)
    found: dict[str, Any] = {}
    kept = list(range(len(pictures)))
    scene, depth = replace(truth.scene, depth=None), truth.scene.depth
    if way.path:
        result, names, in_blender = through_files(case, scene, pictures)
        kept = [int(name) for name in names]
        found["blender"] = in_blender["errors"]
    else:
        if way.review:
            kept = reviewed(pictures)
        if way.normals == "estimated":
            wrong = disturbed(scene, "estimator", NORMALS_OFF, case.seed)
            assert depth is not None
            scene = replace(scene, normals=wrong, depth=estimated(depth, case.seed))
        scene = given(scene, pictures[kept], as_files=way.level != "exact")
        if way.maps:
            scene = replace(scene, estimates=maps_of(scene, pictures[0], case.seed, way.maps))
        result, in_blender = way.explain(scene, threads=threads, uncertainty=False), {}
    honest = {i for i, kind in enumerate(kinds) if kind == "honest"}
    found |= {
        "scores": score(result, scene, threads).as_json(),
        "kept": len(kept),
        "honest_refused": len(honest - set(kept)),
        "damaged_kept": len(set(kept) - honest),
    }
    if case.picture:
        panels = of_result(result, scene, threads, scaled=True)
        if "picture" in in_blender:
            panels["Blender"] = in_blender["picture"]
        found |= {"maps": packed(panels), "inputs": packed(inputs(pictures, kinds)), "kinds": kinds}
    return found


def maps_of(scene: Scene, photograph: Array, seed: int, whose: str) -> Materials:
    """Estimates of a network for a room, or those of another room."""
    if whose == "own":
        return map_errors.estimated(scene, photograph, seed)
    other = make_scene(KIND, size=scene.width, lights=2, held_out=1, seed=seed + OTHER_SEED)
    return map_errors.estimated(other, other.images[0].astype(np.float64), seed)


def reviewed(pictures: Array) -> list[int]:
    """Numbers of the pictures that the review of `pbrfit generate` accepts; 0 is the photograph."""
    photo, *others = np.clip(pictures, 0, 1)
    verdicts = review(Reviewer(photo), others)
    accepted = [
        i + 1
        for i, (alone, together) in enumerate(verdicts)
        if alone.accepted and (together is None or together.accepted)
    ]
    return [0, *accepted]


def given(scene: Scene, pictures: Array, *, as_files: bool) -> Scene:
    """The scene of these pictures; of 8-bit files, as `Scene.load` reads them, limits included."""
    names = tuple(f"{i:02d}" for i in range(len(pictures)))
    scene = replace(scene, images=pictures, names=names, limits=None)
    return read_back(scene, write_png) if as_files else scene


def through_files(
    case: Case, scene: Scene, pictures: Array
) -> tuple[Result, Sequence[str], dict[str, Any]]:
    """By commands: from a photograph and a folder of pictures to an export, opened by Blender.

    Normals and segments are files too. Returns the result, away from edges; names of its pictures;
    errors under the first held-out light in Blender and in pbrfit, and Blender's picture.
    """
    assert scene.truth is not None
    assert scene.truth.relight_images is not None
    assert scene.truth.relight_lighting is not None
    with TemporaryDirectory() as parent:
        at = Path(parent)
        (at / "pictures").mkdir()
        for i, picture in enumerate(codes(pictures)):
            Image.fromarray(picture).save(at / ("photo.png" if i == 0 else f"pictures/{i:02d}.png"))
        write_normals(at / "normals.exr", filled(scene.normals, scene.valid))
        Image.fromarray(segments_of(scene)).save(at / "segments.png")
        told = ["--normals", str(at / "normals.exr"), "--segments", str(at / "segments.png")]
        told += ["--depth", "none", "--fov", f"{scene.fov:g}"]
        source = ["--generator", f"folder:{at / 'pictures'}"]
        command("generate", at / "photo.png", "--out", at / "scene", *source, *told)
        options = ["--prior", "material=1", "--threads", 1]  # as `generate` says
        command("decompose", at / "scene", "--out", at / "result", *options)
        command("export", at / "result", "--out", at / "export", "--preset", "blender")
        report = read_json(at / "scene" / "review.json", "a review")
        accepted = [one["name"] for one in report["pictures"] if one["accepted"]]
        result = Result.load(at / "result")
        light = scene.truth.relight_lighting[:1]
        valid = scene.valid[..., None]
        true = np.where(valid, scene.truth.relight_images[:1], np.nan)
        ours = np.where(valid, relight(result, light, 1), np.nan)
        errors: dict[str, Any] = {"ours": scaled_error(ours, true), "blender": None}
        found: dict[str, Any] = {"errors": errors}
        if not cycles.why_not():
            (at / "lights").mkdir()
            held_out = replace(result, lighting=light, pictures=("held out",))
            [panorama] = write_lights(at / "lights", held_out)
            glb, lights = at / "export" / "material.glb", [at / "lights" / panorama.file]
            rendered = rendered_export(at / "job", glb, case.size, lights)
            shown = np.where(valid, rendered, np.nan)
            errors["blender"] = scaled_error(shown, true)
            scaled = metrics.scaled_per_channel(shown, true)
            found["picture"] = displayed(scaled[0], metrics.white_of(true[0]))
        return away_from_edges(result, scene), ["00", *accepted], found


def command(*words: object) -> None:
    """Run a command of pbrfit; an exit code above 0 is an error."""
    code = main([*map(str, words), "--quiet"])
    if code:
        raise RuntimeError(f"pbrfit {words[0]}: expected exit code 0, found {code}")


def scaled_error(found: Array, true: Array) -> float:
    """RMSE after the best factor a channel."""
    return metrics.rmse(metrics.scaled_per_channel(found, true), true)


def away_from_edges(result: Result, scene: Scene) -> Result:
    """With NaN where the truth has none."""
    valid = scene.valid & result.mask
    of = result.materials
    cut = [np.where(valid, plane, np.nan) for plane in (of.roughness, of.metallic)]
    albedo = np.where(valid[..., None], of.albedo, np.nan)
    return replace(result, materials=replace(of, albedo=albedo, roughness=cut[0], metallic=cut[1]))


# ------------------------------------------------------------------------------------- pictures


def inputs(pictures: Array, kinds: Sequence[str]) -> dict[str, NDArray[np.floating[Any]]]:
    """The photograph and the first picture of each kind of damage, as files show them."""
    first = {"photograph": 0}
    for i, kind in enumerate(kinds[1:], start=1):
        first.setdefault("tones alone" if kind == "honest" else kind, i)
    return {name: codes(pictures[i]) / 255 for name, i in first.items()}
