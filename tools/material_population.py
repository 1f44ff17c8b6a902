"""Prints what public material sets are made of: what `pbrfit.fit.priors.population` rests on.

    python tools/material_population.py FOLDER

FOLDER holds the sets as docs/fit.md lists them. Each map counts as much as any other, whatever
its size: a set is one draw of what surfaces there are.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from pbrfit.io.color import decode_srgb

Array = NDArray[np.float64]


def read(path: Path, channel: int | None = None) -> Array:
    """Codes of an image in [0, 1]."""
    codes = np.asarray(Image.open(path).convert("L" if channel is None else "RGB")) / 255.0
    return codes if channel is None else codes[..., channel]


def color(path: Path) -> Array:
    """Linear mean over channels."""
    return np.asarray(decode_srgb(np.asarray(Image.open(path).convert("RGB")) / 255.0)).mean(
        axis=-1
    )


def sets(folder: Path) -> dict[str, tuple[Array, Array, Array]]:
    """Albedo, roughness and metallic of each material set, as many values of each."""
    found: dict[str, tuple[Array, Array, Array]] = {}

    def put(name: str, albedo: Array, roughness: Array, metallic: Array | float) -> None:
        rng = np.random.default_rng(0)
        maps = [albedo, roughness, np.broadcast_to(metallic, roughness.shape)]
        same = all(one.shape == maps[0].shape for one in maps)
        draw = rng.integers(0, maps[0].size, 4096)
        found[name] = tuple(  # type: ignore[assignment]
            one.ravel()[draw if same else rng.integers(0, one.size, 4096)] for one in maps
        )

    for one in sorted((folder / "pbr_ambientcg").iterdir()):
        if one.is_dir():
            metallic = one / "metallic.jpg"
            put(
                one.name,
                color(one / "albedo.jpg"),
                read(one / "roughness.jpg"),
                read(metallic) if metallic.exists() else 0.0,
            )
    hull = folder / "pbr_polyhaven_ship_hull"
    arm = hull / "dutch_ship_medium_hull_arm_1k.jpg"
    diffuse = color(hull / "dutch_ship_medium_hull_diff_1k.jpg")
    put("ship hull", diffuse, read(arm, 1), read(arm, 2))
    chess = folder / "pbr_materialx_chess"
    for name, metal in (
        ("chessboard", "chessboard"),
        *((f"king_{c}", "king_shared") for c in ("black", "white")),
    ):
        put(
            name,
            color(chess / f"{name}_base_color.jpg"),
            read(chess / f"{name}_roughness.jpg"),
            read(chess / f"{metal}_metallic.jpg"),
        )
    for path in sorted((folder / "gltf_FlightHelmet").glob("*_OcclusionRoughMetal.png")):
        base = path.with_name(path.name.replace("OcclusionRoughMetal", "BaseColor"))
        put(path.name.split("_")[2], color(base), read(path, 1), read(path, 2))
    avocado = folder / "gltf_Avocado"
    of = avocado / "Avocado_roughnessMetallic.png"
    put("avocado", color(avocado / "Avocado_baseColor.png"), read(of, 1), 0.0)
    return found


def main(folder: Path) -> None:
    """Print quantiles, and the moments that the prior has."""
    found = sets(folder)
    for name, (albedo, roughness, metallic) in found.items():
        print(
            f"{name:26} albedo {albedo.mean():.2f} ± {albedo.std():.2f}  "
            f"roughness {roughness.mean():.2f} ± {roughness.std():.2f}  "
            f"metallic {metallic.mean():.2f}, between .1 and .9: "
            f"{np.mean((metallic > 0.1) & (metallic < 0.9)):.2f}"
        )
    albedo, roughness, metallic = (np.concatenate(of) for of in zip(*found.values(), strict=True))
    dielectric, metal = metallic < 0.1, metallic > 0.9
    for name, values in (
        ("roughness", roughness),
        ("albedo of dielectrics", albedo[dielectric]),
        ("albedo of metals", albedo[metal]),
    ):
        quantiles = np.quantile(values, [0.02, 0.1, 0.5, 0.9, 0.98])
        print(
            f"{name}: {values.mean():.3f} ± {values.std():.3f}, 2 10 50 90 98 %", quantiles.round(3)
        )
    mean, variance = roughness.mean(), roughness.var()
    strength = mean * (1 - mean) / variance - 1
    print(f"Beta of roughness: {mean * strength:.2f}, {(1 - mean) * strength:.2f}")
    print(f"metallic: below .1 {dielectric.mean():.2f}, above .9 {metal.mean():.2f}")
    print(f"share of roughness below .1: {np.mean(roughness < 0.1):.3f}")
    means = np.log([np.mean(a) for a, _, _ in found.values()])
    print(
        f"mean albedo of a set: {np.exp(means.mean()):.2f}, "
        f"deviation of its logarithm {means.std():.2f}"
    )


if __name__ == "__main__":
    main(Path(sys.argv[1]))
