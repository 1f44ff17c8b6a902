"""What a scene holds, what was assumed, and what a fit will need, for people to read."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pbrfit._core import InputError
from pbrfit.fit import memory
from pbrfit.fit.causes import left_out_words
from pbrfit.fit.parameters import ParameterLayout
from pbrfit.io.depth_files import DEPTH_FILES
from pbrfit.io.normal_files import UNCERTAINTY
from pbrfit.model import geometry
from pbrfit.model.reflection import DEFAULT_MODEL, chosen_model
from pbrfit.registration.placement import register
from pbrfit.result.options import SOLVERS, Priors
from pbrfit.result.refinement import hindrance
from pbrfit.scene import known_lamps
from pbrfit.scene.depth import compared
from pbrfit.scene.scene import Scene
from pbrfit.transport.room import counted, name_of
from pbrfit.transport.scenery import Scenery


def _needed(scene: Scene, layout: ParameterLayout, held: int) -> str:
    """Memory that `decompose` needs at its peak, beside the interpreter and its libraries."""
    of_solver = {
        solver: memory.plan(
            layout,
            solver,
            held=held,
            refine_normals=hindrance(scene) is None,
            optional=True,
            transport="none" if scene.depth is None else "auto",
            model=chosen_model(None, scene.model),
        )
        for solver in SOLVERS
    }
    found = "; ".join(
        f"about {memory.size(way.needed.peak)} for solver {solver}"
        f"{', in tiles' if way.tiled else ''}"
        for solver, way in of_solver.items()
    )
    saved = of_solver["gauss-newton"].needed.saved
    if saved is not None:
        less, option = saved
        found += f"; {memory.size(less)} less with --{option.replace('_', '-')}"
    return found


def expected_seconds(layout: ParameterLayout, *, normals_known: bool) -> float:
    """Processor time of `pbrfit decompose` without surroundings, mostly right within 1.5 times.

    Calibrated by rooms with 1 % noise and by photographs without normals, on an EPYC (Zen 4).
    """
    if not normals_known:
        return 8.0 + 1.9 * layout.pictures + 145e-6 * layout.pixels
    samples = layout.pixels * layout.pictures * layout.channels
    return 4.0 + 0.08 * layout.pictures + 50e-6 * layout.pixels + 0.4e-6 * samples


def time_in_words(seconds: float) -> str:
    """A time in seconds, minutes or hours, whichever is two digits long."""
    if seconds < 100:
        return f"{seconds:.0f} s"
    minutes = seconds / 60
    return f"{minutes:.0f} min" if minutes < 100 else f"{minutes / 60:.0f} h"


def _depth(scene: Scene) -> str:
    """What the depth is like, and how it goes with the normals."""
    if scene.depth is None:
        return "none"
    low, high = np.nanmin(scene.depth), np.nanmax(scene.depth)
    unknown = 100 * np.isnan(scene.depth[scene.valid]).mean()
    said = "".join(f"{name}, " for name in DEPTH_FILES if name in scene.inputs)
    said += f"{low:.3g} to {high:.3g}, unknown in {unknown:.1f} % of the mask"
    if not scene.normals_known:
        return said
    angle = compared(scene.depth, scene.normals, scene.fov)[0]
    if np.isnan(angle):
        return said
    return f"{said}; its normals {angle:.1f} degrees (median) from the given ones"


def _surroundings(scene: Scene) -> str:
    """What of them is found in the depth."""
    if scene.depth is None:
        return "unknown: no depth is given"
    if not scene.normals_known:
        return "unknown: no normals are given"
    try:
        walls = Scenery(scene.depth, scene.normals, scene.valid, scene.segments, scene.fov).walls
    except InputError as error:
        return f"none: {error}"
    return counted([name_of(wall, walls) for wall in walls]) or "no wall, no floor"


def _lamps(scene: Scene) -> str:
    """How many lamps are known, and how far apart far ones are."""
    if (lamps := scene.lamps) is None:
        return "unknown"
    said, far = known_lamps.in_words(lamps), lamps.places[~lamps.near]
    if lamps.near.any() and scene.depth is None:
        said += "; no fit of near ones without depth, and none is given"
    if len(far) < 2:
        return said
    tilt = np.degrees(np.arccos(np.clip(far[:, 2], -1.0, 1.0)))
    return (
        f"{said}; far ones up to {known_lamps.spread(far):.0f} degrees apart, {tilt.min():.0f} to "
        f"{tilt.max():.0f} from the viewer"
    )


def facts(scene: Scene) -> list[tuple[str, str]]:
    """(topic, fact) pairs, most wanted first."""
    layout, reason = ParameterLayout.of(scene), hindrance(scene)
    unused = left_out_words(scene, layout, Priors())
    height, width = (scene.source and scene.source.fitted) or scene.valid.shape
    times, looked = height * width / scene.valid.size, ""
    if times != 1:
        layout = replace(layout, valid=np.broadcast_to(True, (1, round(times * layout.pixels))))
        looked = f"; values are of their means over {scene.width} × {scene.height}"
    each = map(scene.samples, range(len(scene.images)))
    mean, low, high = np.transpose([(one.mean(dtype=float), one.min(), one.max()) for one in each])
    away, error = "unknown: no normals are given", "none given"
    if scene.normals_known:
        facing = geometry.facing_away(scene.normals[scene.valid], scene.views[scene.valid])
        away, error = f"{100 * facing.mean():.1f} % of the normals", "unknown"
    if scene.normals_known and scene.normal_sigma is not None:
        middle, most = np.percentile(scene.normal_sigma[scene.valid], [50, 95])
        error = f"{middle:.1f} degrees (median), {most:.1f} (95 %), from {UNCERTAINTY}"
    alignment = register(scene)
    moved = [f"NO: {one.in_words()}" for one in alignment.placements if not one.in_line]
    first, *others = moved or [alignment.in_words()]
    from pbrfit.fit.estimates import mismatch
    from pbrfit.fit.given import contradiction  # here: it needs scipy, which takes long to import

    found = [
        ("pictures", f"{len(scene.images)} of {width} × {height} pixels{looked}"),
        ("", f"{scene.names[0]} ... {scene.names[-1]}"),
        ("radiance", f"mean {mean.mean():.4g}, from {low.min():.4g} to {high.max():.4g}"),
        ("mask", f"{layout.pixels} pixels used, {100 * scene.valid.mean():.1f} %"),
        ("facing away", away),
        ("normal error", error),
        ("depth", _depth(scene)),
        ("surroundings", _surroundings(scene)),
        ("refine normals", f"not possible: {reason}" if reason else "possible"),
        ("segments", "none" if layout.segments is None else f"{layout.segment_count} ids"),
        ("colour", "three channels" if layout.channels > 1 else "grey: one channel will be fitted"),
        ("lights", "known" if layout.lighting_known else "unknown, will be fitted"),
        ("lamps", _lamps(scene)),
        ("aligned", first),
        *(("", one) for one in others),
        ("contradictions", one.in_words() if (one := contradiction(scene)) else "none found"),
        ("ground truth", "none" if scene.truth is None else "yes, errors will be reported"),
    ]
    if scene.estimates is not None and (why := mismatch(scene)):
        found.append(("estimates", f"not used: {why}"))
    found += [(f"assumed {topic}", fact) for topic, fact in scene.assumed.items()]
    if "model" not in scene.assumed:
        by = f"{scene.model}, with which the pictures were rendered"
        found.append(("assumed model", by if scene.model else f"{DEFAULT_MODEL}, the default"))
    found += [
        ("left out", "; ".join(unused) or "nothing"),
        ("unknowns", f"{layout.size}"),
    ]
    free = memory.available()
    about = time_in_words(expected_seconds(layout, normals_known=scene.normals_known))
    found += [
        ("time needed", f"about {about} of processor time, more among surroundings"),
        ("memory needed", _needed(scene, layout, round(times * memory.bytes_of(scene)))),
        ("memory free", "unknown" if free is None else memory.size(free)),
    ]
    return found
