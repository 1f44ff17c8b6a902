"""Stand-ins for generated pictures: a room under many lights, damaged as a generator would.

What is done about a level of damage is a row of the comparison. Levels build upon each other: what
one adds is done on top of what those before it do, with the same random numbers. The photograph,
picture 0, is a file of 8 bits and otherwise as it is. Lengths are in pixels at a width of 96 and
grow with the picture.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Literal, get_args

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray
from PIL import Image

from pbrfit._core import InputError
from pbrfit.acquire.photo import LEAST_SIDE
from pbrfit.acquire.review import Reviewer
from pbrfit.cli import main
from pbrfit.export.lights import write_lights
from pbrfit.io.color import decode_srgb, encode_srgb
from pbrfit.io.json_files import read_json
from pbrfit.io.normal_files import write_normals
from pbrfit.model.materials import Materials
from pbrfit.result import metrics
from pbrfit.result.options import Priors
from pbrfit.result.relighting import relight
from pbrfit.result.result import Result
from pbrfit.result.sheet import displayed
from pbrfit.scene.scene import Scene
from pbrfit.synthetic import draw, make_scene
from pbrfit_evaluation import cycles
from pbrfit_evaluation.arrays import Array, Floats, filled, known
from pbrfit_evaluation.cycles.process import rendered_export
from pbrfit_evaluation.estimator_errors import estimated_depth, estimated_maps
from pbrfit_evaluation.everyday.measure import read_back, write_png
from pbrfit_evaluation.grid import Case, Grid
from pbrfit_evaluation.jobs import Values
from pbrfit_evaluation.normals.measure import disturbed
from pbrfit_evaluation.panels import of_result, packed
from pbrfit_evaluation.recipes import GUESS, Way
from pbrfit_evaluation.review.measure import review
from pbrfit_evaluation.review.pictures import REPAINTS, bent, camera, codes, damaged, exposed, moved
from pbrfit_evaluation.scores import score
from pbrfit_evaluation.suite import Options

Level = Literal["exact", "toned", "drifted", "repainted"]
LEVELS: tuple[Level, ...] = get_args(Level)

KIND = "detailed"
HELD_OUT = 4

SAMPLES = 256
"""Light paths a pixel: twice the noise of `cycles.SAMPLES`, 1.4 to 2 % of a picture's mean."""

DRIFTED, REPAINTED = 0.25, 0.2
"""Shares of the generated pictures that are moved, and painted over; one more shows another room.
No picture has two of these, so that each costs what it costs."""

SHIFT = (0.3, 2.0)
"""Pixels by which a picture is moved as a whole."""

WARP = 0.5
"""Pixels by which it is bent besides, where it is most."""

STOPS = 0.4
"""Standard deviation of the exposure of a generated picture, in powers of two."""

GAMMA, CONTRAST, FILMIC = (0.8, 1.25), (-0.5, 0.7), (2.0, 4.0)
"""Ranges of the three tone curves: exponent of sRGB values; share of the way to a smoothstep of
them; radiance, over white, that the shoulder of Reinhard's curve (2002, eq. 4) shows as white."""

OTHER_SEED = 100_000
"""Added to the seed of a room: that of another, for the picture of something else."""


def room(seed: int, size: int, lights: int, *, by_cycles: bool) -> Scene:
    """A textured room under soft lights, by Cycles with all light transport, or by our renderer.

    Its pictures are exposed: white = 1, brighter values there.
    """
    if by_cycles:
        scene = cycles.render_scene(
            draw(KIND, np.random.default_rng(seed)),
            size,
            lights=lights,
            held_out=HELD_OUT,
            seed=seed,
            samples=SAMPLES,
            threads=1,
        )
    else:
        scene = make_scene(KIND, size=size, lights=lights, held_out=HELD_OUT, seed=seed)
    rng = np.random.default_rng([seed, 4])
    pictures = np.stack([exposed(of.astype(np.float64), rng) for of in scene.images])
    truth = replace(known(scene.truth), lighting=None)  # of other exposures
    return replace(scene, images=pictures, truth=truth)


def stand_ins(of: Scene, level: Level, seed: int) -> tuple[Array, list[str]]:
    """Pictures (N, H, W, 3), linear, and in a word what was done to each beside its tones.

    Those of "exact" are floats; all others went through sRGB files of 8 bits.
    """
    pictures = np.array(of.images, np.float64)
    if level == "exact":
        return pictures, ["honest"] * len(pictures)
    rank, count = LEVELS.index(level), len(pictures) - 1
    order = 1 + np.random.default_rng([seed, 5]).permutation(count)
    drifts, repaints = round(DRIFTED * count), round(REPAINTED * count)
    kinds = ["honest"] * len(pictures)
    width = pictures.shape[2]
    for i in range(1, len(pictures)):
        place = int(np.flatnonzero(order == i)[0])
        rng = np.random.default_rng([seed, 6, i])
        if place < drifts:
            if rank >= LEVELS.index("drifted"):
                pictures[i], kinds[i] = drifted(pictures[i], rng), "drift"
        elif rank < LEVELS.index("repainted"):
            pass
        elif place < drifts + repaints:
            kind = REPAINTS[(seed + place) % len(REPAINTS)]
            pictures[i], kinds[i] = damaged(pictures[i], kind, of.segments, rng)[0], "repaint"
        elif place == drifts + repaints:
            other = make_scene(KIND, size=width, lights=2, held_out=1, seed=seed + OTHER_SEED)
            pictures[i], kinds[i] = exposed(other.images[0].astype(np.float64), rng), "another"
        pictures[i] = toned(pictures[i], np.random.default_rng([seed, 7, i]))
    return camera(pictures), kinds


def drifted(picture: Array, rng: Generator) -> Array:
    """A picture (H, W, 3) moved by `SHIFT` and bent by `WARP`."""
    width = picture.shape[1]
    unit = width / 96
    angle, length = rng.uniform(0, 2 * np.pi), unit * rng.uniform(*SHIFT)
    down, right = bent(picture.shape[:2], 0.1 * width, unit * WARP, rng)
    return moved(picture, down + length * np.sin(angle), right + length * np.cos(angle))


def toned(picture: Array, rng: Generator) -> Array:
    """A picture after another exposure and one of three smooth monotone tone curves; white = 1."""
    linear = np.maximum(picture, 0) * 2 ** rng.normal(scale=STOPS)
    kind = rng.integers(3)
    shown = encode_srgb(np.clip(linear, 0, 1))
    if kind == 0:
        return decode_srgb(shown ** rng.uniform(*GAMMA))
    if kind == 1:
        smoothstep = shown * shown * (3 - 2 * shown)
        return decode_srgb(shown + rng.uniform(*CONTRAST) * (smoothstep - shown))
    white = rng.uniform(*FILMIC)
    return np.asarray(np.clip(linear * (1 + linear / white**2) / (1 + linear), 0, 1))


def segments_of(scene: Scene) -> NDArray[Any]:
    """Ids of objects, as a grey picture of 8 bits holds them."""
    segments = known(scene.segments)
    found: NDArray[Any] = np.unique(segments, return_inverse=True)[1]
    return (found.reshape(segments.shape) + 1).astype(np.uint8)


BARE: Mapping[str, Any] = {
    "align": "off",
    "robust": "none",
    "response": "srgb",
    "equal_exposures": False,
    "refine_normals": "off",
    "light": "sh",
}
"""Options that take pictures as they are."""

ALIGN: Mapping[str, Any] = {"align": "auto"}
ROBUST: Mapping[str, Any] = {"robust": "auto"}
EXPOSURE: Mapping[str, Any] = {"response": "auto", "equal_exposures": None}

PRIOR: Mapping[str, Any] = {"priors": Priors(material=1.0)}

TOGETHER: Mapping[str, Any] = {**BARE, **ALIGN, **ROBUST, **EXPOSURE, **PRIOR}

REFINED: Mapping[str, Any] = {**TOGETHER, "refine_normals": "auto"}

NORMALS_OFF = 8.0
"""Degrees, θ of `normals.disturbances`: estimated normals are off by 10 degrees in the mean."""


@dataclass(frozen=True)
class Handled(Way):
    """A level of damage and what is done about it."""

    level: Level = "repainted"
    """Of the pictures."""
    review: bool = False
    """Whether pictures are reviewed first."""
    estimated: bool = False
    """Whether normals have the errors of an estimator, and depth is a network's."""
    path: bool = False
    """Whether commands do it, from files to files."""
    maps: str = ""
    """Whose maps are estimates of the scene: "own" or "another"'s; empty = there are none."""


WAYS: Mapping[str, Handled] = {
    "constant": Handled(**vars(GUESS), level="exact"),
    "exact": Handled("exact pictures", BARE, level="exact"),
    "toned": Handled("tone curves, exposures, 8 bits", BARE, level="toned"),
    "drifted": Handled("and a quarter drifted", BARE, level="drifted"),
    "repainted": Handled("and a quarter repainted or of something else", BARE),
    "review": Handled("all damage: review alone", BARE, review=True),
    "align": Handled("all damage: alignment alone", {**BARE, **ALIGN}),
    "robust": Handled("all damage: robust weights alone", {**BARE, **ROBUST}),
    "exposure": Handled("all damage: exposure handling alone", {**BARE, **EXPOSURE}),
    "together": Handled("all damage: all together", TOGETHER, review=True),
    "maps": Handled("all together, a network's maps", TOGETHER, review=True, maps="own"),
    "other-maps": Handled(
        "all together, maps of another room", TOGETHER, review=True, maps="another"
    ),
    "estimated": Handled(
        "all together, estimated normals and depth", REFINED, review=True, estimated=True
    ),
    "estimated-maps": Handled(
        "all together, estimated normals and depth, a network's maps",
        REFINED,
        review=True,
        estimated=True,
        maps="own",
    ),
    "exact-handled": Handled("exact pictures: all together", TOGETHER, level="exact", review=True),
    "path": Handled("all damage: generate, decompose, export", review=True, path=True),
}
"""By key; words are those of tables."""


def by_cycles(options: Options) -> bool:
    """Whether Cycles renders the rooms: where it is there, but for a quick look."""
    return not (options.quick or cycles.why_not())


def why_not(options: Options, key: str, _: str) -> str:
    """Why a way cannot be run; empty if it can."""
    lacks = WAYS[key].estimated and not by_cycles(options)
    return "rooms by our renderer have no depth" if lacks else ""


GRID = Grid(
    {key: way.words for key, way in WAYS.items()},
    pictured=("exact", "repainted", "together", "maps", "path"),
    few=("constant", "exact", "repainted", "together", "maps", "path"),
    why_not=why_not,
)
"""What is done is the condition; kinds "cycles" and "own" say what renders the rooms."""


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
    scene, depth = replace(truth, depth=None), truth.depth
    if way.path:
        result, names, in_blender = through_files(case, scene, pictures)
        kept = [int(name) for name in names]
        found["blender"] = in_blender["errors"]
    else:
        if way.review:
            kept = reviewed(pictures)
        if way.estimated:
            wrong = disturbed(scene, "estimator", NORMALS_OFF, case.seed)
            scene = replace(scene, normals=wrong, depth=estimated_depth(known(depth), case.seed))
        scene = given(scene, pictures[kept], as_files=way.level != "exact")
        if way.maps:
            scene = replace(scene, estimates=maps_of(scene, pictures[0], case.seed, way.maps))
        result, in_blender = way.explain(scene, threads=threads, uncertainty=False), {}
    honest = {i for i, kind in enumerate(kinds) if kind == "honest"}
    found |= {
        "scores": score(result, scene, threads),
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
        return estimated_maps(scene, photograph, seed)
    other = make_scene(KIND, size=scene.width, lights=2, held_out=1, seed=seed + OTHER_SEED)
    return estimated_maps(other, other.images[0].astype(np.float64), seed)


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
    truth = known(scene.truth)
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
        light = known(truth.relight_lighting)[:1]
        valid = scene.valid[..., None]
        true = np.where(valid, known(truth.relight_images)[:1], np.nan)
        ours = np.where(valid, relight(result, light, 1), np.nan)
        errors: dict[str, Any] = {"ours": metrics.scaled_rmse(ours, true), "blender": None}
        found: dict[str, Any] = {"errors": errors}
        if not cycles.why_not():
            (at / "lights").mkdir()
            held_out = replace(result, lighting=light, pictures=("held out",))
            [panorama] = write_lights(at / "lights", held_out)
            glb, lights = at / "export" / "material.glb", [at / "lights" / panorama.file]
            rendered = rendered_export(at / "job", glb, case.size, lights)
            shown = np.where(valid, rendered, np.nan)
            errors["blender"] = metrics.scaled_rmse(shown, true)
            scaled = metrics.scaled_per_channel(shown, true)
            found["picture"] = displayed(scaled[0], metrics.white_of(true[0]))
        return away_from_edges(result, scene), ["00", *accepted], found


def command(*words: object) -> None:
    """Run a command of pbrfit; an exit code above 0 is an error."""
    code = main([*map(str, words), "--quiet"])
    if code:
        raise RuntimeError(f"pbrfit {words[0]}: expected exit code 0, found {code}")


def away_from_edges(result: Result, scene: Scene) -> Result:
    """With NaN where the truth has none."""
    return replace(result, materials=result.materials.within(scene.valid & result.mask))


# ------------------------------------------------------------------------------------- pictures


def inputs(pictures: Array, kinds: Sequence[str]) -> dict[str, Floats]:
    """The photograph and the first picture of each kind of damage, as files show them."""
    first = {"photograph": 0}
    for i, kind in enumerate(kinds[1:], start=1):
        first.setdefault("tones alone" if kind == "honest" else kind, i)
    return {name: codes(pictures[i]) / 255 for name, i in first.items()}


def cases(options: Options) -> list[Case]:
    """Every room in every way; by Cycles where it is there and wanted.

    Raises InputError if there are too few pictures for each kind of damage, or they are too small
    for a photograph.
    """
    if options.pictures < 6:
        raise InputError(f"--pictures: expected at least 6, found {options.pictures}")
    if options.size < LEAST_SIDE:
        raise InputError(f"--size: expected at least {LEAST_SIDE}, found {options.size}")
    kind = "cycles" if by_cycles(options) else "own"
    return [replace(case, kind=kind, lights=options.pictures) for case in GRID.cases(options)]
