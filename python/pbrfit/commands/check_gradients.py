"""`pbrfit check-gradients`."""

from __future__ import annotations

import argparse

from pbrfit.commands import arguments as cli
from pbrfit.commands.fit_options import UNKNOWNS, add_option, add_priors, given, given_priors
from pbrfit.commands.scene_options import add_input, reading
from pbrfit.fit.gradient_check import check_gradients
from pbrfit.fit.objective import Objective
from pbrfit.scene.scene import Scene


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add its options."""
    cli.add_scene(parser, pictures=True)
    add_input(parser)
    for name in ("model", *UNKNOWNS):
        add_option(parser, name)
    add_priors(parser)
    said = "of the random point and directions"
    cli.add_flags(parser, seed=cli.value(None, cli.whole_number, said, default=0))


def run(options: argparse.Namespace) -> int:
    """Print both gradients, function by function."""
    scene = Scene.load(cli.scene_named(options.scene), reading(options))
    objective = Objective(
        scene,
        sh_order=options.sh_order,
        metallic=given(options, "metallic"),
        mono_light=options.mono_light,
        priors=given_priors(options),
        equal_exposures=given(options, "equal_exposures"),
        model=options.model,
    )
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
    return cli.SOME_FAILED if failed else cli.DONE
