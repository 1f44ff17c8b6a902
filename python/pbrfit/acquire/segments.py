"""Segments for pictures that come without: by SAM2 (Ravi et al. 2024), or from a file."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pbrfit.acquire import weights
from pbrfit.acquire.normals import check_reducible
from pbrfit.io import images
from pbrfit.io.resampling import at_centres
from pbrfit.scene.folder import MAX_ID
from pbrfit.values.arrays import Codes, Mask
from pbrfit.values.checks import finite

MODEL = "facebook/sam2.1-hiera-large"

SMALLEST = 0.0005
"""Share of the picture below which a mask is dropped: 22² pixels of a picture of 1000²."""

POINTS = 32
"""A side: SAM2 is asked what lies at each point of this grid."""

WHAT, SHARE = "SAM2", "a share of the picture, 0 to 1"


def segment(source: str, srgb8: Codes, **options: Any) -> tuple[NDArray[np.uint16], dict[str, Any]]:
    """Find the segments of a picture.

    The source is "sam2", with the options of `by_sam2`, or a file with ids: a grey PNG or TIFF of 8
    or 16 bits or a palette PNG, of the picture's size or larger in the same proportion. The network
    is shown `srgb8` (H, W, 3); of a file only its size matters. Returns ids: (H, W), 0 = in no
    segment; record: how they were made, as JSON. Raises InputError or OSError in one line that
    names the file or option, what was expected and what was found.
    """
    if source == "sam2":
        return by_sam2(srgb8, **options)
    path = Path(source)
    ids = images.read_ids(path)
    height, width = srgb8.shape[:2]
    check_reducible(path, ids.shape, (height, width))
    ids = at_centres(ids, (height, width))
    return ids, {"source": "file", "file": path.name, "segments": len(np.unique(ids[ids > 0]))}


def by_sam2(
    srgb8: Codes,
    *,
    model: str = MODEL,
    points: int = POINTS,
    smallest: float = SMALLEST,
    device: str = "auto",
    **thresholds: float,
) -> tuple[NDArray[np.uint16], dict[str, Any]]:
    """Segments by SAM2 through the mask generation of transformers.

    `model` is a name on the Hugging Face Hub or a local folder, `points` a side of the grid of
    points that are asked about, `smallest` as for `ids_of`, and `device` as for
    `pbrfit.acquire.weights.placement`; always in float32, for the network is small. `thresholds`
    are ``pred_iou_thresh`` and ``stability_score_thresh`` of transformers'
    `MaskGenerationPipeline`, which masks are trusted; its defaults are SAM2's. Returns ids: (H, W),
    0 = in no segment, which may be so everywhere; record: how they were made, as JSON. Raises
    InputError if a package or the weights are missing, an option cannot be used, or memory runs
    out.
    """
    finite("smallest", smallest, SHARE, 0.0, 1.0)
    weights.need("segment", "torch", "torchvision", "transformers")
    import torch
    from PIL import Image
    from transformers import AutoImageProcessor, Sam2Model, pipeline
    from transformers.utils import logging

    where = weights.placement(device, "float32", what=WHAT)
    verbosity = logging.get_verbosity()
    logging.set_verbosity_error()  # checkpoints that were made for video are warned of
    try:
        loaded = weights.load(WHAT, model, loader=Sam2Model.from_pretrained, marker="config.json")
    finally:
        logging.set_verbosity(verbosity)
    processor = weights.load(
        WHAT, model, loader=AutoImageProcessor.from_pretrained, marker="config.json"
    )
    with weights.memory_in_words(WHAT, "a smaller picture, fewer --points, --device cpu"):
        generator = pipeline(
            "mask-generation",
            model=loaded.network,
            image_processor=processor.network,
            device=torch.device(where.device),
        )
        found = generator(Image.fromarray(srgb8), points_per_crop=points, **thresholds)
    masks = [np.asarray(mask, dtype=bool) for mask in found["masks"]]
    height, width = srgb8.shape[:2]
    ids = ids_of(masks, (height, width), smallest=smallest)
    record = {
        "source": "sam2",
        "model": model,
        "revision": loaded.record["revision"],
        "points": points,
        "smallest": smallest,
        **thresholds,
        "masks": len(masks),
        "segments": int(ids.max()),
        "device": where.device,
        "packages": weights.versions("transformers", "torchvision", "torch"),
    }
    return ids, record


def ids_of(
    masks: Sequence[Mask], size: tuple[int, int], *, smallest: float = SMALLEST
) -> NDArray[np.uint16]:
    """One id map of masks that may overlap.

    Masks are laid down from the largest to the smallest, so that a smaller one lies on top: the cup
    on the table, the handle on the cup. What then shows of a mask counts: the mask of which least
    shows is taken away, and what lay below comes to light, until all that are left show enough.
    Masks are (H, W) = `size` each, in any order: equal masks in another order give the same ids.
    `smallest` is the share of the picture, 0 to 1, that must show of a mask. Returns (H, W): 1 is
    the largest mask, and so on without gaps, at most 65535; 0 = in none.
    """
    finite("smallest", smallest, SHARE, 0.0, 1.0)
    least = max(1.0, smallest * size[0] * size[1])
    # Of masks of one size the one that comes first in the picture lies below.
    kept = sorted(
        (mask for mask in masks if np.count_nonzero(mask) >= least),
        key=lambda mask: (-np.count_nonzero(mask), tuple(np.flatnonzero(mask)[:1]), mask.tobytes()),
    )[:MAX_ID]
    while True:
        ids = np.zeros(size, dtype=np.uint16)
        for i, mask in enumerate(kept):
            ids[mask] = i + 1
        shown = np.bincount(ids.ravel(), minlength=len(kept) + 1)[1 : len(kept) + 1]
        if not len(kept) or shown.min() >= least:
            return ids
        del kept[int(shown.argmin())]
