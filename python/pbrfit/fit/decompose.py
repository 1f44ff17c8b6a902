"""From Scene to Result."""

from __future__ import annotations

import importlib
import inspect
import logging
import math
import time
from collections.abc import Callable
from dataclasses import fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from pbrfit import address_space
from pbrfit._core import InputError
from pbrfit.fit import memory
from pbrfit.fit.causes import left_out_words, with_causes
from pbrfit.fit.run import FitSetup, Progress, Trace, material_errors, notebook_bar
from pbrfit.fit.sampling import slices
from pbrfit.fit.scale import checked_white
from pbrfit.fit.tiles import fit_tiles
from pbrfit.fit.transport import Surrounded
from pbrfit.fit.whole_picture import FitOutput, fit_whole
from pbrfit.model.geometry import angles_between
from pbrfit.model.materials import Materials
from pbrfit.model.reflection import (
    DEFAULT_MODEL,
    Model,
    chosen_model,
    render,
    render_rows,
    whole_number,
)
from pbrfit.registration.placement import aligned
from pbrfit.result import metrics
from pbrfit.result.data import SEGMENT_MAX
from pbrfit.result.history import History
from pbrfit.result.options import FitOptions, attributes_of
from pbrfit.result.refinement import hindrance
from pbrfit.result.result import Result
from pbrfit.result.verdict import FOV_CONTRADICTED, capped, doubted
from pbrfit.scene import arrays, exposure
from pbrfit.scene.options import ReadOptions
from pbrfit.scene.scene import Scene
from pbrfit.threads import in_pieces, one_blas_thread
from pbrfit.values.arrays import Array

if TYPE_CHECKING:
    from pbrfit.fit.compare import Choice

__all__ = ["Progress", "decompose"]

log = logging.getLogger("pbrfit")

Start = Materials | tuple[Materials, NDArray[Any]] | Result | None


@one_blas_thread()
def decompose(
    scene: Scene | str | Path,
    options: FitOptions | None = None,
    *,
    start: Start = None,
    threads: int = 0,
    progress: Callable[[Progress], None] | bool | None = None,
    **overrides: Any,
) -> Result:
    """Recover materials and lights from the pictures of one view.

    Parameters
    ----------
    scene
        Pictures, normals and what else is known, or the path of a scene folder, which
        `Scene.load` reads. With `scene.lighting` only materials are fitted.
    options
        What is fitted and how; None = the defaults.
    start
        Maps to start from, alone or with lights (N, 16, 3) in picture units; or a result of the
        same model, which has both. Default: albedo from the mean picture, constant roughness and
        metallic, lights by least squares.
    threads
        0 = one for each processor. The result does not depend on it, to the last bit.
    progress
        Called at the start, after each iteration, after each step on a subset of the pixels and
        after each tile. True = a bar by `tqdm.auto`, in notebooks too; False or None = nothing.
    **overrides
        Single options by name, in place of those in `options`:

    Returns
    -------
    Result
        Materials, lights in picture units, status, history.

    Raises
    ------
    InputError, OSError
        If an option or the scene cannot be used or read, or `start` is a result of another model.
    TypeError
        If there is no option of a name.
    MemoryError
        If memory runs short.
    """
    options = _overridden(options, overrides)
    options.check_priors()
    if progress is True:
        with notebook_bar(options.iterations) as show:
            return decompose(scene, options, start=start, threads=threads, progress=show)
    scene = _read(scene)
    model = chosen_model(options.model, scene.model)
    threads = whole_number("threads", threads)
    begin = _to_start_from(start, model)
    # Here and not above: scipy would double the time of `import pbrfit`. Before the clock starts:
    # loading it is no part of the fit.
    importlib.import_module("scipy.optimize")
    address_space.reserve_blas()
    from pbrfit.fit import compare, estimates
    from pbrfit.fit.lamps.estimator import LOOK_LAST, LampFit, check_light
    from pbrfit.fit.lamps.shape import first_shape, height_of

    setup = FitSetup(options, threads, progress or None, time.perf_counter())
    trace = Trace(setup)
    if options.align == "auto" and "alignment" not in scene.assumed:
        with trace.stage("alignment"):
            scene = aligned(scene, stop=trace.out_of_time, threads=threads)
    scene, options = estimates.used(scene, options)
    hindered = hindrance(scene)
    if options.refine_normals == "off":
        hindered = "not asked for"
    elif options.iterations == 0:
        hindered = "0 iterations asked for"
    if not scene.normals_known and options.refine_normals == "auto":
        hindered = "they are from the pictures already"
    if hindered and options.refine_normals == "on":
        log.warning("normals are not refined: %s", hindered)
    white = options.white
    if white is not None:
        if scene.lighting is not None:
            raise InputError("white: expected unknown lights, found known ones, which have a scale")
        size = None if scene.source is None else scene.source.size
        white = checked_white(white, scene.valid, size or scene.valid.shape)
    options_now = replace(options, model=model, white=white)
    setup = replace(setup, options=options_now, why_normals=hindered or "")
    check_light(scene, setup)
    with trace.stage("model selection"):
        chosen = compare.choose(scene, setup, start_given=begin is not None)
    how = chosen.explanation
    if how.response is not None:
        scene = scene.decoded_by(how.response)
    start_shape = None
    if not scene.normals_known:
        with trace.stage("photometric stereo"):
            start_shape = first_shape(scene, threads)
            if how.light == "sh":
                silent = replace(setup, progress=None)
                start_shape = LampFit(scene, silent, start_shape, rounds=LOOK_LAST).settled
        for said in start_shape.undetermined:
            log.warning("normals: %s", said)
    priors = replace(setup.options.priors, material=how.material)
    asked = options.refine_normals == "on"
    setup = replace(
        setup,
        options=replace(setup.options, priors=priors, robust=how.robust),
        stages=tuple(trace.stages),
        refines=not hindered and (asked or how.free_normals),
        why_normals=hindered or ("asked for" if asked else chosen.why_normals),
    )
    if how.light == "lamps":
        found = LampFit(scene, setup, start_shape, chosen.found).solve()
        if start_shape is not None:
            with trace.stage("height"):
                height = height_of(found.normals, scene, threads)
            stages = (*found.stages, trace.stages[-1])
            found = replace(found, height=height, stages=stages, seconds=trace.elapsed)
            scene = replace(scene, normals=found.normals, normals_known=True)
        return _result(scene, setup, found, options, chosen)
    if start_shape is not None:
        scene = replace(scene, normals=start_shape.normals, normals_known=True)
    layout, blocking = setup.layout(scene), chosen.transport.kind
    way = memory.plan(
        layout,
        options.solver,
        held=memory.bytes_of(scene),
        refine_normals=setup.refines,
        optional=options.refine_normals == "auto",
        transport=blocking,
        model=model,
        threads=threads,
    )
    memory.check(options.solver, way.needed)  # before anything large is made
    if way.tiled and layout.pixels <= memory.whole_pixels_max(blocking):
        log.warning("fitted in tiles: there is not enough memory for all pixels at once")
    if way.hindered:
        setup = replace(setup, refines=False, why_normals=way.hindered)
    if chosen.scenery is not None:
        surrounded = Surrounded(scene, chosen.transport, chosen.scenery)
        setup = replace(setup, surrounded=surrounded)
    found = (fit_tiles if way.tiled else fit_whole)(scene, setup, begin)
    if scene.estimates is not None and found.uncertainty is not None:
        materials, uncertainty = estimates.fused(
            found.materials, found.uncertainty, scene.estimates, grey=scene.grey
        )
        found = replace(found, materials=materials, uncertainty=uncertainty)
    if start_shape is not None:
        found = replace(found, refinement=found.refinement.of_normals_from_pictures())
    return _result(scene, setup, found, options, chosen)


def _result(
    scene: Scene, setup: FitSetup, found: FitOutput, options: FitOptions, chosen: Choice
) -> Result:
    """What a fit hands over, with final errors and what is to be said."""
    camera = replace(found.camera, response=scene.response)
    if chosen.other_fov is not None:
        degrees, sigma = chosen.other_fov
        figures = {"other_fov_degrees": degrees, "other_fov_sigma": sigma}
        camera = replace(camera, contradicted=True, figures=figures)
    found = replace(found, camera=camera)
    threads, model = setup.threads, setup.model
    left_out = tuple(
        left_out_words(scene, setup.layout(scene), options.priors, found.measured_lighting)
    )
    scene = scene.through(found.camera.fov_degrees, found.camera.correction)
    given = np.asarray(scene.normals, dtype=np.float64)
    refinement = found.refinement
    if refinement.refined:
        refinement = refinement.with_change(angles_between(found.normals, given))
    surrounded, transport = found.surrounded, chosen.transport
    segments = None
    if surrounded is not None and surrounded.scene.segments is not None:
        segments = arrays.storable_ids(surrounded.scene.segments, SEGMENT_MAX).astype(np.int32)
    if not transport.blocks:
        left_out = (*left_out, f"surroundings: {transport.why}")
    if found.lamps is None:
        why = "environment light explains the pictures"
        if options.light == "sh" or options.mono_light:
            why = "not asked for"
        elif chosen.held_out is None:
            why = "not compared with environment light"
        left_out = (*left_out, f"lamps: {why}")
    elif scene.estimates is not None:
        left_out = (*left_out, "estimates: they are evidence under environment light alone")
    uncertainty = found.uncertainty
    if uncertainty is not None:
        verdicts = with_causes(
            uncertainty,
            scene,
            normals=found.normals,
            discrepancy=found.discrepancy,
            shown=found.shown,
            transport=transport,
            lighting=found.lighting if found.lamps is None else None,
            albedo=found.materials.albedo,
        )
        verdicts = capped(verdicts, chosen.held_out)
        if camera.contradicted:
            verdicts = doubted(verdicts, FOV_CONTRADICTED, "the true field of view would help")
        if (one := chosen.contradiction) is not None:
            verdicts = doubted(verdicts, one.why, f"{one.remedy} would help")
        uncertainty = replace(uncertainty, verdicts=verdicts)
    return Result(
        materials=found.materials,
        lighting=found.lighting,
        normals=found.normals,
        mask=scene.valid.copy(),
        fov=scene.fov,
        model=model,
        pictures=scene.names,
        status=found.status,
        stop_reason=found.reason,
        history=History(found.rows),
        evaluations=found.evaluations,
        seconds=found.seconds,
        metrics=_metrics(scene, found, model, threads),
        options=options,
        assumed=_assumed(scene, found, options.model, chosen),
        left_out=left_out,
        inputs=dict(scene.inputs),
        source=scene.source,
        stages=found.stages,
        uncertainty=uncertainty,
        refinement=refinement,
        camera=found.camera,
        held_out=chosen.held_out,
        given_normals=given if refinement.refined else None,
        depth=scene.depth,
        transport=transport,
        segments=segments,
        lamps=found.lamps,
        height=found.height,
    )


def _read(scene: Scene | str | Path) -> Scene:
    """The scene itself, or what a path leads to."""
    if isinstance(scene, (str, Path)):
        return Scene.load(scene)
    if not isinstance(scene, Scene):
        found = type(scene).__name__
        raise InputError(f"scene: expected a Scene or the path of a scene folder, found {found}")
    return scene


def _overridden(options: FitOptions | None, overrides: dict[str, Any]) -> FitOptions:
    known = [one.name for one in fields(FitOptions)]
    for name in overrides:
        if name in (one.name for one in fields(ReadOptions)):
            raise TypeError(f"decompose: {name} is an option of Scene.load(path, {name}=...)")
        if name not in known:
            raise TypeError(f"decompose: expected options {', '.join(known)}, found {name!r}")
    if options is None:
        return FitOptions(**overrides)
    if not isinstance(options, FitOptions):
        raise InputError(f"options: expected FitOptions, found {type(options).__name__}")
    return replace(options, **overrides)


def _signature() -> inspect.Signature:
    """The signature of `decompose` with all options by name, for `help` and editors."""
    own = inspect.signature(decompose)
    named = [one for name, one in own.parameters.items() if name != "overrides"]
    options = [
        parameter.replace(kind=inspect.Parameter.KEYWORD_ONLY)
        for parameter in inspect.signature(FitOptions).parameters.values()
    ]
    return own.replace(parameters=[*named, *options])


def _to_start_from(start: Start, model: Model) -> tuple[Materials, Array | None] | None:
    """Maps and perhaps lights; those of a result, if it is of the same model."""
    if isinstance(start, Materials):
        return start, None
    if not isinstance(start, Result):
        return start
    if start.model != model:
        raise InputError(
            f"start: expected a result of model {model}, found one of model {start.model}; its "
            "materials alone may be given"
        )
    return start.materials, start.lighting


def _recon_rmse(scene: Scene, fit: FitOutput, model: Model, threads: int) -> float:
    """Of all samples by their weights; each picture's divided by its exposure.

    All pictures have the same work for their materials, so they are rendered together, a few rows
    at a time: little beside the pictures of a large scene, much beside what a call costs.
    """
    count = max(1, (1 << 21) // (len(scene.images) * scene.width))

    def of_rows(rows: slice) -> list[tuple[float, float]]:
        """Error and weight of each picture there."""
        if not scene.valid[rows].any():
            return []
        rendered = render_rows(
            fit.materials, fit.normals, fit.lighting, scene.fov, rows, threads, model
        )
        found = []
        for i, image in enumerate(rendered):
            weights = scene.channel_weights(i, rows)
            total = 3.0 * int(np.count_nonzero(scene.valid[rows]))
            if weights is not None:
                total = float(weights[scene.valid[rows]].sum(dtype=np.float64))
            if total > 0:
                error = metrics.rmse(image, scene.picture(i, rows), weights)
                found.append((error if fit.exposures is None else error / fit.exposures[i], total))
        return found

    errors, totals = np.concatenate(
        [of for of in in_pieces(threads, of_rows, slices(scene.height, count)) if of]
    ).T
    shares = np.sqrt(totals / math.fsum(totals))
    return math.hypot(*(shares * errors))


def _metrics(scene: Scene, fit: FitOutput, model: Model, threads: int) -> dict[str, float]:
    """Final errors, computed in float64."""
    normals, materials = fit.normals, fit.materials
    recon = fit.recon_rmse
    found = {"recon_rmse": _recon_rmse(scene, fit, model, threads) if recon is None else recon}
    truth = scene.truth
    if truth is None:
        return found
    found |= material_errors(materials, truth.materials)
    found["albedo_scaled_rmse"] = metrics.scaled_rmse(materials.albedo, truth.materials.albedo)
    if truth.relight_images is not None and truth.relight_lighting is not None:
        lights = truth.relight_lighting
        among = fit.surrounded
        if among is not None:
            rendered = among.scenery.render(
                materials, normals, lights, among.transport, model=model, threads=threads
            )
        else:
            rendered = render(materials, normals, lights, scene.fov, threads, model=model)
        found["relight_rmse"] = metrics.rmse(rendered, truth.relight_images)
    return found


def _assumed(scene: Scene, fit: FitOutput, model: Model | None, chosen: Choice) -> dict[str, str]:
    assumed = dict(scene.assumed)
    camera = fit.camera
    if camera.how == "fitted":
        assumed["fov"] = camera.in_words()
    elif camera.contradicted:
        given = assumed.get("fov", camera.in_words())
        assumed["fov"] = f"{given}; {camera.contradiction()}"
        log.warning("field of view: %s", assumed["fov"])
    if (one := chosen.contradiction) is not None:
        log.warning("%s", one.in_words())
        assumed[one.what] = "; ".join(filter(None, (assumed.get(one.what), one.in_words())))
    if camera.correction is not None:
        assumed["response"] = camera.correction.in_words()
    if model is not None:
        assumed["model"] = f"{model}, asked for"
        if scene.model not in (None, model):
            assumed["model"] += f"; the pictures were rendered with {scene.model}"
    elif scene.model is None:
        assumed["model"] = f"{DEFAULT_MODEL}, the default"
    else:
        assumed.setdefault("model", f"{scene.model}, with which the pictures were rendered")
    if fit.noise is not None and (remarks := fit.noise.remarks(scene.names, fit.exposures)):
        assumed["noise"] = remarks
    surrounded = fit.surrounded
    if surrounded is not None:
        assumed["surroundings"] = surrounded.scenery.in_words(surrounded.transport)
    elif scene.depth is not None:
        assumed["surroundings"] = f"none: {chosen.transport.why}"
    assumed["scale"] = fit.scale
    if fit.lamps is not None:
        assumed["light"] = "lamps"
    if chosen.held_out is not None:
        assumed["explanation"] = chosen.held_out.decision()
    if fit.exposures is not None:
        assumed["exposures"] = exposure.in_words(fit.exposures)
    return assumed


decompose.__signature__ = _signature()  # type: ignore[attr-defined]
_before, _returns, _after = inspect.cleandoc(decompose.__doc__ or "").partition("\nReturns\n")
decompose.__doc__ = f"{_before}{attributes_of(FitOptions)}{_returns}{_after}"
