"""A step of what all pixels share, lamps and ambient light, with the pixels eliminated.

The unknowns y move along the columns of a sparse matrix E, y = E v. With the damped pixels' A, the
coupling G = B E and K = Eᵀ (Σ J_yᵀ W J_y + Q_y) E, damped by D, a step solves

    S v = Gᵀ A⁻¹ g_p − Eᵀ g_y,    S = K + D − Gᵀ A⁻¹ G,    subject to C v = 0

where C has the slopes of what is held, such as the scale that lamps and albedo share: v moves in
the null space of C. S takes the square, and its solution the cube, of the number of unknowns.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(eq=False)
class Directions:
    """The columns of E, and what is held."""

    size: int
    """M, the number of unknowns."""
    rows: list[NDArray[np.intp]] = field(default_factory=list)
    vectors: list[Array] = field(default_factory=list)
    """(rows, columns) of each block."""
    held: list[Array] = field(default_factory=list)
    """(M,) each: slopes of what must not change."""

    def add(self, rows: NDArray[np.intp], vectors: Array) -> None:
        """Some unknowns move along some vectors."""
        self.rows.append(rows)
        self.vectors.append(vectors)

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
    """The changes of what is shared, (M,), and of the pixels' unknowns, (P, U); None if singular.

    By the matrix (M, M) and gradient of what is shared, A (P, U, U), B (P, U, M) and gradients
    (P, U) of the pixels, and the `directions` in which what is shared may move. `damping` is the
    share of the diagonals that is added to them.
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
        free = null_space_of(directions.constraints(along))
        matrix = free.T @ (matrix - coupling.T @ eliminated) @ free
        moved = free @ np.linalg.solve(matrix, free.T @ right)
    except np.linalg.LinAlgError:
        return None
    if not np.isfinite(moved).all():
        return None
    of_pixels = -np.einsum("puv,pv->pu", inverse, gradients) - solved @ moved
    return np.asarray(along @ moved), of_pixels
