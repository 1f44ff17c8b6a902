"""Flags of a fit, made from `FitOptions`."""

from __future__ import annotations

import argparse
from collections.abc import Collection, Mapping
from dataclasses import fields, replace
from typing import Any

from pbrfit.commands import arguments as cli
from pbrfit.result.options import FLAGS, FitOptions, Priors, described, prior_names

DEFAULTS = {one.name: one.default for one in fields(FitOptions)}

UNKNOWNS = ("sh_order", "metallic", "equal_exposures", "mono_light")
"""Options that say which unknowns there are and how pictures count."""

DESCRIBED = described(FitOptions)

MODEL_OF_PICTURES, _, _ = DESCRIBED.get("model", "").partition(" Default:")
"""Help of `--model` where pictures are rendered with it."""


def add_fit_options(parser: Any, *, there: Collection[str] = ()) -> None:
    """Add all flags of a fit, those of the priors and `--threads`; `fit_options` reads them.

    Options of the names in `there` have flags already.
    """
    for name in FLAGS:
        if name not in there:
            add_option(parser, name)
    add_priors(parser)
    cli.add_threads(parser)


def add_option(parser: Any, name: str, said: str | None = None, default: Any = None) -> None:
    """Add the flag of one option, perhaps with a help or a default of its own."""
    flag = FLAGS[name]
    said = said or flag.help or DESCRIBED.get(name, "")
    default = DEFAULTS[name] if default is None else default
    if flag.kind is bool:
        arguments = cli.switch(said)
    elif flag.values is None:
        arguments = cli.value(flag.metavar, flag.kind, said, default=default)
    else:
        if isinstance(flag.values, Mapping):
            default = next(word for word, meant in flag.values.items() if meant == default)
        kind = int if isinstance(default, int) else str
        arguments = cli.choice(tuple(flag.values), said, type=kind, default=default)
    cli.add_flags(parser, **{flag.name or name: {"dest": name, **arguments}})


def given(options: argparse.Namespace, name: str) -> Any:
    """The value that an option was given on the command line."""
    value, values = getattr(options, name), FLAGS[name].values
    return values[value] if isinstance(values, Mapping) else value


def fit_options(options: argparse.Namespace) -> FitOptions:
    """What the flags of `add_fit_options` ask for."""
    asked = {name: given(options, name) for name in FLAGS if hasattr(options, name)}
    found = FitOptions(**asked, priors=given_priors(options))
    found.check_priors()
    return found


def add_priors(parser: Any) -> None:
    """Add `--prior` and `--no-priors`; `given_priors` reads them."""
    said = f"weight of a prior ({', '.join(prior_names())}); 0 leaves it out; can be repeated"
    cli.add_flags(
        parser,
        prior=cli.value("NAME=WEIGHT", prior_weight, said, dest="prior_weights", action="append"),
        no_priors=cli.switch("only the priors that --prior names"),
    )


def given_priors(options: argparse.Namespace) -> Priors:
    """Priors that `--prior` and `--no-priors` ask for."""
    priors = Priors.none() if options.no_priors else Priors()
    return replace(priors, **dict(options.prior_weights or ()))


def prior_weight(text: str) -> tuple[str, float]:
    """Read NAME=WEIGHT for `argparse`."""
    name, _, weight = text.partition("=")
    try:
        return name, getattr(Priors(**{name: float(weight)}), name)
    except (TypeError, ValueError):
        expected = f"NAME=WEIGHT with one of {', '.join(prior_names())} and a weight of 0 or more"
        raise argparse.ArgumentTypeError(f"expected {expected}, found {text!r}") from None
