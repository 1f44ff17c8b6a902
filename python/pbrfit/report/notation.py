"""Numbers as people read them."""

from __future__ import annotations

import math

_SUPERSCRIPT = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def scientific(value: float) -> str:
    """Two digits and a power of ten, 4.7·10⁻¹⁵; plain where that is short: 0, 0.041, 16,384."""
    if not math.isfinite(value):
        return "not a number" if math.isnan(value) else "infinite"
    if value == int(value) and abs(value) < 1e6:
        return f"{int(value):,}"
    if 0.01 <= abs(value) < 1000:
        return f"{value:.2g}" if abs(value) < 99.5 else f"{value:.0f}"  # not 1e+02
    digits, _, exponent = f"{value:.1e}".partition("e")
    power = f"10{str(int(exponent)).translate(_SUPERSCRIPT)}"
    return power if digits == "1.0" else f"{digits.removesuffix('.0')}·{power}"


def plain(value: float) -> str:
    """Two digits without a power of ten, as long as that is readable: 0.00011; else scientific."""
    return f"{value:.2g}" if 1e-4 <= abs(value) < 0.01 else scientific(value)


def percent(share: float) -> str:
    """Write a share: 57 %, 3.4 %, 0.0092 %, < 0.001 %; on one line."""
    space = "\N{NO-BREAK SPACE}"
    return f"<{space}0.001{space}%" if 0 < share < 1e-5 else f"{plain(100 * share)}{space}%"


def angle(degrees: float) -> str:
    """Write an angle in whole degrees, with the sign for minus: −37°."""
    return f"{round(degrees)}°".replace("-", "−")
