"""Options of a fit: said once, for `decompose`, for `result.json`, for batches and for flags."""

from __future__ import annotations

import inspect
import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields
from typing import Any, Literal, get_args, get_origin, get_type_hints

import numpy as np

from pbrfit._core import InputError
from pbrfit.model.reflection import MODELS, Model, checked_model, whole_number
from pbrfit.result.refinement import RefineNormals
from pbrfit.values.checks import finite, of_what, one_of

Solver = Literal["gauss-newton", "lbfgsb"]
SOLVERS: tuple[Solver, ...] = get_args(Solver)

Loss = Literal["auto", "none"]
Align = Literal["auto", "off"]
TransportChoice = Literal["none", "occlusion", "bounce", "auto"]
LightChoice = Literal["sh", "lamps", "auto"]
Response = Literal["auto", "srgb", "linear", "fit"]

WHITE_ALBEDO = 0.9
"""Albedo of a white reference of which none is given: the white patch of a ColorChecker has a
density of 0.05 (C. McCamy, H. Marcus and J. Davidson, J. Appl. Photogr. Eng. 2, 1976)."""


@dataclass(frozen=True)
class Priors:
    """Weights of the priors, beside a data term that is a mean over samples; 0 = not evaluated.

    A weight means the same at any resolution, exposure and number of pictures. docs/fit.md says
    when each prior helps and when it hurts.

    Attributes
    ----------
    material
        Strength of the mixture prior on roughness and metallic that is fitted for each segment; 1
        is Bayes' rule. None = 1, but 0 where left-out pictures are explained no worse without.
    cohesion
        Weight of the squared distance of roughness and metallic to their segment's mean.
    smoothness
        Weight of the squared change of roughness and metallic between neighbours.
    sparsity
        Weight of metallic itself.
    monochrome
        Weight of the squared deviation of lights from grey; None = chosen from the fitted lights.

    Raises
    ------
    InputError
        If a weight is no finite number of 0 or more.
    """

    material: float | None = None
    cohesion: float = 0.0
    smoothness: float = 0.0
    sparsity: float = 0.0
    monochrome: float | None = None

    def __post_init__(self) -> None:
        expected = "a finite weight, 0 or more"
        for name in prior_names():
            value = getattr(self, name)
            if name in ("material", "monochrome") and value is None:
                continue
            object.__setattr__(self, name, finite(f"prior {name}", value, expected, 0.0))

    @property
    def material_strength(self) -> float:
        """Strength of the mixture prior where there is one."""
        return 1.0 if self.material is None else self.material

    @classmethod
    def none(cls) -> Priors:
        """All weights 0."""
        return cls(**dict.fromkeys(prior_names(), 0.0))


def prior_names() -> tuple[str, ...]:
    """Names of the weights in `Priors`."""
    return tuple(one.name for one in fields(Priors))


@dataclass(frozen=True)
class Flag:
    """How the command line asks for an option."""

    help: str = ""
    """What it does, in words; empty = what `FitOptions` says of the field."""
    name: str | None = None
    """Without dashes, where it is not the field's."""
    values: Mapping[str, Any] | Sequence[Any] | None = None
    """The values that it takes, or what the words that it takes stand for; None = any."""
    kind: Callable[[str], Any] = int
    """How a text is read where there are no `values`; bool for a switch."""
    metavar: str | None = None
    """What stands for the value in the help."""


@dataclass(frozen=True)
class FitOptions:
    """Options of `decompose` that change the result.

    Attributes
    ----------
    solver
        `"gauss-newton"`: joint steps of lights and materials; above 2 MP, or where memory is short,
        lights from a subset of the pixels and then tiles. `"lbfgsb"`: scipy's L-BFGS-B, the paper's
        recipe, which alone knows the priors cohesion, smoothness and sparsity (docs/fit.md).
    iterations
        Largest number of iterations: steps of L-BFGS, or joint steps of Gauss-Newton. Before these
        at most as many steps on a subset of the pixels, which find the lights and do not count.
    time_limit
        In seconds; the fit of a scene stops after the iteration that passes it (default: none).
    sh_order
        Order of the lights' spherical harmonics: 3, or 2 to fit lights without band 3.
    metallic
        A number in [0, 1] that all pixels have, then it is not fitted; None = fitted.
    mono_light
        Whether lights are the same in all channels.
    priors
        Weights of the priors; None stands for `Priors.none()`.
    robust
        `"auto"`: samples weigh by their noise, which is estimated from residuals by picture,
        radiance and file, and outliers weigh less where there are some, if left-out pictures are
        explained better then; `"none"`, and `lbfgsb`: equal weights (docs/fit.md).
    equal_exposures
        Whether pictures are divided by their mean radiance, so that bright ones do not outweigh
        dark ones; None = where the brightest has more than 4 times that of the darkest.
    response
        Tone curve of the pictures. `"srgb"`, `"linear"`: integer files are decoded by it; `"auto"`:
        by the one that explains left-out pictures, where no file or option says it; `"fit"`: a
        monotone curve common to all is fitted beside what files were decoded by.
    refine_normals
        Whether the given normals are refined together with materials and lights (docs/fit.md);
        `"auto"`: where three or more pictures say that they are wrong, and memory is enough.
    white
        X, Y and perhaps albedo of a diffuse white or grey reference: pixels from the left and the
        top of the files, albedo 0.9 unless given (a grey card: 0.18). It fixes the scale between
        lights and albedo (docs/fit.md).
    align
        `"auto"`: pictures that are out of line with the others are put back, by a shift or an
        affine map, and pictures of something else left out; `"off"`: pictures are used as they are.
    model
        How surfaces reflect light (docs/model.md). `"paper"`: the paper's approximation (eq. 12);
        `"principled"`: the BRDF of Blender's Principled node, glTF and game engines, integrated
        exactly. Default: what the pictures were rendered with, where the scene says it, else
        `"paper"`.
    transport
        What surroundings do to light, where the scene has depth (docs/fit.md).
        `"occlusion"`: they block it; `"bounce"`: they also reflect it; `"auto"`: whichever explains
        left-out pictures best.
    light
        What lights the pictures (docs/fit.md). `"sh"`: environment light, as spherical harmonics;
        `"lamps"`: a lamp in each picture and faint environment light; `"auto"`: whichever explains
        left-out pictures better.
    same_lamp
        Whether all lamps have the same colour and strength: one that was carried around.
    uncertainty
        Whether to estimate standard deviations of the maps (docs/fit.md).

    Raises
    ------
    InputError
        If a value is none of the above; one line that names the option.
    """

    solver: Solver = "gauss-newton"
    iterations: int = 500
    time_limit: float | None = None
    sh_order: int = 3
    metallic: float | None = None
    mono_light: bool = False
    priors: Priors = field(default_factory=Priors)
    robust: Loss = "auto"
    equal_exposures: bool | None = None
    response: Response = "auto"
    refine_normals: RefineNormals = "auto"
    align: Align = "auto"
    white: tuple[float, float, float] | None = None
    model: Model | None = None
    transport: TransportChoice = "auto"
    light: LightChoice = "auto"
    same_lamp: bool = False
    uncertainty: bool = True

    def __post_init__(self) -> None:
        for name, kind in KINDS.items():
            if get_origin(kind) is Literal:
                one_of(name, getattr(self, name), kind)
            elif kind is bool:
                self._keep(**{name: _flag(name, getattr(self, name))})
        self._keep(
            iterations=whole_number("iterations", self.iterations),
            sh_order=whole_number("sh_order", self.sh_order),
            priors=Priors.none() if self.priors is None else self.priors,
        )
        if self.sh_order not in (2, 3):
            raise InputError(f"sh_order: expected 2 or 3, found {self.sh_order}")
        if self.time_limit is not None:
            self._keep(time_limit=finite("time_limit", self.time_limit, "seconds, 0 or more", 0.0))
        if self.metallic is not None:
            self._keep(metallic=unit_interval("metallic", self.metallic))
        if self.equal_exposures is not None:
            self._keep(equal_exposures=_flag("equal_exposures", self.equal_exposures))
        if self.white is not None:
            self._keep(white=_reference(self.white))
        if self.model is not None:
            checked_model(self.model)

    def _keep(self, **values: Any) -> None:
        for name, value in values.items():
            object.__setattr__(self, name, value)

    def check_priors(self) -> None:
        """Raise InputError where the solver does not know a prior of weight above 0."""
        for name in ("cohesion", "smoothness", "sparsity"):
            if getattr(self.priors, name) and self.solver != "lbfgsb":
                raise InputError(
                    f"prior {name}: expected --solver lbfgsb, which alone knows it, found "
                    f"{self.solver}"
                )


KINDS = get_type_hints(FitOptions)
"""Types of the options by name."""


def attributes_of(options: type) -> str:
    """What the docstring of a class says of its attributes, as it stands there."""
    _, _, said = inspect.cleandoc(options.__doc__ or "").partition("Attributes\n----------\n")
    return said.partition("\n\nRaises")[0] + "\n"


def described(options: type) -> dict[str, str]:
    """The same as text for the command line, by name."""
    parts = re.findall(r"^(\w+)\n((?:    .*\n)+)", attributes_of(options), re.MULTILINE)
    return {name: " ".join(re.sub(r'`"?|"?`', "", text).split()) for name, text in parts}


_OWN_WAYS = {
    "iterations": Flag(metavar="K"),
    "time_limit": Flag(kind=float, metavar="S"),
    "sh_order": Flag(values=(2, 3)),
    "metallic": Flag("0: metallic is 0 and not fitted", values={"free": None, "0": 0.0}),
    "equal_exposures": Flag(
        "equal: pictures are divided by their mean radiance, so that bright ones do not outweigh "
        "dark ones; as-is: they are not; auto: where one has more than 4 times the mean of another",
        name="exposures",
        values={"auto": None, "as-is": False, "equal": True},
    ),
    "white": Flag(kind=lambda text: text.split(","), metavar="X,Y[,ALBEDO]"),
    "model": Flag(values=MODELS),
}
FLAGS = {
    name: _OWN_WAYS.get(name) or Flag(values=get_args(kind) or None, kind=kind)
    for name, kind in KINDS.items()
    if name not in ("priors", "uncertainty")
}
"""Options that have a flag, by the names of the fields; priors have flags of their own."""


def unit_interval(name: str, value: Any) -> float:
    """Check a number in [0, 1]."""
    return finite(name, value, "None or a number in [0, 1]", 0.0, 1.0)


def _reference(white: Any) -> tuple[float, float, float]:
    expected = "a pixel x,y, 0 or more, and perhaps an albedo above 0 and up to 1"
    try:
        x, y, value = map(float, [*white, WHITE_ALBEDO][:3] if len(white) in (2, 3) else ())
    except (TypeError, ValueError):
        raise InputError(f"white: expected {expected}, found {white!r}") from None
    if not (0 <= x < math.inf and 0 <= y < math.inf and 0 < value <= 1):
        raise InputError(f"white: expected {expected}, found {x:g},{y:g},{value:g}")
    return x, y, value


def _flag(name: str, value: Any) -> bool:
    if not isinstance(value, (bool, np.bool_)):
        raise InputError(f"{name}: expected True or False, found {of_what(value)}")
    return bool(value)
