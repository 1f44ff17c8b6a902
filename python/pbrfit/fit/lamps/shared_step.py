"""A step of what all pixels share, lamps and ambient light, with the pixels eliminated.

The unknowns y move along the columns of a matrix E, mostly 0, y = E v. With the damped pixels' A,
the coupling G = B E and K = Eᵀ (Σ J_yᵀ W J_y + Q_y) E, damped by D, a step solves

    S v + Cᵀ λ = Gᵀ A⁻¹ g_p − Eᵀ g_y,    C v = 0,    S = K + D − Gᵀ A⁻¹ G

where C has the slopes of what is held, such as the scale that lamps and albedo share. S takes the
square, and its solution the cube, of the number of unknowns.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def step_of(
    shared: Array,
    gradient: Array,
    own: Array,
    mixed: Array,
    gradients: Array,
    directions: Array,
    held: Array,
    damping: float,
) -> tuple[Array, Array] | None:
    """The changes of what is shared, (M,), and of the pixels' unknowns, (P, U); None if singular.

    By the matrix (M, M) and gradient of what is shared, A (P, U, U), B (P, U, M) and gradients
    (P, U) of the pixels, and the `directions` E (M, columns) in which what is shared may move,
    without what the slopes `held` (rows, M) see. `damping` is the share of the diagonals that is
    added to them.
    """
    from scipy.sparse import csr_array

    own = own.copy()
    np.einsum("puu->pu", own)[:] *= 1 + damping
    try:
        inverse = np.linalg.inv(own)
        along = csr_array(directions)
        coupling = np.asarray(along.T @ mixed.reshape(-1, mixed.shape[-1]).T).T
        solved = np.matmul(inverse, coupling.reshape(*mixed.shape[:2], -1))
        eliminated = solved.reshape(coupling.shape)
        matrix = np.asarray(along.T @ shared @ along)
        np.einsum("uu->u", matrix)[:] += damping * np.maximum(np.diag(matrix), 1e-12)
        right = eliminated.T @ gradients.reshape(-1) - along.T @ gradient
        matrix -= coupling.T @ eliminated
        bound, none = held @ along, np.zeros((len(held), len(held)))
        bordered = np.block([[matrix, bound.T], [bound, none]])
        moved = np.linalg.solve(bordered, np.append(right, none[:, :1]))[: len(right)]
    except np.linalg.LinAlgError:
        return None
    if not np.isfinite(moved).all():
        return None
    of_pixels = -np.einsum("puv,pv->pu", inverse, gradients) - solved @ moved
    return np.asarray(along @ moved), of_pixels
