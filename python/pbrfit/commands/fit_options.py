"""Options of a fit, what they ask for, and how it is shown."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from pbrfit.commands.arguments import add_threads, given_priors, progress_bar, whole_number
from pbrfit.fit.robust import LOSSES
from pbrfit.fit.solvers import SOLVERS
from pbrfit.model.reflection import DEFAULT_MODEL, MODELS
from pbrfit.result.refinement import CHOICES

if TYPE_CHECKING:
    from pbrfit.batch.settings import Fitting
    from pbrfit.fit.decompose import Progress

EXPOSURES = {"auto": None, "as-is": False, "equal": True}
"""`equal_exposures` by what it is called here."""


def add_solver(parser: argparse.ArgumentParser) -> None:
    """Add what says how long is fitted."""
    parser.add_argument(
        "--solver",
        choices=SOLVERS,
        default="auto",
        help="auto: Gauss-Newton, then L-BFGS where there is more to minimise than squares; "
        "gauss-newton: squares and the material prior; lbfgsb: the paper's recipe "
        "(default: %(default)s)",
    )
    parser.add_argument("--iterations", metavar="K", type=int, default=500, help="at most so many")
    parser.add_argument(
        "--time-limit",
        metavar="S",
        type=float,
        help="stop the fit of a scene after so many seconds (default: none)",
    )
    add_threads(parser)


def add_seed(parser: argparse.ArgumentParser) -> None:
    """Add `--seed`."""
    parser.add_argument(
        "--seed",
        metavar="SEED",
        type=whole_number,
        default=0,
        help="of what a fit draws at random: pixels on which lights are sought "
        "(default: %(default)s)",
    )


MODELS_IN_WORDS = (
    "paper: the paper's approximation (eq. 12); principled: the BRDF of Blender's Principled node, "
    "glTF and game engines, integrated exactly"
)
"""What the values of `--model` mean."""


def add_model(parser: argparse.ArgumentParser, default: str | None = None) -> None:
    """Add `--model`; without it the scene decides, unless there is a `default`."""
    meaning = f"how surfaces reflect light. {MODELS_IN_WORDS}"
    if default is None:
        meaning += (
            f" (default: what the scene was rendered with, where it says so, else {DEFAULT_MODEL})"
        )
    parser.add_argument("--model", choices=MODELS, default=default, help=meaning)


def add_unknowns(parser: argparse.ArgumentParser, what_order: str) -> None:
    """Add what says what is fitted."""
    add_sh_order(parser, what_order)
    parser.add_argument(
        "--metallic",
        choices=("free", "0"),
        default="free",
        help="0: no pixel is a metal, and metallic is not fitted",
    )
    parser.add_argument(
        "--robust",
        choices=LOSSES,
        default="none",
        help="loss that shadows and other outliers pull less at than at squares",
    )
    parser.add_argument(
        "--exposures",
        choices=EXPOSURES,
        default="auto",
        help="equal: pictures are divided by their mean radiance, so that bright ones do not "
        "outweigh dark ones; as-is: they are not; auto: where one has more than 4 times the mean "
        "of another",
    )

    parser.add_argument(
        "--mono-light",
        action="store_true",
        help="lights are grey: the same in all colour channels",
    )


def add_refinement(parser: argparse.ArgumentParser) -> None:
    """Add `--refine-normals`."""
    parser.add_argument(
        "--refine-normals",
        choices=CHOICES,
        default="auto",
        help="fit the normals too, from three pictures on; auto: where the pictures say that the "
        "given ones are wrong (default: %(default)s)",
    )


def add_sh_order(parser: argparse.ArgumentParser, what: str) -> None:
    """Add `--sh-order`."""
    parser.add_argument("--sh-order", type=int, choices=(2, 3), default=3, help=what)


def metallic(options: argparse.Namespace) -> float | None:
    """Metallic of all pixels that `--metallic` asks for."""
    return None if options.metallic == "free" else float(options.metallic)


def fitting(options: argparse.Namespace) -> Fitting:
    """What the options ask for."""
    from pbrfit.batch.settings import Fitting

    return Fitting(
        solver=options.solver,
        iterations=options.iterations,
        time_limit=options.time_limit,
        sh_order=options.sh_order,
        metallic=metallic(options),
        mono_light=options.mono_light,
        priors=given_priors(options),
        robust=options.robust,
        equal_exposures=EXPOSURES[options.exposures],
        refine_normals=options.refine_normals,
        seed=options.seed,
        model=options.model,
    )


@contextmanager
def fit_bar(
    iterations: int, name: str, *, quiet: bool, within: bool = False
) -> Iterator[Callable[[Progress], None]]:
    """Show how a fit goes on, on a line that goes away where it is `within` another one's.

    A large picture's lights take iterations; after that tiles are counted, which tell how much time
    is left.
    """
    with progress_bar(iterations, quiet=quiet, name=name, leave=not within) as bar:

        def show(progress: Progress) -> None:
            bar.set_postfix_str(f"recon {progress.recon_rmse:.2e}", refresh=False)
            done = progress.iteration
            if progress.tiles is not None:
                done, of = progress.tiles
                if done == 0:
                    bar.unit = "tile"
                    bar.reset(of)
            bar.update(done - bar.n)

        yield show
        # Most fits need fewer iterations than they may do: then the bar was all of them.
        bar.total = bar.n
        bar.refresh()
