"""`pbrfit check-gradients`."""

from __future__ import annotations

import argparse
from pathlib import Path

from pbrfit.commands.arguments import (
    DONE,
    SOME_FAILED,
    Subcommands,
    add_command,
    add_priors,
    given_priors,
    whole_number,
)
from pbrfit.commands.fit_options import UNKNOWNS, add_option, given
from pbrfit.commands.scene_options import add_input, load


def add(commands: Subcommands) -> None:
    """Add the command to `pbrfit`."""
    added = add_command(
        commands, "check-gradients", _run, "compare the gradient with finite differences"
    )
    added.add_argument("scene", metavar="SCENE", type=Path, help="scene folder")
    add_input(added)
    for name in ("model", *UNKNOWNS):
        add_option(added, name)
    add_priors(added)
    added.add_argument(
        "--seed", type=whole_number, default=0, help="of the random point and directions"
    )


def _run(options: argparse.Namespace) -> int:
    from pbrfit.fit.gradient_check import check_gradients
    from pbrfit.fit.objective import Objective

    scene = load(options.scene, options)
    objective = Objective(
        scene,
        sh_order=options.sh_order,
        metallic=given(options, "metallic"),
        mono_light=options.mono_light,
        priors=given_priors(options),
        equal_exposures=given(options, "equal_exposures"),
        model=options.model,
    )
    objective.robust = objective.robust_around(objective.start(), options.robust)
    checks = check_gradients(objective, seed=options.seed)
    print(f"{'function':<12}{'unknowns':<12}{'analytic':>16}{'numeric':>16}{'relative error':>16}")
    for check in checks:
        verdict = "" if check.passed else "   differs"
        print(
            f"{check.function:<12}{check.unknowns:<12}{check.analytic:>16.8e}{check.numeric:>16.8e}"
            f"{check.relative_error:>16.1e}{verdict}"
        )
    failed = sum(not check.passed for check in checks)
    print(f"{len(checks) - failed} of {len(checks)} within {checks[0].tolerance:g}")
    return SOME_FAILED if failed else DONE
