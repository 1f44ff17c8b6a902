"""`pbrfit report`."""

from __future__ import annotations

import argparse
from pathlib import Path

from pbrfit.commands import arguments as cli
from pbrfit.report import write_report


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add its options."""
    cli.add_result(parser, "FILE", "page to write, FILE.html")
    said = "scene folder that the result was made from (default: where it was then)"
    cli.add_flags(parser, scene=cli.value("SCENE", Path, said))
    cli.add_quiet(parser)


def run(options: argparse.Namespace) -> int:
    """Write the page."""
    result = cli.read_result(options)
    write_report(result, options.out, options.scene, options.overwrite)
    size = options.out.stat().st_size / 1e6
    cli.tell(options, [f"{options.out}: {size:.1f} MB, open it in a browser"])
    return cli.DONE
