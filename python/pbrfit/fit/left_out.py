"""What left-out pictures say of one explanation: its errors, their score, and how sure that is.

With the mean square of picture i over the P pixels, and k numbers of its light,

    score = mean over pictures of [ln Σ e²/P + 2 k/P]

which is H. Akaike's criterion by sample ("A new look at the statistical model identification",
IEEE Trans. Automatic Control 19, 1974): a light that was fitted to the picture which it is judged
by leaves less than it would of another, by k/P in the mean, and explains as much too little of
that. A light of harmonics has 48 numbers, a lamp with constant light around it 8, a known light
none. The pixels are so far apart that errors of neighbours are hardly alike. Differences of scores
are as uncertain as their means over patches of the pictures say.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from pbrfit.fit import settings
from pbrfit.fit.lamps.estimator import Found
from pbrfit.fit.sampling import pairs_apart, pixel_index
from pbrfit.io.color import Curve
from pbrfit.lazy import lazy
from pbrfit.result.options import Loss
from pbrfit.transport.decision import Kind
from pbrfit.values.arrays import Array, Mask

LightKind = Literal["sh", "lamps"]


@dataclass(frozen=True)
class Explanation:
    """What differs between explanations of the same pictures."""

    response: Curve | None
    """The curve that files' values are decoded by; None = as the scene has it, for good."""
    light: LightKind
    material: float
    """Strength of the material prior, `Priors.material`."""
    robust: Loss
    """How samples weigh, `FitOptions.robust`."""
    other_fov: bool = False
    """Whether a field of view is fitted in place of the given one."""
    surroundings: Kind = "none"
    """What blocks light, or also brings some."""
    free_normals: bool = False
    """Whether normals are refined."""

    def in_words(self) -> str:
        """In a few words, for people."""
        words = ["environment light" if self.light == "sh" else "a lamp in each picture"]
        if self.surroundings != "none":
            bring = ", and bring some" if self.surroundings == "bounce" else ""
            words.append(f"surroundings block light{bring}")
        if self.response is not None:
            words.append(f"{'sRGB' if self.response == 'srgb' else self.response} values")
        if self.light == "sh":
            words.append("material prior" if self.material else "no material prior")
            words.append("equal weights" if self.robust == "none" else "weights by noise")
        if self.other_fov:
            words.append("another field of view")
        if self.free_normals:
            words.append("other normals")
        return ", ".join(words)


@dataclass(frozen=True, eq=False)
class LeftOut:
    """Left-out pictures as one explanation has them."""

    explanation: Explanation
    numbers: int
    """How many a picture's light has, that were fitted to it."""
    errors: Array
    values: Array
    """(M, P, 3) each: of the files' values, and these; NaN where nothing is told."""
    rounding: Array
    """(M,): variance of what files did to the values, as far as it is known; else 0."""
    valid: Mask
    """(H, W): where the P pixels are."""
    found: Found | None = None
    """Of a fit under far lamps: with those of all pictures."""
    fov: tuple[float, float] | None = None
    """That was fitted, and its standard deviation, in degrees."""

    @classmethod
    def together(cls, folds: Sequence[LeftOut]) -> LeftOut:
        """Several folds of one explanation."""
        names = ("errors", "values", "rounding")
        of_all: dict[str, Any] = {
            name: np.concatenate([getattr(one, name) for one in folds]) for name in names
        }
        return replace(folds[0], **of_all)

    @lazy
    def squares(self) -> Array:
        """(M, P): squared error, in the mean over the channels."""
        return mean_of_channels(np.square(self.errors))

    @property
    def error(self) -> float:
        """Relative root mean square error of the pictures, their geometric mean."""
        sizes = np.nanmean(mean_of_channels(np.square(self.values)), axis=1)
        sizes = np.log(np.maximum(sizes, settings.NOISE_VARIANCE_MIN))
        return float(np.exp(0.5 * (np.log(self.means) - sizes).mean()))

    @property
    def score(self) -> float:
        """As in the head of this file; infinite where nothing is told."""
        price = 2 * self.numbers / self.squares.shape[1]
        found = float(np.log(self.means).mean() + price)
        return found if math.isfinite(found) else math.inf

    @property
    def means(self) -> Array:
        """(M,): mean square error of each picture."""
        means = np.nanmean(self.squares, axis=1)
        return np.asarray(np.maximum(means, settings.NOISE_VARIANCE_MIN))

    @property
    def is_noise(self) -> bool:
        """Whether what is left is noise, of which pixels and channels share little, or rounding.

        Rounding is that of float32, or up to twice the deviation that the files have.
        """
        least = np.maximum(4 * self.rounding, (settings.EXACT_RMSE * settings.MEAN_RADIANCE) ** 2)
        return bool((self.means <= least).all() or self.share < settings.COMPARE_SHARED_MAX)

    @property
    def leaves_no_lamp(self) -> bool:
        """Whether it leaves so little that lamps cannot be what lights the pictures."""
        shared = self.error * math.sqrt(max(self.share, 0.0))
        return self.is_noise or shared < settings.COMPARE_LAMP_LEFT_MIN

    @property
    def share(self) -> float:
        """Share of the mean square that pixels and channels have in common, at most.

        What a wrong explanation leaves, neighbouring pixels and the channels of one share: the mean
        product of their errors, over the mean square, is about its share, with a standard error of
        1/√R by R products of independent errors.
        """
        errors = mean_of_channels(self.errors)
        beside = np.concatenate(pairs_apart(pixel_index(self.valid)), axis=1)
        one, other = (errors[:, of] for of in beside)
        square = np.maximum(np.nanmean(np.square(errors), axis=1), settings.NOISE_VARIANCE_MIN)
        # Grey pictures, whose channels are one, do not tell noise from anything else.
        red, green, blue = np.moveaxis(self.errors, -1, 0)
        between = (red * green + green * blue + blue * red) / 3 / self.means[:, None]
        return max(_share(one * other / square[:, None]), _share(between))

    @property
    def is_hot(self) -> Mask:
        """(M, P): far beyond what normal errors of that median can be."""
        most = (settings.OUTLIER_WIDTHS[0] / 0.6745) ** 2
        return np.asarray(self.squares > most * np.nanmedian(self.squares, axis=1, keepdims=True))

    def without(self, hot: Mask) -> LeftOut:
        """As if some pixels (M, P) told nothing."""
        errors, values = (np.where(hot[..., None], np.nan, of) for of in (self.errors, self.values))
        return replace(self, errors=errors, values=values)

    def is_worse(self, best: LeftOut, errors: float) -> bool:
        """Whether its score is higher by more than so many standard errors of the difference.

        A small change of a picture's mean square moves its logarithm by the change over the mean;
        the means of that over patches tell how sure it is.
        """
        shares = [one.squares / one.means[:, None] for one in (self, best)]
        difference = np.nan_to_num(shares[0] - shares[1])
        patches = patches_of(self.valid)
        sums = np.array([np.bincount(patches, row) for row in difference])
        sums /= difference.size
        error = float(np.sqrt(np.square(sums - sums.mean()).sum()))
        return self.score - best.score > errors * error


def patches_of(valid: Mask) -> NDArray[np.intp]:
    """(P,): number of the patch that each valid pixel is in."""
    rows, columns = np.nonzero(valid)
    side = max(valid.shape) / settings.COMPARE_PATCHES
    numbers = (rows // side) * settings.COMPARE_PATCHES + columns // side
    return np.asarray(np.unique(numbers, return_inverse=True)[1], np.intp)


def mean_of_channels(values: Array) -> Array:
    """(M, P): mean over the channels that tell something; NaN without any."""
    told = np.isfinite(values)
    sums, count = np.where(told, values, 0.0).sum(axis=-1), told.sum(axis=-1)
    return np.where(count > 0, sums / np.maximum(count, 1), np.nan)


def _share(products: Array) -> float:
    """At most, by two standard errors: the mean of products, of which the squares' mean is 1."""
    told = products[np.isfinite(products)]
    if not told.size:
        return 0.0
    return float(told.mean()) + settings.COMPARE_ERRORS_MIN / math.sqrt(told.size)
