"""Layers of EXR files: which channels are meant where programs write several kinds of data."""

from __future__ import annotations

import re
from collections.abc import Collection, Sequence
from pathlib import Path

from pbrfit.io.input_files import unexpected
from pbrfit.values.quoting import listed, shown

Rule = tuple[Sequence[Sequence[str]], str]
"""Sets of channels, the best first, and a pattern of the names of layers that may have them."""

VECTORS = r"position|vector|uv|motion|velocity|tangent|crypto|(^|\.)p(world)?$"
"""Words in the names of layers that hold vectors which are no normals."""

_CHANNEL = re.compile(r"((?:.*[._])?n?)(red|green|blue|alpha|[rgbaxyz])", re.IGNORECASE)
"""Names as `N.X`, `N_x`, `Nx` and `N.red`: a layer and its channel."""

_GREY = ("YA", "Y")
_COLORS = ("RGBA", "RGB")
_CHROMA = (("Y", "RY", "BY", "A"), ("Y", "RY", "BY"))

# Plain channels, those of what renderers call the picture, or of the only layer with light.
PICTURE: tuple[Rule, ...] = (
    ((*_COLORS, *_CHROMA), "^$"),
    (_COLORS, r"(^|\.)(rgba?|beauty|combined|ci?)$"),
    (_GREY, "^$"),
    (_COLORS, rf"^(?!.*(normal|(^|\.)n$|albedo|col$|limits|matte|mask|depth|{VECTORS})).+$"),
)

_NORMAL = r"(^|\.)(n|normals?)$"

NORMALS: tuple[Rule, ...] = (
    (("XYZ",), "^$"),
    (("XYZ", "RGB"), _NORMAL),
    (("XYZ", "RGB"), "normal"),
    (("XYZ",), rf"^(?!.*({VECTORS})).+$"),
    (("RGB",), "^$"),
    (("XY", "RG"), rf"^$|{_NORMAL}"),
)

# Of colours and vectors the first channel is no depth; whoever reads them refuses that.
DEPTH: tuple[Rule, ...] = (
    (("Z", ("DEPTH",)), "^$"),
    (("Z", "V", "Y", "RGB", "R", "X"), r"(^|\.)depth$"),
    (("Z", "V", "Y", "RGB", "R", "X"), "depth$"),
    (("XYZ", "Z", ("DEPTH",)), rf"^(?!.*({VECTORS}|normal|(^|\.)n$|mist)).+$"),
    (("Y", "RGB", "R"), "^$"),
)


def chosen(
    path: Path, names: Collection[str], rules: Sequence[Rule], what: str, layer: str | None = None
) -> tuple[str, list[str]]:
    """A layer and the full names of its channels, by the first rule that finds some.

    Names are as of `_CHANNEL`, and case does not count. A given `layer` is sought by its whole
    name, else by the end of one: ``Combined`` is also ``ViewLayer.Combined``. InputError if no rule
    finds `what`, or one several.
    """
    layers: dict[str, dict[str, str]] = {}
    for name in sorted(names):  # R before r
        of, _, channel = name.rpartition(".")
        if parts := _CHANNEL.fullmatch(name):
            of, channel = parts[1].rstrip("._"), parts[2][0]
        layers.setdefault(of, {}).setdefault(channel.upper(), name)
    if layer is not None:
        every = [kind for kinds, _ in rules for kind in kinds]
        rules = [(every, rf"{start}{re.escape(layer)}$") for start in ("^", r"\.")]
        what += f" in layer {shown(layer)}"
    for kinds, called in rules:
        found: dict[str, list[str]] = {}
        for of, channels in layers.items():
            kind = next((kind for kind in kinds if channels.keys() >= set(kind)), None)
            if kind is not None and re.search(called, of, re.IGNORECASE):
                found[of] = [channels[channel] for channel in kind]
        if len(found) == 1:
            return next(iter(found.items()))
        if found:
            raise unexpected(path, f"one layer of {what}", listed(map(" ".join, found.values())))
    below = f" in layers {listed(filter(None, layers))}" if layers.keys() - {""} else ""
    raise unexpected(path, what, f"{listed(names)}{below}")
