"""Bounded L-BFGS for many unknowns: vectors in Rust, pairs in float32, memory within bounds.

A quasi-Newton method for a smooth function on a box. In each iteration, entries of x on a bound
that the gradient pushes them against are held; the model of the others is minimised exactly, its
minimum is clipped to the box, and a point is taken on the straight way there.

The matrix is that of L-BFGS, from pairs s = x′ − x and y = g′ − g, the newest k of them, in the
compact form of R. H. Byrd, J. Nocedal, R. B. Schnabel, Math. Program. 63, 1994, eq. 3.5:

    B = θ I − W M Wᵀ,   W = [Y  θS],   M⁻¹ = [−D  Lᵀ; L  θSᵀS],   θ = yᵀy / sᵀy of the newest,

with D the diagonal of SᵀY and L what is below it. On the free entries F, by the
Sherman-Morrison-Woodbury formula (R. H. Byrd, P. Lu, J. Nocedal, C. Zhu, SIAM J. Sci. Comput. 16,
1995, section 5.1, which scipy's L-BFGS-B follows),

    B_FF⁻¹ g_F = g_F / θ + W_F K⁻¹ W_Fᵀ g_F / θ²,   K = M⁻¹ − W_Fᵀ W_F / θ.

Only products of 2k vectors and one sum of them are as long as x; `_core.Lbfgs` does these. Unlike
L-BFGS-B there is no search for the first minimum along the projected gradient: with one, losses
after as many iterations were the same within their scatter of a few percent.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pbrfit import _core
from pbrfit._core import InputError
from pbrfit.fit.settings import LBFGS_PAIRS, SCIPY_UP_TO
from pbrfit.model.reflection import whole_number

Array = NDArray[np.float64]

Reason = Literal["iterations", "stopped", "gradient", "descent", "stall"]
"""Why a minimisation ended: iterations done; `callback` or `fun` raised StopIteration; no entry may
move downwards; no step lowers the loss; it falls too slowly."""

DECREASE = 1e-4
"""Share of the decrease that the slope promises by which a step has to lower the loss (Armijo)."""

SHORTEN = (0.1, 0.5)
"""Smallest and largest factor by which a step that was refused is shortened."""

TRIALS = 12
"""Evaluations in one line search at most; then the model's pairs are given up."""


def choose(size: int) -> Literal["scipy", "rust"]:
    """Who minimises over so many unknowns: scipy's L-BFGS-B, or this module."""
    return "scipy" if size <= SCIPY_UP_TO else "rust"


@dataclass(frozen=True, eq=False)
class Bounds:
    """A box in runs of equal bounds, because a number for each entry would need memory."""

    ends: NDArray[np.int64]
    """(R,) int64: where each run ends; the last is n."""
    lower: Array
    upper: Array
    """(R,) float64: its bounds; infinite = none."""

    @classmethod
    def of(cls, lower: ArrayLike, upper: ArrayLike) -> Bounds:
        """From bounds of each entry, (n,)."""
        lower, upper = _vector("lower", lower), _vector("upper", upper)
        if lower.shape != upper.shape:
            raise InputError(f"upper: expected shape {lower.shape}, found {upper.shape}")
        change = (lower[1:] != lower[:-1]) | (upper[1:] != upper[:-1])
        last = np.append(np.flatnonzero(change), [len(lower) - 1] if len(lower) else [])
        last = last.astype(np.int64)
        return cls(last + 1, lower[last], upper[last])

    @classmethod
    def of_slices(cls, size: int, *parts: tuple[slice, float, float]) -> Bounds:
        """From (slice of x, lower, upper): of several for an entry the last; without one, none."""
        marks = {0, size}.union(*(part.indices(size)[:2] for part, _, _ in parts))
        first = np.array(sorted(marks), dtype=np.int64)
        lower, upper = np.full((2, len(first) - 1), [[-np.inf], [np.inf]])
        for part, low, high in parts:
            start, stop, _ = part.indices(size)
            inside = (first[:-1] >= start) & (first[:-1] < stop)
            lower[inside], upper[inside] = low, high
        return cls(first[1:], lower, upper)


@dataclass(frozen=True, eq=False)
class Iterate:
    """What a callback gets."""

    x: Array
    """Where the minimisation stands. Its memory is used again: copy what is to be kept."""
    fun: float


@dataclass(frozen=True, eq=False)
class Minimum:
    """Where a minimisation ended."""

    x: Array
    fun: float
    """The best point and its loss."""
    iterations: int
    evaluations: int
    """Steps taken, and evaluations of loss and gradient."""
    reason: Reason


def minimize(
    fun: Callable[[Array], tuple[float, Array]],
    x0: ArrayLike,
    bounds: Bounds,
    *,
    iterations: int,
    callback: Callable[[Iterate], Any] | None = None,
    corrections: int = LBFGS_PAIRS,
    threads: int = 0,
    stall: tuple[int, float] | None = None,
    resolution: float = 0.0,
) -> Minimum:
    """Lower a smooth function on a box.

    Parameters
    ----------
    fun
        Loss and gradient (n,) float64 at x. The gradient has to be a new array in each call, and x
        must not be changed or kept. Where the loss or the gradient is not finite, the step is made
        shorter. May raise StopIteration.
    x0, bounds
        (n,) start, and the box; what is outside is clipped.
    iterations
        At most so many.
    callback
        Called after each iteration; may raise StopIteration.
    corrections
        Pairs that are kept, 1 to 64: 8 bytes each for an entry of x.
    threads
        0 = one for each processor. The result does not depend on it, to the last bit.
    stall
        (window, share): stop where the loss fell by less than `share` of itself in the last
        `window` iterations.
    resolution
        Relative error of differences of nearby losses. A step whose promise is less cannot be
        judged: where such a one does not lower the loss, the minimisation ends instead of trying
        shorter ones.

    Returns
    -------
    Minimum
        Never with a higher loss than x0's.

    Raises
    ------
    InputError
        If an argument cannot be used, or the loss at x0 is not finite.
    """
    iterations = whole_number("iterations", iterations)
    vectors = _core.Lbfgs(
        bounds.ends,
        bounds.lower,
        bounds.upper,
        whole_number("corrections", corrections),
        whole_number("threads", threads),
    )
    window, share = stall or (0, 0.0)
    if stall is not None and whole_number("stall", window) == 0:
        raise InputError("stall: expected a window of 1 or more iterations, found 0")
    x0 = _vector("x0", x0)
    if x0.shape != (vectors.size,):
        raise InputError(f"x0: expected shape {(vectors.size,)}, found {x0.shape}")
    if not np.isfinite(x0).all():
        raise InputError("x0: expected finite numbers, found NaN or inf")
    search = _Search(fun, vectors, x0, resolution)
    return search.run(iterations, callback, deque([search.loss], maxlen=window + 1), share)


class _Search:
    """The point, the loss and gradient there, and memory for the next."""

    def __init__(
        self,
        fun: Callable[[Array], tuple[float, Array]],
        vectors: _core.Lbfgs,
        x0: Array,
        resolution: float,
    ) -> None:
        self.fun, self.vectors, self.resolution = fun, vectors, resolution
        self.evaluations = 0
        self.x, self.next, self.way = np.empty_like(x0), np.empty_like(x0), np.zeros_like(x0)
        vectors.moved(x0, self.way, 0.0, out=self.x)  # into the box
        self.loss, self.gradient = self._evaluate(self.x)
        squares = vectors.dot(self.gradient, self.gradient)
        if not math.isfinite(self.loss) or not math.isfinite(squares):
            raise InputError(
                f"fun: expected a finite loss and gradient at x0, found {self.loss:g} and a "
                f"gradient of square {squares:g}"
            )
        self.reach = 1.0  # length of a step without pairs

    def run(
        self,
        iterations: int,
        callback: Callable[[Iterate], Any] | None,
        losses: deque[float],
        share: float,
    ) -> Minimum:
        """`losses` keeps the last of a window."""
        done = 0
        reason: Reason = "iterations"
        try:
            while done < iterations:
                failed = self._step()
                if failed is not None:
                    reason = failed
                    break
                done += 1
                if callback is not None:
                    callback(Iterate(self.x, self.loss))
                losses.append(self.loss)
                window_is_full = share > 0 and len(losses) == losses.maxlen
                if window_is_full and losses[0] - self.loss < share * abs(losses[0]):
                    reason = "stall"
                    break
        except StopIteration:
            reason = "stopped"
        return Minimum(self.x, self.loss, done, self.evaluations, reason)

    def _step(self) -> Reason | None:
        """One iteration; or why there is none."""
        slope = self._quasi_newton() if self.vectors.pairs else None
        if slope is None or not self._along(slope):
            # The pairs may be of another region: once more without them.
            self.vectors.clear_pairs()
            slope = self._steepest()
            if slope is None:
                return "gradient"
            if not self._along(slope):
                return "descent"
        return None

    def _quasi_newton(self) -> float | None:
        """Makes the way to the model's minimum, clipped, and returns its slope, or None."""
        of_all, of_free, by_gradient, _ = self.vectors.products(self.x, self.gradient)
        found = _coefficients(of_all, of_free, by_gradient)
        if found is None:
            return None
        slope = self.vectors.direction(self.x, self.gradient, *found, out=self.way)
        return slope if slope < 0 else None

    def _steepest(self) -> float | None:
        """Makes a way down the gradient and returns its slope; None where nothing may move."""
        *_, squares = self.vectors.products(self.x, self.gradient)
        if squares == 0:
            return None
        descent = self.reach / math.sqrt(squares)
        slope = self.vectors.direction(self.x, self.gradient, descent, np.empty(0), out=self.way)
        return slope if slope < 0 else None

    def _along(self, slope: float) -> bool:
        """Goes so far on the way that the loss falls; False where it does not.

        Lengths are tried from 1 down, the next where a cubic through losses and slopes at both ends
        is least (J. Nocedal, S. J. Wright, Numerical Optimization, 2nd ed., eq. 3.59).
        """
        length = 1.0
        for _ in range(TRIALS):
            self.vectors.moved(self.x, self.way, length, out=self.next)
            loss, gradient = self._evaluate(self.next)
            # Of a gradient with NaN or inf anywhere this is not finite.
            end = self.vectors.dot(gradient, self.way)
            usable = math.isfinite(loss) and math.isfinite(end)
            if usable and loss < self.loss and loss <= self.loss + DECREASE * length * slope:
                self._take(loss, gradient)
                return True
            del gradient  # its memory, before the next is made
            if usable and -length * slope <= self.resolution * abs(self.loss):
                return False
            least = _cubic_minimum(length, self.loss, slope, loss, end) if usable else 0.0
            length = min(max(least, SHORTEN[0] * length), SHORTEN[1] * length)
        return False

    def _take(self, loss: float, gradient: Array) -> None:
        learnt = self.vectors.add_pair(self.x, self.next, self.gradient, gradient)
        if not learnt and not self.vectors.pairs:
            self.reach *= 2  # the slope does not flatten yet
        self.x, self.next = self.next, self.x
        self.loss, self.gradient = loss, gradient

    def _evaluate(self, x: Array) -> tuple[float, Array]:
        self.evaluations += 1
        loss, gradient = self.fun(x)
        return float(loss), gradient


def _coefficients(of_all: Array, of_free: Array, by_gradient: Array) -> tuple[float, Array] | None:
    """Those of the gradient and of the columns [S Y] in B_FF⁻¹ g_F; None where rounding ruins K.

    `of_all` = [S Y]ᵀ[S Y], `of_free` the same over free entries, `by_gradient` = [S Y]_Fᵀ g_F.
    """
    k = len(by_gradient) // 2
    s_y = of_all[:k, k:]
    curvature = s_y.diagonal()
    if not (curvature > 0).all():
        return None
    theta = of_all[-1, -1] / curvature[-1]
    below = np.tril(s_y, -1)
    inverse = np.block([[-np.diag(curvature), below.T], [below, theta * of_all[:k, :k]]])
    # W = [Y θS], so that both halves have the same unit. Each pair is divided by the root of its
    # own curvature: steps differ in length by orders of magnitude.
    unit = np.tile(1 / np.sqrt(curvature), 2)
    order = np.r_[k : 2 * k, :k]
    factor = unit * np.repeat([1.0, theta], k)
    of_w = factor[:, None] * of_free[np.ix_(order, order)] * factor
    matrix = unit[:, None] * inverse * unit - of_w / theta
    try:
        solved = np.linalg.solve(matrix, factor * by_gradient[order])
    except np.linalg.LinAlgError:
        return None
    coefficients = np.empty(2 * k)
    coefficients[order] = factor * solved / theta**2
    return 1 / theta, coefficients


def _cubic_minimum(
    length: float, start: float, slope: float, end: float, end_slope: float
) -> float:
    """Where the cubic with these values and slopes at 0 and `length` is least; 0 if nowhere."""
    d1 = slope + end_slope - 3 * (end - start) / length
    inside = d1 * d1 - slope * end_slope
    if inside < 0:
        return 0.0
    d2 = math.sqrt(inside)
    below = end_slope - slope + 2 * d2
    return length * (1 - (end_slope + d2 - d1) / below) if below > 0 else 0.0


def _vector(name: str, values: ArrayLike) -> Array:
    vector = np.ascontiguousarray(values, dtype=np.float64)
    if vector.ndim != 1:
        raise InputError(f"{name}: expected one dimension, found shape {vector.shape}")
    return vector
