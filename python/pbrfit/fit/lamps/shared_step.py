"""A step of what all pixels share, lamps and ambient light, with the pixels eliminated.

The unknowns y move along the columns of a sparse matrix E, y = E v. With the damped pixels' A, the
coupling G = B E and K = Eᵀ (Σ J_yᵀ W J_y + Q_y) E, damped by D, a step solves

    S v = Gᵀ A⁻¹ g_p − Eᵀ g_y,    S = K + D − Gᵀ A⁻¹ G,    subject to C v = 0

where C has the slopes of what is held, such as the scale that lamps and albedo share. Few unknowns
are solved for at once. That costs the cube of their number, so that of many S is never formed:
conjugate gradients with products G v, whose preconditioner has the blocks of S that belong to one
picture each, projected on C v = 0 (N. Gould, M. Hribar, J. Nocedal, "On the Solution of Equality
Constrained Quadratic Programming Problems", SIAM J. Sci. Comput. 23, 2001).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pbrfit.fit.conjugate_gradients import conjugate_gradients

Array = NDArray[np.float64]

DENSE_UNKNOWNS_MAX = 1000
"""Unknowns up to which S is formed: there it takes as long as a hundred products."""

PRODUCTS_MAX = 300
"""Products with S at most in a step."""

ERROR_RATIO = 1e-3
"""Ratio of the remaining error to the first, in the norm of the preconditioner, at which conjugate
gradients stop: far below what a step leaves that is not linear."""


@dataclass(eq=False)
class Directions:
    """The columns of E, the picture that each belongs to, and what is held."""

    size: int
    """M, the number of unknowns."""
    rows: list[NDArray[np.intp]] = field(default_factory=list)
    vectors: list[Array] = field(default_factory=list)
    """(rows, columns) of each block."""
    groups: list[int] = field(default_factory=list)
    """A picture, or another number for what all have in common, a block."""
    held: list[Array] = field(default_factory=list)
    """(M,) each: slopes of what must not change."""

    def add(self, rows: NDArray[np.intp], vectors: Array, group: int) -> None:
        """Some unknowns move along some vectors."""
        self.rows.append(rows)
        self.vectors.append(vectors)
        self.groups.append(group)

    def sparse(self) -> Any:
        """E, (M, columns), a sparse array of scipy."""
        from scipy.sparse import coo_array

        values, at, columns, count = [], [], [], 0
        for rows, vectors in zip(self.rows, self.vectors, strict=True):
            own = np.arange(count, count + vectors.shape[1])
            values.append(vectors.ravel())
            at.append(np.repeat(rows, len(own)))
            columns.append(np.tile(own, len(rows)))
            count += len(own)
        if not values:
            return coo_array((self.size, 0)).tocsr()
        entries = np.concatenate(values), (np.concatenate(at), np.concatenate(columns))
        return coo_array(entries, shape=(self.size, count)).tocsr()

    def column_groups(self) -> NDArray[np.intp]:
        """(columns,): of which group each is."""
        return np.repeat(self.groups, [vectors.shape[1] for vectors in self.vectors]).astype(
            np.intp
        )

    def constraints(self, along: Any) -> Array:
        """C, (held, columns)."""
        held = np.array(self.held).reshape(-1, self.size)
        return np.asarray(along.T @ held.T).T

    def basis(self) -> Array:
        """(M, free): E times the null space of C, dense."""
        along = self.sparse()
        return np.asarray(along @ null_space_of(self.constraints(along)))


def null_space_of(constraints: Array) -> Array:
    """An orthonormal basis (M, M − rows) of what constraints (rows, M) of full rank allow.

    Columns that no constraint has part in stay axes.
    """
    from scipy.linalg import null_space

    count = constraints.shape[1]
    if not len(constraints):
        return np.eye(count)
    bound = constraints.any(axis=0)
    found = np.zeros((count, count - len(constraints)))
    free = int(np.count_nonzero(~bound))
    found[np.flatnonzero(~bound), np.arange(free)] = 1.0
    found[np.ix_(bound, np.arange(free, found.shape[1]))] = null_space(constraints[:, bound])
    return found


def step_of(
    shared: Array,
    gradient: Array,
    own: Array,
    mixed: Array,
    gradients: Array,
    directions: Directions,
    damping: float,
) -> tuple[Array, Array] | None:
    """The changes of what is shared, (M,), and of the pixels' unknowns, (P, U).

    Parameters
    ----------
    shared, gradient
        Matrix (M, M) and gradient of what is shared.
    own, mixed, gradients
        A (P, U, U), B (P, U, M) and gradients (P, U) of the pixels.
    directions
        In which what is shared may move.
    damping
        Share of the diagonals that is added to them.

    Returns
    -------
    None if there is no such step.
    """
    own = own.copy()
    np.einsum("puu->pu", own)[:] *= 1 + damping
    try:
        inverse = np.linalg.inv(own)
        along = directions.sparse()
        coupling = np.asarray(along.T @ mixed.reshape(-1, mixed.shape[-1]).T).T
        solved = np.matmul(inverse, coupling.reshape(*mixed.shape[:2], -1))
        eliminated = solved.reshape(coupling.shape)
        matrix = np.asarray(along.T @ shared @ along)
        np.einsum("uu->u", matrix)[:] += damping * np.maximum(np.diag(matrix), 1e-12)
        right = eliminated.T @ gradients.reshape(-1) - along.T @ gradient
        system = _System(matrix, coupling, eliminated, directions.constraints(along))
        if along.shape[1] <= DENSE_UNKNOWNS_MAX:
            moved = system.solved_at_once(right)
        else:
            moved = system.solved_by_products(right, directions.column_groups())
    except np.linalg.LinAlgError:
        return None
    if not np.isfinite(moved).all():
        return None
    of_pixels = -np.einsum("puv,pv->pu", inverse, gradients) - solved @ moved
    return np.asarray(along @ moved), of_pixels


@dataclass(frozen=True, eq=False)
class _System:
    """S and what is held."""

    matrix: Array
    """K + D."""
    coupling: Array
    """G, (P U, columns)."""
    eliminated: Array
    """A⁻¹ G."""
    constraints: Array

    def solved_at_once(self, right: Array) -> Array:
        """By S itself, with CᵀC added: S tells next to nothing along what is held."""
        held = self.constraints
        whole = self.matrix - self.coupling.T @ self.eliminated
        if len(held):
            whole += np.trace(whole) / np.square(held).sum() * (held.T @ held)
        found = np.linalg.solve(whole, np.column_stack([right, held.T]))
        moved, across = found[:, 0], found[:, 1:]
        return np.asarray(moved - across @ np.linalg.solve(held @ across, held @ moved))

    def solved_by_products(self, right: Array, groups: NDArray[np.intp]) -> Array:
        """By conjugate gradients."""

        def product(v: Array) -> Array:
            return np.asarray(self.matrix @ v - self.eliminated.T @ (self.coupling @ v))

        solved = self._preconditioner(groups)
        return conjugate_gradients(
            right, product, solved, ratio=ERROR_RATIO, iterations=PRODUCTS_MAX
        )[0]

    def _preconditioner(self, groups: NDArray[np.intp]) -> Callable[[Array], Array]:
        """S⁻¹ of each group by itself, projected."""
        from scipy.sparse import coo_array

        values, rows, columns = [], [], []
        for group in np.unique(groups):
            of = np.flatnonzero(groups == group)
            block = self.matrix[np.ix_(of, of)] - self.coupling[:, of].T @ self.eliminated[:, of]
            values.append(np.linalg.inv(block).ravel())
            rows.append(np.repeat(of, len(of)))
            columns.append(np.tile(of, len(of)))
        entries = np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))
        blocks = coo_array(entries, shape=self.matrix.shape).tocsr()
        across = np.asarray(blocks @ self.constraints.T)
        inner = np.linalg.inv(self.constraints @ across)

        def solved(v: Array) -> Array:
            found = blocks @ v
            return np.asarray(found - across @ (inner @ (self.constraints @ found)))

        return solved
