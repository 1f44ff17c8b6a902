"""`pbrfit evaluate peers`."""

from __future__ import annotations

import argparse
from dataclasses import replace
from typing import TYPE_CHECKING, get_args

from pbrfit.acquire.weights import Device
from pbrfit.commands.arguments import Subcommands, positive, unread_is_no_failure
from pbrfit_evaluation.commands import resumable

if TYPE_CHECKING:
    from pbrfit_evaluation.peers import Method


def add(suites: Subcommands) -> None:
    """Add the suite to `pbrfit evaluate`."""
    added = suites.add_parser(
        "peers",
        help="networks that see one picture, beside our fit of all",
        description="Marigold-IID and RGB-X find materials in one picture of synthetic scenes, "
        "our fit in all pictures; errors of the maps and of pictures relit with them. A peer "
        "whose packages (pbrfit[diffusion]) or weights are missing is left out, and the report "
        "says why. Writes report.html, pictures, scenes.csv and summary.json.",
    )
    added.set_defaults(command=_run)
    resumable.add_options(added, timed=True)
    added.add_argument(
        "--scenes", metavar="K", type=positive, help="how many (default: 10, with --quick 2)"
    )
    added.add_argument(
        "--size",
        metavar="PIXELS",
        type=positive,
        help="of the pictures (default: 256, with --quick 64)",
    )
    added.add_argument(
        "--marigold",
        metavar="ID|FOLDER",
        help="Marigold-IID (default: prs-eth/marigold-iid-appearance-v1-1)",
    )
    added.add_argument("--rgbx", metavar="ID|FOLDER", help="RGB-X (default: zheng95z/rgb-to-x)")
    added.add_argument(
        "--device",
        choices=get_args(Device),
        default="auto",
        help="where peers compute; auto = a GPU, else cpu",
    )
    added.add_argument(
        "--quick", action="store_true", help="few small scenes, short fits, few sampler steps"
    )


def _run(options: argparse.Namespace) -> int:
    from pbrfit_evaluation import peers, workspace
    from pbrfit_evaluation.peers import marigold, report, rgbx

    effort = peers.QUICK if options.quick else peers.FULL
    asked = {"scenes": options.scenes, "size": options.size}
    effort = replace(effort, **{name: value for name, value in asked.items() if value is not None})
    models: dict[Method, str] = {
        "marigold": options.marigold or marigold.MODEL,
        "rgbx": options.rgbx or rgbx.MODEL,
    }
    plan = peers.plan(effort, models, options.device)
    ours = [task for method, tasks in plan.items() if method not in peers.PEERS for task in tasks]
    records = resumable.run_tasks(ours, peers.work, options, unit="fit")
    done = {record.key: record for record in records}
    for method in peers.PEERS:
        # In this process, one after another: a network is loaded once and fills a GPU.
        found = resumable.go_on(
            plan[method], peers.work, options, jobs=1, unit="picture", complaints=1
        )
        done |= {record.key: record for record in found}
    measured = [
        report.Measured(method, tasks, [done[task.key] for task in tasks])
        for method, tasks in plan.items()
    ]
    with workspace.publish(options.out) as folder:
        report.write(folder, measured, effort)
    if not options.quiet:
        with unread_is_no_failure():
            print("\n".join(report.lines(measured)))
            print(f"\nlook at {options.out / 'report.html'}")
    return resumable.exit_code([record for one in measured for record in one.expected])
