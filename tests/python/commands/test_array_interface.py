"""Any array for any argument: one line that names the argument, or a finite answer; never a change.

Each call gets arguments as they should be, of which some are then made strange: another type,
order or shape, numbers that are none, huge or next to nothing. PBRFIT_EXAMPLES sets how many
examples there are for each call, and draws others in each run.
"""

from __future__ import annotations

import copy
import functools
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

import pbrfit
from pbrfit import DirectionalLight, InputError, Materials, Objective, Priors, Result, Scene
from pbrfit.model import lighting as sh_lights
from pbrfit.model.geometry import unit
from pbrfit.result import metrics
from pbrfit.synthetic import make_scene
from scene_files import known, truth_of

EXAMPLES = os.environ.get("PBRFIT_EXAMPLES")

profile = settings(
    max_examples=int(EXAMPLES or 20),
    phases=(Phase.explicit, Phase.generate) if EXAMPLES else tuple(Phase),
    deadline=None,
    derandomize=EXAMPLES is None,  # the same examples in every run
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large],
)

SIZE, LIGHTS = 4, 3


DTYPES: tuple[Any, ...] = (
    *("?", "i1", "u1", "i2", "u2", "i4", "u4", "i8", "u8", "f2", "f4", "f8", ">f4", ">f8", "g"),
    *("c8", "c16", "O", "U5", "S5", "M8[s]", "m8[s]", "V4", [("a", "f4"), ("b", "i4")]),
)
NUMBERS = (
    *(np.nan, np.inf, -np.inf, -1.0, 0.0, -0.0, 1.0, 2.0, 0.5, 5e-324, 1e-310, 1e-45, -1e-45),
    *(1e-30, 1e30, -1e30, 3.4e38, 3.5e38, 1e200, 1.7e308, -1.7e308, 65504.0, 1 + 1e-9),
)
OTHERS: tuple[Any, ...] = (
    *(None, "text", b"bytes", 1.5, -3, True, 10**400, float("nan"), object(), {}, {"a": 1}),
    *([], [[]], [[1.0], [1.0, 2.0]], ["a", "b"], range(3), [None], Ellipsis),
)


def retyped(array: NDArray[Any], dtype: Any) -> Any:
    with np.errstate(all="ignore"):
        try:
            return array.astype(dtype)
        except (TypeError, ValueError):
            return np.zeros(array.shape, dtype)


def every_other(array: NDArray[Any]) -> NDArray[Any]:
    wide = np.repeat(array, 2, axis=-1)
    return wide[..., ::2]


def backwards(array: NDArray[Any]) -> NDArray[Any]:
    turn = (slice(None, None, -1),) * array.ndim
    return array[turn].copy()[turn]


def locked(array: NDArray[Any]) -> NDArray[Any]:
    array = array.copy()
    array.flags.writeable = False
    return array


def unaligned(array: NDArray[Any]) -> NDArray[Any]:
    if array.dtype.hasobject:
        return array
    raw = np.zeros(array.nbytes + 1, np.uint8)
    view = raw[1:].view(array.dtype).reshape(array.shape)
    view[...] = array
    return view


LAYOUTS: dict[str, Callable[[NDArray[Any]], Any]] = {
    "C": np.ascontiguousarray,
    "Fortran": np.asfortranarray,
    "gaps": every_other,
    "backwards": backwards,
    "read-only": locked,
    "unaligned": unaligned,
    "matrix": lambda array: array.view(np.matrix) if array.ndim == 2 else array,
    "masked": np.ma.asarray,
    "list": lambda array: array.tolist(),
}
SHAPES: dict[str, Callable[[NDArray[Any]], NDArray[Any]]] = {
    "none in the first": lambda array: array[:0],
    "none in the last": lambda array: array[..., :0],
    "one in the first": lambda array: array[:1],
    "one more axis": lambda array: array[None],
    "one axis less": lambda array: array[0],
    "a last axis more": lambda array: array[..., None],
    "transposed": lambda array: array.T,
    "flat": lambda array: array.ravel(),
    "one number": lambda array: array.ravel()[0].reshape(()),
    "doubled": lambda array: np.concatenate([array, array]),
    "broadcast": lambda array: np.broadcast_to(array.ravel()[0], array.shape),
}  # fmt: skip


@st.composite
def strange(draw: st.DrawFn, value: Any) -> Any:
    """A value, or something like it, or nothing like it."""
    if not isinstance(value, np.ndarray):
        return draw(st.sampled_from((*OTHERS, *NUMBERS, np.float32(2), np.int64(1), np.zeros(2))))
    kind = draw(st.sampled_from(["dtype", "numbers", "shape", "other", "layout", "several"]))
    if kind == "other":
        return draw(st.sampled_from(OTHERS))
    array = value.copy()
    if kind in ("numbers", "several") and array.dtype.kind == "f" and array.size:
        number = draw(st.sampled_from(NUMBERS))
        where = draw(st.sampled_from(["one", "all", "row"]))
        index: Any = (slice(None),) * array.ndim
        if where == "one":
            index = tuple(draw(st.integers(0, n - 1)) for n in array.shape)
        elif where == "row":
            index = draw(st.integers(0, len(array) - 1)) if array.ndim else ()
        with np.errstate(all="ignore"):
            array[index] = number
    if kind in ("dtype", "several"):
        array = retyped(array, draw(st.sampled_from(DTYPES)))
    if kind == "shape" and array.ndim:
        array = SHAPES[draw(st.sampled_from(sorted(SHAPES)))](array)
    if kind in ("layout", "several") and array.ndim:
        return LAYOUTS[draw(st.sampled_from(sorted(LAYOUTS)))](array)
    return array


@functools.cache
def room() -> Scene:
    return make_scene("room", size=SIZE, lights=LIGHTS, held_out=1)


@functools.cache
def result() -> Result:
    return pbrfit.decompose(room(), iterations=2, refine_normals="off")


@functools.cache
def objective() -> Objective:
    return Objective(room(), priors=Priors())


def pixel_arguments() -> dict[str, Any]:
    rng = np.random.default_rng(1)
    return {
        "normal": unit(rng.normal(size=(5, 3))),
        "view": unit(rng.normal(size=(5, 3))),
        "albedo": rng.random((5, 3)),
        "roughness": rng.random(5),
        "metallic": rng.random(5),
    }


def maps() -> dict[str, Any]:
    true = known(room().truth)
    materials = true.materials
    return {
        "albedo": np.asarray(materials.albedo, np.float64),
        "roughness": np.asarray(materials.roughness, np.float64),
        "metallic": np.asarray(materials.metallic, np.float64),
    }


def scene_arguments() -> dict[str, Any]:
    scene = room()
    return {
        "images": np.asarray(scene.images, np.float64),
        "normals": np.asarray(scene.normals),
        "fov": 60.0,
        "mask": np.ones((SIZE, SIZE), bool),
        "segments": np.asarray(scene.segments),
        "lighting": truth_of(scene).lighting,
        "weights": np.ones((LIGHTS, SIZE, SIZE)),
        "normal_sigma": np.ones((SIZE, SIZE)),
        "names": np.array(["a", "b", "c"]),
    }


def picture_pair() -> dict[str, Any]:
    rng = np.random.default_rng(2)
    return {"found": rng.random((6, 5, 3)), "true": rng.random((6, 5, 3))}


def render(**arguments: Any) -> Any:
    of = {name: arguments.pop(name) for name in ("albedo", "roughness", "metallic")}
    return pbrfit.kernel.render(Materials(**of), **arguments)


def fitted(**arguments: Any) -> list[Any]:
    scene = Scene(**arguments)
    found = pbrfit.decompose(scene, iterations=2, uncertainty=True)
    inside = found.mask
    of = found.materials
    assert of.albedo.shape == (*inside.shape, 3)
    assert found.lighting.shape == (len(scene.images), 16, 3)
    return [
        of.albedo[inside],
        of.roughness[inside],
        of.metallic[inside],
        found.lighting,
        found.normals[inside],
        np.array(list(found.metrics.values())),
    ]


def start_from(**arguments: Any) -> list[Any]:
    lights = arguments.pop("lighting")
    start = (Materials(**arguments), lights)
    found = pbrfit.decompose(room(), start=start, iterations=1, uncertainty=False)
    return [found.materials.albedo, found.lighting]


@dataclass(frozen=True)
class Call:
    """A function, arguments as they should be, and names by which its refusals may know them.

    `nan_out`: NaN of what was given as NaN may come back; `inf_out`: an answer may be infinite.
    """

    function: Callable[..., Any]
    arguments: Callable[[], dict[str, Any]]
    aliases: Sequence[str] = ()
    nan_out: bool = False
    inf_out: bool = False


CALLS: dict[str, Call] = {
    "sh_basis": Call(
        pbrfit.kernel.sh_basis,
        lambda: {"directions": unit(np.random.default_rng(0).normal(size=(7, 3)))},
    ),
    "ggx_band_weights": Call(pbrfit.kernel.ggx_band_weights, lambda: {"r": np.linspace(0, 1, 6)}),
    "shade": Call(pbrfit.kernel.shade, pixel_arguments, ["pixels"]),
    "shade_vjp": Call(
        pbrfit.kernel.shade_vjp,
        lambda: pixel_arguments() | {"cotangent": np.ones((5, 3, 16))},
        ["pixels"],
    ),
    "render": Call(
        render,
        lambda: maps()
        | {
            "normals": np.asarray(room().normals),
            "lighting": np.ones((2, 16, 3)),
            "fov": 60.0,
            "threads": 1,
        },
        nan_out=True,
    ),
    "relight": Call(
        lambda **a: pbrfit.relight(result(), **a),
        lambda: {"light": np.ones((2, 16, 3)), "threads": 1},
        ["lighting"],
    ),
    "relight by a lamp": Call(
        lambda **a: pbrfit.relight(result(), DirectionalLight(**a)),
        lambda: {"azimuth": 10.0, "elevation": 20.0, "color": np.ones(3)},
        ["color", "colors"],
    ),
    "rotated": Call(
        sh_lights.rotated, lambda: {"coefficients": np.ones((2, 16, 3)), "degrees": 30.0}
    ),
    "Scene": Call(
        lambda **a: Scene(**a).normals, scene_arguments, ["picture", "a:", "b:", "c:"], nan_out=True
    ),
    "decompose": Call(fitted, scene_arguments, ["picture", "a:", "b:", "c:"]),
    "decompose from a start": Call(
        start_from, lambda: maps() | {"lighting": np.ones((LIGHTS, 16, 3))}, ["start"]
    ),
    "Objective": Call(
        lambda **a: list(objective().value_and_grad(**a)), lambda: {"x": objective().start()}
    ),
    "Objective.unpack": Call(
        lambda **a: objective().unpack(**a)[1], lambda: {"x": objective().start()}
    ),
    "Objective.pack": Call(
        lambda **a: objective().pack(**a), lambda: maps() | {"lighting": np.ones((LIGHTS, 16, 3))}
    ),
    "Priors": Call(
        lambda **a: [w for w in vars(Priors(**a)).values() if w is not None],
        lambda: {"material": 1.0, "cohesion": 0.1, "smoothness": 0.0, "sparsity": 0.0},
    ),
    "rmse": Call(
        metrics.rmse,
        lambda: picture_pair() | {"weights": np.ones((6, 5, 1))},
        ["rmse"],
        inf_out=True,
    ),
    "scaled_per_channel": Call(
        metrics.scaled_per_channel, picture_pair, nan_out=True, inf_out=True
    ),
}  # fmt: skip


def numbers_of(answer: Any) -> list[NDArray[Any]]:
    parts = answer if isinstance(answer, (list, tuple)) else [answer]
    return [np.asarray(part) for part in parts]


def fingerprint(value: Any) -> Any:
    """What shows a change: of an array its bytes, type and shape."""
    if isinstance(value, np.ndarray):
        if value.dtype.hasobject:
            return repr(value.tolist()), value.shape
        return value.tobytes(), str(value.dtype), value.shape, value.strides
    return repr(value)


def check(call: Call, arguments: dict[str, Any]) -> None:
    before = {name: fingerprint(value) for name, value in arguments.items()}
    names = [*arguments, *call.aliases]
    answer, refused = None, None
    try:
        answer = call.function(**arguments)
    except (InputError, TypeError, ValueError) as error:
        refused = error
    if refused is not None:
        words = str(refused)
        assert words, repr(refused)
        assert "\n" not in words, words
        assert any(name in words for name in names), f"{type(refused).__name__}: {words}"
    else:
        for part in numbers_of(answer):
            assert part.dtype.kind in "fiub", part.dtype
            wrong = np.isnan(part) & (not call.nan_out) | np.isinf(part) & (not call.inf_out)
            assert not wrong.any(), part
    assert {name: fingerprint(value) for name, value in arguments.items()} == before


@pytest.mark.parametrize("name", CALLS)
def test_arguments_as_they_should_be(name: str) -> None:
    call = CALLS[name]
    for part in numbers_of(call.function(**call.arguments())):
        assert np.isfinite(part).all()


@pytest.mark.parametrize("name", CALLS)
@profile
@given(data=st.data())
def test_any_array_is_answered_or_refused_by_name(name: str, data: st.DataObject) -> None:
    call = CALLS[name]
    arguments = call.arguments()
    chosen = data.draw(
        st.lists(st.sampled_from(sorted(arguments)), min_size=1, max_size=2, unique=True)
    )
    for argument in chosen:
        arguments[argument] = data.draw(strange(copy.deepcopy(arguments[argument])), argument)
    check(call, arguments)
