"""What a fit hands over, as data: maps, lights, how it went."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from pbrfit._core import InputError
from pbrfit.lazy import lazy
from pbrfit.model.geometry import angles_between, positions
from pbrfit.model.lamps import Lamps
from pbrfit.model.materials import Materials
from pbrfit.model.reflection import Model, sh_basis
from pbrfit.result.camera import Camera
from pbrfit.result.held_out import HeldOut
from pbrfit.result.history import History
from pbrfit.result.options import FitOptions
from pbrfit.result.refinement import NOT_ASKED, Refinement
from pbrfit.result.uncertainty import Uncertainty
from pbrfit.result.verdict import Verdict
from pbrfit.scene.options import Source
from pbrfit.transport.decision import NOT_TRIED, Transport

if TYPE_CHECKING:
    from pbrfit.transport.scenery import Scenery

GIVEN_NORMALS = tuple(f"normal_given.{name}" for name in "XYZ")
NORMAL_CHANGE = "normal_change.Y"
"""Layers of `materials.exr` where normals were refined."""

DEPTH = "depth.Z"
"""Layer of `materials.exr` where the scene had depth: 0 where it is unknown."""

SEGMENT = "segment.ID"
"""Layer of `materials.exr` where surroundings block light and the scene had segments."""

SEGMENT_MAX = 1 << 24
"""Largest id that float32 holds; with larger ones all are counted anew, in their order."""


class Status(StrEnum):
    """Why a fit ended."""

    CONVERGED = "converged"
    ITERATION_LIMIT = "iteration_limit"
    TIME_LIMIT = "time_limit"


@dataclass(frozen=True)
class Stage:
    """A part of a fit: which method ran, how long, and what is to be said about it."""

    name: str
    seconds: float
    note: str = ""


@dataclass(frozen=True, eq=False)
class ResultData:
    """What `decompose` found.

    Attributes
    ----------
    materials
        Maps; `albedo`, `roughness` and `metallic` are shorthands. NaN outside the mask.
    lighting
        (N, 16, 3) float64 SH lights of the pictures, in picture units, linear Rec.709; where there
        are lamps, the ambient light beside them.
    normals
        (H, W, 3) unit vectors, camera space, that belong to the materials: the refined ones where
        normals were refined, else the given ones. NaN outside the mask.
    mask
        (H, W) bool: pixels that were fitted.
    fov
        Horizontal field of view in degrees, 0 = orthographic.
    model
        "paper" or "principled": the reflection model that was fitted. Materials and lights belong
        to it; with another one they show something else.
    pictures
        Names, in the order of `lighting`.
    status, stop_reason
        Why the fit ended: for programs, and in words.
    history
        Loss and errors by iteration.
    stages
        Which methods ran, one after the other.
    evaluations
        Passes over all pictures by L-BFGS: evaluations of loss and gradient.
    seconds
        Time of the fit, reading and writing of files apart.
    metrics
        Final errors; `metrics.PROTOCOL` says how they are taken. Against ground truth where known.
    uncertainty
        Deviations, intervals and verdicts of the maps; None where they were not asked for.
    options, assumed, left_out, inputs
        Run details: options, decisions about the input, work that the scene did not
        need, sha256 of the files.
    source
        Where the scene was read from and how; None where it was made of arrays.
    refinement
        Whether normals were refined, why, and the figures of that decision.
    camera
        What was decided about the field of view, and what the pictures say of it.
    given_normals
        (H, W, 3), the scene's normals where they were refined; else None. NaN outside the mask.
    depth
        (H, W) float32, the scene's distances along the camera's axis; None where it had none. NaN
        where they are unknown. What is outside the mask blocks light, too.
    transport
        What was decided about surroundings, and why.
    segments
        (H, W) integer ids, 0 = unclassified, by which walls are found again; None where
        surroundings do nothing, or the scene had none.
    lamps
        Lamps of the pictures, with known colours in picture units; None where all light is in
        `lighting`.
    height
        (H, W): height of the surface towards the viewer in pixels, from normals that the pictures
        told; None where it was not sought. NaN outside the mask, and where it is unknown.
    held_out
        How well pictures are explained that were not fitted; None where none could be left out.

    Raises
    ------
    InputError
        If `refinement` tells of refined normals and there are no given ones, or the reverse; if
        lamps are of more pictures than there are, or of unknown colour, or near and without depth;
        if `height` has another shape than the mask.
    """

    materials: Materials
    lighting: NDArray[np.float64]
    normals: NDArray[np.float64]
    mask: NDArray[np.bool_]
    fov: float
    model: Model
    pictures: tuple[str, ...]
    status: Status
    stop_reason: str
    history: History
    evaluations: int
    seconds: float
    metrics: Mapping[str, float]
    options: FitOptions
    assumed: Mapping[str, str] = field(default_factory=dict)
    left_out: tuple[str, ...] = ()
    inputs: Mapping[str, str] = field(default_factory=dict)
    uncertainty: Uncertainty | None = None
    source: Source | None = None
    stages: tuple[Stage, ...] = ()
    refinement: Refinement = NOT_ASKED
    given_normals: NDArray[np.float64] | None = None
    camera: Camera | None = None
    depth: NDArray[np.float32] | None = None
    transport: Transport = NOT_TRIED
    segments: NDArray[np.integer[Any]] | None = None
    lamps: Lamps | None = None
    height: NDArray[np.floating[Any]] | None = None
    held_out: HeldOut | None = None

    def __post_init__(self) -> None:
        if self.refinement.refined != (self.given_normals is not None):
            expected = "the normals before" if self.refinement.refined else "none without"
            raise InputError(f"given_normals: expected {expected} their refinement")
        if self.lamps is not None:
            self.lamps.check_pictures(len(self.pictures))
            if not self.lamps.colored:
                raise InputError("lamps: expected known colors, found NaN")
            if self.lamps.near.any() and self.depth is None:
                raise InputError("lamps: expected depth for near lamps, found none")
        if self.height is not None and self.height.shape != self.mask.shape:
            raise InputError(f"height: expected {self.mask.shape}, found {self.height.shape}")

    def __repr__(self) -> str:
        """In a line: of what it is, how the fit ended, verdicts; and no arrays."""
        height, width = self.mask.shape
        parts = [
            f"{len(self.pictures)} pictures of {width} × {height}",
            f"model {self.model}",
            str(self.status),
        ]
        if "recon_rmse" in self.metrics:
            parts.append(f"residual {self.metrics['recon_rmse']:.3g}")
        parts += [f"{name} {one.level}" for name, one in self.verdicts.items()]
        return f"{type(self).__name__}({', '.join(parts)})"

    @lazy
    def scenery(self) -> Scenery | None:
        """Surroundings as the fit had them, built when first asked for; None where they do nothing.

        Raises InputError if the depth has too few points.
        """
        if not self.transport.blocks or self.depth is None:
            return None
        # Here: what finds walls takes longer to import than a result.
        from pbrfit.transport.scenery import Scenery

        normals = self.normals if self.given_normals is None else self.given_normals
        extents = self.transport.extents
        return Scenery(self.depth, normals, self.mask, self.segments, self.fov, extents)

    @lazy
    def basis_pictures(self) -> NDArray[np.float32] | None:
        """(16, H, W, 3): what is seen among the surroundings under each SH function alone.

        Pictures are linear in the light, so these give them under any. NaN outside the mask; None
        where surroundings do nothing.
        """
        if self.scenery is None:
            return None
        return self._under_each_function(self.materials, self.transport, self.model)

    @lazy
    def open_share(self) -> NDArray[np.float32] | None:
        """(16, H, W): what white matt surfaces show among the surroundings, by SH function.

        Over the same without any it is the share of a light that reaches them. NaN outside the
        mask; None where surroundings do nothing.
        """
        if self.scenery is None:
            return None
        blocked = replace(self.transport, kind="occlusion")
        return self._under_each_function(self.white, blocked, "principled")[..., 0]

    @lazy
    def reflected_pictures(self) -> NDArray[np.float32] | None:
        """(16, H, W, 3): what surfaces send each other of each SH function; None if nothing."""
        if self.scenery is None or self.transport.kind != "bounce":
            return None
        assert self.basis_pictures is not None
        blocked = replace(self.transport, kind="occlusion")
        return self.basis_pictures - self._under_each_function(self.materials, blocked, self.model)

    def _under_each_function(
        self, materials: Materials, transport: Transport, model: Model
    ) -> NDArray[np.float32]:
        """(16, H, W, 3): materials in the place of its own among the surroundings, by function."""
        assert self.scenery is not None
        functions = np.repeat(np.eye(16)[..., None], 3, axis=-1)
        pictures = self.scenery.render(materials, self.normals, functions, transport, model=model)
        return pictures.astype(np.float32)

    @property
    def white(self) -> Materials:
        """White matt surfaces in the place of the result's; NaN outside the mask."""
        inside = np.where(self.mask, 1.0, np.nan)
        return Materials(np.repeat(inside[..., None], 3, axis=-1), inside, 0.0 * inside)

    @property
    def middle(self) -> NDArray[np.float64] | None:
        """(3,): median of the points in the mask, in the unit of the depth; None without depth."""
        if self.depth is None:
            return None
        points = positions(self.depth, self.fov)[self.mask & np.isfinite(self.depth)]
        return np.asarray(np.median(points, axis=0)) if len(points) else None

    def lamps_seen(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Directions (K, 3) and colours (K, 3) of the lamps at the middle of the surface.

        Raises InputError if a near one is seen from nowhere, because no pixel has depth.
        """
        if self.lamps is None:
            return np.zeros((0, 3)), np.zeros((0, 3))
        middle = self.middle
        directions, strengths = self.lamps.at(None if middle is None else middle[None])
        return directions[0], strengths[0][:, None] * self.lamps.colors

    def sh_lighting(self) -> NDArray[np.float64]:
        """(N, 16, 3): `lighting`, and of lamps what l ≤ 3 holds at the middle of the surface.

        A lamp of irradiance E = π · colour from d has L_k = E Y_k(d).
        """
        found = np.array(self.lighting)
        if self.lamps is not None:
            directions, colors = self.lamps_seen()
            light = np.pi * sh_basis(directions)[:, :, None] * colors[:, None, :]
            np.add.at(found, self.lamps.pictures, light)
        return found

    @property
    def verdicts(self) -> Mapping[str, Verdict]:
        """What each map can be used for, by its name; empty without an uncertainty."""
        return {} if self.uncertainty is None else self.uncertainty.verdicts

    @property
    def lights(self) -> tuple[NDArray[np.float64] | tuple[Lamps, NDArray[np.float64]], ...]:
        """Of each picture, as `relight` takes it: SH light (16, 3), with its lamps before it."""
        if self.lamps is None:
            return tuple(self.lighting)
        each = enumerate(self.lighting)
        return tuple((self.lamps.of_pictures([i]), ambient) for i, ambient in each)

    @property
    def normal_change(self) -> NDArray[np.float64] | None:
        """(H, W): degrees between given and refined normals; None where none were refined."""
        if self.given_normals is None:
            return None
        return angles_between(self.normals, self.given_normals)

    @property
    def albedo(self) -> NDArray[np.floating[Any]]:
        """(H, W, 3), linear Rec.709."""
        return self.materials.albedo

    @property
    def roughness(self) -> NDArray[np.floating[Any]]:
        """(H, W), perceptual."""
        return self.materials.roughness

    @property
    def metallic(self) -> NDArray[np.floating[Any]]:
        """(H, W)."""
        return self.materials.metallic

    def further_layers(self) -> dict[str, NDArray[Any]]:
        """Layers (H, W) of `materials.exr` beside materials, normals and mask, by channel.

        These and `whole_layers` are all.
        """
        layers: dict[str, NDArray[Any]] = {}
        if self.given_normals is not None:
            layers |= {name: self.given_normals[..., i] for i, name in enumerate(GIVEN_NORMALS)}
            # Of the normals as they are stored: what is read back and saved again is the same.
            stored = (one.astype(np.float32) for one in (self.normals, self.given_normals))
            layers[NORMAL_CHANGE] = angles_between(*(one.astype(np.float64) for one in stored))
        if self.uncertainty is not None:
            layers |= self.uncertainty.layers()
        return layers

    def whole_layers(self) -> dict[str, NDArray[Any]]:
        """Layers (H, W) of `materials.exr` that hold outside the mask, too, by channel."""
        layers: dict[str, NDArray[Any]] = {}
        if self.depth is not None:
            layers[DEPTH] = np.where(np.isfinite(self.depth), self.depth, np.float32(0))
        if self.segments is not None:
            layers[SEGMENT] = self.segments
        return layers
