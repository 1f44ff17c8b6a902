"""The border to Rust: whatever is passed, a finite result or one line that names the argument.

A panic would surface as `pyo3_runtime.PanicException`, which no test here expects.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

import reference
from pbrfit import InputError, _core
from under_lamps import of_lamp_samples

Array = NDArray[Any]
Arguments = dict[str, Any]

EXAMPLES = os.environ.get("PBRFIT_EXAMPLES")

thorough = settings(
    max_examples=int(EXAMPLES or 15),
    deadline=None,
    derandomize=EXAMPLES is None,  # the same examples in every run
    suppress_health_check=[HealthCheck.too_slow],
)


@dataclass(frozen=True)
class Kind:
    """Sizes, and which of the parts of a problem there are."""

    pixels: int
    pictures: int
    channels: int
    sh_order: int
    weights: str
    known_lights: bool
    metallic: float | None
    free_normals: bool = False

    @property
    def coefficients(self) -> int:
        return (self.sh_order + 1) ** 2


kinds = st.builds(
    Kind,
    pixels=st.sampled_from([1, 2, 5, 130]),
    pictures=st.integers(1, 3),
    channels=st.sampled_from([1, 3]),
    sh_order=st.sampled_from([2, 3]),
    weights=st.sampled_from(["none", "sample", "channel"]),
    known_lights=st.booleans(),
    metallic=st.sampled_from([None, 0.0, 0.7]),
    free_normals=st.booleans(),
)


def pixels_of(kind: Kind, rng: np.random.Generator) -> Arguments:
    normal, view = reference.unit(rng.normal(size=(2, kind.pixels, 3)))
    return {
        "normal": normal,
        "view": view,
        "albedo": rng.random((kind.pixels, 3)),
        "roughness": rng.random(kind.pixels),
        "metallic": rng.random(kind.pixels),
    }


def many_of(kind: Kind, rng: np.random.Generator) -> Arguments:
    """The same by the names of functions of many pixels."""
    names = {"normal": "normals", "view": "views"}
    return {names.get(name, name): array for name, array in pixels_of(kind, rng).items()}


def lamplit_of(kind: Kind, rng: np.random.Generator) -> Arguments:
    """With a lamp for each picture."""
    directions = reference.unit(rng.normal(size=(kind.pixels, kind.pictures, 3)))
    return many_of(kind, rng) | {"directions": directions, "threads": 1}


def seen_under_lamps(kind: Kind, rng: np.random.Generator) -> Arguments:
    samples = (kind.pixels, kind.pictures, 3)
    return lamplit_of(kind, rng) | {
        "pictures": rng.random(samples),
        "weights": rng.random(samples),
        "limits": rng.integers(0, 3, samples).astype(np.uint8),
        "intensities": rng.random(samples),
        "picture_of": np.arange(kind.pictures, dtype=np.uint64),
        "ambient": rng.normal(size=(kind.pictures, 3)),
    }


def under_moving_lamps(kind: Kind, rng: np.random.Generator) -> Arguments:
    of_lamps = kind.pixels, kind.pictures
    moving = {"strengths": rng.random(of_lamps), "by_place": rng.normal(size=(*of_lamps, 4))}
    return seen_under_lamps(kind, rng) | moving


def with_noise(kind: Kind, rng: np.random.Generator) -> Arguments:
    noise = {"floor": 0.1, "growth": 0.2, "proportional": kind.free_normals, "least": 1e-4}
    return seen_under_lamps(kind, rng) | noise | {"shadows": rng.random(kind.pictures)}


def under_lamps(kind: Kind, rng: np.random.Generator) -> Arguments:
    seen = seen_under_lamps(kind, rng)
    # Less than 90 degrees apart.
    normals = reference.unit(np.array([0, 0, 1.5]) + seen.pop("normals"))
    return seen | {
        "base_normals": normals,
        "start_normals": normals,
        "prior_mean": rng.random((kind.pixels, 7)),
        "prior_precision": rng.random((kind.pixels, 7)),
        "free_normals": kind.free_normals,
        "free_metallic": kind.metallic is None,
        "free_roughness": True,
        "iterations": 3,
    }


def problem_of(kind: Kind, rng: np.random.Generator) -> Arguments:
    pixels = pixels_of(kind, rng)
    shape = (kind.pictures, kind.pixels, kind.channels)
    arguments = {
        "images": rng.random(shape, dtype=np.float32),
        "normals": pixels["normal"],
        "views": pixels["view"],
        "threads": 1,
        "sh_order": kind.sh_order,
        "metallic": kind.metallic,
        "free_normals": kind.free_normals,
    }
    if kind.weights != "none":
        of_samples = shape[: 2 if kind.weights == "sample" else 3]
        arguments["weights"] = rng.random(of_samples, dtype=np.float32)
    if kind.known_lights:
        lights = (kind.pictures, kind.coefficients, kind.channels)
        arguments["lighting"] = rng.normal(size=lights)
    return arguments


def among_of(kind: Kind, rng: np.random.Generator) -> Arguments:
    """With tables of what surroundings block and bring; their normals are given."""
    return problem_of(replace(kind, free_normals=False), rng) | {
        "transfer": rng.random((kind.pixels, 5, 16), dtype=np.float32),
        "bounced": rng.random((kind.pixels, 5, kind.pictures * kind.channels), dtype=np.float32),
    }


def solved_of(kind: Kind, rng: np.random.Generator) -> Arguments:
    """What methods are given that solve for pixels, with a prior on what clusters share."""
    count = 1 + (kind.metallic is None) + 2 * kind.free_normals
    return {
        "x": x_of(kind, rng),
        "pixels": rng.permutation(kind.pixels).astype(np.uint64),
        "precision": rng.random((kind.pixels, count)),
    }


def maps_of(kind: Kind, rng: np.random.Generator) -> Array:
    planes = kind.channels + 1 + (kind.metallic is None) + 2 * kind.free_normals
    return rng.random(planes * kind.pixels)


def x_of(kind: Kind, rng: np.random.Generator) -> Array:
    lights = 0 if kind.known_lights else kind.pictures * kind.coefficients * kind.channels
    return np.concatenate([maps_of(kind, rng), rng.normal(size=lights)])


def evaluate(kind: Kind, rng: np.random.Generator, arguments: Arguments) -> tuple[Array, ...]:
    """Everything that a problem of these arguments can say."""
    problem = _core.Problem(**arguments)
    loss, gradient = problem.value_and_grad(x_of(kind, rng))
    return np.array(loss), gradient, *problem.light_equations(maps_of(kind, rng))


@dataclass(frozen=True)
class Function:
    """A function of the core: good arguments, and how it is called."""

    arguments: Callable[[Kind, np.random.Generator], Arguments]
    call: Callable[[Kind, np.random.Generator, Arguments], Any]


def alone(function: Callable[..., Any]) -> Callable[[Kind, np.random.Generator, Arguments], Any]:
    """The call of a function that needs its arguments only."""
    return lambda _, __, arguments: function(**arguments)


def of_lamps(name: str) -> Callable[[Kind, np.random.Generator, Arguments], Any]:
    """The call of a method of samples under lamps."""
    return lambda _, __, arguments: of_lamp_samples(name, arguments)


def of_problem(name: str, **more: Any) -> Callable[[Kind, np.random.Generator, Arguments], Any]:
    """The call of a method of a good problem."""

    def call(kind: Kind, rng: np.random.Generator, arguments: Arguments) -> Any:
        return getattr(_core.Problem(**problem_of(kind, rng)), name)(**arguments, **more)

    return call


def with_cotangent(kind: Kind, rng: np.random.Generator) -> Arguments:
    return pixels_of(kind, rng) | {"cotangent": rng.normal(size=(kind.pixels, 3, 16))}


def with_lighting(kind: Kind, rng: np.random.Generator) -> Arguments:
    lighting = rng.normal(size=(kind.pictures, 16, 3))
    return many_of(kind, rng) | {"lighting": lighting, "threads": 1}


def with_clusters(kind: Kind, rng: np.random.Generator) -> Arguments:
    solved = solved_of(kind, rng)
    means = {"mean": rng.random(solved["precision"].shape)}
    return solved | means | {"roughness": rng.random(3), "metallic": rng.random(2)}


def with_deviation(kind: Kind, rng: np.random.Generator) -> Arguments:
    solved = solved_of(kind, rng)
    return solved | {"deviation": rng.normal(size=solved["precision"].shape)}


FUNCTIONS = {
    "sh_basis": Function(
        lambda kind, rng: {"directions": pixels_of(kind, rng)["normal"]}, alone(_core.sh_basis)
    ),
    "ggx_band_weights": Function(
        lambda kind, rng: {"r": rng.random(kind.pixels)}, alone(_core.ggx_band_weights)
    ),
    "shade": Function(pixels_of, alone(_core.shade)),
    "shade_vjp": Function(with_cotangent, alone(_core.shade_vjp)),
    "render": Function(with_lighting, alone(_core.render)),
    "lamp_radiance": Function(lamplit_of, alone(_core.lamp_radiance)),
    "LampSamples.system": Function(under_moving_lamps, of_lamps("system")),
    # Odds of samples that no shadow explains are infinite.
    "LampSamples.judge": Function(with_noise, lambda *given: of_lamps("judge")(*given)[1:]),
    "LampSamples.fit": Function(under_lamps, of_lamps("fit")),
    "Problem": Function(problem_of, evaluate),
    "Problem among surroundings": Function(
        among_of,
        lambda kind, rng, arguments: evaluate(replace(kind, free_normals=False), rng, arguments),
    ),
    "fit_materials": Function(with_clusters, of_problem("fit_materials")),
    "schur_complement": Function(with_deviation, of_problem("schur_complement", damping=0.1)),
    "value_and_grad": Function(
        lambda kind, rng: {"x": x_of(kind, rng)}, of_problem("value_and_grad")
    ),
    "light_equations": Function(
        lambda kind, rng: {"maps": maps_of(kind, rng)}, of_problem("light_equations")
    ),
}

every_function = pytest.mark.parametrize("name", FUNCTIONS)


def outcome(function: Function, kind: Kind, arguments: Arguments) -> tuple[Array, ...]:
    found = function.call(kind, np.random.default_rng(1), arguments)
    arrays = found if isinstance(found, tuple) else (found,)
    return tuple(np.asarray(array) for array in arrays)


def packed(array: Array) -> Array:
    """A field of records without padding: strides that are no multiple of the item size."""
    records = np.zeros(array.shape, dtype=[("other", "u1"), ("values", array.dtype)])
    records["values"] = array
    return np.asarray(records["values"])


def shifted(array: Array) -> Array:
    """One byte off any alignment."""
    data = b"\0" + array.tobytes()
    return np.frombuffer(data, array.dtype, array.size, offset=1).reshape(array.shape)


def every_other(array: Array) -> Array:
    whole = np.full((*array.shape[:-1], 2 * array.shape[-1]), 7, dtype=array.dtype)
    whole[..., ::2] = array
    return whole[..., ::2]


def backwards(array: Array) -> Array:
    flipped = tuple(slice(None, None, -1) for _ in array.shape)
    return array[flipped].copy()[flipped]


def read_only(array: Array) -> Array:
    copy = array.copy()
    copy.setflags(write=False)
    return copy


def first_repeated(array: Array) -> Array:
    """All rows like the first, in the memory of one."""
    return np.broadcast_to(array[:1], array.shape)


LAYOUTS: dict[str, Callable[[Array], Array]] = {
    "C order": np.ascontiguousarray,
    "Fortran order": np.asfortranarray,
    "last axis first": lambda a: np.moveaxis(np.moveaxis(a, -1, 0).copy(), 0, -1),
    "negative strides": backwards,
    "every other": every_other,
    "packed records": packed,
    "one byte off": shifted,
    "read-only": read_only,
    "zero stride": first_repeated,
}


@every_function
@thorough
@given(kind=kinds, data=st.data())
def test_layout_does_not_change_a_bit(name: str, kind: Kind, data: st.DataObject) -> None:
    function = FUNCTIONS[name]
    arguments = function.arguments(kind, np.random.default_rng(0))
    for argument, value in arguments.items():
        if isinstance(value, np.ndarray):
            layout = data.draw(st.sampled_from(list(LAYOUTS)), label=f"layout of {argument}")
            arguments[argument] = LAYOUTS[layout](value)
    plain = {
        argument: np.array(value, order="C") if isinstance(value, np.ndarray) else value
        for argument, value in arguments.items()
    }
    found, expected = outcome(function, kind, arguments), outcome(function, kind, plain)
    for a, b in zip(found, expected, strict=True):
        np.testing.assert_array_equal(a, b)


DTYPES = [
    *("float16", "float32", "float64", "longdouble", "complex64", "complex128"),
    *("bool", "int8", "int64", "uint64", ">f4", ">f8", "datetime64[s]", "U3", "S3", "O"),
]
NO_ARRAYS: list[Any] = [None, "a picture", b"bytes", 0.5, 3, [0.5, 0.5], [], {}, object(), ...]
VALUES = [np.nan, np.inf, -np.inf, -0.0, 5e-324, 1e-45, -1e-9, 1 + 1e-9, 1e9, 1e19, 1e38, 1e308]


def other_dtype(array: Array, data: st.DataObject) -> Any:
    dtype = data.draw(st.sampled_from([d for d in DTYPES if np.dtype(d) != array.dtype]))
    return np.zeros(array.shape, dtype) if dtype[0] in "d>US" else array.astype(dtype)


def other_shape(array: Array, data: st.DataObject) -> Any:
    """An axis that is longer, shorter, empty, gone or more, or no axes at all."""
    axis = data.draw(st.integers(0, array.ndim - 1))
    length = array.shape[axis]
    changes: dict[str, Callable[[], Array]] = {
        "longer": lambda: np.take(array, [0, *range(length)], axis),
        "shorter": lambda: np.take(array, range(1, length), axis),
        "empty": lambda: np.take(array, [], axis),
        "gone": lambda: np.take(array, 0, axis),
        "more": lambda: np.expand_dims(array, axis),
        "many more": lambda: array.reshape((1,) * (32 - array.ndim) + array.shape),
        "none": lambda: array.ravel()[0],
        "swapped": lambda: array.T,
    }
    return changes[data.draw(st.sampled_from(list(changes)))]()


def other_value(array: Array, data: st.DataObject) -> Any:
    changed = array.copy()
    place = data.draw(st.integers(0, array.size - 1))
    values = VALUES if array.dtype.kind == "f" else [0, 1, 2, 3, 200]
    with np.errstate(over="ignore"):
        changed.flat[place] = data.draw(st.sampled_from(values))
    return changed


def huge(array: Array, data: st.DataObject) -> Any:
    """More numbers than memory could hold, of which few exist."""
    axis = data.draw(st.integers(0, array.ndim - 1))
    length = data.draw(st.sampled_from([2**31 + 1, 2**40]))
    one = np.take(array, [0], axis)
    shape = (*array.shape[:axis], length, *array.shape[axis + 1 :])
    return np.broadcast_to(one, shape)


def no_array(_: Array, data: st.DataObject) -> Any:
    return data.draw(st.sampled_from(NO_ARRAYS))


NUMBERS = ("sh_order", "metallic", "threads")
CHANGES = [other_dtype, other_shape, other_value, huge, no_array]


def assert_finite_or_refused(
    function: Function, kind: Kind, arguments: Arguments, changed: str = ""
) -> None:
    """A refusal is one line that names an argument: the changed one, or one it should go with.

    Numbers of another type are the business of the signature.
    """
    names = "|".join([*function.arguments(kind, np.random.default_rng(0)), "x", "maps"])
    try:
        found = outcome(function, kind, arguments)
    except (InputError, TypeError) as error:
        message, form = str(error), rf"({names})( \(.*\))?: expected .*, found .*"
        if isinstance(error, TypeError):
            message = " ".join([message, *getattr(error, "__notes__", [])])
            form = f".*'{changed}'" if changed in NUMBERS else "(no TypeError)"
        if not re.fullmatch(form, message):
            raise AssertionError(f"{changed}: {message!r} is not of the form {form}") from error
    else:
        for array in found:
            assert np.isfinite(array).all(), f"{changed} led to {array}"


@every_function
@pytest.mark.parametrize("change", CHANGES)
@thorough
@given(kind=kinds, data=st.data())
def test_a_bad_array_is_refused_by_name(
    change: Callable[[Array, st.DataObject], Any], name: str, kind: Kind, data: st.DataObject
) -> None:
    function = FUNCTIONS[name]
    arguments = function.arguments(kind, np.random.default_rng(0))
    arrays = [argument for argument, value in arguments.items() if isinstance(value, np.ndarray)]
    changed = data.draw(st.sampled_from(arrays))
    arguments[changed] = change(arguments[changed], data)
    if change in (other_dtype, no_array, huge):
        if changed in ("weights", "lighting", "limits") and arguments[changed] is None:
            return  # may be left out
        with pytest.raises(InputError, match=f"^{changed}: expected") as refusal:
            outcome(function, kind, arguments)
        assert "\n" not in str(refusal.value)
    assert_finite_or_refused(function, kind, arguments, changed)


@thorough
@given(
    kind=kinds,
    changed=st.sampled_from(NUMBERS),
    value=st.sampled_from([None, "3", 2.5, 0, 1, 4, 10**6, np.nan, -1.0, 1.5, np.inf, [2], 2j]),
)
def test_a_bad_number_is_refused_by_name(kind: Kind, changed: str, value: Any) -> None:
    arguments = problem_of(kind, np.random.default_rng(0)) | {changed: value}
    if changed == "metallic" and (value is None) != (kind.metallic is None):
        return  # that is another kind of problem
    assert_finite_or_refused(FUNCTIONS["Problem"], kind, arguments, changed)


@pytest.mark.parametrize(("pixels", "pictures"), [(0, 1), (1, 0), (0, 0), (5, 0)])
@pytest.mark.parametrize("channels", [1, 3])
def test_a_problem_of_nothing_is_refused(pixels: int, pictures: int, channels: int) -> None:
    kind = Kind(pixels, pictures, channels, 3, "sample", known_lights=True, metallic=None)
    with pytest.raises(InputError, match=r"^images: expected at least one picture and one pixel"):
        _core.Problem(**problem_of(kind, np.random.default_rng(0)))


@pytest.mark.parametrize("name", ["sh_basis", "ggx_band_weights", "shade", "shade_vjp", "render"])
@pytest.mark.parametrize("pixels", [0, 1])
@pytest.mark.parametrize("pictures", [0, 1])
def test_nothing_gives_nothing(name: str, pixels: int, pictures: int) -> None:
    kind = Kind(pixels, pictures, 3, 3, "none", known_lights=False, metallic=None)
    function = FUNCTIONS[name]
    found = outcome(function, kind, function.arguments(kind, np.random.default_rng(0)))
    for array in found:
        assert (array.size == 0) == (pixels == 0 or (name == "render" and pictures == 0))


@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize(
    ("pixels", "pictures"), [(2, 2**30 + 1), (2**16, 2**16), (2**31 + 1, 1), (2**40, 2**15)]
)
def test_too_many_samples_are_refused_before_they_are_copied(
    pixels: int, pictures: int, channels: int
) -> None:
    images = np.broadcast_to(np.float32(0.5), (pictures, pixels, channels))
    directions = np.broadcast_to([0.0, 0.0, 1.0], (pixels, 3))
    weights = np.broadcast_to(np.float32(0.5), (pictures, pixels))
    for of_samples in (None, weights):
        with pytest.raises(InputError, match=r"^(images|normals): expected at most 2147483648 "):
            _core.Problem(images, directions, directions, weights=of_samples)


def test_too_many_rendered_samples_are_refused_before_they_are_made() -> None:
    pixels = FUNCTIONS["render"].arguments(
        Kind(2**18, 1, 3, 3, "none", known_lights=False, metallic=None), np.random.default_rng(0)
    )
    pixels["lighting"] = np.broadcast_to(1.0, (2**14, 16, 3))
    with pytest.raises(InputError, match=r"^lighting: expected at most 2147483648 pixels times"):
        _core.render(**pixels)


@pytest.mark.skipif(sys.platform != "linux", reason="limits and sizes of memory as Linux has them")
def test_too_little_memory_is_a_memory_error() -> None:
    """For the copy of x, then for the gradient, 38 MiB each; in a process of its own."""
    code = """
import resource
import numpy as np
from pbrfit import _core

normals = np.tile([0.0, 0.0, 1.0], (1_000_000, 1))
images = np.ones((1, 1_000_000, 3), np.float32)
problem = _core.Problem(images, normals, normals, 1)
x = np.full(problem.size, 0.5)
pages = int(open("/proc/self/statm").read().split()[0])
for mib in (10, 60, 120):
    limit = pages * resource.getpagesize() + mib * 2**20
    resource.setrlimit(resource.RLIMIT_AS, (limit, resource.RLIM_INFINITY))
    try:
        print("ok" if problem.value_and_grad(x)[0] > 0 else "wrong")
    except MemoryError:
        print("MemoryError")
"""
    ran = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=120, check=False
    )
    assert ran.stdout.split() == ["MemoryError", "MemoryError", "ok"], ran.stderr
