"""The gallery: fits public sets of pictures, writes their reports, thumbnails and docs/gallery.md.

    python tools/gallery.py DATA [--only NAME ...]     # half an hour on two cores
    make gallery DATA=...                              # the same, in the site's environment

DATA holds the public sets (docs/real-pictures.md). Reports and all pictures go to out/gallery, from
where `make site` takes them. Pictures of sets whose licence lets them be passed on under any terms
also go to docs/images/gallery. Fits that are there already, with the same options and version, are
kept. `--page` writes docs/gallery.md, when all entries are there.
"""

from __future__ import annotations

import argparse
import json
import shlex
import subprocess
import sys
import textwrap
from dataclasses import dataclass
from pathlib import Path

import cards

from pbrfit import DirectionalLight, Result, Scene, relight
from pbrfit.io.output import new_folder
from pbrfit.result.relighting import rendered_picture
from pbrfit_evaluation.real.sources import find_sources, write_scene

ROOT = Path(__file__).resolve().parents[1]
OUT = ROOT / "out" / "gallery"
THUMBNAILS = ROOT / "docs" / "images" / "gallery"
PAGE = ROOT / "docs" / "gallery.md"

HEIGHT = 220
"""Of a panel of a thumbnail, in pixels."""

LAMPS = {"lamp on the left": (-60.0, 30.0), "lamp on the right": (60.0, 30.0)}
"""Azimuth and elevation of lamps of our own, which none of the pictures has."""

VISIONT3LAB = "[visiont3lab/photometric_stereo](https://github.com/visiont3lab/photometric_stereo)"
BUNNY = "[yasumat/RobustPhotometricStereo](https://github.com/yasumat/RobustPhotometricStereo)"


@dataclass(frozen=True)
class Entry:
    """One fit of a set.

    Attributes
    ----------
    name
        Of its files.
    title
        Heading.
    source
        The set, as `find_sources` names it.
    about
        What to look at.
    credit
        Whose pictures, under which licence.
    passed_on
        Whether the licence lets thumbnails stand here under the project's own terms.
    options
        Of `pbrfit decompose`, beside the size.
    max_size
        Longer side of the pictures that are fitted, in pixels.
    """

    name: str
    title: str
    source: str
    about: str
    credit: str
    passed_on: bool = True
    options: tuple[str, ...] = ()
    max_size: int = 512


ENTRIES = (
    Entry(
        "figure-lamps",
        "Figure under lamps",
        "visiont3lab_shrek",
        "Told that lamps lit it, the fit finds a figure of one colour and no metal. The outline is "
        "rougher than the rest, where the given normals, estimates too, are too flat.",
        f"Pictures: {VISIONT3LAB}, MIT.",
        options=("--light", "lamps"),
        max_size=800,
    ),
    Entry(
        "figure",
        "The same figure, by default",
        "visiont3lab_shrek",
        "A failure: harmonics were taken for the likelier light, albedo pales, and metal makes up "
        "for the highlights that they lack.",
        f"Pictures: {VISIONT3LAB}, MIT.",
    ),
    Entry(
        "ball",
        "Glossy ball",
        "visiont3lab_ball3",
        "Eight lamps, a small highlight each. Only where one falls do the pictures tell roughness: "
        "rings of guesses lie between.",
        f"Pictures: {VISIONT3LAB}, MIT.",
    ),
    Entry(
        "bricks",
        "Brick sphere",
        "maxcrous_sphere_color",
        "Matt, 25 lamps. Colours look right up to the outline, but over a third of the samples is "
        "clipped, so the verdict believes none of the maps.",
        "Pictures: [maxcrous/photometric-stereo](https://github.com/maxcrous/photometric-stereo), "
        "MIT.",
    ),
    Entry(
        "kitchen",
        "Kitchen cabinet",
        "everett_kitchen2",
        "The only photographs here, 93 pixels wide: glass, chrome and bottles behind each other "
        "under a flash, with normals taken to be flat. Almost all that the model supposes is "
        "wrong.",
        "Photographs: Murmann et al., [lmurmann/multi_illumination]"
        "(https://github.com/lmurmann/multi_illumination), MIT.",
    ),
    Entry(
        "bunny",
        "Matt bunny",
        "bunny_lambert_noshadow_12",
        "Twelve lamps within 17 degrees of each other. A failure that the verdicts do not see: the "
        "pictures' colour went to the lights, and the albedo is nearly white.",
        f"Pictures: {BUNNY}, GPL-3.0.",
        passed_on=False,
    ),
    Entry(
        "glossy-bunny",
        "Glossy bunny",
        "bunny_specular_25",
        "Small highlights of up to 77 times the mean radiance, and cast shadows. Another failure "
        "that the verdicts do not see: patches become mirrors.",
        f"Pictures: {BUNNY}, GPL-3.0.",
        passed_on=False,
    ),
)

HEAD = """# Gallery

Public sets of pictures that pbrfit did not make, each fitted by the command below it. Most are
renders of others under lamps; the kitchen is photographs. Verdicts are the program's own; nobody
knows the true maps. [Real pictures](real-pictures.md) has measurements on the same sets.

<!-- not live -->
Each fit has a page with the live viewer, where you move the lamp. These pages are not part of the
repository. To make them, with the sets in a folder:

    make gallery DATA=...      # half an hour on two cores
    make site                  # takes them up

<!-- /not live -->

![A flight helmet under a lamp that goes round, two of the pictures, and the recovered albedo,
roughness and metallic](images/moving-lamp.webp)

## The helmet

Above: 16 renders of one view, fitted, and the result under a lamp that none of them has. Unlike
the sets below, its truth is known. RMSE against the renders' truth: albedo 0.068 (0.067 at the
best scale), roughness 0.155, metallic 0.342. The program calls albedo usable, roughness a rough
guide and metallic not determined: metal is also found where there is none, in the goggles and
elsewhere. The lamp casts no shadows, since no depth was given. The true normals, with those of
the textures, were given, and the fit changed them by 10 degrees in the mean, maybe as light that is
blocked or reflected by other parts passes for other normals. The lenses were left out. The
panoramas were turned any way and blurred by 25 degrees before rendering. Shadows and light
between surfaces are in the renders, denoised; the fit takes neither into account.
Another render of it, smaller and under the panoramas unblurred,
was off by 0.140, 0.183 and 0.318, with its depth given by 0.276, 0.182 and 0.278.

```sh
python tools/helmet_scene.py DATA --height 416 --samples 32
pbrfit decompose out/helmet --out out/helmet-result --model principled
python tools/moving_lamp.py
```

The model is FlightHelmet of the [glTF sample
assets](https://github.com/KhronosGroup/glTF-Sample-Assets) (Microsoft, Khronos; CC0), the
panoramas are from [Poly Haven](https://polyhaven.com), CC0; rendered by Blender's Cycles.
"""


def main() -> int:
    """Fit what is asked for."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("data", metavar="DATA", type=Path, help="folder of the public sets")
    parser.add_argument("--only", metavar="NAME", nargs="+", choices=[one.name for one in ENTRIES])
    parser.add_argument("--page", action="store_true", help="write docs/gallery.md")
    options = parser.parse_args()
    sources = {source.name: source for source in find_sources(options.data)}
    for entry in ENTRIES:
        if options.only and entry.name not in options.only:
            continue
        if entry.source not in sources:
            print(f"{entry.name}: no {entry.source} in {options.data}, left out", file=sys.stderr)
            continue
        scene = OUT / "scenes" / entry.source
        if not scene.exists():
            with new_folder(scene) as folder:
                write_scene(sources[entry.source], folder)
        result = OUT / "results" / entry.name
        pbrfit(*command(entry, scene, result), "--resume")
        pbrfit("report", result, "--out", OUT / f"{entry.name}.html", "--overwrite")
        thumbnail(entry, scene, result)
    if options.page:
        PAGE.write_text(HEAD + "".join(map(section, ENTRIES)), encoding="utf-8")
    return 0


def command(entry: Entry, scene: Path | str, result: Path | str) -> list[str]:
    """What `pbrfit` is told."""
    said = ["decompose", str(scene), "--out", str(result), "--max-size", str(entry.max_size)]
    return [*said, *entry.options]


def pbrfit(*arguments: object) -> None:
    """Run a command, which says itself what is wrong."""
    said = [str(one) for one in arguments]
    print(f"\n$ pbrfit {shlex.join(said)}", flush=True)
    subprocess.run([sys.executable, "-m", "pbrfit", *said], check=True)


def thumbnail(entry: Entry, scene_folder: Path, result_folder: Path) -> None:
    """A picture, the same rendered again and under lamps of our own; below them the maps."""
    result = Result.load(result_folder)
    picture = Scene.load(scene_folder, max_size=entry.max_size).images[0]
    white = cards.white_of(picture)
    views = {
        "a picture": cards.radiance(picture, white),
        "rendered again": cards.radiance(rendered_picture(result, 0), white),
    }
    for name, direction in LAMPS.items():
        relit = relight(result, DirectionalLight(*direction))
        views[name] = cards.radiance(relit, cards.white_of(relit))
    above = [(name, cards.shown(one, result.mask, height=HEIGHT)) for name, one in views.items()]
    sheet = cards.card([above, cards.maps_of(result, height=HEIGHT)])
    cards.save(sheet, OUT / f"{entry.name}.webp")
    if entry.passed_on:
        cards.save(sheet, THUMBNAILS / f"{entry.name}.webp")


def section(entry: Entry) -> str:
    """What the page says of it."""
    folder = OUT / "results" / entry.name
    result = Result.load(folder)
    seconds = json.loads((folder / "result.json").read_text("utf-8"))["seconds"]
    height, width = result.mask.shape
    about = f"{len(result.pictures)} pictures of {width} × {height}, {seconds:.0f} seconds"
    lines = ["", f"## {entry.title}", ""]
    if entry.passed_on:
        lines += [f"![{entry.title}: maps](images/gallery/{entry.name}.webp)", ""]
    else:
        lines += [
            "<!-- not live -->",
            "*No picture here: the licence of the set is not that of this project.*",
            "<!-- /not live -->",
            "",
        ]
    lines += [f"<!-- live: {entry.name} -->", "", filled(entry.about), ""]
    if result.uncertainty is None:
        lines += ["No verdict.", ""]
    else:
        alike: dict[tuple[str, str], list[str]] = {}
        for name, one in result.uncertainty.verdicts.items():
            alike.setdefault((one.level, one.why), []).append(f"{name} ({one.error_in_words})")
        for (level, why), maps in alike.items():
            lines.append(filled(f"- {', '.join(maps)}: **{level}**{why}"))
        lines.append("")
    said = shlex.join(command(entry, entry.source, "out"))
    lines += ["```sh", f"pbrfit {said}", "```", ""]
    lines += [filled(f"{about}. {entry.credit}"), ""]
    return "\n".join(lines)


def filled(text: str) -> str:
    """A paragraph, or an item of a list, in lines as the other pages have them."""
    indent = "  " if text.startswith("- ") else ""
    return textwrap.fill(
        text, 105, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False
    )


if __name__ == "__main__":
    sys.exit(main())
