"""The look that all pages share: colours of a dark and a light theme, type and spacing scales.

Style sheets take them as custom properties. The dark theme is the default, the light one follows
the system's setting, and a button chooses between them.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

COLORS: Mapping[str, tuple[str, str]] = {
    "ground": ("#121315", "#fbfbfa"),
    "stage": ("#0a0b0c", "#e6e6e4"),
    "raised": ("#1c1e21", "#ffffff"),
    "control": ("#2a2d31", "#efefed"),
    "line": ("#34383d", "#dcdcd8"),
    "edge": ("#7d848c", "#787c80"),
    "text": ("#e9eaec", "#1b1c1e"),
    "quiet": ("#a4aab2", "#55595e"),
    "accent": ("#7cc0f5", "#00568a"),
    "on-accent": ("#0b1a26", "#ffffff"),
    "usable": ("#6fbcf2", "#005b94"),
    "rough": ("#efb341", "#7d5300"),
    "poor": ("#ff9166", "#a83c00"),
    "pass": ("#4fc79b", "#00674b"),
    "fail": ("#ff9166", "#a83c00"),
}
"""By name: in the dark theme, and in the light one."""

DARK, LIGHT = ({name: pair[k] for name, pair in COLORS.items()} for k in range(2))

SCALES: Mapping[str, str] = {
    # Type: a ratio of 1.2 around 15 px.
    "small": ".75rem",
    "less": ".8125rem",
    "body": ".9375rem",
    "large": "1.125rem",
    "title": "1.375rem",
    # Spacing: multiples of 4 px.
    "s1": ".25rem",
    "s2": ".5rem",
    "s3": ".75rem",
    "s4": "1rem",
    "s6": "1.5rem",
    "s8": "2rem",
    "s12": "3rem",
    "round": ".5rem",
    # Plots and white maps stand on paper in both themes.
    "plate": "#ffffff",
    "plate-text": "#1b1c1e",
}


def style() -> str:
    """Custom properties of both themes, and the style sheet of every page."""
    base = (Path(__file__).parent / "base.css").read_text(encoding="utf-8")
    light = _properties(LIGHT)
    return "\n".join(
        [
            f":root {{ color-scheme: dark; {_properties({**DARK, **SCALES})} }}",
            "@media (prefers-color-scheme: light) { :root:not([data-theme=dark]) "
            f"{{ color-scheme: light; {light} }} }}",
            f":root[data-theme=light] {{ color-scheme: light; {light} }}",
            # Paper is white.
            f"@media print {{ :root, :root[data-theme] {{ color-scheme: light; {light} }} }}",
            base,
        ]
    )


def script() -> str:
    """What makes the theme's button work, and remembers the choice."""
    return (Path(__file__).parent / "theme.js").read_text(encoding="utf-8")


def button() -> str:
    """Switches between the themes; hidden where no script runs."""
    return (
        '<button type="button" class="theme tool" hidden aria-label="Light or dark theme" '
        'title="Light or dark theme"><svg viewBox="0 0 24 24" aria-hidden="true">'
        '<circle cx="12" cy="12" r="8"/><path d="M12 4a8 8 0 0 1 0 16z" fill="currentColor"/></svg>'
        "</button>"
    )


def _properties(values: Mapping[str, str]) -> str:
    return " ".join(f"--{name}: {value};" for name, value in values.items())
