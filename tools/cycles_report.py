"""The tables of docs/cycles.md: checks, noise, and how far the models are off.

    python tools/cycles_report.py [--size 64] [--scenes 3] [--kind furnished] [--docs docs]

Renders are kept in the user's cache, or in the folder that --cache names. Needs the environment of
`make cycles-env`.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np

sys.path.append(str(Path(__file__).resolve().parents[1] / "tests" / "evaluation"))
sys.path.append(str(Path(__file__).resolve().parents[1] / "tests" / "support"))

from test_cycles import sphere_errors

from cycles_sphere import relative_rmse
from pbrfit import Scene
from pbrfit.io.color import encode_srgb
from pbrfit.kernel import render
from pbrfit.model.reflection import MODELS, Model, shade
from pbrfit.synthetic import World, draw, random_lights
from pbrfit_evaluation.cycles import SAMPLES, Light, Transport, render_scene
from pbrfit_evaluation.cycles.export import export
from pbrfit_evaluation.cycles.job import Job, rendered
from pbrfit_evaluation.cycles.scene import inner_pixels
from pbrfit_evaluation.report import evidence, markdown
from pbrfit_evaluation.suite import Table, Value

FIRST_SEED = 9000  # tuned on by nobody

SPHERES = {
    "diffuse": "white, diffuse, four SH lights",
    "metal": "white metal, polished",
    "point light": "white, diffuse, one point light",
    "mirrored": "a mirrored axis would show as, at least",
    "paper": "plastic, beside the paper's model",
    "principled": "plastic, beside the principled model",
    "normals": "normals, degrees",
}
"""What `sphere_errors` names, in words."""


def main() -> None:
    """Measure and tell."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--size", type=int, default=64)
    parser.add_argument("--scenes", type=int, default=3)
    parser.add_argument("--kind", default="furnished")
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--cache", type=Path)
    parser.add_argument("--docs", type=Path, help="fill the page's tables there")
    parser.add_argument("--picture", type=Path, help="write a comparison of pictures and stop")
    chosen = parser.parse_args()
    size, cache, threads = chosen.size, chosen.cache, chosen.threads
    seeds = range(FIRST_SEED, FIRST_SEED + chosen.scenes)
    worlds = {
        seed: draw(chosen.kind, np.random.default_rng(np.random.SeedSequence(seed).spawn(4)[0]))
        for seed in seeds
    }

    if chosen.picture is not None:
        draw_pictures(worlds[FIRST_SEED], size, cache, threads, chosen.picture)
        return
    tables = {
        "Spheres": checked(cache, threads),
        "Noise": noises(worlds[FIRST_SEED], size, cache, threads),
        "How far the models are off": gaps(list(worlds.items()), size, cache, threads),
    }
    for title, table in tables.items():
        print(f"{title}\n\n{markdown(table)}")
    if chosen.docs is not None:
        evidence.record(
            chosen.docs,
            "cycles",
            command=f"python tools/cycles_report.py --size {size} --scenes {chosen.scenes}",
            protocol="pbrfit-cycles-1: RMSE over the mean radiance",
            tables=tables,
        )


def checked(cache: Path | None, threads: int) -> Table:
    """Spheres whose pictures are known."""
    errors = sphere_errors(64, 1024, cache, threads)
    return Table(["sphere", "off by"], [[SPHERES.get(n, n), e] for n, e in errors.items()])


def noises(world: World, size: int, cache: Path | None, threads: int) -> Table:
    """Standard deviation over the mean of a picture, by two seeds of the renderer."""
    lines: list[list[Value]] = []
    lights = random_lights(16, np.random.default_rng(0))
    stage = export(world, size, 60.0)
    for (light, transport), samples in SAMPLES.items():
        if light != "panorama":
            continue
        jobs = [Job(stage, None, transport, samples, seed) for seed in (1, 2)]
        two = [rendered(job, cache=cache, threads=threads) for job in jobs]
        inner = inner_pixels(two[0].segments, two[0].normals, 60.0)
        a, b = (np.einsum("kpc,nkc->npc", r.radiance[:, inner], lights) for r in two)
        noise = np.sqrt(np.mean((a - b) ** 2, axis=(1, 2)) / 2) / a.mean(axis=(1, 2))
        found = [float(of) for of in (noise.mean(), noise.min(), noise.max())]
        lines.append([transport, float(samples), *found])
    return Table(["step", "samples", "noise, mean over lights", "least", "largest"], lines)


def gaps(worlds: Sequence[tuple[int, World]], size: int, cache: Path | None, threads: int) -> Table:
    """Models beside Cycles, with the true materials; means over the rooms."""
    lines: list[list[Value]] = []
    for light, transport in SAMPLES:
        if (light, transport) == ("points", "full"):
            continue
        scenes = [
            render_scene(
                world,
                size,
                light=light,
                transport=transport,
                seed=seed,
                cache=cache,
                threads=threads,
            )
            for seed, world in worlds
        ]
        for model in MODELS:
            found = [reflection_gap(scene, model) for scene in scenes]
            known = [true for true, _ in found if true is not None]
            true = float(np.mean(known)) if known else None
            best = float(np.mean([least for _, least in found]))
            lines.append([f"{light}, {transport}", model, true, best])
    return Table(["pictures", "model", "true lights", "best lights"], lines)


def reflection_gap(scene: Scene, model: Model) -> tuple[float | None, float]:
    """RMSE of a model with the true materials, over the mean of the pictures.

    First under the pictures' own lights, None where those are not spherical harmonics; then under
    the SH light that comes closest, for each picture and channel: what the best fit of the lights
    leaves. A fit of the materials as well can hide more.
    """
    assert scene.truth is not None
    known, of, true = scene.truth, scene.valid, None
    maps = known.materials
    pictures = scene.images[:, of].astype(np.float64)  # (N, P, 3)
    if known.lighting is not None:
        ours = render(maps, scene.normals, known.lighting, scene.fov, model=model)[:, of]
        true = relative_rmse(ours, pictures)
    material = (maps.albedo[of], maps.roughness[of], maps.metallic[of])
    weights = shade(scene.normals[of], scene.views[of], *material, model=model)
    best = np.empty_like(pictures)
    for channel in range(3):
        w = weights[:, channel]  # (P, 16)
        light, *_ = np.linalg.lstsq(w, pictures[..., channel].T)
        best[..., channel] = (w @ light).T
    return true, relative_rmse(best, pictures)


def draw_pictures(
    world: World, size: int, cache: Path | None, threads: int, path: Path, lights: int = 3
) -> None:
    """One row a light, one column a renderer; each column exposed on its own."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    def pictures(light: Light, transport: Transport) -> Scene:
        return render_scene(
            world,
            size,
            light=light,
            transport=transport,
            seed=FIRST_SEED,
            cache=cache,
            threads=threads,
        )

    brdf = pictures("panorama", "brdf")
    assert brdf.truth is not None
    assert brdf.truth.lighting is not None
    view = world.cast(size)
    columns = {
        "principled model": render(
            *(view.materials, view.normals, brdf.truth.lighting, view.fov), model="principled"
        ),
        "Cycles, BRDF alone": brdf.images,
        "+ shadows": pictures("panorama", "shadows").images,
        "+ interreflections": pictures("panorama", "full").images,
        "point lights,\nno shadows": pictures("points", "brdf").images,
        "point lights,\nshadows": pictures("points", "shadows").images,
    }
    figure = Figure(figsize=(1.6 * len(columns), 1.6 * lights + 0.4), layout="constrained")
    axes = figure.subplots(lights, len(columns))
    for column, (name, images) in enumerate(columns.items()):
        axes[0, column].set_title(name, fontsize=8)
        for row in range(lights):
            axes[row, column].imshow(
                encode_srgb(np.clip(images[row], 0, 1)), interpolation="nearest"
            )
            axes[row, column].set_axis_off()
    FigureCanvasAgg(figure).print_png(path)


if __name__ == "__main__":
    main()
