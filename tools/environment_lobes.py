"""Makes rust/environment/environment_lobes.bin: BRDF lobes as sums of round, blurred ones.

    python tools/environment_lobes.py            fit, write the table, print its errors
    python tools/environment_lobes.py --check    the table as it is: its errors

Needs numpy, scipy and pbrfit. Takes ten minutes. A panorama is kept blurred by von Mises-Fisher
lobes of widths σ_j = 2^j σ_0 (`rust/environment/blurred.rs`). Here the mirror-like part of each
reflection model, with x = n·v, in the frame with z = n and the mirror direction (√(1−x²), 0, x),

    a(l) = D V n·l (1 − (1−v·h)⁵)        b(l) = D V n·l (1−v·h)⁵

is fitted by sums of such lobes in the plane of incidence, both with the same lobes,

    a(l) ≈ Σ_k a_k K(l, d_k; λ_k)    b(l) ≈ Σ_k b_k K(l, d_k; λ_k)    d_k = (sin φ_k, 0, cos φ_k)
    K(l, d; j + f) = (1−f) K_j(l·d) + f K_{j+1}(l·d)
    K_j(c) = e^{(c−1)/σ_j²} / (2π σ_j² (1−e^{−2/σ_j²}))

with a_k, b_k ≥ 0, so that the radiance of a surface is Σ_k (A a_k + B b_k) times the panorama at
d_k and blur λ_k, and never negative. The last two lobes are hemispheres about the normal, which the
horizon cuts. Several lobes follow the long tail of GGX and its stretching at grazing angles, which
one round lobe (the usual split sum) does not.

Least squares in the mean over directions, together with the ten harmonics up to l = 3, for F0 = 1
and F0 = 0.04, each by its own norm; Σ a_k and Σ b_k are then scaled to the integrals of a and b.
Fits start from a neighbour's, and are held to it weakly, so that tables may be interpolated.

The file is little-endian: 8 bytes "PBRENVL1"; uint32 models, cells by r and by x (nodes less one),
lobes; then float32 [model][r][x][lobe][φ − mirror's, λ, a, b]. Nodes: r = i/cells, x = (j/cells)².
"""

from __future__ import annotations

import argparse
import struct
import sys
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

ROOT = Path(__file__).resolve().parent.parent
TABLE = ROOT / "rust" / "environment" / "environment_lobes.bin"

MAGIC = b"PBRENVL1"
HEADER = struct.Struct("<8s4I")
MODELS = ("paper", "principled")

LOBES = 8
"""With two at the end that the horizon cuts."""
HORIZON = 0.2
"""n·l up to which the even hemisphere grows."""
CELLS_R, CELLS_X = 20, 20
LEVELS = 8
SHARPEST = 2 * np.pi / 1024 * 2
"""σ_0: two texels of the sharpest panorama, radians."""
LEAST_ROUGHNESS = 0.06
"""Smoother lobes are sharper than σ_0 by far, and are fitted as this one."""
LEAST_COSINE = 1e-3
MOMENTS = 2.0
"""Weight of the harmonics beside the density."""
NEIGHBOUR = 0.04
"""Weight of staying where the neighbour is, in units of a parameter."""
STEPS = 60
POLAR, AZIMUTHS = 48, 20
ORDERED_FROM = 6, 10
"""Node whose lobes others are ordered by."""
FLOOR = 0.15
"""Least root of a weight at the start of a fit, in that of an even share."""
SMOOTHING, HELD = 4, 0.1
"""Further times, and the weight of the neighbours then: without floors, for interpolation."""
SWEEPS = 4
"""Times that every node is fitted anew, held to the mean of its neighbours."""
SEEDS = 12


def geometry_term(model: str, alpha: float, nv: float, nl: Array) -> Array:
    """V: masking of both sides over 4 n·l n·v."""
    if model == "paper":
        k = alpha**2 / 2
        g = 1 / ((nv * (1 - k) + k) * (nl * (1 - k) + k))
        return g / 4
    e = alpha**2
    return 0.5 / np.maximum(
        nl * np.sqrt(nv**2 * (1 - e) + e) + nv * np.sqrt(nl**2 * (1 - e) + e), 1e-12
    )


class Nodes:
    """Directions about the mirror direction, y ≥ 0, and the solid angle that each stands for."""

    def __init__(self, nv: float, alpha: float) -> None:
        # Polar angle from the mirror: evenly in log(1 + γ/γ0), with γ0 of the lobe's or the blur's
        # width.
        narrow = 0.35 * np.hypot(alpha, SHARPEST) * max(nv, 0.15)
        u = (np.arange(POLAR) + 0.5) / POLAR
        top = np.log1p(np.pi / narrow)
        gamma = narrow * np.expm1(u * top)
        d_gamma = (gamma + narrow) * top / POLAR
        psi = (np.arange(AZIMUTHS) + 0.5) / AZIMUTHS * np.pi
        g, p = (one.ravel() for one in np.meshgrid(gamma, psi, indexing="ij"))
        d = np.repeat(d_gamma, AZIMUTHS)
        self.weights = 2 * np.sin(g) * d * (np.pi / AZIMUTHS)
        s = np.sqrt(max(1 - nv**2, 0.0))
        mirror = np.array([s, 0.0, nv])
        across = np.array([nv, 0.0, -s])
        self.l = (
            np.cos(g)[:, None] * mirror
            + (np.sin(g) * np.cos(p))[:, None] * across
            + (np.sin(g) * np.sin(p))[:, None] * np.array([0.0, 1.0, 0.0])
        )


def harmonics(d: Array) -> Array:
    """(..., 10) the real harmonics up to l = 3 that are even in y."""
    from pbrfit.model.reflection import sh_basis

    return sh_basis(d / np.linalg.norm(d, axis=-1, keepdims=True))[
        ..., [0, 2, 3, 6, 7, 8, 12, 13, 14, 15]
    ]


def target(model: str, r: float, nv: float, l: Array) -> tuple[Array, Array]:
    """A and b at directions."""
    alpha = r**2
    v = np.array([-np.sqrt(max(1 - nv**2, 0.0)), 0.0, nv])
    h = l + v
    h /= np.maximum(np.linalg.norm(h, axis=-1, keepdims=True), 1e-12)
    nh, vh = h[:, 2], np.clip(h @ v, 0, 1)
    nl = l[:, 2]
    dd = alpha**2 / (np.pi * ((nh**2) * (alpha**2 - 1) + 1) ** 2)
    whole = np.where(nl > 0, dd * geometry_term(model, alpha, nv, np.maximum(nl, 0)) * nl, 0)
    schlick = (1 - vh) ** 5
    return whole * (1 - schlick), whole * schlick


def kernels(cosine: Array) -> Array:
    """(..., LEVELS) K_j at cosines."""
    s2 = (SHARPEST * 2.0 ** np.arange(LEVELS)) ** 2
    return np.exp((cosine[..., None] - 1) / s2) / (2 * np.pi * s2 * -np.expm1(-2 / s2))


def clamped(cosine: Array) -> Array:
    """The two lobes that end at the horizon, by n·l: an even hemisphere, and the matt lobe."""
    up = np.maximum(cosine, 0)
    return np.stack([np.minimum(up / HORIZON, 1) / (np.pi * (2 - HORIZON)), up / np.pi])


def of_lobes(parameters: Array, mirror: float, l: Array) -> tuple[Array, Array, Array]:
    """K of each lobe at directions, and its slopes by φ and by λ: (lobe, node)."""
    phi = mirror + parameters[:, 0]
    level = np.clip(parameters[:, 1], 0, LEVELS - 1 - 1e-9)
    j = level.astype(int)
    f = level - j
    s2 = (SHARPEST * 2.0 ** np.arange(LEVELS)) ** 2
    cosine = np.sin(phi)[:, None] * l[:, 0] + np.cos(phi)[:, None] * l[:, 2]
    turned = np.cos(phi)[:, None] * l[:, 0] - np.sin(phi)[:, None] * l[:, 2]

    def k(j: NDArray[np.intp]) -> Array:
        return (
            np.exp((cosine - 1) / s2[j, None])
            / (2 * np.pi * s2[j] * -np.expm1(-2 / s2[j]))[:, None]
        )

    low, high = k(j), k(j + 1)
    value = (1 - f)[:, None] * low + f[:, None] * high
    by_phi = turned * ((1 - f)[:, None] * low / s2[j, None] + f[:, None] * high / s2[j + 1, None])
    by_level = high - low
    # The last two end at the horizon, and stand still.
    value[-2:] = clamped(l[:, 2])
    by_phi[-2:] = by_level[-2:] = 0
    return value, by_phi, by_level


class Fit:
    """One node of the table."""

    def __init__(self, model: str, r: float, nv: float) -> None:
        r, nv = max(r, LEAST_ROUGHNESS), max(nv, LEAST_COSINE)
        nodes = Nodes(nv, r * r)
        self.mirror = np.arccos(nv)
        self.l = nodes.l
        a, b = target(model, r, nv, nodes.l)
        weights = nodes.weights
        y = harmonics(nodes.l)
        self.energy = np.array([(a * weights).sum(), (b * weights).sum()])
        root = np.sqrt(weights)
        self.moments = MOMENTS * (weights[:, None] * y)
        self.root = root
        self.mixes = []
        for f0 in (1.0, 0.04):
            mix = (f0, 1.0)
            t = mix[0] * a + mix[1] * b
            norm = np.sqrt((weights * t * t).sum())
            total = (weights * t).sum()
            data = np.concatenate([root * t / norm, self.moments.T @ t / total])
            self.mixes.append((mix, norm, total, data))

    def residual(self, p: Array) -> tuple[Array, Array]:
        """Residuals and their slopes."""
        value, by_phi, by_level = of_lobes(p, self.mirror, self.l)
        count = len(p)
        residuals, slopes = [], []
        lifted = [(self.root * x, x @ self.moments) for x in (value, by_phi, by_level)]
        for mix, norm, total, data in self.mixes:
            w = mix[0] * p[:, 2] ** 2 + mix[1] * p[:, 3] ** 2
            columns = [np.concatenate([x / norm, m / total], axis=1) for x, m in lifted]
            residuals.append(w @ columns[0] - data)
            block = np.empty((len(data), count, 4))
            block[:, :, 0] = (w[:, None] * columns[1]).T
            block[:, :, 1] = (w[:, None] * columns[2]).T
            block[:, :, 2] = (2 * mix[0] * p[:, 2, None] * columns[0]).T
            block[:, :, 3] = (2 * mix[1] * p[:, 3, None] * columns[0]).T
            slopes.append(block.reshape(len(data), -1))
        return np.concatenate(residuals), np.concatenate(slopes)

    def solve(
        self, start: Array, scale: Array, neighbour: float, floor: float = FLOOR
    ) -> tuple[Array, float]:
        """Levenberg-Marquardt from a start, held to it weakly."""
        p, damping = start.copy(), 1e-2
        # A weight is a square: from 0 there is no way back.
        p[:, 2:] = np.maximum(p[:, 2:], floor * np.sqrt(self.energy.sum() / len(p)))
        hold = neighbour / scale.ravel()

        def cost(p: Array) -> tuple[float, Array, Array]:
            residuals, slopes = self.residual(p)
            held = hold * (p - start).ravel()
            return float(residuals @ residuals + held @ held), residuals, slopes

        value, residuals, slopes = cost(p)
        for _ in range(STEPS):
            normal = slopes.T @ slopes + np.diag(hold**2)
            gradient = slopes.T @ residuals + hold**2 * (p - start).ravel()
            step = np.linalg.solve(normal + damping * np.diag(1e-9 + np.diag(normal)), -gradient)
            q = p + step.reshape(p.shape)
            q[:, 1] = np.clip(q[:, 1], 0, LEVELS - 1 - 1e-6)
            q[:, 0] = np.clip(q[:, 0], -np.pi / 2, 0.6)
            new = cost(q)
            if new[0] < value:
                gain = value - new[0]
                p, (value, residuals, slopes), damping = q, new, damping / 4
                if gain < 1e-6 * value:
                    break
            else:
                damping *= 6
                if damping > 1e6:
                    break
        return p, value

    def errors(self, p: Array) -> tuple[float, float]:
        """Relative L2 error of the density for F0 = 1 and 0.04."""
        value, _, _ = of_lobes(p, self.mirror, self.l)
        found = []
        for mix, norm, _, data in self.mixes:
            w = mix[0] * p[:, 2] ** 2 + mix[1] * p[:, 3] ** 2
            found.append(
                float(np.linalg.norm(self.root * (w @ value) / norm - data[: len(self.root)]))
            )
        return found[0], found[1]


def first(r: float, fit: Fit, lobes: int) -> Array:
    """A start: lobes in a row about the mirror direction, narrow and wide."""
    alpha = max(r, LEAST_ROUGHNESS) ** 2
    p = np.empty((lobes, 4))
    width = max(alpha, SHARPEST)
    p[:, 0] = -width * np.linspace(-0.3, 0.6, lobes)
    p[:, 1] = np.clip(np.log2(width * np.geomspace(0.4, 3, lobes) / SHARPEST), 0.2, LEVELS - 1.2)
    p[:, 2] = np.sqrt(fit.energy[0] / lobes)
    p[:, 3] = np.sqrt(fit.energy[1] / lobes) + 1e-4
    return p


def nodes() -> tuple[Array, Array]:
    """Roughness and n·v of the table's nodes."""
    return np.arange(CELLS_R + 1) / CELLS_R, (np.arange(CELLS_X + 1) / CELLS_X) ** 2


def scales(r: float, fit: Fit, lobes: int) -> Array:
    """Units of the parameters that neighbours are held by."""
    unit = np.ones((lobes, 4))
    unit[:, 0] = max(r * r, SHARPEST)
    unit[:, 2:] = np.sqrt(max(fit.energy.sum(), 1e-3))
    return unit


def solved(model: str) -> Array:
    """Parameters [r][x][lobe][4] of a model."""
    of_r, of_x = nodes()
    fits = [[Fit(model, r, x) for x in of_x] for r in of_r]
    table = np.zeros((len(of_r), len(of_x), LOBES, 4))
    cost = np.full(table.shape[:2], np.inf)

    def improve(i: int, j: int, start: Array, neighbour: float, floor: float = FLOOR) -> None:
        fit = fits[i][j]
        found, value = fit.solve(start, scales(of_r[i], fit, LOBES), neighbour, floor)
        if value < cost[i, j] or neighbour > 0:
            table[i, j], cost[i, j] = found, value

    # One node from many starts, then its row by x, then all others by r.
    middle, column = round(0.35 * CELLS_R), round(0.75 * CELLS_X)
    rng = np.random.default_rng(0)
    for _ in range(SEEDS):
        fit = fits[middle][column]
        start = first(of_r[middle], fit, LOBES)
        start += (
            0.3
            * rng.standard_normal(start.shape)
            * scales(of_r[middle], fit, LOBES)
            * [1, 1, 0.3, 0.3]
        )
        improve(middle, column, start, 0.0)
    print(model, "seed", fits[middle][column].errors(table[middle, column]), flush=True)
    for way in (1, -1):
        for j in range(column + way, (CELLS_X + 1 if way > 0 else -1), way):
            improve(middle, j, table[middle, j - way], NEIGHBOUR)
        for j in range(len(of_x)):
            for i in range(middle + way, (CELLS_R + 1 if way > 0 else -1), way):
                improve(i, j, moved(table[i - way, j], of_r[i - way], of_r[i]), NEIGHBOUR)
    for sweep in range(SWEEPS + SMOOTHING):
        rough = sweep < SWEEPS
        for i in range(len(of_r)):
            for j in range(len(of_x)):
                about = [(i + a, j + b) for a, b in ((1, 0), (-1, 0), (0, 1), (0, -1))]
                near = [
                    moved(table[a, b], of_r[a], of_r[i])
                    for a, b in about
                    if 0 <= a < len(of_r) and 0 <= b < len(of_x)
                ]
                start = np.mean(near, axis=0)
                improve(i, j, start, *((NEIGHBOUR, FLOOR) if rough else (HELD, 0.0)))
        found = np.array(
            [
                [f.errors(t) for f, t in zip(*row, strict=True)]
                for row in zip(fits, table, strict=True)
            ]
        )
        seen = np.percentile(found[3:, 9:, 0], [50, 90, 100]).round(3)
        print(model, "sweep", sweep, "median, 90 %, worst of F0 = 1:", seen, flush=True)
    table = ordered(table)
    table[..., 2:] **= 2
    # No energy is lost or made.
    for i, row in enumerate(fits):
        for j, fit in enumerate(row):
            table[i, j, :, 2:] *= fit.energy / np.maximum(table[i, j, :, 2:].sum(axis=0), 1e-12)
    return table


def ordered(table: Array) -> Array:
    """The same lobes in an order that neighbouring nodes share, or there is nothing between them.

    From one node along its row and then from row to row, each node's lobes are assigned to those of
    the neighbours that are ordered already, by what would be between them.
    """
    from scipy.optimize import linear_sum_assignment

    found = table.copy()
    free = LOBES - 2
    of_r, of_x = nodes()
    rows, columns = (
        [start, *range(start + 1, count), *range(start - 1, -1, -1)]
        for start, count in zip(ORDERED_FROM, (len(of_r), len(of_x)), strict=True)
    )
    done: set[tuple[int, int]] = set()
    for i, j in ((i, j) for i in rows for j in columns):
        unit = np.array([max(of_r[i] ** 2, SHARPEST), 1, 1, 1])
        cost = np.zeros((free, free))
        here = found[i, j, None, :free]
        for near in ((i, j + 1), (i, j - 1), (i + 1, j), (i - 1, j)):
            if near in done:
                there = found[near][:free, None]
                energy = np.maximum(np.sum(there[..., 2:] ** 2, -1), np.sum(here[..., 2:] ** 2, -1))
                cost += np.sum(((there - here) / unit) ** 2, axis=-1) * (np.sqrt(energy) + 0.02)
        if done:
            found[i, j, :free] = found[i, j, linear_sum_assignment(cost)[1]]
        done.add((i, j))
    return found


def moved(p: Array, r: float, to: float) -> Array:
    """A node's parameters for another roughness: angles grow with alpha."""
    found = p.copy()
    found[:, 0] *= (max(to, LEAST_ROUGHNESS) / max(r, LEAST_ROUGHNESS)) ** 2 if to < r else 1.0
    shift = 2 * np.log2(max(to, LEAST_ROUGHNESS) / max(r, LEAST_ROUGHNESS))
    found[:, 1] = np.clip(p[:, 1] + np.clip(shift, -0.6, 0.6), 0.0, LEVELS - 1 - 1e-6)
    return found


def interpolated(table: Array, r: float, x: float) -> Array:
    """Parameters [lobe][4] anywhere."""
    u, t = r * (table.shape[0] - 1), np.sqrt(x) * (table.shape[1] - 1)
    i, j = min(int(u), table.shape[0] - 2), min(int(t), table.shape[1] - 2)
    f, g = u - i, t - j
    return (1 - f) * ((1 - g) * table[i, j] + g * table[i, j + 1]) + f * (
        (1 - g) * table[i + 1, j] + g * table[i + 1, j + 1]
    )


def report(tables: Array) -> None:
    """Errors at nodes and between them."""
    for model, table in zip(MODELS, tables, strict=True):
        print(f"{model}: relative L2 error of the lobe, F0 = 1 / 0.04")
        cosines = (0.97, 0.8, 0.6, 0.4, 0.25, 0.12)
        print("| r | " + " | ".join(f"n·v {x:g}" for x in cosines) + " |")
        print("|---" * (len(cosines) + 1) + "|")
        for r in (0.12, 0.22, 0.33, 0.47, 0.62, 0.78, 0.97):
            cells = []
            for x in cosines:
                fit = Fit(model, r, x)
                p = interpolated(table, r, x)
                p[:, 2:] = np.sqrt(p[:, 2:])
                cells.append("{:.3f} / {:.3f}".format(*fit.errors(p)))
            print(f"| {r:g} | " + " | ".join(cells) + " |", flush=True)


def main() -> None:
    """Fit and write, or check."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--check", action="store_true")
    if parser.parse_args().check:
        content = TABLE.read_bytes()
        _, *shape = HEADER.unpack_from(content)
        models, r, x, lobes = shape
        tables = (
            np.frombuffer(content, "<f4", offset=HEADER.size)
            .reshape(models, r + 1, x + 1, lobes, 4)
            .astype(float)
        )
    else:
        tables = np.array([solved(model) for model in MODELS])
        TABLE.write_bytes(
            HEADER.pack(MAGIC, len(MODELS), CELLS_R, CELLS_X, LOBES)
            + tables.astype("<f4").tobytes()
        )
    report(tables)


if __name__ == "__main__":
    sys.exit(main())
