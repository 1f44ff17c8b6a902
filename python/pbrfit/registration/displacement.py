"""How far a picture is displaced from others of its view, whatever lights them.

Under lights of order l radiance is a linear combination of (l + 1)² pictures. So what picture i
shows at a pixel x is explained by the other pictures of the view, and by what the normals n say,

    I_i(x + u(x)) ≈ Σ_k β_k C_k(x) + Σ_m γ_m Y_m(n(x)) M(x),

where C are the first principal components of the others, M their mean, Y_m the harmonics up to
order 2, and u the displacement: a shift, or an affine map. A picture in line needs no u. Linear in
β, γ and a small change of u, this is a least-squares problem. It is solved with weights that fade
what light does not explain, and repeated with the picture resampled (Lucas and Kanade 1981; the
basis of lights is that of Hager and Belhumeur 1998). Because the change of the light is fitted with
the displacement, relief under another lamp is not taken for a displacement, as it is by the
correlation of edges, which is 0.1 to 0.4 pixels off in the same pictures.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pbrfit.io.resampling import averaged_channels, averaged_where
from pbrfit.registration import alignment
from pbrfit.scene.scene import Scene
from pbrfit.values.arrays import Array, Floats, Mask

Size = tuple[int, int]

LEAST_DISPLACEMENT = 0.2
"""Root mean square displacement in pixels from which a picture is out of line. Specular light that
the other pictures do not explain moves the estimate by less."""

LEAST_SHARE = 0.2
"""Share that a displacement has to explain of what the other pictures leave of one: of the squares
to be looked into, of Cauchy's loss to be believed. Light alone reached 0.16 in 1,280 pictures;
shifts of 0.3 pixels explain 0.26 to 0.8."""

SCREENING = (8, 8)
WINDOWS = (12, 12)
"""Windows along each axis, and pixels along a window's side, at which pictures are compared at
their full resolution where they are larger: spread over the picture, as many pixels as one of 64²
to ask whether there is a displacement, and as one of 144² to measure it."""

COMPONENTS = 8
"""Principal components of the others that explain a picture, at most. Where several pictures are
displaced, many would also explain a displacement."""

LEAST_COMMON = 0.5
"""Share of a picture's pixels that the others it is compared with have to have too: those with the
fewest, as a black one of integers, half of whose noise is clipped, are left out until they do."""

_BLUR = 0.7  # pixels
_HALO = 4  # pixels around a window that blur and differences need
_FLOOR = 0.2  # of the mean: darker pixels weigh as this
_REWEIGHTED = 2
_CAUCHY = 2.4  # in standard deviations, 95 % efficient for normal residuals
_SAMPLES_OF_UNKNOWN = 16
_KEPT_PIXELS = 1 << 18


def displacement_at(affine: Array, places: Array, shape: Sequence[int]) -> Array:
    """(2, ...) u at rows and columns (2, ...) of a picture."""
    y, x = from_middle(places, shape)
    return np.stack([one[0] + one[1] * y + one[2] * x for one in affine])


def from_middle(places: Array, shape: Sequence[int]) -> tuple[Array, Array]:
    """Rows and columns from the middle, in halves of the longer side."""
    half = max(shape[:2]) / 2
    return (places[0] - (shape[0] - 1) / 2) / half, (places[1] - (shape[1] - 1) / 2) / half


@dataclass(frozen=True, eq=False)
class Estimate:
    """A displacement, or what an affine map adds to a shift, and how much it explains."""

    affine: Array
    """(2, 3), in pixels of the picture."""
    length: float
    """Root mean square over the picture, in pixels of the level."""
    share: float
    """Of the unexplained squares that it explains."""

    @property
    def believed(self) -> bool:
        """Whether it is none that light makes."""
        return self.length >= LEAST_DISPLACEMENT and self.share >= LEAST_SHARE


@dataclass(frozen=True, eq=False)
class Fit:
    """How a picture lies relative to others."""

    shift: Estimate
    bend: Estimate
    """What an affine map adds to the shift."""
    unexplained: Array
    """(P,) what the light leaves, relative to brightness; NaN where there is no data."""

    @property
    def out_of_line(self) -> bool:
        """Whether either part is believed."""
        return self.shift.believed or self.bend.believed

    def share_explained_by(self, other: Fit) -> float:
        """Share of Cauchy's loss of what this leaves that another fit of the picture does not."""
        both = np.isfinite(self.unexplained) & np.isfinite(other.unexplained)
        before, after = self.unexplained[both], other.unexplained[both]
        sigma = max(1.4826 * float(np.median(np.abs(before))), 1e-9)
        loss = [np.log1p((left / (_CAUCHY * sigma)) ** 2).sum() for left in (before, after)]
        return float(1 - loss[1] / max(loss[0], 1e-30))


class Level:
    """Windows of all pictures of a scene, grey and blurred, at one resolution.

    Windows (n, h, w) have a halo; their inner pixels, P in all, are compared.
    """

    def __init__(self, pictures: Greys, size: Size, windows: Size = WINDOWS) -> None:
        self._pictures, self._size = pictures, size
        self.pixel = max(pictures.shape) / max(size)
        rows, columns = (_windows(length, *windows) for length in size)
        grid = np.broadcast_arrays(rows[:, None, :, None], columns[None, :, None, :])
        self._places = np.stack(grid).reshape(2, -1, rows.shape[1], columns.shape[1])
        middle = self._inner(self._places)
        y, x = from_middle(middle, size)
        self._ones_y_x = np.stack([np.ones(len(y)), y, x])
        n = np.nan_to_num(np.moveaxis(pictures.normals(size)[tuple(self._places)], -1, 0))
        # Polynomials that span the harmonics up to order 2: (9, n, h, w).
        squares = n[0] * n[0] - n[1] * n[1], 3 * n[2] * n[2] - 1
        basis = [np.ones_like(n[0]), *n, n[0] * n[1], n[0] * n[2], n[1] * n[2], *squares]
        self._harmonics = np.stack(basis).astype(np.float32)
        cut = [self._cut(i, None) for i in range(pictures.count)]
        self._values = np.stack([values for values, _ in cut])
        self._used = np.stack([used for _, used in cut])
        flat = self._values.reshape(len(cut), -1)
        self._products = (flat @ flat.T).astype(np.float64)

    def move(self, i: int, affine: Array) -> None:
        """Take picture i from x + u(x)."""
        self._values[i], self._used[i] = self._cut(i, affine if affine.any() else None)
        flat = self._values.reshape(len(self._values), -1)
        self._products[i] = self._products[:, i] = flat @ flat[i]

    def _cut(self, i: int, affine: Array | None) -> tuple[NDArray[np.float32], Mask]:
        """Blurred windows (n, h, w) of a picture, of RMS 1, and which of the P pixels hold data."""
        from scipy.ndimage import gaussian_filter, map_coordinates

        grey, used = self._pictures.of(i, self._size)
        if affine is None:
            values, sound = grey[tuple(self._places)], used[tuple(self._places)]
        else:
            places = self._places + displacement_at(affine, self._places, self._size) / self.pixel
            values = map_coordinates(grey, places, order=3, mode="nearest")
            sound = map_coordinates(used.astype(np.float32), places, order=1) > 0.999
        if not sound.all():
            # What is no data counts as its surroundings, and pixels beside it do not count.
            weight = gaussian_filter(sound.astype(np.float32), (0, 2.0, 2.0))
            around = gaussian_filter(np.where(sound, values, 0), (0, 2.0, 2.0))
            values = np.where(sound, values, around / np.maximum(weight, 1e-6))
            sound = gaussian_filter(sound.astype(np.float32), (0, _BLUR, _BLUR)) > 0.99
        values = gaussian_filter(values.astype(np.float32), (0, _BLUR, _BLUR))
        sound = np.asarray(self._inner(sound), bool)
        # Not the mean, which may be 0 where there is only noise.
        square = float(np.mean(self._inner(values)[sound] ** 2)) if sound.any() else 0.0
        return (values / max(square**0.5, 1e-15)).astype(np.float32), sound

    @staticmethod
    def _inner(windows: NDArray[Any]) -> NDArray[Any]:
        """(..., P) of (..., n, h, w)."""
        cut = windows[..., _HALO:-_HALO, _HALO:-_HALO]
        return cut.reshape(*cut.shape[:-3], -1)

    def fit(self, i: int, others: Sequence[int], components: int = COMPONENTS) -> Fit | None:
        """How picture i lies relative to the others; None if nothing tells it."""
        others, used = self._common(i, others)
        # Of all pictures without a copy: the mean of the others, and their main components.
        components = min(components, len(others))
        shares = np.zeros((1 + components, len(self._values)), np.float32)
        shares[0, others] = 1 / len(others)
        _, vectors = np.linalg.eigh(self._products[np.ix_(others, others)])
        shares[1:, others] = vectors[:, ::-1][:, :components].T
        mean, *main = np.tensordot(shares, self._values, axes=1)
        basis = np.concatenate([mean * self._harmonics, main])
        if np.count_nonzero(used) < _SAMPLES_OF_UNKNOWN * (len(basis) + 6):
            return None
        # Least squares by the basis and a displacement, reweighted for Cauchy's loss.
        count = len(basis)
        place = self._ones_y_x[:, used]
        wanted = self._inner(self._values[i])[used].astype(np.float64)
        known = np.empty((count + 6, len(wanted)))
        known[:count] = self._inner(basis)[:, used]
        scale = 1.0 / (self._inner(mean)[used].clip(0).astype(np.float64) + _FLOOR)
        weights = scale**2
        factors, matrix = _normal_equations(known[:count], wanted, weights)
        for _ in range(_REWEIGHTED):
            explained = np.tensordot(factors[:count].astype(np.float32), basis, axes=1)
            slope = alignment.gradient(np.moveaxis(explained, 0, -1))
            slopes = self._inner(np.moveaxis(slope, -1, 0))[used]
            known[count:] = -np.concatenate([slopes.imag * place, slopes.real * place])
            factors, matrix = _normal_equations(known, wanted, weights)
            residual = (wanted - factors @ known) * scale
            sigma = 1.4826 * float(np.median(np.abs(residual)))
            weights = scale**2 / (1 + (residual / (_CAUCHY * max(sigma, 1e-9))) ** 2)
        by_basis = np.linalg.solve(matrix[:count, :count], matrix[:count, count:])
        # What the parts of the displacement change that the basis does not explain.
        moves, found = known[count:] - by_basis.T @ known[:count], factors[count:]
        unmoved = residual / scale + found @ moves
        weighted = moves * weights
        unexplained = np.full(len(used), np.nan)
        unexplained[used] = unmoved * scale
        matrix, by_moves = weighted @ moves.T, weighted @ unmoved
        ridge = 1e-9 * np.trace(matrix)
        if not ridge > 0:
            return None
        matrix[np.diag_indices(6)] += ridge
        shift, alone = [0, 3], np.zeros(6)
        alone[shift] = np.linalg.solve(matrix[np.ix_(shift, shift)], by_moves[shift])
        squares = float(weights @ unmoved**2) or 1.0
        gains = float(by_moves @ alone), float(by_moves @ found)
        return Fit(
            shift=Estimate(
                affine=self.pixel * alone.reshape(2, 3),
                length=self.rms(alone.reshape(2, 3)),
                share=gains[0] / squares,
            ),
            bend=Estimate(
                affine=self.pixel * (found - alone).reshape(2, 3),
                length=self.rms((found - alone).reshape(2, 3)),
                share=(gains[1] - gains[0]) / max(squares - gains[0], 1e-30),
            ),
            unexplained=unexplained,
        )

    def _common(self, i: int, others: Sequence[int]) -> tuple[list[int], Mask]:
        """The others that have pixels in common with picture i, and which these are."""
        own, kept = self._used[i], sorted(others)
        used = own & self._used[kept].all(axis=0)
        while len(kept) > 2 and np.count_nonzero(used) < LEAST_COMMON * np.count_nonzero(own):
            kept.remove(min(kept, key=lambda j: int(np.count_nonzero(own & self._used[j]))))
            used = own & self._used[kept].all(axis=0)
        return kept, used

    def rms(self, affine: Array) -> float:
        """Root mean square length of a displacement (2, 3) over the pixels."""
        return float(np.sqrt(((affine @ self._ones_y_x) ** 2).sum(axis=0).mean()))


def _normal_equations(known: Array, wanted: Array, weights: Array) -> tuple[Array, Array]:
    """Factors of the rows of `known`, and their matrix."""
    weighted = known * weights
    matrix = weighted @ known.T
    diagonal = np.diag_indices(len(matrix))
    matrix[diagonal] += 1e-9 * np.trace(matrix) + 1e-30
    return np.asarray(np.linalg.solve(matrix, weighted @ wanted)), np.asarray(matrix)


def _windows(length: int, count: int, side: int) -> NDArray[np.intp]:
    """(n, w) the rows, or columns, of windows with their halo: one, or `count` spread evenly."""
    if length <= count * side:
        return np.arange(length)[None]
    side += 2 * _HALO
    starts = np.linspace(0, length - side, count).round().astype(np.intp)
    return starts[:, None] + np.arange(side)


class Greys:
    """Grey pictures of a scene at any size, and where they hold data."""

    def __init__(self, scene: Scene) -> None:
        self._scene = scene
        self.count, self.shape = len(scene.images), scene.valid.shape
        self._kept: dict[tuple[int, tuple[int, int]], tuple[NDArray[Any], Mask]] = {}

    def of(self, i: int, size: tuple[int, int]) -> tuple[NDArray[Any], Mask]:
        """Picture i of a size (h, w); 0 where it holds no data."""
        if (i, size) in self._kept:
            return self._kept[i, size]
        if size != self.shape:
            small, share = averaged_where(*self.of(i, self.shape), size)
            grey, used = small.astype(np.float32), share > alignment.NEARLY_ALL
        else:
            scene, image = self._scene, self._scene.images[i]
            grey = (image[..., 0] + image[..., 1] + image[..., 2]).astype(np.float32)
            used = np.isfinite(grey)
            if scene.mask is not None:
                used &= scene.mask
            for c in range(3):  # one after the other: an axis of three is slow to go along
                if scene.weights is not None:
                    used &= scene.weights[i, ..., c] > 0
                if scene.limits is not None:
                    used &= scene.limits[i, ..., c] == 0
            grey = np.where(used, grey, np.float32(0))
        if size[0] * size[1] <= _KEPT_PIXELS:
            self._kept[i, size] = grey, used
        return grey, used

    def normals(self, size: tuple[int, int]) -> Floats:
        """(h, w, 3); NaN or 0 where there are none."""
        normals = self._scene.normals
        return normals if size == self.shape else averaged_channels(np.nan_to_num(normals), size)
