"""What to do next about a result: sentences that follow from what is in it.

The terminal, notebooks and pages say the same words. Options are named as Python names them,
"option fov", which the command line turns into flags.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from pbrfit._core import InputError
from pbrfit.result.data import ResultData, Status
from pbrfit.result.light_sides import main_directions, one_side, unlit_sides
from pbrfit.result.verdict import FOV_CONTRADICTED, MORE_TOLD, UNEXPLAINED, Verdict, enumerated

AT_MOST = 2
"""Steps that are named: the first that help most, not all that might."""

BLACK_ALBEDO = 0.02
"""Albedo up to which a pixel is black in pictures under any light: velvet has about 0.01."""

BLACK_SHARE = 0.1
"""Share of black pixels from which on a mask is recommended, where there is none."""


def next_steps(result: ResultData) -> tuple[str, ...]:
    """What would make a result better, the most urgent first; none where nothing is to be done."""
    return tuple(_steps(result))[:AT_MOST]


def of_verdicts(verdicts: Mapping[str, Verdict]) -> tuple[str, ...]:
    """What verdicts alone say: each cause once, with its remedy and the maps it is about."""
    maps: dict[tuple[str, str], list[str]] = {}
    for name, one in verdicts.items():
        if one.cause:
            maps.setdefault((one.cause, one.remedy), []).append(name)
    return tuple(
        f"{cause}: {remedy} {enumerated(names)}".rstrip() if remedy else cause
        for (cause, remedy), names in maps.items()
    )[:AT_MOST]


def _steps(result: ResultData) -> Iterator[str]:
    yield from _unfinished(result)
    yield from of_verdicts(result.verdicts)
    named = {one.cause for one in result.verdicts.values()}
    if result.held_out is not None and not result.held_out.explains and UNEXPLAINED not in named:
        yield f"{UNEXPLAINED}: {MORE_TOLD}"
    yield from _camera(result, named)
    facing = "all normals face the camera"
    if facing not in named and (result.normals[result.mask] == (0.0, 0.0, 1.0)).all():
        yield f"{facing}: true ones (pbrfit normals) would tell shape from material"
    wanting = [name for name, one in result.verdicts.items() if one.level != "usable"]
    yield from _sides(result, [name for name in wanting if name != "albedo"], named)
    yield from _mask(result)


def _unfinished(result: ResultData) -> Iterator[str]:
    done = result.history.iterations
    after, more = f"{done} iteration{'s' * (done != 1)}", "more of them (option iterations)"
    if result.status is Status.TIME_LIMIT:
        after, more = f"{result.seconds:.3g} s", "more time (option time_limit)"
    if result.status is not Status.CONVERGED:
        yield f"the fit was stopped after {after}: {more} would help all maps"


def _camera(result: ResultData, named: set[str]) -> Iterator[str]:
    camera = result.camera
    if camera is None or (camera.contradicted and FOV_CONTRADICTED in named):
        return
    remedy = "the true one (option fov) would help"
    if camera.contradicted:
        remedy = "see whether it is right (option fov)"
    if doubt := camera.doubt():
        yield f"{doubt}: {remedy}"


def _sides(result: ResultData, maps: list[str], named: set[str]) -> Iterator[str]:
    """Sides that no light comes from, where a map that highlights tell is not usable."""
    if not maps or len(result.pictures) < 2 or any("one side" in cause for cause in named):
        return
    try:
        directions = main_directions(result.sh_lighting())
    except InputError:  # near lamps that are seen from nowhere
        return
    sides = one_side(directions)
    if sides is not None:
        yield (
            f"light from one side, {sides[0]}, in all pictures: pictures lit from {sides[1]} would "
            f"help {enumerated(maps)}"
        )
    elif unlit := unlit_sides(directions):
        yield (
            f"no picture is lit from {enumerated(unlit, 'or')}: such pictures would help "
            f"{enumerated(maps)}"
        )


def _mask(result: ResultData) -> Iterator[str]:
    """Pixels that are black in all pictures, most likely a background."""
    if not result.mask.all():
        return
    share = float(np.mean(result.albedo.max(axis=-1) <= BLACK_ALBEDO))
    if share >= BLACK_SHARE:
        yield (
            f"{100 * share:.0f} % of the pixels are black, as a background is: a mask (mask.png) "
            "would leave them out"
        )
