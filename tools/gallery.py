"""The gallery: fits public sets of pictures, writes their reports, loops and docs/gallery.md.

    python tools/gallery.py DATA [--only NAME ...]     # 25 minutes on two cores
    make gallery DATA=...                              # the same, in the site's environment

DATA holds scene folders, as tools/gallery_sets.py writes them, and public sets
(docs/heldout.md). Of each set some pictures are held out; the others are fitted, and the
light of the held-out ones is fitted to the result. Reports and all pictures go to out/gallery, from
where `make site` takes them. Loops of sets whose licence is that of this project also go to
docs/images/gallery. Fits that are there already, with the same options and version, are kept.
`--page` writes docs/gallery.md and docs/evidence/gallery.json, of the entries that are there.
"""

from __future__ import annotations

import argparse
import json
import shlex
import shutil
import subprocess
import sys
import textwrap
from dataclasses import dataclass, field
from pathlib import Path

import moving_lamp
import numpy as np

from pbrfit import Result, Scene
from pbrfit.io.lamp_files import find_lamps
from pbrfit.io.output import new_folder
from pbrfit.result.relighting import relight
from pbrfit.scene.folder import locate
from pbrfit_evaluation.heldout.baselines import Baseline, explained_by_kept
from pbrfit_evaluation.heldout.light import explained_by, relative_error
from pbrfit_evaluation.heldout.measure import Split, judged_at
from pbrfit_evaluation.heldout.sources import find_sources, write_scene
from pbrfit_evaluation.report import evidence
from pbrfit_evaluation.suite import Row, Table, Value, digits

ROOT = Path(__file__).resolve().parents[1]
OUT = ROOT / "out" / "gallery"
LOOPS = ROOT / "docs" / "images" / "gallery"
PAGE = ROOT / "docs" / "gallery.md"

HEIGHT = 300
"""Height of the relit picture of a loop, in pixels."""

FRAMES = 24

REAL_RTI = "[Univr-RTI/RealRTI](https://github.com/Univr-RTI/RealRTI), no licence stated"
SHAPE = "[dlichy/ShapeAndMaterial](https://github.com/dlichy/ShapeAndMaterial), no licence stated"
VISIONT3LAB = (
    "Renders: [visiont3lab/photometric_stereo]"
    "(https://github.com/visiont3lab/photometric_stereo), MIT."
)
NORMAL_PHOTOS = (
    "Photographs: Mika I., [mikatalk/photo-normal-map]"
    "(https://github.com/mikatalk/photo-normal-map), MIT."
)
LAMPS = ("--light", "lamps")


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
    shown
        Whether the licence is that of this project, so that pictures may stand in it.
    options
        Of `pbrfit decompose`, beside the size.
    max_size
        Longer side of the pictures that are fitted, in pixels.
    held_out
        Numbers of the pictures that are held out; empty = a quarter, evenly.
    most_kept
        Pictures that are fitted at most, evenly chosen: a dome of lamps gives five times as many.
    inputs
        Which two of the fitted pictures are shown; empty = the first and the middle one.
    """

    name: str
    title: str
    source: str
    about: str
    credit: str
    shown: bool = True
    options: tuple[str, ...] = LAMPS
    max_size: int = 256
    held_out: tuple[int, ...] = field(default=())
    most_kept: int = 10
    inputs: tuple[int, ...] = ()


ENTRIES = (
    Entry(
        "sand",
        "Sand",
        "sand",
        "Four photographs with a lamp at each side, directions unknown, become relief that any "
        "lamp can light. Sparkling grains pass for gloss; the verdict does not trust the "
        "roughness. The picture lit from the front was held out.",
        NORMAL_PHOTOS,
        max_size=512,
        held_out=(1,),
        inputs=(1, 3),
    ),
    Entry(
        "icon",
        "Painted icon with gold leaf",
        "icon",
        "A failure that the verdict does not see: gold leaf is not found to be metal. The panel "
        "is flat, so that each lamp shows little but a sheet of gloss. Face and ground differ in "
        "roughness. The pictures are read as linear, for the known lamps fit so.",
        "Photographs: Scan4Reco project, in [Univr-RTI/NeuralRTI]"
        "(https://github.com/Univr-RTI/NeuralRTI), MIT.",
        options=(*LAMPS, "--fov", "0"),
        max_size=180,
        most_kept=20,
        inputs=(2, 12),
    ),
    Entry(
        "paper",
        "Folded paper",
        "paper",
        "Folds of a few degrees. Where the lamp at the left was near, the sheet bends away: "
        "without an outline nothing tells the tilt of the whole from the lamps. The picture lit "
        "from the front was held out.",
        NORMAL_PHOTOS,
        held_out=(1,),
        inputs=(1, 3),
    ),
    Entry(
        "stones",
        "Stones",
        "stones",
        "A failure: three near lamps light neighbouring stones from different sides, which far "
        "ones cannot do, gaps that no lamp reaches become metal, and the held-out picture is "
        "hardly explained.",
        "Photographs: Christian Petry, [cpetry/NormalMap-Online]"
        "(https://github.com/cpetry/NormalMap-Online), MIT.",
        held_out=(0,),
    ),
    Entry(
        "kitchen",
        "Kitchen cabinet",
        "everett_kitchen2",
        "A failure in its maps: 93 pixels wide, glass, chrome and bottles behind each other, "
        "normals assumed flat. Its light is still explained better than by either baseline.",
        "Photographs: Murmann et al., [lmurmann/multi_illumination]"
        "(https://github.com/lmurmann/multi_illumination), MIT.",
        options=(),
    ),
    Entry(
        "figure-lamps",
        "Figure",
        "visiont3lab_shrek",
        "Told that lamps lit it, the fit finds one colour and no metal. The outline is rougher "
        "than the rest, where the given normals, estimates too, are too flat.",
        VISIONT3LAB,
    ),
    Entry(
        "figure",
        "The same figure, by default",
        "visiont3lab_shrek",
        "A failure: harmonics were taken for the likelier light, albedo pales, and metal makes "
        "up for the highlights that they lack.",
        VISIONT3LAB,
        options=(),
    ),
    Entry(
        "ball",
        "Glossy ball",
        "visiont3lab_ball3",
        "Eight lamps, a small highlight each. Only where one falls do the pictures tell "
        "roughness: rings of guesses lie between.",
        VISIONT3LAB,
    ),
    Entry(
        "mug",
        "Glazed mug",
        "mug",
        "A failure: from four pictures the glaze is taken for rough, and its highlights for "
        "white spots.",
        SHAPE,
        shown=False,
    ),
    Entry(
        "pumpkin",
        "Painted pumpkin",
        "pumpkin",
        "A failure: from four pictures with cast shadows normals come in steps, and colours burn "
        "out.",
        SHAPE,
        shown=False,
    ),
    Entry(
        "leaves",
        "Leaves",
        "leaves",
        "A failure: the lamps were near, and leaves far from them become metal.",
        "[YertleTurtleGit/photometric-stereo-mappings]"
        "(https://github.com/YertleTurtleGit/photometric-stereo-mappings), GPL-3.0",
        shown=False,
    ),
    Entry(
        "jacket",
        "Cloth jacket",
        "jacket",
        "",
        "[YertleTurtleGit/scanning-pipeline]"
        "(https://github.com/YertleTurtleGit/scanning-pipeline), GPL-3.0",
        shown=False,
        options=(),
    ),
    Entry("door", "Painted door", "door", "", REAL_RTI, shown=False, max_size=144),
    Entry("canvas", "Canvas painting", "canvas", "", REAL_RTI, shown=False, max_size=144),
    Entry("fresco", "Fresco fragment", "fresco", "", REAL_RTI, shown=False, max_size=144),
    Entry(
        "clay",
        "Clay relief",
        "clay",
        "A shell pressed into clay: one albedo, no metal.",
        REAL_RTI,
        shown=False,
        max_size=144,
    ),
    Entry(
        "coin",
        "Coin",
        "coin",
        "Metal is found on the coin and not on the paper beside it.",
        REAL_RTI,
        shown=False,
        max_size=144,
    ),
    Entry(
        "statue",
        "Bronze statue",
        "statue",
        "Patinated bronze with cast shadows.",
        REAL_RTI,
        shown=False,
        max_size=144,
    ),
)


def main() -> int:
    """Fit what is asked for."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("data", metavar="DATA", type=Path, nargs="+", help="folders of the sets")
    parser.add_argument("--only", metavar="NAME", nargs="+", choices=[one.name for one in ENTRIES])
    parser.add_argument("--page", action="store_true", help="write docs/gallery.md")
    options = parser.parse_args()
    sources = {source.name: source for data in options.data for source in find_sources(data)}
    for entry in ENTRIES:
        if options.only and entry.name not in options.only:
            continue
        if entry.source not in sources:
            print(f"{entry.name}: no {entry.source}, left out", file=sys.stderr)
            continue
        whole = OUT / "scenes" / entry.source
        if not whole.exists():
            source = sources[entry.source]
            with new_folder(whole) as folder:
                if source.kind == "scene":
                    shutil.copytree(source.folder, folder, dirs_exist_ok=True)
                else:
                    write_scene(source, folder)
        which = chosen(entry, len(locate(whole).pictures))
        kept = OUT / "kept" / entry.name / entry.source
        if not kept.exists():
            with new_folder(kept) as folder:
                write_kept(whole, which, folder)
        result = OUT / "results" / entry.name
        pbrfit(*command(entry, kept, result), "--resume")
        pbrfit("report", result, "--out", OUT / f"{entry.name}.html", "--overwrite")
        scores = OUT / "scores" / f"{entry.name}.json"
        scores.parent.mkdir(exist_ok=True)
        scores.write_text(json.dumps(score(whole, which, Result.load(result))), encoding="utf-8")
        loop(entry, which, Result.load(result))
    if options.page:
        write_page()
    return 0


def chosen(entry: Entry, pictures: int) -> Split:
    """Which pictures are fitted, and which are held out."""
    held_out = entry.held_out or tuple(range(1, pictures, 4))
    others = [i for i in range(pictures) if i not in held_out]
    count = min(entry.most_kept, len(others))
    at = np.linspace(0, len(others) - 1, count).round().astype(int)
    return Split(tuple(others[i] for i in at), held_out)


def write_kept(whole: Path, which: Split, folder: Path) -> None:
    """Write the scene folder of the pictures that are fitted."""
    shutil.copytree(whole, folder, dirs_exist_ok=True)
    pictures = locate(folder).pictures
    names = {pictures[i].stem.lower() for i in which.kept}
    for path in pictures:
        if path.stem.lower() not in names:
            path.unlink()
    for lamps in find_lamps(folder)[:1]:
        lines = lamps.read_text(encoding="utf-8").splitlines()[1:]
        kept = [line for line in lines if Path(line.split()[0]).stem.lower() in names]
        lamps.write_text("\n".join([str(len(kept)), *kept, ""]), encoding="utf-8")


def command(entry: Entry, scene: Path | str, result: Path | str) -> list[str]:
    """What `pbrfit` is told."""
    said = ["decompose", str(scene), "--out", str(result), "--max-size", str(entry.max_size)]
    return [*said, *entry.options]


def pbrfit(*arguments: object) -> None:
    """Run a command, which says itself what is wrong."""
    said = [str(one) for one in arguments]
    print(f"\n$ pbrfit {shlex.join(said)}", flush=True)
    subprocess.run([sys.executable, "-m", "pbrfit", *said], check=True)


def score(whole: Path, which: Split, result: Result) -> dict[str, float]:
    """Errors of the held-out pictures over their RMS, all together: ours and those beside it."""
    height, width = result.mask.shape
    scene = Scene.load(whole, fov=result.fov, max_size=max(height, width))
    scene = judged_at(scene, scene.valid)
    lamps = scene.lamps
    ways: tuple[Baseline, ...] = (
        "nearest",
        "lambert",
        *(("lambert-known",) if lamps is not None else ()),
    )
    errors = {
        way: relative_error(explained_by_kept(way, scene, which.kept, which.held_out, lamps)[0])
        for way in ways
    }
    return {
        "kept": len(which.kept),
        "held_out": len(which.held_out),
        "known_lamps": float(lamps is not None),
        "ours": relative_error(explained_by(result, scene, which.held_out)),
        "nearest": errors["nearest"],
        "lambert": min(error for way, error in errors.items() if way != "nearest"),
    }


def loop(entry: Entry, which: Split, result: Result) -> None:
    """Write the result under a lamp that goes round, beside two pictures and the maps.

    The pictures of others stay where they come from: shown is how the fit explains two of them.
    """
    at = entry.inputs or (0, len(which.kept) // 2)
    pictures = [relight(result, picture=i) for i in at]
    names = [f"picture {i + 1}, as fitted" for i in at]
    frames = moving_lamp.frames_of(result, pictures, names, count=FRAMES, height=HEIGHT)
    path = OUT / f"{entry.name}.webp"
    moving_lamp.save(frames, path, quality=48)
    if entry.shown:
        LOOPS.mkdir(exist_ok=True)
        shutil.copyfile(path, LOOPS / path.name)


HEAD = """# Gallery

Photographs from public sets, each of one view under several lights; nobody knows the true maps. A
loop shows two pictures as the fit explains them; the photographs stay with their sources.

<!-- not live -->
Each fit has a page with the live viewer: `python tools/gallery_sets.py CHECKOUTS DATA` (it lists
repositories and commits), `make gallery DATA=...`, `make site`.

<!-- /not live -->

Errors of held-out pictures are RMSE over RMS as in [heldout](heldout.md); 1 would be black.
*Lambert* is the best of rank three or, if better, with known lamps (icon and RealRTI; pbrfit has
them too). Of large domes ten pictures were fitted, of the icon twenty.

<!-- evidence: gallery/Held out -->
<!-- /evidence -->
"""

TAIL = """
## Without pictures here

These repositories state no licence, or another one than this project's.

<!-- evidence: gallery/Without pictures here | ours | nearest picture | Lambert | what it shows; source -->
<!-- /evidence -->
"""  # noqa: E501


def write_page() -> None:
    """Write docs/gallery.md, and the table of held-out errors that stands in it."""
    there = [entry for entry in ENTRIES if (OUT / "scores" / f"{entry.name}.json").is_file()]
    shown = [entry for entry in there if entry.shown]
    text = HEAD + "".join(map(section, shown)) + TAIL
    PAGE.write_text(text, encoding="utf-8")
    rows = [row_of(entry) for entry in there]
    evidence.record(
        ROOT / "docs",
        "gallery",
        command="python tools/gallery.py DATA --page",
        protocol="pbrfit-gallery-2: some pictures of each set fitted; of the others the light "
        "alone, RMSE over their RMS, in values of their files, clipped samples left out",
        tables={
            "Held out": table(shown),
            "Without pictures here": table([entry for entry in there if not entry.shown]),
        },
        rows=rows,
    )


def row_of(entry: Entry) -> Row:
    """Every number of an entry."""
    scores = json.loads((OUT / "scores" / f"{entry.name}.json").read_text("utf-8"))
    folder = OUT / "results" / entry.name
    result = Result.load(folder)
    seconds = json.loads((folder / "result.json").read_text("utf-8"))["seconds"]
    height, width = result.mask.shape
    return Row(
        entry.name, 1, None, {**scores, "width": width, "height": height, "seconds": seconds}
    )


def table(entries: list[Entry]) -> Table:
    """Held-out errors, and the verdicts in short."""
    lines: list[list[Value]] = []
    for entry in entries:
        result = Result.load(OUT / "results" / entry.name)
        metrics = row_of(entry).metrics
        verdicts = [] if result.uncertainty is None else result.uncertainty.verdicts.items()
        alike: dict[str, list[str]] = {}
        for name, one in verdicts:
            alike.setdefault(one.level, []).append(f"{name} {one.error_in_words}")
        errors = {name: metrics[name] or 0.0 for name in ("ours", "nearest", "lambert")}
        least = min(errors.values())
        marked = [
            f"**{digits(error)}**" if error == least else digits(error) for error in errors.values()
        ]
        told = "; ".join(f"{level}: {', '.join(maps)}" for level, maps in alike.items())
        about = [] if entry.shown else [f"{entry.about} {entry.credit}"]
        split = f"{metrics['kept']:.0f} / {metrics['held_out']:.0f}"
        lines.append([entry.title, split, *marked, told, *about])
    more = [] if all(entry.shown for entry in entries) else ["what it shows; source"]
    head = ["scene", "kept / held out", "ours", "nearest picture", "Lambert", "verdict", *more]
    return Table(head, lines)


def section(entry: Entry) -> str:
    """What the page says of an entry whose pictures stand here."""
    lines = ["", f"## {entry.title}", ""]
    lines += [
        f"![{entry.title}: two pictures, maps, and under a lamp](images/gallery/{entry.name}.webp)",
        "",
    ]
    lines += [f"<!-- live: {entry.name} -->", "", filled(entry.about), ""]
    said = shlex.join(command(entry, entry.source, "out"))
    lines += ["```sh", f"pbrfit {said}", "```", "", filled(entry.credit), ""]
    return "\n".join(lines)


def filled(text: str) -> str:
    """A paragraph, or an item of a list, in lines as the other pages have them."""
    indent = "  " if text.startswith("- ") else ""
    return textwrap.fill(
        text, 105, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False
    )


if __name__ == "__main__":
    sys.exit(main())
