"""`pbrfit export`."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from pathlib import Path

from pbrfit.commands import arguments as cli
from pbrfit.export import Exported, export_result
from pbrfit.export.maps import Bits, NormalConvention
from pbrfit.export.presets import Format, PresetName
from pbrfit.export.view_mesh import Geometry


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add its options."""
    cli.add_result(parser, "DIR", "folder to write")
    cli.add_flags(
        parser,
        format=cli.choice(
            Format,
            "this one alone; mtlx: MaterialX, with its PNG files; lp: directions of the lamps; "
            "ptm, rti: a polynomial texture map, hemispherical harmonics for RTI viewers; "
            "openlime: these for the web "
            "(default: those of the preset, else gltf, exr, png and mtlx)",
        ),
        preset=cli.choice(
            PresetName,
            "textures with the names, channels and normals that a tool expects (default: a file a "
            "map)",
        ),
        normals=cli.choice(
            NormalConvention,
            "green of normal maps upwards or downwards (default: as the preset says, else opengl)",
        ),
        bits=cli.choice(
            Bits,
            "of PNG files and of textures in glTF (default: as the preset says, else 16, and in "
            "glTF 16 for normals alone)",
            type=int,
        ),
        geometry=cli.choice(
            Geometry,
            "of glTF: a card with a normal texture, or a rectangle a pixel, turned to its normal, "
            "for path tracers (default: card)",
        ),
        no_height=cli.switch("no height map, which for large pictures takes the longest"),
    )
    cli.add_quiet(parser)


def run(options: argparse.Namespace) -> int:
    """Write the export, and list its files."""
    names = ("format", "preset", "normals", "bits", "geometry", "overwrite")
    asked = {name: getattr(options, name) for name in names}
    result = cli.read_result(options)
    exported = export_result(result, options.out, height=not options.no_height, **asked)
    cli.tell(options, _listed(exported, options.out))
    return cli.DONE


def _listed(exported: Exported, out: Path) -> Iterator[str]:
    """The files; panoramas, of which there may be many, in one line."""
    total = sum(file.size for file in exported.files)
    yield f"{out}: {len(exported.files) + 1} files, {total / 1e6:.2f} MB"
    of_lights = {f"lights/{light.file}" for light in exported.panoramas}
    lines = [
        (file.path, file.size, file.holds) for file in exported.files if file.path not in of_lights
    ]
    worst = max(exported.panoramas, key=lambda light: light.difference)
    remark = f"; without negative light, at most {worst.difference:.1%} different ({worst.picture})"
    remark *= worst.difference > 0
    size = sum(file.size for file in exported.files if file.path in of_lights)
    lines.append((f"lights/*.exr ({len(of_lights)})", size, f"a panorama a light{remark}"))
    width = max(len(path) for path, _, _ in lines)
    for path, size, holds in lines:
        yield f"{path:<{width}}{size / 1e3:>10.1f} kB  {holds}"
