"""Decompose pictures that were not made with pbrfit's own model.

    python examples/real_pictures.py DATA --out DIR

turns public sets of pictures into scene folders (docs/formats.md) and gives them to the public
command, `pbrfit decompose`. DATA is the folder of one set, or a folder that holds several:
`bunny_ps`, `visiont3lab_shrek`, ... What comes out, and what to think of it:
docs/heldout.md.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
from collections.abc import Iterable
from pathlib import Path

from pbrfit import InputError
from pbrfit.io.output import new_folder
from pbrfit_evaluation.heldout.public_sets import SETS, PublicSet
from pbrfit_evaluation.heldout.sources import absent, find_sources, write_scene


def main() -> int:
    """Run the example; returns 0, or 2 if there was nothing to decompose."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("data", metavar="DATA", type=Path, help="folder of the data")
    parser.add_argument("--out", metavar="DIR", type=Path, required=True, help="folder to write")
    parser.add_argument("--iterations", metavar="K", type=int, default=500)
    parser.add_argument("--max-size", metavar="PIXELS", type=int)
    parser.add_argument("--overwrite", action="store_true", help="replace what an earlier run left")
    options = parser.parse_args()

    scenes: list[Path] = []
    try:
        sources = [one for one in find_sources(options.data) if one.kind in SETS]
        tell_origins(options.data, absent(options.data, sources))
        for source in sources:
            path = options.out / source.name / "scene"
            with new_folder(path, overwrite=options.overwrite) as folder:
                write_scene(source, folder)
            print(f"{path}: {source.pictures} pictures; {source.about}")
            scenes.append(path)
    except (InputError, OSError) as error:
        print(f"real_pictures: {error}", file=sys.stderr)
        if not scenes:
            tell_origins(options.data, SETS.values())
        return 2
    for scene in scenes:
        result = scene.with_name("result")
        command = [sys.executable, "-m", "pbrfit", "decompose", str(scene), "--out", str(result)]
        command += ["--iterations", str(options.iterations)]
        if options.max_size is not None:
            command += ["--max-size", str(options.max_size)]
        if options.overwrite:
            command.append("--overwrite")
        print(f"\n$ pbrfit {' '.join(command[3:])}", flush=True)
        code = subprocess.run(command, check=False).returncode
        if code:
            return code
        print(f"preview: {result / 'preview.png'}")
    return 0 if scenes else 2


def tell_origins(data: Path, sets: Iterable[PublicSet]) -> None:
    """Say where sets that are not there come from."""
    for one in sets:
        print(f"{data / one.kind}: not there, left out. It is: {one.origin}")


if __name__ == "__main__":
    sys.exit(main())
