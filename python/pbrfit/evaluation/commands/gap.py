"""`pbrfit evaluate gap`."""

from __future__ import annotations

import argparse

from pbrfit.arguments import (
    DONE,
    Subcommands,
    add_out,
    add_quiet,
    progress_bar,
    unread_is_no_failure,
    whole_number,
)


def add(suites: Subcommands) -> None:
    """Add the suite to `pbrfit evaluate`."""
    added = suites.add_parser(
        "gap",
        help="the reflection model against the full reflection integral",
        description="Compare the closed form that pbrfit fits with brute-force integration of the "
        "BRDF that it stands for, over roughness, view angle and SH band. Writes report.html, "
        "heat maps, gap.csv, spheres.csv and summary.json.",
    )
    added.set_defaults(command=_run)
    add_out(added, "folder to write")
    added.add_argument("--quick", action="store_true", help="a coarser table")
    added.add_argument("--seed", type=whole_number, default=0, help="of the random lights")
    add_quiet(added)


def _run(options: argparse.Namespace) -> int:
    from pbrfit.evaluation import gap
    from pbrfit.evaluation.gap import report
    from pbrfit.output import new_folder

    effort = gap.QUICK if options.quick else gap.FULL
    with new_folder(options.out, overwrite=options.overwrite, contains=report.CONTAINS) as folder:
        with progress_bar(len(effort.r), quiet=options.quiet) as bar:

            def show(roughness: float) -> None:
                bar.set_description(f"r = {roughness:g}")
                bar.update(effort.r.index(roughness) - bar.n)

            measured = gap.measure(effort, seed=options.seed, progress=show)
            bar.update(len(effort.r) - bar.n)
        report.write(folder, measured)
    if not options.quiet:
        with unread_is_no_failure():
            print("spheres under random lights, RMSE / RMS radiance, all roughnesses together")
            for model in measured.models:
                overall = measured.overall_rmse(model)
                for material, value in zip(measured.materials, overall, strict=True):
                    print(f"{value:>8.3f}  {model}, {material.name}")
            print(
                f"\nquadrature error {measured.quadrature_error:.1e}; "
                f"look at {options.out / 'report.html'}"
            )
    return DONE
