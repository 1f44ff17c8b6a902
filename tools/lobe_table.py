"""Makes rust/reflectance/lobe_table.bin, the principled lobe functions as bicubic splines.

    python tools/lobe_table.py              integrate, fit, write the table, print its errors
    python tools/lobe_table.py --check      the table as it is: its errors, and five samples
    python tools/lobe_table.py --samples    write tests/data/lobe_samples.json, by quadrature alone

Needs numpy. The functions are those of lobe_integrals.py: ten a_j/sinᵐ, ten b_j/sinᵐ, Ebar(r),
then kappa. They are C² splines, uniform in s(r) and t(x), x = n·v, both of the form

    s(r) = w (1+c) r/(r+c) + (1−w) r        s(0) = 0, s(1) = 1, slope finite everywhere

with many knots where the functions change most, alpha near x. The file is little-endian: 8 bytes
"PBRLOBE1"; the numbers of cells by s and by t (uint32); c and w of s, c and w of t (float32); then
float32 coefficients [cells_s + 3][cells_t + 3][24], 22 functions and two zeros. Cell i of an axis
takes coefficients i to i+3 with the weights of the uniform cubic B-spline.
"""

from __future__ import annotations

import argparse
import json
import struct
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from lobe_integrals import DIELECTRIC_F0, ORDER, Array, Quadrature

ROOT = Path(__file__).resolve().parent.parent
TABLE = ROOT / "rust" / "reflectance" / "lobe_table.bin"
SAMPLES = ROOT / "tests" / "data" / "lobe_samples.json"

MAGIC = b"PBRLOBE1"
HEADER = struct.Struct("<8s2I4f")
FUNCTIONS = 22
MEAN, KAPPA = 20, 21
STRIDE = 24

LEAST_COSINE = 1e-4
"""Callers raise n·v to it."""
SAMPLES_A_CELL = 4
RESOLVED_COSINE = 0.02
"""Below, where alpha is near x too, the functions change faster than the splines: samples count
less, so that their misfit does not spread."""
MIRROR_COEFFICIENTS = 3
"""The first by s, held at the mirror's values: then value, slope and curvature are right at r = 0,
which the functions leave like r⁴."""
BOUNDED_COEFFICIENTS = 4
"""The first by s whose reflectance is brought down to 1, all functions alike: a spline never
exceeds its coefficients. From the next on it stays below without that."""


@dataclass(frozen=True)
class Axis:
    """A coordinate in [0, 1] of a number in [0, 1], and its cells."""

    cells: int
    c: float
    w: float

    def at(self, x: Array) -> Array:
        """The coordinate."""
        return self.w * (1 + self.c) * x / (x + self.c) + (1 - self.w) * x

    def slope(self, x: Array) -> Array:
        """Its derivative."""
        return self.w * (1 + self.c) * self.c / (x + self.c) ** 2 + 1 - self.w

    def inverse(self, s: Array) -> Array:
        """The number at a coordinate."""
        linear = self.w * (1 + self.c) + (1 - self.w) * self.c - s
        root = np.sqrt(linear * linear + 4 * (1 - self.w) * s * self.c)
        return np.clip(2 * s * self.c / (linear + root), 0, 1)

    def weights(self, x: Array, derivative: bool = False) -> Array:
        """(X, cells + 3): weights of the coefficients in values, or in derivatives by x."""
        position = self.at(x) * self.cells
        cell = np.clip(position.astype(int), 0, self.cells - 1)
        u = position - cell
        if derivative:
            four = [-((1 - u) ** 2), (3 * u - 4) * u, (2 - 3 * u) * u + 1, u * u]
            scale = self.cells * self.slope(x) / 2
        else:
            four = [(1 - u) ** 3, (3 * u - 6) * u * u + 4, ((3 - 3 * u) * u + 3) * u + 1, u**3]
            scale = np.full(len(x), 1 / 6)
        matrix = np.zeros((len(x), self.cells + 3))
        for k, weight in enumerate(four):
            matrix[np.arange(len(x)), cell + k] = scale * weight
        return matrix


BY_ROUGHNESS = Axis(52, 0.15625, 0.8125)
BY_COSINE = Axis(44, 0.01953125, 0.5)


@dataclass(frozen=True)
class Table:
    """The splines: coefficients (cells_s + 3, cells_t + 3, 22)."""

    s: Axis
    t: Axis
    coefficients: Array

    def grid(self, r: Array, x: Array, by_r: bool = False, by_x: bool = False) -> Array:
        """(R, X, 22) values, or derivatives, at all pairs."""
        return np.einsum(
            "ai,bj,ijk->abk",
            self.s.weights(r, by_r),
            self.t.weights(x, by_x),
            self.coefficients,
            optimize=True,
        )

    def write(self, path: Path) -> None:
        """As the module says."""
        header = HEADER.pack(
            MAGIC, self.s.cells, self.t.cells, self.s.c, self.s.w, self.t.c, self.t.w
        )
        padded = np.zeros((*self.coefficients.shape[:2], STRIDE), "<f4")
        padded[..., :FUNCTIONS] = self.coefficients
        path.write_bytes(header + padded.tobytes())

    @classmethod
    def read(cls, path: Path) -> Table:
        """What `write` wrote."""
        data = path.read_bytes()
        magic, cells_s, cells_t, *maps = HEADER.unpack_from(data)
        if magic != MAGIC:
            raise SystemExit(f"{path}: expected a lobe table, found one that begins with {magic!r}")
        shape = (cells_s + 3, cells_t + 3, STRIDE)
        coefficients = np.frombuffer(data, "<f4", offset=HEADER.size).reshape(shape)
        return cls(
            Axis(cells_s, maps[0], maps[1]),
            Axis(cells_t, maps[2], maps[3]),
            coefficients[..., :FUNCTIONS].astype(np.float64),
        )


def reflectance(values: Array) -> Array:
    """E from the functions."""
    return 2 * np.sqrt(np.pi) * (values[..., 0] + values[..., 10])


def dielectric_reflectance(values: Array) -> Array:
    """What a dielectric reflects of uniform light, multiple scattering included (docs/model.md)."""
    f0 = DIELECTRIC_F0
    once = 2 * np.sqrt(np.pi) * values[..., KAPPA] * (f0 * values[..., 0] + values[..., 10])
    e, mean = reflectance(values), values[..., MEAN]
    fresnel_mean = f0 + (1 - f0) / 21
    again = fresnel_mean * mean / (1 - fresnel_mean * (1 - mean))
    return (1 + again * (1 - e) / e) * once


def with_mean(functions: Array, mean: Array) -> Array:
    """The order of the table: Ebar goes before kappa."""
    parts = (functions[..., :MEAN], mean[..., None], functions[..., MEAN:])
    return np.concatenate(parts, axis=-1)


def fit() -> Table:
    """Least squares at several samples a cell, first along x, then along r."""
    s, t = BY_ROUGHNESS, BY_COSINE
    quadrature = Quadrature(fine=False)
    r = s.inverse(np.linspace(0, 1, SAMPLES_A_CELL * s.cells + 1))
    least = t.at(np.array(LEAST_COSINE))
    x = t.inverse(np.linspace(float(least), 1, SAMPLES_A_CELL * t.cells + 1))
    values = np.array([quadrature.along_cosine(roughness, x) for roughness in r])

    trust = np.minimum(1, (x / RESOLVED_COSINE) ** 2) + 1e-3
    along_x = np.linalg.lstsq(
        t.weights(x) * trust[:, None],
        (trust[None, :, None] * values).transpose(1, 0, 2).reshape(len(x), -1),
        rcond=None,
    )[0].reshape(t.cells + 3, len(r), -1)
    mean = np.array([quadrature.mean_reflectance(roughness) for roughness in r])
    along_x = with_mean(along_x, np.broadcast_to(mean, along_x.shape[:2]))
    targets = along_x.transpose(1, 0, 2).reshape(len(r), -1)

    known = MIRROR_COEFFICIENTS
    weights = s.weights(r)
    mirror = np.repeat(targets[:1], known, axis=0)
    rest = np.linalg.lstsq(weights[:, known:], targets - weights[:, :known] @ mirror, rcond=None)[0]
    coefficients = np.concatenate((mirror, rest)).reshape(s.cells + 3, t.cells + 3, FUNCTIONS)

    few = coefficients[:BOUNDED_COEFFICIENTS]
    few[..., :MEAN] /= np.maximum(reflectance(few), 1)[..., None]
    return Table(s, t, coefficients.astype(np.float32).astype(np.float64))


# --- Errors -------------------------------------------------------------------------------------


def exact(quadrature: Quadrature, r: float, x: Array) -> tuple[Array, Array, Array]:
    """The functions and their derivatives by r and by x, each (X, 22), by quadrature."""

    def at(roughness: float) -> Array:
        mean = np.full(len(x), quadrature.mean_reflectance(roughness))
        return with_mean(quadrature.along_cosine(roughness, x), mean)

    # Analytic in r from 0 to 2r and beyond 1; in x from 0 on and, divided by sinᵐ, at 1.
    value = at(r)
    by_r = np.zeros_like(value)
    if r > 0:
        by_r = slope(lambda nodes: np.array([at(q) for q in nodes]), r, 0.85 * r, 1.15 * r)
    by_x = np.zeros_like(value)
    for i, cosine in enumerate(x):
        begin, end = (0.85 * cosine, 1.15 * cosine) if 1.15 * cosine < 1 else (0.8 * cosine, 1.0)
        along = slope(lambda nodes: quadrature.along_cosine(r, nodes), cosine, begin, end)
        by_x[i] = with_mean(along, np.array(0.0))
    return value, by_r, by_x


def slope(f: Callable[[Array], Array], at: float, begin: float, end: float) -> Array:
    """Derivative of f, which takes several places at once, of its polynomial on an interval."""
    nodes = np.cos(np.pi * (np.arange(13) + 0.5) / 13)
    known = f((begin + end) / 2 + (end - begin) / 2 * nodes)
    series = np.polynomial.chebyshev.chebfit(nodes, known.reshape(13, -1), 12)
    series = np.polynomial.chebyshev.chebder(series)
    u = (2 * at - begin - end) / (end - begin)
    return np.polynomial.chebyshev.chebval(u, series).reshape(known.shape[1:]) * 2 / (end - begin)


def print_errors(table: Table) -> None:
    """Against quadrature at random places, and by regions below 0.02."""
    quadrature = Quadrature(fine=False)
    draw = np.random.default_rng(3)
    s, t = table.s, table.t
    bound = np.array(RESOLVED_COSINE)
    r = np.concatenate(([0.02, 1.0], s.inverse(draw.uniform(float(s.at(bound)), 1, 60))))
    x = np.concatenate(([0.02, 1.0], t.inverse(draw.uniform(float(t.at(bound)), 1, 40))))
    sine = np.sqrt(1 - x * x)[:, None] ** np.concatenate((ORDER, ORDER))
    found = (table.grid(r, x), table.grid(r, x, by_r=True), table.grid(r, x, by_x=True))
    miss = [
        [np.abs(of[i] - true) for of, true in zip(found, exact(quadrature, q, x), strict=True)]
        for i, q in enumerate(r)
    ]
    print(f"r and n·v in [0.02, 1], {len(r) * len(x)} places, with sinᵐ (without):")
    for name, part in zip(
        ("value", "d/dr", "d/dn·v"), np.moveaxis(np.array(miss), 1, 0), strict=True
    ):
        lobes, mean, kappa = np.split(part, (MEAN, KAPPA), axis=-1)
        print(
            f"  {name:7} {(sine * lobes).max():.1e} ({lobes.max():.1e}); "
            f"Ebar {mean.max():.1e}, kappa {kappa.max():.1e}"
        )

    def dense(axis: Axis, low: float, high: float) -> Array:
        begin, end = axis.at(np.array([low, high]))
        return axis.inverse(np.linspace(begin, end, int(7 * axis.cells * (end - begin))))

    r, x = dense(s, 0, 0.25), dense(t, LEAST_COSINE, 0.05)
    truth = np.array([quadrature.along_cosine(roughness, x) for roughness in r])
    wrong = np.abs(np.delete(table.grid(r, x), MEAN, axis=2) - truth)
    print(
        "r <= 0.25, n·v <= 0.05, largest error where n·v is at least (columns), r at least (rows)"
    )
    print("a_j and b_j:")
    print_corner(wrong[..., :MEAN].max(axis=2), r, x)
    print(f"kappa, which is {truth[..., MEAN].min():.3f} to {truth[..., MEAN].max():.3f} there:")
    print_corner(wrong[..., MEAN], r, x)
    values = table.grid(dense(s, 0, 1), dense(t, LEAST_COSINE, 1))
    e, of_dielectric = reflectance(values), dielectric_reflectance(values)
    least = values[..., [0, 10]].min()
    print(f"E from {e.min():.6f} to 1 + {e.max() - 1:.1e}; least a_0 or b_0 {least:.1e}")
    print(f"M(0.04) E_d from {of_dielectric.min():.6f} to 1 + {of_dielectric.max() - 1:.1e}")


def print_corner(wrong: Array, r: Array, x: Array) -> None:
    """Errors (R, X) near r = 0 and n·v = 0."""
    cosines = (1e-4, 5e-4, 1e-3, 2e-3, 5e-3, 0.01, 0.02)
    print("       " + "".join(f"{cosine:9}" for cosine in cosines))
    for roughness in (0, 0.01, 0.02, 0.03, 0.05, 0.1, 0.2):
        part = [wrong[np.ix_(r >= roughness, x >= cosine)].max() for cosine in cosines]
        print(f"  {roughness:5}" + "".join(f"{value:9.0e}" for value in part))


def samples() -> list[dict[str, object]]:
    """Rows of the golden file."""
    quadrature = Quadrature()
    cosines = np.array([1e-4, 0.001, 0.005, 0.02, 0.2, 0.5, 0.7, 0.95, 1.0])
    rows: list[dict[str, object]] = []
    for r in (0.0, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.35, 0.5, 0.7, 0.9, 1.0):
        parts = exact(quadrature, r, cosines)
        for i, x in enumerate(cosines):
            value, by_r, by_x = (rounded(part[i]) for part in parts)
            rows.append({"r": r, "cosine": x, "value": value, "by_r": by_r, "by_cosine": by_x})
    return rows


def rounded(values: Array) -> list[float]:
    """To 13 digits."""
    return [float(f"{value:.12e}") + 0.0 for value in values]


def write_samples(path: Path) -> None:
    """One row a line."""
    about = (
        "Lobe functions of the principled model by quadrature (tools/lobe_integrals.py): ten "
        "a_j/sin^m, ten b_j/sin^m, Ebar, kappa; and their derivatives by roughness and by n.v"
    )
    lines = ",\n".join(json.dumps(row, separators=(",", ":")) for row in samples())
    path.write_text(f'{{"about":{json.dumps(about)},\n"rows":[\n{lines}\n]}}\n', encoding="utf-8")


def main() -> None:
    """See the module."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--check", action="store_true")
    parser.add_argument("--samples", action="store_true")
    options = parser.parse_args()
    if options.samples:
        write_samples(SAMPLES)
        return
    if not options.check:
        fit().write(TABLE)
    table = Table.read(TABLE)
    print(f"{TABLE.name}: {TABLE.stat().st_size} bytes, cells {table.s.cells} x {table.t.cells}")
    print_errors(table)
    if options.check:
        np.set_printoptions(precision=9, linewidth=100, suppress=True)
        for r, x in ((0.0, 0.5), (0.02, 0.02), (0.3, 0.1), (0.5, 0.7), (1.0, 1.0)):
            here = np.array([r]), np.array([x])
            print(f"r = {r}, n·v = {x}: value, by r, by n·v")
            for by_r, by_x in ((False, False), (True, False), (False, True)):
                print(table.grid(*here, by_r=by_r, by_x=by_x)[0, 0])


if __name__ == "__main__":
    main()
