"""Which order of the shipped prompts gives the most independent lights, wherever it is cut.

A fit tells materials from lights by how lights differ, so the first n of the catalogue should span
as much as n lights can. Each lighting has a nominal light here, as its text describes it: caps of
even radiance, nine tenths of the light, and one tenth from everywhere; a colour. With L (n, K) the
SH coefficients of n lights in one channel, each band times its clamped-cosine transfer, the
measure is

    s_K(L) / s_1(L),   the smallest singular value over the largest, in the worst of three channels,

for K = 4 (l ≤ 1) and K = 9 (l ≤ 2). Pairs are exchanged as long as the sum of its logarithms over
n = 4, 6 … 30 grows; the first two stay. What a network makes of a text may be something else.

    python tools/prompt_order.py          how the order that ships does, beside random ones
    python tools/prompt_order.py --find   a better order, in some seconds
"""

from __future__ import annotations

import argparse
import itertools

import numpy as np

import pbrfit
from pbrfit.acquire.prompts import read_prompts

COLORS = {
    "amber": (1.4, 0.85, 0.3),
    "blue": (0.25, 0.45, 1.3),
    "candle": (1.5, 0.7, 0.2),
    "cool": (0.8, 0.95, 1.2),
    "cyan": (0.3, 1.1, 1.2),
    "fire": (1.5, 0.6, 0.2),
    "gold": (1.35, 1.0, 0.55),
    "green": (0.1, 1.2, 0.2),
    "greenish": (0.9, 1.1, 0.85),
    "leaves": (0.8, 1.15, 0.7),
    "magenta": (1.2, 0.1, 1.0),
    "moon": (0.8, 0.9, 1.2),
    "orange": (1.5, 0.8, 0.3),
    "pale blue": (0.6, 0.85, 1.3),
    "red": (1.5, 0.1, 0.08),
    "rose": (1.3, 0.85, 0.9),
    "sodium": (1.5, 0.9, 0.2),
    "violet": (0.8, 0.3, 1.3),
    "warm": (1.3, 0.95, 0.55),
    "white": (1.0, 1.0, 1.0),
    "yellow": (1.3, 1.05, 0.5),
}

# Towards the light: X right, Y up, Z to the viewer; half angle of the cap in degrees; colour.
Cap = tuple[tuple[float, float, float], float, str]
NOMINAL: dict[str, list[Cap]] = {
    "cool_window_left": [((-1, 0.1, 0.3), 50, "cool")],
    "warm_lamp_right": [((1, 0.1, 0.3), 50, "warm")],
    "warm_floor_bounce": [((0, -1, 0.4), 60, "yellow")],
    "flash_at_camera": [((0, 0, 1), 50, "white")],
    "cyan_from_below": [((0, -1, 0.3), 60, "cyan")],
    "cool_skylight_behind": [((0, 0.8, -0.7), 50, "cool")],
    "blue_window_behind_right": [((0.8, 0.2, -0.8), 55, "pale blue")],
    "softbox_upper_right": [((0.7, 0.7, 0.5), 40, "white")],
    "dawn_rose_behind_left": [((-0.8, 0.2, -0.8), 60, "rose")],
    "softbox_upper_left": [((-0.7, 0.7, 0.5), 40, "white")],
    "red_glow_behind": [((0, 0, -1), 50, "red")],
    "magenta_neon_right": [((1, 0, 0.2), 50, "magenta")],
    "fireplace_right_low": [((1, -0.4, 0.2), 50, "fire")],
    "noon_skylight": [((0, 1, 0.1), 60, "warm")],
    "candles_front_low": [((0, -0.6, 1), 50, "candle")],
    "amber_lamp_left_low": [((-1, -0.5, 0.2), 50, "amber")],
    "sunset_from_behind": [((0, 0.2, -1), 50, "orange")],
    "green_neon_left": [((-1, 0, 0.2), 50, "green")],
    "warm_ceiling_lamps": [((0, 1, 0), 75, "warm")],
    "warm_umbrella_front_left": [((-0.6, 0.2, 0.8), 50, "warm")],
    "teal_left_orange_right": [((-1, 0, 0.2), 50, "cyan"), ((1, 0, 0.2), 50, "orange")],
    "white_from_all_sides": [((0, 1, 0), 180, "white")],
    "violet_above": [((0, 1, 0), 75, "violet")],
    "green_garden_right": [((1, 0.2, 0.1), 55, "leaves")],
    "moonlight_upper_right": [((0.8, 0.8, 0.2), 55, "moon")],
    "street_lamps_left": [((-1, 0.2, -0.2), 50, "sodium")],
    "screen_blue_front": [((0, 0, 1), 60, "pale blue")],
    "golden_hour_left": [((-1, 0.15, 0.1), 60, "gold")],
    "fluorescent_ceiling": [((0, 1, 0), 75, "greenish")],
    "overcast_above": [((0, 1, 0.1), 75, "white")],
    "blue_hour_right": [((1, 0.3, 0.2), 70, "blue")],
    "cool_window_right": [((1, 0.1, 0.2), 55, "cool")],
}

TRANSFER = np.repeat([np.pi, 2 * np.pi / 3, np.pi / 4], [1, 3, 5])
"""Of the clamped cosine, l = 0, 1, 2 (Ramamoorthi and Hanrahan 2001, eq. 8)."""

SIZES = range(4, 31, 2)


def nominal_lights(names: list[str]) -> np.ndarray:
    """SH coefficients l ≤ 2 (N, 9, 3) times the transfer, by directions all over the sphere."""
    points = np.random.default_rng(0).normal(size=(20_000, 3))
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    basis = pbrfit.kernel.sh_basis(points)[:, :9] * TRANSFER
    lights = np.zeros((len(names), 9, 3))
    for light, name in zip(lights, names, strict=True):
        for towards, half_angle, color in NOMINAL[name]:
            cosine = points @ (np.array(towards) / np.linalg.norm(towards))
            cap = cosine >= np.cos(np.radians(half_angle))
            radiance = 0.9 * cap / cap.mean() + 0.1
            coefficients = 4 * np.pi * basis.T @ radiance / len(points)
            light += coefficients[:, None] * np.array(COLORS[color]) / len(NOMINAL[name])
    return lights


def independence(lights: np.ndarray, k: int) -> float:
    """The measure above, of lights (n, 9, 3)."""
    singular = np.linalg.svd(lights[:, :k].transpose(2, 0, 1), compute_uv=False)
    return float((singular[:, k - 1] / singular[:, 0]).min())


def worth(lights: np.ndarray) -> float:
    """Sum over all cuts of lights (N, 9, 3) in their order."""
    total = sum(np.log(independence(lights[:n], 4)) for n in SIZES)
    return float(total + sum(np.log(independence(lights[:n], 9)) for n in SIZES if n > 9))


def better_order(lights: np.ndarray) -> list[int]:
    """Exchange pairs behind the first two until nothing is won."""
    order = list(range(len(lights)))
    best, before = worth(lights), -np.inf
    while best > before:
        before = best
        for i, j in itertools.combinations(range(2, len(order)), 2):
            order[i], order[j] = order[j], order[i]
            tried = worth(lights[order])
            if tried > best + 1e-9:
                best = tried
            else:
                order[i], order[j] = order[j], order[i]
    return order


def main() -> None:
    """Print what was asked for."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--find", action="store_true", help="find a better order and print it")
    options = parser.parse_args()
    names = [prompt.name for prompt in read_prompts().lighting]
    lights = nominal_lights(names)
    if options.find:
        order = better_order(lights)
        print("\n".join(names[i] for i in order))
        lights = lights[order]
    rng = np.random.default_rng(0)
    print("first n    l <= 1: this, random (median, 95 %)    l <= 2: this, random")
    for n in (4, 8, 12, 16, 24, len(names)):
        row = f"{n:7}"
        for k in (4, 9):
            if n < k:
                continue
            others = [independence(lights[rng.permutation(len(names))[:n]], k) for _ in range(500)]
            middle, high = np.quantile(others, (0.5, 0.95))
            row += f"    {independence(lights[:n], k):18.3f}{middle:8.3f}{high:8.3f}"
        print(row)


if __name__ == "__main__":
    main()
