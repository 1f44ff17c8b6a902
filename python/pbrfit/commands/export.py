"""`pbrfit export`."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from pbrfit._core import InputError
from pbrfit.commands.arguments import (
    DONE,
    Subcommands,
    add_command,
    add_quiet,
    add_result,
    unread_is_no_failure,
)

if TYPE_CHECKING:
    from pbrfit.export import Exported


def add(commands: Subcommands) -> None:
    """Add the command to `pbrfit`."""
    added = add_command(
        commands, "export", _run, "write a result for Blender, Unreal, Unity and others"
    )
    add_result(added, "DIR", "folder to write")
    added.add_argument(
        "--format",
        choices=("gltf", "exr", "png"),
        help="this one alone (default: those of the preset, else all)",
    )
    added.add_argument(
        "--preset",
        choices=("blender", "unreal", "unity"),
        help="textures with the names, channels and normals that a tool expects (default: a file "
        "a map)",
    )
    added.add_argument(
        "--normals",
        choices=("opengl", "directx"),
        help="green of normal maps upwards or downwards (default: as the preset says, else opengl)",
    )
    added.add_argument(
        "--bits",
        type=int,
        choices=(8, 16),
        help="of PNG files and of textures in glTF (default: as the preset says, else 16, and in "
        "glTF 16 for normals alone)",
    )
    added.add_argument(
        "--geometry",
        choices=("card", "facets"),
        help="of glTF: a card with a normal texture, or a rectangle a pixel, turned to its normal, "
        "for path tracers (default: card)",
    )
    add_quiet(added)


def _run(options: argparse.Namespace) -> int:
    from pbrfit.export import CONTAINS, export_result
    from pbrfit.io.output import check_free
    from pbrfit.result.result import Result

    if options.result.resolve().is_relative_to(options.out.resolve()):
        raise InputError(
            f"{options.out}: expected a folder apart from the result, found {options.result}"
        )
    check_free(options.out, overwrite=options.overwrite, contains=CONTAINS)
    exported = export_result(
        Result.load(options.result),
        options.out,
        format=options.format,
        preset=options.preset,
        normals=options.normals,
        bits=options.bits,
        geometry=options.geometry,
        overwrite=options.overwrite,
    )
    if not options.quiet:
        with unread_is_no_failure():
            _tell(exported, options.out)
    return DONE


def _tell(exported: Exported, out: Path) -> None:
    """List the files; panoramas, of which there may be many, in one line."""
    total = sum(file.size for file in exported.files)
    print(f"{out}: {len(exported.files) + 1} files, {total / 1e6:.2f} MB")
    of_lights = {f"lights/{light.file}" for light in exported.panoramas}
    lines = [
        (file.path, file.size, file.holds) for file in exported.files if file.path not in of_lights
    ]
    worst = max(exported.panoramas, key=lambda light: light.difference)
    remark = (
        f"; without negative light, at most {worst.difference:.1%} different ({worst.picture})"
        if worst.difference > 0
        else ""
    )
    size = sum(file.size for file in exported.files if file.path in of_lights)
    lines.append((f"lights/*.exr ({len(of_lights)})", size, f"a panorama a light{remark}"))
    width = max(len(path) for path, _, _ in lines)
    for path, size, holds in lines:
        print(f"{path:<{width}}{size / 1e3:>10.1f} kB  {holds}")
