"""The bounded L-BFGS: its vector work against numpy, and where it ends against scipy."""

from __future__ import annotations

import math
from collections.abc import Callable
from itertools import pairwise

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import Bounds as ScipyBounds
from scipy.optimize import minimize as scipy_minimize

import pbrfit
from pbrfit import _core
from pbrfit._core import InputError
from pbrfit.fit.objective import Objective
from pbrfit.fit.solvers.projected_lbfgs import TRIALS, Bounds, Iterate, minimize
from pbrfit.synthetic import make_scene

Array = NDArray[np.float64]
Function = Callable[[Array], tuple[float, Array]]


def quadratic(size: int, condition: float = 1e3) -> Function:
    """½ (x − c)ᵀ A (x − c) with a dense A of that condition number."""
    rng = np.random.default_rng(size)
    axes, _ = np.linalg.qr(rng.normal(size=(size, size)))
    matrix = axes @ np.diag(np.geomspace(1, condition, size)) @ axes.T
    centre = rng.normal(scale=1.5, size=size)

    def value(x: Array) -> tuple[float, Array]:
        slope = matrix @ (x - centre)
        return 0.5 * float((x - centre) @ slope), slope

    return value


def rosenbrock(x: Array) -> tuple[float, Array]:
    bend = x[1:] - x[:-1] ** 2
    slope = np.zeros_like(x)
    slope[:-1] = -400 * bend * x[:-1] - 2 * (1 - x[:-1])
    slope[1:] += 200 * bend
    return float((100 * bend**2 + (1 - x[:-1]) ** 2).sum()), slope


def box(size: int, lower: float, upper: float) -> Bounds:
    return Bounds.of(np.full(size, lower), np.full(size, upper))


def projected(x: Array, gradient: Array, bounds: Bounds) -> Array:
    """What a small step down the gradient moves x by, in its unit."""
    lower, upper = spread(bounds)
    down = -gradient.copy()
    down[(x <= lower) & (down < 0) | (x >= upper) & (down > 0)] = 0
    return down


def spread(bounds: Bounds) -> tuple[Array, Array]:
    lengths = np.diff(bounds.ends, prepend=0)
    return np.repeat(bounds.lower, lengths), np.repeat(bounds.upper, lengths)


def scipy_minimum(fun: Function, x0: Array, bounds: Bounds) -> float:
    found = scipy_minimize(
        fun,
        x0,
        jac=True,
        method="L-BFGS-B",
        bounds=ScipyBounds(*spread(bounds)),
        options={"maxiter": 10**5, "maxfun": 10**6, "ftol": 0.0, "gtol": 0.0},
    )
    return float(found.fun)


class TestVectors:
    """`_core.Lbfgs` against numpy, while pairs come, are dropped and entries come free."""

    @pytest.mark.parametrize("size", [1, 127, 128, 129, 5000])
    def test_products_and_directions_are_those_of_numpy(self, size: int) -> None:
        rng = np.random.default_rng(size)
        lower = np.where(np.arange(size) < size // 3, 0.0, -0.5)
        upper = np.where(np.arange(size) < size // 2, 1.0, 2.0)
        lower[-1] = -np.inf
        bounds = Bounds.of(lower, upper)
        vectors = _core.Lbfgs(bounds.ends, bounds.lower, bounds.upper, 3, 2)
        pairs: list[tuple[Array, Array]] = []
        x = np.clip(rng.normal(size=size), lower, upper)
        gradient = rng.normal(size=size)
        came_free = 0
        held = np.ones(size, bool)
        for step in range(12):
            new_x = np.clip(x + 10.0**-step * rng.normal(size=size), lower, upper)
            new_gradient = gradient + 1e-5 * (new_x - x) * rng.uniform(0.5, 2, size)
            if step % 4 == 3:
                new_gradient *= rng.choice([-1, 1], size)
            s, y = new_x - x, new_gradient - gradient
            learnt = vectors.add_pair(x, new_x, gradient, new_gradient)
            assert learnt == (
                s @ y > np.finfo(np.float32).eps * np.linalg.norm(s) * np.linalg.norm(y)
            )
            if learnt:
                pairs = [*pairs, (s, y)][-3:]
            assert vectors.pairs == len(pairs)
            x, gradient = new_x, new_gradient
            if step in (1, 5):
                continue  # two pairs one after the other
            columns = np.array([s for s, _ in pairs] + [y for _, y in pairs]).reshape(-1, size)
            free = ~((x <= lower) & (gradient >= 0) | (x >= upper) & (gradient <= 0))
            came_free += int((free & held).sum())
            held = ~free
            lengths = np.linalg.norm(columns, axis=1)

            # Columns are rounded to float32, and kept that way.
            def relative(found: Array, expected: Array, unit: Array) -> float:
                return float(np.abs((found - expected) / unit).max())

            of_all, of_free, by_gradient, squares = vectors.products(x, gradient)
            unit = np.outer(lengths, lengths)
            assert relative(of_all, columns @ columns.T, unit) < 2e-7
            assert relative(of_free, columns * free @ columns.T, unit) < 2e-7
            unit = lengths * np.linalg.norm(gradient)
            assert relative(by_gradient, columns @ (gradient * free), unit) < 2e-7
            assert squares == pytest.approx(gradient * free @ gradient, rel=1e-12)

            coefficients = rng.normal(size=len(columns)) / lengths
            way = np.empty(size)
            slope = vectors.direction(x, gradient, 0.3, coefficients, way)
            d = (0.3 * gradient + coefficients @ columns) * free
            np.testing.assert_allclose(way, np.clip(x - d, lower, upper) - x, atol=2e-6)
            assert slope == pytest.approx(gradient @ way, rel=1e-12)
            out = np.empty(size)
            vectors.moved(x, way, 0.7, out)
            assert np.array_equal(out, np.clip(x + 0.7 * way, lower, upper))
        assert size == 1 or came_free > 0
        vectors.clear_pairs()
        assert vectors.pairs == 0

    def test_pairs_of_any_unit_are_kept_to_float32(self) -> None:
        x, gradient = np.zeros(300), np.ones(300)
        vectors = _core.Lbfgs(np.array([300]), np.array([-np.inf]), np.array([np.inf]), 2)
        s = 1e-30 * np.linspace(1, 2, 300)
        assert vectors.add_pair(x, s, gradient, gradient + 1e-10 * np.linspace(2, 1, 300))
        of_all, *_ = vectors.products(x, gradient)
        assert of_all[0, 0] == pytest.approx(s @ s, rel=1e-6, abs=0)

    @pytest.mark.parametrize(
        ("change", "message"),
        [
            ({"ends": np.array([3, 3])}, "ends: expected rising numbers above 0, found 3 after 3"),
            ({"ends": np.array([], np.int64)}, "lower: expected 0 numbers, found 2"),
            ({"lower": np.array([0.0, 2.0])}, "bounds: expected from lower to upper, found 2 to 1"),
            ({"lower": np.array([np.nan, 0])}, "found NaN to 1"),
            ({"lower": np.array([np.inf, 0]), "upper": np.array([np.inf, 1])}, "found inf to inf"),
            ({"corrections": 0}, "corrections: expected 1 to 64 pairs, found 0"),
            ({"corrections": 65}, "corrections: expected 1 to 64 pairs, found 65"),
        ],
    )
    def test_bad_arguments_are_refused(self, change: dict[str, Array], message: str) -> None:
        good = {"ends": np.array([2, 3]), "lower": np.zeros(2), "upper": np.ones(2)}
        with pytest.raises(InputError) as refused:
            _core.Lbfgs(**{"corrections": 5, **good, **change})  # type: ignore[arg-type]
        assert message in str(refused.value)

    def test_vectors_of_another_length_kind_or_layout_are_refused(self) -> None:
        vectors = _core.Lbfgs(np.array([4]), np.zeros(1), np.ones(1), 2)
        four, out = np.zeros(4), np.zeros(4)
        with pytest.raises(InputError, match=r"^x: expected 4 numbers, found 3"):
            vectors.products(np.zeros(3), four)
        with pytest.raises(InputError, match=r"^gradient: expected an array of float64"):
            vectors.products(four, four.astype(np.float32))
        with pytest.raises(InputError, match=r"^gradient: expected a contiguous array"):
            vectors.products(four, np.zeros(8)[::2])
        with pytest.raises(InputError, match=r"^coefficients: expected 0 numbers, found 2"):
            vectors.direction(four, four, 1.0, np.zeros(2), out)
        with pytest.raises(InputError, match=r"^out: expected a writable array"):
            vectors.moved(out, four, 1.0, out)


class TestMinimum:
    @pytest.mark.parametrize("size", [1, 2, 40, 300])
    @pytest.mark.parametrize("half_width", [0.3, 1.0, np.inf])
    def test_of_a_convex_quadratic_is_scipys(self, size: int, half_width: float) -> None:
        fun, bounds = quadratic(size), box(size, -half_width, half_width)
        found = minimize(fun, np.zeros(size), bounds, iterations=5000)
        expected = scipy_minimum(fun, np.zeros(size), bounds)
        start, _ = fun(np.zeros(size))
        assert found.fun - expected <= 1e-9 * start
        loss, gradient = fun(found.x)
        assert loss == found.fun
        _, first = fun(np.zeros(size))
        left = np.linalg.norm(projected(found.x, gradient, bounds))
        assert left <= 1e-4 * np.linalg.norm(first)

    @pytest.mark.parametrize(("lower", "upper"), [(-2.0, 2.0), (-1.5, 0.8), (1.1, 3.0)])
    def test_of_rosenbrocks_valley_is_scipys(self, lower: float, upper: float) -> None:
        x0 = np.clip(np.tile([-1.2, 1.0], 10), lower, upper)
        bounds = box(20, lower, upper)
        found = minimize(rosenbrock, x0, bounds, iterations=3000)
        assert found.fun <= scipy_minimum(rosenbrock, x0, bounds) + 1e-8
        assert ((lower <= found.x) & (found.x <= upper)).all()

    def test_of_entries_with_bounds_of_their_own_is_in_the_box(self) -> None:
        rng = np.random.default_rng(5)
        lower = rng.uniform(-1, 0, 200)
        upper = lower + rng.uniform(0, 1, 200)
        upper[::7] = lower[::7]  # held for good
        fun = quadratic(200)
        found = minimize(fun, np.zeros(200), Bounds.of(lower, upper), iterations=2000)
        assert ((lower <= found.x) & (found.x <= upper)).all()
        expected = scipy_minimum(fun, np.clip(np.zeros(200), lower, upper), Bounds.of(lower, upper))
        assert found.fun == pytest.approx(expected, rel=1e-9)

    def test_takes_as_few_steps_as_scipy_on_a_scene(self) -> None:
        scene = make_scene("room", size=32, lights=8, held_out=1, seed=2000)
        objective = Objective(scene)
        x0 = objective.start()
        bounds = Bounds.of(*objective.bounds.T)
        found = minimize(objective.value_and_grad, x0, bounds, iterations=100)
        theirs = scipy_minimize(
            objective.value_and_grad,
            x0,
            jac=True,
            method="L-BFGS-B",
            bounds=ScipyBounds(*objective.bounds.T),
            options={"maxiter": 100, "ftol": 0.0, "gtol": 0.0},
        )
        start, _ = objective.value_and_grad(x0)
        assert found.fun < 0.01 * start
        assert found.fun < 1.25 * theirs.fun
        assert found.evaluations < 115


class TestEnds:
    @pytest.mark.parametrize(
        ("slope", "x0", "end", "iterations"),
        [
            (1.0, 0.0, 0.0, 0),  # all entries are on bounds that hold them
            (-1.0, 0.5, 1.0, None),  # everything is pushed to its bound
            (0.0, 1.0, 1.0, 0),  # the gradient is zero
        ],
    )
    def test_where_the_gradient_leads_no_further(
        self, slope: float, x0: float, end: float, iterations: int | None
    ) -> None:
        def fun(x: Array) -> tuple[float, Array]:
            return slope * float(x.sum()), np.full_like(x, slope)

        found = minimize(fun, np.full(9, x0), box(9, 0, 1), iterations=50)
        assert found.reason == "gradient"
        assert np.array_equal(found.x, np.full(9, end))
        if iterations is not None:
            assert (found.iterations, found.evaluations) == (iterations, iterations + 1)

    def test_a_start_outside_is_clipped(self) -> None:
        seen = []

        def fun(x: Array) -> tuple[float, Array]:
            seen.append(x.copy())
            return float(x @ x), 2 * x

        minimize(fun, np.array([-3.0, 5.0]), box(2, 1, 2), iterations=3)
        assert np.array_equal(seen[0], [1.0, 2.0])
        assert all(((x >= 1) & (x <= 2)).all() for x in seen)

    @pytest.mark.parametrize("iterations", [0, 1, 7])
    def test_after_the_iterations_asked_for(self, iterations: int) -> None:
        states: list[tuple[Array, float]] = []
        found = minimize(
            quadratic(50),
            np.zeros(50),
            box(50, -1, 1),
            iterations=iterations,
            callback=lambda state: states.append((state.x.copy(), state.fun)),
        )
        assert (found.iterations, len(states)) == (iterations, iterations)
        assert found.reason == "iterations"
        losses = [quadratic(50)(np.zeros(50))[0], *(fun for _, fun in states)]
        assert all(after < before for before, after in pairwise(losses))
        for x, fun in states:
            assert quadratic(50)(x)[0] == fun

    def test_when_the_callback_says_so(self) -> None:
        start, _ = quadratic(50)(np.zeros(50))

        def callback(state: Iterate) -> None:
            if state.fun < 0.6 * start:
                raise StopIteration

        found = minimize(
            quadratic(50), np.zeros(50), box(50, -1, 1), iterations=99, callback=callback
        )
        assert found.reason == "stopped"
        assert found.fun < 0.6 * start
        assert quadratic(50)(found.x)[0] == found.fun

    def test_when_the_function_says_so_with_the_last_point_that_was_taken(self) -> None:
        calls = 0
        fun = quadratic(50)

        def limited(x: Array) -> tuple[float, Array]:
            nonlocal calls
            calls += 1
            if calls == 9:
                raise StopIteration
            return fun(x)

        found = minimize(limited, np.zeros(50), box(50, -1, 1), iterations=99)
        assert (found.reason, found.evaluations) == ("stopped", 9)
        assert fun(found.x)[0] == found.fun < fun(np.zeros(50))[0]

    def test_where_the_loss_falls_too_slowly(self) -> None:
        losses: list[float] = []
        minimize(
            rosenbrock,
            np.tile([-1.2, 1.0], 30),
            box(60, -2, 2),
            iterations=500,
            stall=(10, 0.5),
            callback=lambda state: losses.append(state.fun),
        )
        start, _ = rosenbrock(np.tile([-1.2, 1.0], 30))
        losses.insert(0, start)
        falls = [1 - losses[i] / losses[i - 10] for i in range(10, len(losses))]
        assert falls[-1] < 0.5
        assert all(fall >= 0.5 for fall in falls[:-1])
        assert 10 < len(losses) < 500

    def test_where_rounding_hides_any_descent(self) -> None:
        """A loss in float32 is known to 1e-7 only: no endless search for less."""
        fun = quadratic(100, 10)

        def coarse(x: Array) -> tuple[float, Array]:
            loss, gradient = fun(x)
            return 5.0 + float(np.float32(loss)), gradient.astype(np.float32).astype(np.float64)

        found = minimize(coarse, np.zeros(100), box(100, -1, 1), iterations=10**6)
        assert found.reason in {"descent", "gradient"}
        assert found.iterations < 200
        assert found.evaluations < found.iterations + 4 * TRIALS
        least = minimize(fun, np.zeros(100), box(100, -1, 1), iterations=1000).fun
        assert found.fun - 5.0 <= least * (1 + 1e-6)

        judged = minimize(coarse, np.zeros(100), box(100, -1, 1), iterations=10**6, resolution=1e-6)
        assert judged.evaluations <= found.evaluations
        assert judged.fun - 5.0 <= least * (1 + 1e-5)


class TestRefuses:
    @pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
    @pytest.mark.parametrize("what", ["loss", "gradient", "both"])
    def test_points_without_a_finite_loss_and_gradient(self, bad: float, what: str) -> None:
        fun = quadratic(30)

        def broken(x: Array) -> tuple[float, Array]:
            loss, gradient = fun(x)
            if np.abs(x).max() > 0.4:
                loss = bad if what != "gradient" else loss
                gradient[7] = bad if what != "loss" else gradient[7]
            return loss, gradient

        found = minimize(broken, np.zeros(30), box(30, -2, 2), iterations=60)
        assert math.isfinite(found.fun)
        assert np.isfinite(found.x).all()
        assert found.fun < fun(np.zeros(30))[0]
        assert np.abs(found.x).max() <= 0.4

    def test_a_function_that_is_finite_at_the_start_alone(self) -> None:
        def broken(x: Array) -> tuple[float, Array]:
            return (1.0 if (x == 0.5).all() else math.nan), np.ones_like(x)

        found = minimize(broken, np.full(6, 0.5), box(6, 0, 1), iterations=60)
        assert (found.reason, found.fun) == ("descent", 1.0)
        assert np.array_equal(found.x, np.full(6, 0.5))
        assert found.evaluations <= 1 + TRIALS

    def test_to_end_above_the_start_where_the_gradient_lies(self) -> None:
        fun = quadratic(30)
        found = minimize(
            lambda x: (fun(x)[0], -fun(x)[1]), np.zeros(30), box(30, -1, 1), iterations=60
        )
        assert (found.reason, found.iterations) == ("descent", 0)
        assert found.fun == fun(np.zeros(30))[0]

    @pytest.mark.parametrize("bad", [np.nan, np.inf])
    def test_a_start_whose_loss_is_not_finite(self, bad: float) -> None:
        with pytest.raises(InputError, match=r"^fun: expected a finite loss and gradient at x0"):
            minimize(lambda x: (bad, x), np.zeros(3), box(3, -1, 1), iterations=5)

    @pytest.mark.parametrize(
        ("change", "message"),
        [
            ({"x0": np.zeros(4)}, r"x0: expected shape \(3,\), found \(4,\)"),
            ({"x0": np.zeros((3, 1))}, "x0: expected one dimension"),
            ({"x0": np.array([0, np.nan, 0])}, "x0: expected finite numbers"),
            ({"iterations": -1}, "iterations: expected"),
            ({"iterations": 1.5}, "iterations: expected"),
            ({"corrections": 0}, "corrections: expected 1 to 64 pairs, found 0"),
            ({"threads": -1}, "threads: expected"),
            ({"stall": (0, 0.1)}, "stall: expected a window of 1 or more iterations, found 0"),
        ],
    )
    def test_arguments_that_cannot_be_used(self, change: dict[str, object], message: str) -> None:
        arguments = {"x0": np.zeros(3), "bounds": box(3, -1, 1), "iterations": 5, **change}
        with pytest.raises(InputError, match=f"^{message}"):
            minimize(quadratic(3), **arguments)  # type: ignore[arg-type]


class TestBounds:
    def test_of_slices_are_those_of_entries(self) -> None:
        scene = make_scene("room", size=16, lights=4, held_out=1, seed=3)
        objective = Objective(scene, priors=pbrfit.Priors())
        lower, upper = objective.bounds.T.copy()
        lower[objective.roughness] = 0.1
        bounds = Bounds.of_slices(
            objective.size, (objective.layout.maps, 0.0, 1.0), (objective.roughness, 0.1, 1.0)
        )
        found = spread(bounds)
        assert np.array_equal(found[0], lower)
        assert np.array_equal(found[1], upper)

    def test_of_different_lengths_are_refused(self) -> None:
        with pytest.raises(InputError, match=r"^upper: expected shape \(2,\), found \(3,\)"):
            Bounds.of(np.zeros(2), np.ones(3))
