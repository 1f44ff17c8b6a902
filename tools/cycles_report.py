"""Print the figures of docs/cycles.md: checks, noise, times, and how far the models are off.

    python tools/cycles_report.py [--size 64] [--scenes 3] [--kind furnished] [--threads 1]

Renders are kept in the user's cache, or in the folder that --cache names. Needs the environment of
`make cycles-env`.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np

sys.path.append(str(Path(__file__).resolve().parents[1] / "tests" / "evaluation"))

from test_cycles import sphere_errors, truth_errors

from pbrfit import Scene, render
from pbrfit.io.color import encode_srgb
from pbrfit.model.reflection import MODELS, Model, shade
from pbrfit.synthetic import World, draw, random_lights
from pbrfit_evaluation.cycles import SAMPLES, Light, Transport, render_scene
from pbrfit_evaluation.cycles.export import export
from pbrfit_evaluation.cycles.job import Job, rendered
from pbrfit_evaluation.cycles.scene import inner_pixels
from pbrfit_evaluation.cycles.spheres import relative_rmse

FIRST_SEED = 9000  # tuned on by nobody


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--size", type=int, default=64)
    parser.add_argument("--scenes", type=int, default=3)
    parser.add_argument("--kind", default="furnished")
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--cache", type=Path)
    parser.add_argument("--only", choices=["checks", "noise", "gap"])
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
    if chosen.only in (None, "checks"):
        print(sphere_errors(64, 1024, cache, threads))
        for world in worlds.values():
            print(truth_errors(world, size, cache, threads))

    if chosen.only in (None, "noise"):
        lights = random_lights(16, np.random.default_rng(0))
        stage = export(worlds[FIRST_SEED], size, 60.0)
        for light, transport in SAMPLES:
            if light == "panorama":
                job = [
                    Job(stage, None, transport, SAMPLES[light, transport], seed) for seed in (1, 2)
                ]
                two = [rendered(j, cache=cache, threads=threads) for j in job]
                inner = inner_pixels(two[0].segments, two[0].normals, 60.0)
                a, b = (np.einsum("kpc,nkc->npc", r.radiance[:, inner], lights) for r in two)
                noise = np.sqrt(np.mean((a - b) ** 2, axis=(1, 2)) / 2) / a.mean(axis=(1, 2))
                print(f"noise, {transport}, {SAMPLES[light, transport]} samples:", end=" ")
                print(f"{noise.mean():.4f} ({noise.min():.4f} to {noise.max():.4f})", end="; ")
                print(f"{two[0].cpu_seconds:.1f} s of one processor", flush=True)

    if chosen.only in (None, "gap"):
        for light, transport in SAMPLES:
            for shell in ("stage", "open") if transport != "brdf" else ("stage",):
                if (light, transport) == ("points", "full") or (light, shell) == ("points", "open"):
                    continue
                scenes = []
                for seed, world in worlds.items():
                    scenes.append(
                        render_scene(
                            world,
                            size,
                            light=light,
                            transport=transport,
                            seed=seed,
                            shell=shell,
                            cache=cache,
                            threads=threads,
                        )
                    )
                for model in MODELS:
                    gaps = [reflection_gap(scene, model) for scene in scenes]
                    known = [f"{true:.3f}" for true, _ in gaps if true is not None]
                    best = [f"{least:.3f}" for _, least in gaps]
                    print(f"gap, {model}, {light}, {transport}, {shell}:", end=" ")
                    print(
                        f"true lights {', '.join(known)}; best lights {', '.join(best)}", flush=True
                    )


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
