"""Scenes whose truth is known × conditions × ways to explain them: the form of most suites.

A condition says what is done to scenes, or to what a fit is given; a way explains a scene. A suite
is a `Grid` of both by name, a function that makes the scene of a case, and what figures make of the
`scores` that each record has. `grid.figures` has the rows, bars and sheets.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import KW_ONLY, dataclass, field, replace
from typing import Any

from pbrfit._core import InputError
from pbrfit.model.reflection import Model
from pbrfit.result.result import Result
from pbrfit.scene.scene import Scene
from pbrfit.synthetic import make_scene
from pbrfit_evaluation.options import Setting, count, first_seed, models, several
from pbrfit_evaluation.panels import of_result, packed
from pbrfit_evaluation.recipes import Way
from pbrfit_evaluation.scores import score
from pbrfit_evaluation.suite import Options

PICTURES = 16
"""Of a scene, unless `--lights` says otherwise; as many are held out."""

NOISE = 0.01
"""Standard deviation in radiance: 1 % of a radiance of 1, 2.5 % of the mean of 0.4."""


@dataclass(frozen=True)
class Case:
    """A scene of a condition, explained in one way."""

    condition: str
    way: str
    """`condition` and `way`: keys."""
    seed: int
    size: int
    kind: str = "furnished"
    """`seed`, `size` and `kind`: of the scene, its side in pixels, and what it is of."""
    model: Model | None = None
    """That is fitted; None = that of the scene."""
    lights: int = PICTURES
    """Pictures; as many are held out."""
    iterations: int = 500
    """Of a fit."""
    picture: bool = False
    """Whether its maps are kept for the report."""

    @property
    def key(self) -> str:
        """Name of the record."""
        about = (self.condition, self.way, self.kind, self.model or "", str(self.seed))
        return "_".join(filter(None, about))

    def drawn(self, **more: Any) -> Scene:
        """The scene by our renderer; `more` as of `make_scene`."""
        given = {"lights": self.lights, "held_out": self.lights} | more
        return make_scene(self.kind, size=self.size, seed=self.seed, **given)


@dataclass(frozen=True)
class Grid:
    """What a suite compares."""

    conditions: Mapping[str, str]
    """What tables call each, by key."""
    ways: Mapping[str, Way] = field(default_factory=lambda: {"default": Way("")})
    """By key."""
    _: KW_ONLY
    brings: Mapping[str, Sequence[str]] = field(default_factory=dict)
    """Conditions that are run beside one, because it is compared with them."""
    of_condition: Mapping[str, Sequence[str]] = field(default_factory=dict)
    """Keys of the ways of a condition that has not all."""
    kinds: Sequence[str] = ("furnished",)
    """Of scenes, in turn."""
    pictured: Sequence[str] = ()
    """Conditions or ways whose first scene is pictured."""
    few: Sequence[str] = ()
    few_ways: Sequence[str] = ()
    """`few` and `few_ways`: conditions and ways of a quick look, where these are not all."""
    why_not: Callable[[Options, str, str], str] = lambda *_: ""
    """Why a condition or way cannot be run; empty if it can."""
    sized: Callable[[Options, str], tuple[int, int]] = lambda of, _: (of.scenes, of.size)
    """Scenes of a condition and the side of their pictures, where not all have the same."""

    def each(self, options: Options) -> Iterator[tuple[str, str]]:
        """Conditions and ways that are asked for."""
        asked = {*getattr(options, "conditions", self.conditions)}
        asked |= {other for one in asked for other in self.brings.get(one, ())}
        for condition in self.conditions:
            for way in self.of_condition.get(condition, self.ways):
                if condition in asked and way in getattr(options, "ways", self.ways):
                    yield condition, way

    def cases(self, options: Options) -> list[Case]:
        """Every scene of every condition in every way.

        Ways change slowest, so that processes side by side do not render the same room.

        Raises InputError if there are too few pictures.
        """
        lights = getattr(options, "lights", PICTURES)
        if lights < 2:
            raise InputError(f"--lights: expected at least 2, found {lights}")
        order = list(self.ways)
        return [
            Case(
                condition=condition,
                way=way,
                seed=options.first_seed + i,
                size=size,
                kind=self.kinds[i % len(self.kinds)],
                model=model,
                lights=lights,
                iterations=getattr(options, "iterations", 500),
                picture=i == 0 and (condition in self.pictured or way in self.pictured),
            )
            for condition, way in sorted(self.each(options), key=lambda one: order.index(one[1]))
            if not self.why_not(options, condition, way)
            for scenes, size in [self.sized(options, condition)]
            for model in (models(options) if hasattr(options, "model") else (None,))
            for i in range(scenes)
        ]

    @property
    def words(self) -> dict[str, str]:
        """What tables call each way, by key."""
        return {key: way.words for key, way in self.ways.items()}

    def settings(
        self,
        seed: int,
        scenes: Setting,
        size: tuple[int, int],
        conditions: str = "",
        *,
        ways: str = "",
    ) -> dict[str, Setting]:
        """Settings that such suites share; nothing was tuned on seeds from `seed` on.

        `conditions` and `ways` are the names of these options, where they are others.
        """
        what = "only these ways to explain a scene"
        of_ways = several("NAME", self.ways, self.few_ways, what=what, name=ways)
        return {
            "conditions": several("NAME", self.conditions, self.few, name=conditions),
            "ways": of_ways if len(self.ways) > 1 else replace(of_ways, flag=None),
            "scenes": scenes,
            "size": count("PIXELS", "of the pictures", *size),
            "first_seed": first_seed("scene", seed),
        }


def measured(
    case: Case, way: Way, scene: Scene, threads: int, *, truth: Scene | None = None, **common: Any
) -> tuple[Result, dict[str, Any]]:
    """Explain the scene of a case, and compare it with its truth, or with another scene's.

    Returns the result, and of the record `scores`, with `wall` and `processor` seconds of all that
    the fit does; of a case that is pictured, `maps`.
    """
    common = {"iterations": case.iterations, "threads": threads, **common}
    if case.model is not None:
        common["model"] = case.model
    began = time.perf_counter(), time.process_time()
    result = way.explain(scene, **common)
    took = {"wall": time.perf_counter() - began[0], "processor": time.process_time() - began[1]}
    truth = truth or scene
    found: dict[str, Any] = {"scores": score(result, truth, threads) | took}
    if case.picture:
        found["maps"] = packed(of_result(result, truth, threads))
    return result, found
