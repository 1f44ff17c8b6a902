"""Objective: a scene as a function of one vector, for this package's solver or any other."""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pbrfit import _core
from pbrfit._core import InputError
from pbrfit.fit import settings
from pbrfit.fit.parameters import ParameterLayout
from pbrfit.fit.priors.penalties import penalties
from pbrfit.fit.sampling import Pixels
from pbrfit.model.materials import Materials
from pbrfit.model.reflection import Model, chosen_model, whole_number
from pbrfit.result.options import Priors, unit_interval
from pbrfit.scene.arrays import equal_channels
from pbrfit.scene.correction import Correction
from pbrfit.scene.exposure import relative_exposures
from pbrfit.scene.scene import Scene
from pbrfit.transport.scenery import PixelTransfer
from pbrfit.values.arrays import Array, Codes, Floats, Mask
from pbrfit.values.checks import real_array


@dataclass(frozen=True, eq=False)
class Normalization:
    """What pictures and their weights are divided by before they are fitted."""

    scale: float
    """The scene scale, in picture units."""
    exposures: Array | None
    """(N,), beside it; None = nothing."""
    largest_weight: float
    """Of a valid sample; 1 where all are the same."""

    @classmethod
    def of(cls, scene: Scene, equal_exposures: bool | None = None) -> Normalization:
        """Of a scene, unless it is black on the whole; `equal_exposures` as for `Objective`."""
        exposures = relative_exposures(scene, equal_exposures)
        largest = 1.0
        if scene.weights is not None and scene.weighted:
            largest = max(float(of_picture[scene.valid].max()) for of_picture in scene.weights)
        divided_by = np.ones(len(scene.images)) if exposures is None else exposures
        return cls(_scene_scale(scene, largest, divided_by), exposures, largest)


class Objective:
    """Mean squared error of the pictures as a function of x, with its gradient, plus penalties.

    x = [albedo (a plane of P valid pixels for each of C channels) | roughness | metallic | tangent
    offsets | lighting (N, K, C)], float64, without what is known. Grey pictures have C = 1, lights
    of order 2 have K = 9 coefficients instead of 16, lights that are the same in all channels are
    there once, (N, K). Inside, pictures are divided by one scene scale that makes their mean valid
    radiance 0.4, and where exposures are far apart each by its own (`pbrfit.scene.exposure`);
    `pack` and `unpack` convert between x and maps and lights of three channels in picture units.
    Tangent offsets (a, b) turn a given normal n₀ to n = (n₀ + a t₁ + b t₂)/√(1 + a² + b²), with
    tangents t₁ and t₂ at n₀ (docs/model.md).

    Parameters
    ----------
    scene, threads, sh_order, metallic, mono_light, priors, equal_exposures, model
        As of `decompose`. No `priors` are no penalties; `Priors.material` is left to the solver.
    free_normals
        Whether the scene's normals are where unknown ones start, instead of what is known.
    units
        What to divide pictures by, in place of `equal_exposures`: a part of a scene has those of
        the whole.

    Attributes
    ----------
    layout, problem
        Where the unknowns lie in x; the pictures in the core (`for_core` gives x as it takes it).
    albedo, roughness, metallic, tangent_offsets, lighting
        Slices of x, or None where they are known.
    size, pixels, channels, coefficients
        Length of x; P, C and K.
    samples, total_weight
        Number of samples (of one pixel, picture and channel) of some weight, and the sum of their
        weights, of which the largest is 1: the data term is divided by it.
    weights, sample_weights
        (N, P, 1 or C) float32 weights of the samples, at most 1, as given; and as they weigh now, 0
        at limits or by their noise. None where all are the same.
    known_metallic, model
        That were decided for.
    penalties
        Terms beside the data. A solver may change them between evaluations.
    scale, exposures
        In picture units; and (N,): what pictures are divided by beside it, or None.

    Raises
    ------
    InputError
        If the pictures are black on the whole, an option is none of the above, or known lights do
        not go with the pictures or with `sh_order`.
    """

    def __init__(
        self,
        scene: Scene,
        *,
        threads: int = 0,
        sh_order: int = 3,
        metallic: float | None = None,
        mono_light: bool = False,
        priors: Priors | None = None,
        equal_exposures: bool | None = None,
        free_normals: bool = False,
        model: Model | None = None,
        units: Normalization | None = None,
    ) -> None:
        self.model = chosen_model(model, scene.model)
        threads = whole_number("threads", threads)
        sh_order = whole_number("sh_order", sh_order)
        if sh_order not in (2, 3):
            raise InputError(f"sh_order: expected 2 or 3, found {sh_order}")
        self.known_metallic = None if metallic is None else unit_interval("metallic", metallic)
        layout = ParameterLayout.of(
            scene,
            sh_order=sh_order,
            metallic_known=metallic is not None,
            mono_light=mono_light,
            free_normals=free_normals,
        )
        self.channels, self.coefficients = layout.channels, layout.coefficients
        self._lay_out(layout)
        units = units or Normalization.of(scene, equal_exposures)
        self.weights = self._given_weights(scene, units) if scene.weighted else None
        self.transfer: PixelTransfer | None = None
        self._scene, self.threads = scene, threads
        # Where the pixels that take part are in a picture, row by row; None = all valid ones.
        self._places: NDArray[np.intp] | None = None
        self.sample_weights = self._ordinary()
        self.samples = layout.pictures * self.pixels * self.channels
        self.total_weight = float(self.samples)
        self._count_weights()
        self.scale, self.exposures = units.scale, units.exposures
        exposures = np.ones(layout.pictures) if self.exposures is None else self.exposures
        self._units = self.scale * exposures  # picture units of radiance 1, by picture
        self._exact = self._has_more_digits()
        self.problem = self._problem(self.sample_weights)
        self.penalties = [] if priors is None else penalties(layout, priors)

    def _lay_out(self, layout: ParameterLayout) -> None:
        self.layout, self.pixels, self.size = layout, layout.pixels, layout.size
        self.albedo, self.roughness = layout.albedo, layout.roughness
        self.metallic, self.tangent_offsets = layout.metallic, layout.tangent_offsets
        self.lighting = layout.lighting

    @property
    def everything(self) -> Pixels:
        """(P,): indices of all pixels, as the core takes them."""
        return np.arange(self.pixels, dtype=np.uint64)

    @property
    def bounds(self) -> Array:
        """(size, 2): [0, 1] for materials, infinite for the rest. Made anew: it is large."""
        bounds = np.empty((self.size, 2))
        bounds[self.layout.materials] = (0.0, 1.0)
        bounds[self.layout.materials.stop :] = (-np.inf, np.inf)
        return bounds

    def start(self) -> Array:
        """Albedo from the mean picture, constant roughness and metallic, best lights for them.

        Where normals are free they are the given ones.
        """
        maps = np.empty(self.layout.maps.stop)
        albedo = settings.START_MIDDLE / settings.MEAN_RADIANCE * self._mean_image()
        maps[self.albedo] = np.clip(albedo, *settings.START_ALBEDO_RANGE).T.ravel()
        maps[self.roughness] = settings.START_MIDDLE
        if self.metallic is not None:
            maps[self.metallic] = settings.START_METALLIC
        if self.tangent_offsets is not None:
            maps[self.tangent_offsets] = 0.0
        return self.with_best_lights(maps)

    def with_best_lights(self, maps: Array) -> Array:
        """X with the maps of `maps`, which is x or its first part, and the lights that fit best.

        Radiance is linear in the light, so this is a linear least-squares problem a channel (one
        for all, with the sums of their normal equations, where they share the light), and for each
        picture apart where samples have weights. Penalties take no part.
        """
        maps = np.array(maps[self.layout.maps], dtype=np.float64)
        if self.lighting is None:
            return maps
        gram, right = self.problem.light_equations(maps)
        if self.layout.light_channels < self.channels:
            gram, right = gram.sum(axis=0, keepdims=True), right.sum(axis=0, keepdims=True)
        k = self.coefficients
        ridge = settings.LIGHT_RIDGE * np.trace(gram, axis1=-2, axis2=-1) / k
        # A Gram matrix of zeros (nothing reflects) gives lights of 0 instead of an error.
        ridge += np.finfo(np.float64).tiny
        gram += ridge[..., None, None] * np.eye(k)
        if gram.shape[1] == 1:
            lights = np.linalg.solve(gram[:, 0], right.transpose(0, 2, 1)).transpose(2, 1, 0)
        else:
            lights = np.linalg.solve(gram, right[..., None])[..., 0].transpose(1, 2, 0)
        return np.concatenate([maps, lights.ravel()])

    def put_best_albedo(self, x: Array, pixels: Pixels) -> Array:
        """Put the albedo of some pixels to what fits best to the rest of x, which changes.

        Returned is the weighted sum of squared residuals that each of these pixels, given by
        indices below P, is left with. Given its other unknowns, a pixel's loss is a polynomial of
        degree 4 in the albedo of each channel. Penalties take no part.
        """
        albedo, squares = self.problem.best_albedo(self.for_core(x), pixels)
        x[self.albedo].reshape(self.channels, -1)[:, pixels] = albedo.T
        return squares

    def value_and_grad(self, x: ArrayLike, out: Array | None = None) -> tuple[float, Array]:
        """Loss at x and its gradient: (float, (size,) float64).

        Parameters
        ----------
        x
            The unknowns, (size,). It is not changed, unless it is `out`.
        out
            Where the gradient goes, (size,) float64, contiguous; None = a new array. Used again
            from call to call it saves the time in which the system hands out memory.

        Raises
        ------
        InputError
            If x has another length, is not finite, or leaves its bounds; if `out` has another
            length or type, or cannot be written.
        """
        x = real_array("x", x)
        if x is out and self.penalties:
            x = x.copy()  # penalties read it after the gradient is written
        data, gradient = self.data_value_and_grad(x, out)
        return data + self.add_penalties(x, gradient), gradient

    def torch(self) -> Callable[[Any], Any]:
        """The loss as a function of a tensor x (size,), which PyTorch differentiates once.

        x may be of any real type, on any device, and so are the loss and its gradient; both are
        computed in float64 on the processor. Raises ImportError without PyTorch (`pip install
        'pbrfit[torch]'`); the function raises InputError as `value_and_grad`: keep x in `bounds`.
        """
        import torch
        from torch.autograd.function import once_differentiable

        class Loss(torch.autograd.Function):  # type: ignore[misc,unused-ignore]
            @staticmethod
            def forward(ctx: Any, x: Any) -> Any:
                loss, gradient = self.value_and_grad(x.detach().to("cpu", torch.float64).numpy())
                ctx.save_for_backward(torch.from_numpy(gradient).to(x))
                return x.new_tensor(loss)

            @staticmethod
            @once_differentiable  # type: ignore[untyped-decorator,unused-ignore]
            def backward(ctx: Any, by_loss: Any) -> Any:
                return by_loss * ctx.saved_tensors[0]

        return Loss.apply  # type: ignore[no-any-return,unused-ignore]

    def data_value_and_grad(self, x: ArrayLike, out: Array | None = None) -> tuple[float, Array]:
        """As `value_and_grad`, without the penalties."""
        if self.layout.light_channels == self.channels:
            return self.problem.value_and_grad(self.for_core(x), out)
        loss, gradient = self.problem.value_and_grad(self.for_core(x))
        # By the chain rule, derivatives by the light in each channel add up.
        end = self.layout.maps.stop
        by_light = gradient[end:].reshape(-1, self.channels).sum(axis=-1)
        gradient = gradient[: self.size]
        gradient[end:] = by_light
        if out is None:
            return loss, gradient
        if not isinstance(out, np.ndarray) or out.dtype != np.float64 or out.shape != (self.size,):
            found = f"{type(out).__name__} {getattr(out, 'dtype', '')} {np.shape(out)}"
            raise InputError(f"out: expected float64 of shape ({self.size},), found {found}")
        out[:] = gradient
        return loss, out

    def add_penalties(self, x: Array, gradient: Array) -> float:
        """Sum of the penalties at x; their gradient is added to `gradient`."""
        return sum((p.value_and_grad(x, gradient) for p in self.penalties), 0.0)

    def for_core(self, x: ArrayLike) -> Array:
        """X as `_core.Problem` takes it: with lights of every channel."""
        if self.layout.light_channels == self.channels:
            return real_array("x", x)
        x = real_array("x", x, (self.size,))
        end = self.layout.maps.stop
        return np.concatenate([x[:end], np.repeat(x[end:], self.channels)])

    def weighed(self, factors: NDArray[np.float32] | None) -> Objective:
        """Squares in which samples weigh as much more or less, (N, P, C); None = as given.

        Samples at limits count too where their factor is not 0.
        """
        found = copy.copy(self)
        if factors is None:
            factors = self._ordinary()
        elif self.weights is not None:
            factors = factors * self.weights
        found.sample_weights = factors
        if factors is not None:
            found._count_weights()
            found.layout = replace(self.layout, weighted=True)
        found.problem = found._problem(found.sample_weights)
        return found

    def _count_weights(self) -> None:
        """Let `samples` and `total_weight` be those of the weights, where there are any."""
        weights = self.sample_weights
        if weights is not None:
            of_each = self.channels // weights.shape[-1]
            self.samples = of_each * int(np.count_nonzero(weights))
            self.total_weight = of_each * float(weights.sum(dtype=np.float64))

    def _ordinary(self) -> NDArray[np.float32] | None:
        """(N, P, 1 or C): weights as given, 0 at limits; None without both."""
        limits = self.limits(self.everything)
        if limits is None:
            return self.weights
        found: NDArray[np.float32] = (limits == 0).astype(np.float32)
        if self.weights is not None:
            found *= self.weights
        return found

    def _given_weights(self, scene: Scene, units: Normalization) -> NDArray[np.float32]:
        """As `weights`: only their ratios matter."""
        assert scene.weights is not None
        # One that was given for all channels is there once in memory.
        alike = scene.weights.strides[-1] == 0 or all(map(equal_channels, scene.weights))
        channels = slice(1 if alike else self.channels)
        weights = np.stack([of_picture[scene.valid, channels] for of_picture in scene.weights])
        weights /= np.float32(units.largest_weight)  # float32 neither overflows nor loses digits
        return weights

    def adopt(self, weighed: Objective) -> None:
        """Weigh samples as an objective does that `weighed` gave, from here on."""
        for name in ("sample_weights", "samples", "total_weight", "layout", "problem"):
            setattr(self, name, getattr(weighed, name))

    @property
    def has_limits(self) -> bool:
        """Whether some samples of the scene are limits."""
        return self._scene.limits is not None

    def limits(self, pixels: Pixels) -> Codes | None:
        """(N, Q, C): which samples of some pixels are limits, as in `Scene`; None where none is."""
        limits = self._scene.limits
        if limits is None:
            return None
        rows = limits.reshape(len(limits), -1, limits.shape[-1])
        return rows[:, self._all_places()[pixels], : self.channels]

    def pictures(self, pixels: Pixels) -> Array:
        """(N, Q, C): some pixels' samples in the unit of x."""
        places = self._all_places()[pixels]
        samples = [self._scene.samples(i, places) for i in range(self.layout.pictures)]
        return np.stack(samples)[..., : self.channels] / self._by_picture

    def file_variances(self, pixels: Pixels) -> Array | None:
        """(N, Q, C): the variances that files' encoding left, in units of x; None if none did."""
        places, found = self._all_places()[pixels], None
        for i, unit in enumerate(self._units):
            sigma = self._scene.noise_floor(i, places)
            if sigma is None:
                continue
            if found is None:
                found = np.zeros((self.layout.pictures, len(pixels), self.channels))
            found[i] = np.square(sigma[:, : self.channels].astype(np.float64) / unit)
        return found

    def estimated_finish(self, pixels: Pixels) -> Array | None:
        """(Q, 2): roughness and metallic of some pixels as the scene's estimates have them."""
        estimates = self._scene.estimates
        if estimates is None:
            return None
        places = self._all_places()[pixels]
        planes = (estimates.roughness, estimates.metallic)
        return np.stack([plane.flat[places] for plane in planes], axis=-1).astype(np.float64)

    @property
    def file_correlation(self) -> float:
        """As of the scene."""
        return self._scene.file_correlation

    def places_in(self, whole: Scene, pixels: Pixels | None = None) -> NDArray[np.intp]:
        """Where some pixels, or all, are in the picture that this one is, or is a window of."""
        places = self._all_places()[slice(None) if pixels is None else pixels]
        window = getattr(self._scene, "window", None)
        if window is None:
            return places
        rows, columns = np.divmod(places, self._scene.width)
        height, width = whole.valid.shape
        rows = np.arange(height)[window.rows][rows]
        return np.asarray(rows * width + np.arange(width)[window.columns][columns])

    def _all_places(self) -> NDArray[np.intp]:
        return self._scene.places if self._places is None else self._places

    def among(self, transfer: PixelTransfer | None) -> Objective:
        """The same with light that is blocked, and brought, as a transfer of these pixels says."""
        found = copy.copy(self)
        found.transfer = transfer
        found.problem = found._problem(self.sample_weights)
        return found

    def see(self, scene: Scene) -> None:
        """Take the pictures and the camera of the same scene through another instrument."""
        self._scene = scene
        del self.problem  # before there is another one, which is as large
        self.problem = self._problem(self.sample_weights)

    def correction_directions(self, x: Array, correction: Correction) -> list[Array]:
        """As `Correction.directions` at what the model shows, (P, N, C), in units of x."""
        residuals = self.problem.residuals(self.for_core(x), self.everything)
        shown = (residuals + self.pictures(self.everything)) * self._by_picture
        found, _ = correction.directions(shown)
        return [(one / self._by_picture).transpose(1, 0, 2) for one in found]

    def restricted(self, pixels: Pixels, shares: Array | None = None) -> Objective:
        """The objective of some pixels alone, in the same units; squares, without penalties.

        With `shares` (Q,), at most 1, samples of a pixel weigh as much less.

        Its x has the maps of these pixels in their order, and all lights: what `part_of` takes
        from an x of this objective. `pack` and `unpack` are not for it, for it has no picture.
        """
        found = copy.copy(self)
        segments = self.layout.segments
        found._lay_out(
            replace(
                self.layout,
                valid=np.ones((1, len(pixels)), dtype=bool),
                segments=None if segments is None else segments[pixels],
            )
        )
        found.penalties = []
        share = len(pixels) / self.pixels
        found.samples, found.total_weight = round(self.samples * share), self.total_weight * share
        found.weights = None if self.weights is None else self.weights[:, pixels]
        weights = None if self.sample_weights is None else self.sample_weights[:, pixels]
        if shares is not None and (shares != 1).any():
            own = np.ones((self.layout.pictures, 1, 1), np.float32) if weights is None else weights
            weights = own * shares.astype(np.float32)[:, None]
            found.layout = replace(found.layout, weighted=True)
        found.sample_weights = weights
        found._places = self._all_places()[pixels]
        found.transfer = None if self.transfer is None else self.transfer.of(pixels)
        found.problem = found._problem(found.sample_weights)
        return found

    def part_of(self, x: Array, pixels: Pixels) -> Array:
        """X of `restricted(pixels)` from an x of this objective."""
        maps = x[self.layout.maps].reshape(-1, self.pixels)[:, pixels]
        return np.concatenate([maps.ravel(), x[self.layout.maps.stop :]])

    def put_part(self, x: Array, pixels: Pixels, part: Array) -> None:
        """Undo `part_of`: give x the maps of these pixels, and the lights, of `part`."""
        maps = x[self.layout.maps].reshape(-1, self.pixels)
        of_pixels, lights = np.split(part, [len(maps) * len(pixels)])
        maps[:, pixels] = of_pixels.reshape(len(maps), -1)
        x[self.layout.maps.stop :] = lights

    def light_basis(self, x: Array) -> Array | None:
        """Q, (light channels, N, K): an orthonormal basis of the lights of x over the pictures.

        All that materials do to a channel's pictures is in its span. None where surroundings bring
        light that is in no span, or pictures are no more than 2 K: sums of so few save little, and
        where samples have weights they only come near.
        """
        layout = self.layout
        brings = self.transfer is not None and self.transfer.bounced is not None
        if layout.pictures <= 2 * layout.coefficients or brings:
            return None
        return np.linalg.qr(self.lights_in_core(x))[0]

    def combined(self, x: Array, basis: Array) -> tuple[_core.Problem, Array]:
        """Sums of the pictures with shares (light channels, N, J), and x for the core as they are.

        Samples have their mean weights over the pictures.
        """
        of_channels = np.broadcast_to(basis, (self.channels, *basis.shape[1:]))
        images = np.zeros((basis.shape[2], self.pixels, self.channels))
        for i in range(self.layout.pictures):
            images += of_channels[:, i].T[:, None] * self._image(i)
        weights = self.sample_weights
        if weights is not None:
            weights = np.repeat(weights.mean(axis=0, keepdims=True), basis.shape[2], axis=0)
        maps, lights = np.split(self.for_core(x), [self.layout.maps.stop])
        lights = lights.reshape(self.layout.pictures, self.coefficients, self.channels)
        lights = np.einsum("cnj,nkc->jkc", of_channels, lights)
        return self._problem(weights, images), np.concatenate([maps, lights.ravel()])

    def residual_rmse(self, loss: float) -> float:
        """Root of a loss without penalties, in picture units.

        Of squares that is the root mean square residual, where each picture's are divided by its
        exposure if `exposures` are.
        """
        return float(np.sqrt(loss) * self.scale)

    def pack(
        self,
        albedo: NDArray[Any],
        roughness: NDArray[Any],
        metallic: NDArray[Any],
        lighting: NDArray[Any] | None = None,
    ) -> Array:
        """X from maps (H, W, ...) and lights (N, 16, 3) in picture units.

        Without `lighting` the lights that fit the maps best are taken. What x does not have is
        dropped: known metallic, known lights, band 3; where x has one channel for three, their mean
        is taken. Free normals are the given ones.
        """
        valid = self.layout.valid
        colors = in_channels(valid_values("albedo", albedo, valid), self.channels)
        maps = [colors.T.ravel(), valid_values("roughness", roughness, valid)]
        metallic = valid_values("metallic", metallic, valid)
        if self.metallic is not None:
            maps.append(metallic)
        if self.tangent_offsets is not None:
            maps.append(np.zeros(2 * self.pixels))
        x = np.concatenate(maps)
        if lighting is None or self.lighting is None:
            return self.with_best_lights(x)
        lighting = real_array("lighting", lighting, (self.layout.pictures, 16, 3))
        if not np.isfinite(lighting).all():
            raise InputError("lighting: expected finite coefficients, found NaN or infinity")
        lighting = in_channels(lighting[:, : self.coefficients], self.layout.light_channels)
        return np.concatenate([x, (lighting / self._by_picture).ravel()])

    def unpack(self, x: Array) -> tuple[Materials, Array]:
        """Maps (NaN outside the mask) and lights (N, 16, 3) in picture units.

        Whatever x holds, there are three channels and 16 coefficients: one channel comes three
        times, and band 3 is 0 where it is left out.
        """
        x = real_array("x", x, (self.size,))
        if not np.isfinite(x).all():
            raise InputError("x: expected finite numbers, found NaN or infinity")
        albedo = np.broadcast_to(x[self.albedo].reshape(self.channels, -1).T, (self.pixels, 3))
        metallic = self.known_metallic if self.metallic is None else x[self.metallic]
        metallic = np.broadcast_to(np.asarray(metallic), self.pixels)
        materials = Materials(albedo, x[self.roughness], metallic).each(self.layout.whole)
        if self._scene.lighting is not None:
            return materials, self._scene.lighting.copy()
        lighting = np.zeros((self.layout.pictures, 16, 3))
        with np.errstate(over="ignore"):
            lighting[:, : self.coefficients] = self._by_picture * x[self.lighting].reshape(
                -1, self.coefficients, self.layout.light_channels
            )
        if not np.isfinite(lighting).all():
            raise InputError("x: expected lights that float64 can hold in picture units")
        return materials, lighting

    def lights(self, x: Array) -> Array:
        """(N, K, C): those of x, or the known ones, in units of x."""
        if self.lighting is None:
            assert self._scene.lighting is not None
            return self._reduced(self._scene.lighting)
        shape = self.layout.pictures, self.coefficients, self.layout.light_channels
        return np.broadcast_to(x[self.lighting].reshape(shape), (*shape[:2], self.channels))

    def lights_in_core(self, x: Array) -> Array:
        """(light channel, N, K): those of x, where they are unknown, in the core's order."""
        return self.lights(x)[..., : self.layout.light_channels].transpose(2, 0, 1)

    def normals(self, x: Array) -> Array:
        """(P, 3): the unit normals of x, in camera space; the given ones where they are known."""
        if self.tangent_offsets is None:
            return self._rows(self._scene.normals)
        return self.problem.normals(x[self.layout.maps])

    def _image(self, i: int) -> Array:
        """(P, C): a picture in the unit of x."""
        samples = self._scene.samples(i, self._places)[:, : self.channels].astype(np.float64)
        samples /= self._units[i]
        return samples

    def _mean_image(self) -> Array:
        """(P, C): the mean over pictures, of what float32 holds of them."""
        alike = np.ones((self.layout.pictures, 1, 1), np.float32)
        weights = alike if self.weights is None else self.weights
        mean = np.zeros((self.pixels, self.channels))
        for i in range(self.layout.pictures):
            mean += np.multiply(self._image(i).astype(np.float32), weights[i], dtype=np.float64)
        total = weights.sum(axis=0, dtype=np.float64)
        # Weights that are tiny beside the largest can vanish in float32.
        np.divide(mean, total, out=mean, where=total > 0)
        return mean

    def _has_more_digits(self) -> bool:
        if self._scene.images.dtype == np.float32:
            return False
        pictures = (self._scene.samples(i) for i in range(self.layout.pictures))
        with np.errstate(over="ignore"):  # beyond float32: infinite, so not the same
            return any((samples != samples.astype(np.float32)).any() for samples in pictures)

    def _problem(
        self, weights: NDArray[np.float32] | None, sums: Array | None = None
    ) -> _core.Problem:
        """Of the pictures, or of sums (J, P, C) of them."""
        scene = self._scene
        if weights is not None and weights.shape[-1] == 1:
            weights = weights[..., 0]
        # Pictures that came in float64 keep their digits. Of pictures in float32 the division
        # leaves something too, but it is no more than what was rounded away before they came, and
        # keeping it would double the memory.
        images = _OneByOne(
            self.layout.pictures if sums is None else len(sums),
            self._image if sums is None else sums.__getitem__,
            np.dtype(np.float64 if self._exact or sums is not None else np.float32),
        )
        return _core.Problem(
            images,
            self._rows(scene.normals),
            self._rows(scene.views),
            self.threads,
            weights=weights,
            sh_order=self.layout.sh_order,
            metallic=self.known_metallic,
            lighting=None if scene.lighting is None else self._reduced(scene.lighting),
            free_normals=self.layout.free_normals,
            model=self.model,
            transfer=None if self.transfer is None else self.transfer.rows,
            bounced=None if self.transfer is None else self.transfer.scaled(self._units),
        )

    def _rows(self, vectors: Floats) -> Array:
        """Rows (P, 3) of (H, W, 3), no copy if all are valid: memory peaks here."""
        if self._places is not None:
            rows = vectors[np.divmod(self._places, self._scene.width)]
        else:
            rows = vectors.reshape(-1, 3) if self._scene.all_valid else vectors[self._scene.valid]
        return rows.astype(np.float64, copy=False)

    @property
    def _by_picture(self) -> Array:
        """Units of the pictures, beside lights (N, K, C)."""
        return self._units[:, None, None]

    def _reduced(self, known: Array) -> Array:
        """Known lights as the core takes them: in units of x, with its bands and channels."""
        largest = np.abs(known).max(axis=(1, 2))
        beyond = largest > settings.LARGEST_LIGHT * self._units
        if beyond.any():
            first = int(beyond.argmax())
            raise InputError(
                f"lighting: expected coefficients like the pictures' radiance (mean "
                f"{self._units[first] * settings.MEAN_RADIANCE:g}), found {largest[first]:g}"
            )
        left_out = np.abs(known[:, self.coefficients :]).max(initial=0.0)
        if left_out > 0:
            raise InputError(
                f"lighting: expected known lights without band 3 for sh_order 2, found a "
                f"coefficient of {left_out:g} there; sh_order 3 keeps it"
            )
        if self.layout.light_channels < self.channels and not equal_channels(known):
            raise InputError(
                "lighting: expected known lights with equal channels for mono_light, found colour"
            )
        return known[:, : self.coefficients, : self.channels] / self._by_picture


@dataclass(frozen=True)
class _OneByOne:
    """Pictures that are made when their turn comes, so that they never all lie there twice."""

    count: int
    image: Callable[[int], Array]
    dtype: np.dtype[Any]

    def __len__(self) -> int:
        return self.count

    def __iter__(self) -> Iterator[NDArray[Any]]:
        for i in range(self.count):
            yield self.image(i).astype(self.dtype, copy=False)


def in_channels(values: Array, channels: int) -> Array:
    """From three channels on the last axis to 3 or 1."""
    return values if channels == 3 else values.mean(axis=-1, keepdims=True)


def valid_values(name: str, values: NDArray[Any], valid: Mask) -> Array:
    """(P, ...) of the valid pixels of a map (H, W, ...) that is "albedo", or has one channel."""
    shape = valid.shape + ((3,) if name == "albedo" else ())
    values = real_array(name, values, shape)[valid]
    if not np.isfinite(values).all():
        raise InputError(f"{name}: expected finite values at all valid pixels, found NaN")
    return values


def _scene_scale(scene: Scene, largest_weight: float, exposures: Array) -> float:
    total = count = 0.0
    given = scene.weights if scene.weighted else None
    for i in range(len(scene.images)):
        if given is None:
            samples = scene.brightness(i)
            count += samples.size
        else:
            weights = given[i][scene.valid] / np.float32(largest_weight)
            # No dot product: BLAS rounds differently on a machine with another processor count.
            samples = weights * scene.samples(i).astype(np.float64)
            count += float(weights.sum(dtype=np.float64))
        total += float(samples.sum()) / exposures[i]
    mean = total / count
    if not 0 < mean < np.inf:
        raise InputError(
            f"images: expected a positive mean radiance over the valid pixels, found {mean:g}"
        )
    return float(mean / settings.MEAN_RADIANCE)
