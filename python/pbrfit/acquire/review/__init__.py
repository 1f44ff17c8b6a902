"""Review: whether a generated picture shows the photograph's view under another light.

A picture is judged twice, both times without any model.

Alone, against the photograph (`Reviewer.picture`):

- *exposure*: enough of it is neither clipped nor black;
- *copy*: it is not the photograph again with another tone curve;
- *edges*: its edges are those of the photograph, wherever the light comes from;
- *shift*, *warp*: and they are where the photograph has them (`pbrfit.registration.alignment`).

With the photograph and the other pictures (`Reviewer.together`), which tell what is albedo and what
light:

- *shift*, *warp* again, against edges that the others have;
- *colour*: no place has a colour that the others' light cannot give it (`illumination`);
- *content*: what lasts under every light is there (`structure`), as bright as light can make it.

A check is a number and its bound; a person reads its note. docs/generated.md has how often
deliberate damage is found and honest pictures are refused; `pbrfit evaluate review` measures it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pbrfit._core import InputError
from pbrfit.acquire.review import illumination, structure
from pbrfit.io.resampling import averaged, averaged_channels, reduced_size
from pbrfit.registration import alignment
from pbrfit.threads import one_blas_thread
from pbrfit.values.arrays import Array, Mask

USABLE_SHARE_MIN = 0.2
"""Share of pixels that are neither clipped nor black, below which a picture is refused."""

BLACK, CLIPPED = 0.01, 0.98
"""Brightest channel, relative to white, up to which a pixel is black, and from which it is clipped;
by it saturated colours are neither."""

LOG_CHANGE_MIN = 0.04
"""Standard deviation of the logarithm that is left when a tone curve is taken out, below which a
picture is the photograph again."""

EDGE_CORRELATION_MIN = 0.15
EDGE_CORRELATION_TOGETHER_MIN = 0.4
"""Correlation of edges below which a picture is refused: with the photograph, and with what the
others share, which relief under one lamp does not blur; see `pbrfit.registration.alignment`."""

DISPLACED_SHARE_TOGETHER_MAX = 0.07
"""Share of the edges that lie in displaced tiles, compared with what the others share, above which
a picture is refused; compared with the photograph it is `alignment.MOST_MOVED`."""

COLOUR_RESIDUAL_MAX = (0.035, 0.425)
"""Unexplained logarithm of light, up in one channel and down in another, above which a picture is
refused: a + b / N with N pictures, since fewer explain less of a light that is right; see
`illumination`."""

CHANGE_EVIDENCE_MAX = (1.47, 3.0)
BRIGHTNESS = 4.5
DETAIL = 1.6
"""Evidence that a place shows something else, above which a picture is refused, a + b / N likewise:
`DETAIL` times what is missing of the lasting gradients, and the unexplained brightness in units of
`BRIGHTNESS` times the median picture's most. Either alone is common under hard lamps, both in one
place are not. All bounds were chosen on scenes of seeds 2000 to 2104."""

PICTURES_COUNTED_MAX = 17
"""Number of pictures N that bounds a + b / N are taken at for more: those scenes had no more."""

BRIGHTNESS_MIN = 0.05
"""Unexplained logarithm of brightness that the median picture has at least: noise and whole numbers
leave as much."""


@dataclass(frozen=True)
class Check:
    """One thing that was measured of a picture."""

    name: str
    """What was checked, in a word."""
    value: float
    bound: float
    """What was found, and where it begins to be too much (or too little)."""
    passed: bool
    note: str

    @property
    def excess(self) -> float:
        """How far beyond its bound, as a ratio: above 1 has failed."""
        if self.passed:
            return 0.0
        larger, smaller = max(self.value, self.bound), min(self.value, self.bound)
        return larger / max(smaller, 1e-3)


@dataclass(frozen=True)
class Verdict:
    """All checks of a picture."""

    checks: tuple[Check, ...]

    @property
    def accepted(self) -> bool:
        """Whether all passed."""
        return all(check.passed for check in self.checks)

    @property
    def excess(self) -> float:
        """Of the check that failed most; 0 if none did."""
        return max((check.excess for check in self.checks), default=0.0)

    @property
    def reason(self) -> str:
        """Why it was refused, for people: the first check that failed. Empty if none did."""
        return next((check.note for check in self.checks if not check.passed), "")


class Reviewer:
    """Judges pictures of the view of one photograph.

    The photograph is (H, W, 3), linear Rec.709, white = 1; the mask (H, W) False where it is
    transparent. Raises InputError if the photograph has nothing to compare by: no edges at all.
    """

    def __init__(self, photo: NDArray[Any], *, mask: Mask | None = None) -> None:
        self.shape = photo.shape
        size = reduced_size(photo.shape, alignment.SIDE)
        self._size = size
        self._pixel = max(photo.shape[:2]) / max(size)
        self._mask = None if mask is None else averaged(mask.astype(np.float64), size) > 0.999
        self._low = reduced_size(size, illumination.SIDE)
        self._photo = self._reduced(photo)
        self._edges = alignment.edges(self._photo, self._mask)
        if alignment.compare(self._edges, self._edges) is None:
            raise InputError(
                "photo: expected something with edges to compare by, found an even surface; "
                "--no-review (review=False) takes pictures as they come"
            )

    def picture(self, pixels: NDArray[Any]) -> Verdict:
        """Judge one picture (H, W, 3), linear Rec.709, white = 1, against the photograph.

        Raises InputError if it is of another size.
        """
        picture = self._reduced(pixels)
        exposure = self._exposure(picture)
        if not exposure.passed:
            return Verdict((exposure,))
        edges = alignment.edges(picture, self._mask)
        found = alignment.compare(self._edges, edges, pixel=self._pixel)
        aligned = _aligned(found, "the photograph", EDGE_CORRELATION_MIN, alignment.MOST_MOVED)
        return Verdict((exposure, self._copy(picture), *aligned))

    @one_blas_thread()  # small systems: more threads only wait for each other
    def together(self, pictures: Sequence[NDArray[Any]]) -> list[Verdict]:
        """Judge pictures by each other and the photograph: those that were accepted alone.

        The worst one is taken out and the others judged again without it, until none fails: a
        picture that does not fit spoils what it is compared with. Then each of those that were
        taken out is judged once more, beside the good ones. With fewer than 4 pictures, the
        photograph included, none is judged. Pictures are (H, W, 3), linear Rec.709, white = 1.
        """
        verdicts = [Verdict(())] * len(pictures)
        left = list(range(len(pictures)))
        out: list[int] = []
        small = [self._photo, *map(self._reduced, pictures)]
        if len(small) < illumination.FEWEST:
            return verdicts
        photo, *members = (
            (
                alignment.edges(picture, self._mask),
                structure.gradients(picture, self._mask),
                averaged_channels(picture, self._low).reshape(-1, 3),
            )
            for picture in small
        )
        while len(left) + 1 >= illumination.FEWEST:
            judged = self._judge([photo, *(members[i] for i in left)])
            for i, verdict in zip(left, judged, strict=True):
                verdicts[i] = verdict
            worst = max(left, key=lambda i: verdicts[i].excess)
            if verdicts[worst].accepted:
                break
            left.remove(worst)
            out.append(worst)
        else:  # too few are left to say anything of them
            for i in left:
                verdicts[i] = Verdict(())
            return verdicts
        # Beside pictures that do not fit, one that does may have looked wrong.
        for i in sorted(out, key=lambda i: verdicts[i].excess):
            again = self._judge([photo, *(members[j] for j in left), members[i]], len(left) + 1)[0]
            if again.accepted:
                verdicts[i] = again
                left.append(i)
        return verdicts

    def _judge(self, members: Sequence[_Member], first: int = 1) -> list[Verdict]:
        """Verdicts on the members from `first` on; member 0 is the photograph."""
        edges, gradients, small = zip(*members, strict=True)
        others, lasting = alignment.of_the_others(edges), structure.lasting(gradients)
        low = np.stack(small)
        used = illumination.usable(low)
        if self._mask is not None:
            used &= averaged(self._mask.astype(np.float64), self._low).ravel() > 0.999
        residuals = [
            illumination.unexplained(i, low, used).reshape(*self._low, 3)
            for i in range(1, len(members))
        ]
        brightness = [illumination.brightness(residual) for residual in residuals]
        usual = max(float(np.median([found.max() for found in brightness])), BRIGHTNESS_MIN)
        verdicts = []
        for i in range(first, len(members)):
            found = alignment.compare(others[i], edges[i], pixel=self._pixel)
            aligned = _aligned(
                found,
                "what the others share",
                EDGE_CORRELATION_TOGETHER_MIN,
                DISPLACED_SHARE_TOGETHER_MAX,
            )
            kept = structure.kept(gradients[i], lasting, self._low)
            content = self._content(kept, brightness[i - 1], usual, len(members))
            colour = self._colour(residuals[i - 1], len(members))
            verdicts.append(Verdict((*aligned, colour, content)))
        return verdicts

    def _reduced(self, pixels: NDArray[Any]) -> NDArray[np.float32]:
        if pixels.shape != self.shape:
            raise InputError(
                f"pixels: expected the photograph's shape {self.shape}, found {pixels.shape}"
            )
        if self._size == pixels.shape[:2]:
            return np.asarray(pixels, np.float32)
        return averaged_channels(pixels, self._size).astype(np.float32)

    def _exposure(self, picture: NDArray[np.float32]) -> Check:
        bright = picture.max(axis=-1)
        bright = bright if self._mask is None else bright[self._mask]
        share = float(((bright > BLACK) & (bright < CLIPPED)).mean())
        black = float((bright <= BLACK).mean())
        what = "black" if black > 0.5 * (1 - share) else "clipped"
        note = (
            f"{100 * share:.0f} % of the picture is neither clipped nor black; the rest is mostly "
            f"{what}"
        )
        return _at_least("exposure", share, USABLE_SHARE_MIN, note)

    def _copy(self, picture: NDArray[np.float32]) -> Check:
        """Compare with the photograph after the best tone curve a + b log I for each channel."""
        both = illumination.usable(self._photo) & illumination.usable(picture)
        if self._mask is not None:
            both &= self._mask
        change = np.inf
        if np.count_nonzero(both) > 100:
            left = []
            for c in range(3):
                from_, to = (
                    np.log(p[..., c][both].astype(np.float64)) for p in (self._photo, picture)
                )
                curve = np.polynomial.polynomial.polyfit(from_, to, 1)
                left.append(np.std(to - np.polynomial.polynomial.polyval(from_, curve)))
            change = float(np.mean(left))
        known = float(min(change, 10.0))
        note = f"the light differs by {known:.2f} in the logarithm beside a tone curve"
        if change < LOG_CHANGE_MIN:
            note = (
                "the same light as in the photograph: beside a tone curve only "
                f"{known:.3f} of the logarithm differs"
            )
        return _at_least("copy", known, LOG_CHANGE_MIN, note)

    def _colour(self, residual: Array, pictures: int) -> Check:
        mixed = illumination.mixed(residual)
        most = float(mixed.max())
        note = (
            f"a colour that no light of the others makes, by {most:.3f} in the logarithm, around "
            f"{self._place(mixed)}"
        )
        return _at_most("colour", most, _bound(COLOUR_RESIDUAL_MAX, pictures), note)

    def _content(self, kept: Array, brightness: Array, usual: float, pictures: int) -> Check:
        missing = np.nan_to_num(1.05 - kept).clip(0)
        changed = brightness / (BRIGHTNESS * usual) + DETAIL * missing
        place = np.unravel_index(changed.argmax(), changed.shape)
        detail = 100 * float(np.clip(missing[place], 0, 1))
        note = (
            f"something else around {self._place(changed)}: {detail:.0f} % of the lasting detail "
            f"is missing, and brightness is off by {brightness[place]:.2f} in the logarithm "
            f"from what light can make ({usual:.2f} is usual here)"
        )
        bound = _bound(CHANGE_EVIDENCE_MAX, pictures)
        return _at_most("content", float(changed[place]), bound, note)

    def _place(self, found: Array) -> str:
        """Where the largest value is, in words: pixels of the full picture."""
        row, column = np.unravel_index(found.argmax(), found.shape)
        x = (int(column) + 0.5) * self.shape[1] / found.shape[1]
        y = (int(row) + 0.5) * self.shape[0] / found.shape[0]
        return f"x = {x:.0f}, y = {y:.0f}"


def _bound(parts: tuple[float, float], pictures: int) -> float:
    return parts[0] + parts[1] / min(pictures, PICTURES_COUNTED_MAX)


_Member = tuple[alignment.Field, structure.Gradients, Array]
"""What is compared of a picture: edges, gradients, and the picture (P, 3) at low resolution."""


def _aligned(
    found: alignment.Alignment | None, reference: str, least_agreement: float, most_moved: float
) -> tuple[Check, ...]:
    if found is None:
        return (Check("edges", 0.0, least_agreement, False, "no edges to compare by"),)
    (right, down), length = found.shift, float(np.hypot(*found.shift))
    edges = f"edges agree with {reference} to {max(found.agreement, 0):.2f} of 1"
    shift = f"shifted by {length:.1f} pixels ({right:+.1f}, {down:+.1f}) from {reference}"
    warp = (
        f"{100 * found.moved:.0f} % of the edges are displaced from {reference}, in the median "
        f"by {found.warp:.1f} pixels"
    )
    return (
        _at_least("edges", found.agreement, least_agreement, edges),
        _at_most("shift", length, alignment.MOST_SHIFT * found.pixel, shift),
        _at_most("warp", found.moved, most_moved, warp),
    )


def _at_least(name: str, value: float, bound: float, note: str) -> Check:
    return Check(name, value, bound, bool(value >= bound), note)


def _at_most(name: str, value: float, bound: float, note: str) -> Check:
    return Check(name, value, bound, bool(value <= bound), note)
