"""Pictures by FLUX.2 Klein, a diffusion network that edits photographs, on this machine.

The photo is given as the reference that the prompt edits. Guidance g and a negative prompt work
together: in each step the network predicts once for the prompt and once for the negative, v₊ and
v₋, and v₋ + g (v₊ − v₋) is taken (Ho and Salimans 2022). Guidance 5 with negatives is what the
paper found to keep geometry. Networks distilled to few steps have one fixed guidance in their
weights and know no v₋, so with them neither can be asked for.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import KW_ONLY, dataclass
from functools import cached_property, partial
from typing import Any

import numpy as np
from PIL import Image

from pbrfit._core import InputError
from pbrfit.acquire import padding, weights
from pbrfit.acquire.generators import Generated, Request, requests_from
from pbrfit.acquire.photo import Photo
from pbrfit.acquire.prompts import Catalogue
from pbrfit.values.checks import finite

MODEL = "black-forest-labs/FLUX.2-klein-base-4B"
"""The base checkpoint under Apache-2.0; FLUX.2-klein-4B is distilled from it."""

KIND = "FLUX.2 Klein"
PROMPT_TOKENS = 512
"""What the pipeline reads of a prompt; it would cut off the rest without a word."""


@dataclass(eq=False)
class Flux2Klein:
    """Pictures by diffusers' `Flux2KleinPipeline`; the network is loaded at the first one.

    Raises InputError if diffusers is missing, or an option is none there is.
    """

    _: KW_ONLY
    model: str = MODEL
    """Name on the Hugging Face Hub, or a local folder as `save_pretrained` leaves it."""
    guidance: float = 5.0
    """g above; at 1 or less there is no v₋, and so no negative prompt."""
    steps: int = 50
    """Of the sampler."""
    device: str = "auto"
    dtype: str = "auto"
    offload: str = "none"
    """As `pbrfit.acquire.weights.placement` takes them."""
    quiet: bool = False
    """No bar over the steps of a picture; there is one only where stderr is a terminal."""

    name = "flux2-klein"
    retries = True

    def __post_init__(self) -> None:
        weights.need("diffusion", "torch", "diffusers", "transformers", "accelerate")
        finite("guidance", self.guidance, "a number of 0 or more", 0.0)
        if self.steps < 1:
            raise InputError(f"steps: expected at least 1, found {self.steps}")

    def settings(self) -> dict[str, Any]:
        """What decides about the pictures. The device does not: seeds are drawn on the processor.

        Devices differ in rounding, and so in details; records say where each picture was made.
        """
        names = ("model", "guidance", "steps", "dtype")
        return {name: getattr(self, name) for name in names}

    def check(self) -> None:
        """Look for the device and the network, and what kind it is; reads no weights.

        Raises InputError if one of them is not there, or the network is distilled and guidance is
        asked for.
        """
        _ = self._placement
        self._load(self._check_kind)

    def plan(self, catalogue: Catalogue, count: int, seed: int) -> list[Request]:
        """The first `count` lightings of the catalogue.

        Raises InputError if `count` is out of range, or there are negatives and no guidance to use
        them.
        """
        self._check_guidance(catalogue.negative)
        return requests_from(catalogue, count, seed)

    def generate(self, photo: Photo, request: Request) -> Generated:
        """Make one picture; the same seed on the same machine gives the same bits.

        Raises InputError if the network cannot be had, is distilled and cannot do what was asked
        for, or runs out of memory; or the prompt is too long.
        """
        self._check_guidance(request.negative)
        pipeline, made = self._loaded.network, self._loaded.record
        import torch

        frame = padding.frame(photo.size, padding.FLUX2_KLEIN)
        for text in (request.prompt, request.negative):
            self._check_length(request.name, text)
        began = time.perf_counter()
        with weights.memory_in_words(f"{KIND}, picture {request.name}"), torch.no_grad():
            options = {}
            if self.guidance > 1:
                embedded = pipeline.encode_prompt(
                    prompt=request.negative, max_sequence_length=PROMPT_TOKENS
                )
                options["negative_prompt_embeds"] = embedded[0]
            output = pipeline(
                image=Image.fromarray(frame.to_model(photo.srgb8())),
                prompt=request.prompt,
                height=frame.padded[0],
                width=frame.padded[1],
                num_inference_steps=self.steps,
                guidance_scale=self.guidance,
                # On the processor, where a seed means the same noise on every machine.
                generator=torch.Generator("cpu").manual_seed(request.seed),
                max_sequence_length=PROMPT_TOKENS,
                output_type="np",
                **options,
            )
        if not np.isfinite(output.images[0]).all():
            raise InputError(
                f"{KIND}: expected finite pixels, found NaN, as {made['dtype']} gives where it "
                "overflows; --dtype bfloat16 or float32 does not"
            )
        return Generated(
            pixels=frame.from_model(np.rint(255 * output.images[0]).astype(np.uint8)),
            record={
                **made,
                "guidance": self.guidance,
                "steps": self.steps,
                "seed": request.seed,
                "prompt": request.prompt,
                "negative": request.negative,
                "network_size": list(frame.padded),
                "scaled_size": list(frame.scaled),
                "seconds": round(time.perf_counter() - began, 3),
            },
        )

    @cached_property
    def _loaded(self) -> weights.Loaded:
        """The pipeline on its device, and how pictures are made by it."""
        from diffusers import Flux2KleinPipeline

        self.check()  # the small file first: a wrong choice shows before gigabytes are read
        where = self._placement
        loaded = self._load(partial(Flux2KleinPipeline.from_pretrained, dtype=where.torch_dtype))
        pipeline = loaded.network
        pipeline.set_progress_bar_config(disable=True if self.quiet else None, leave=False)
        weights.place(pipeline, where, what=f"{KIND} {self.model}")
        record = {
            "generator": self.name,
            **loaded.record,
            "device": where.device,
            "dtype": where.dtype,
            "offload": where.offload,
            "versions": weights.versions("torch", "diffusers", "transformers"),
        }
        return weights.Loaded(pipeline, record)

    def _load(self, loader: Callable[..., Any]) -> weights.Loaded:
        return weights.load(KIND, self.model, loader=loader, marker="model_index.json")

    @cached_property
    def _placement(self) -> weights.Placement:
        return weights.placement(self.device, self.dtype, self.offload, what=KIND)

    def _check_kind(self, name: str, **options: Any) -> None:
        """Read what a checkpoint says about itself, a small file."""
        from diffusers import Flux2KleinPipeline

        config = Flux2KleinPipeline.load_config(name, **options)
        kind = config.get("_class_name")
        if kind != "Flux2KleinPipeline":
            raise InputError(f"{name}: expected a Flux2KleinPipeline, found a {kind}")
        if config.get("is_distilled", False) and self.guidance != 1:
            raise InputError(
                f"{self.model}: expected a base checkpoint for guidance {self.guidance:g}, found a "
                f"distilled one, which ignores it: take {MODEL}, or --guidance 1 --negative ''"
            )

    def _check_guidance(self, negative: str) -> None:
        if negative and self.guidance <= 1:
            raise InputError(
                f"negative prompts: expected guidance above 1, which they work through, found "
                f"{self.guidance:g}; --negative '' leaves them out"
            )

    def _check_length(self, name: str, text: str) -> None:
        tokenizer = self._loaded.network.tokenizer
        whole = tokenizer.apply_chat_template(
            [{"role": "user", "content": text}],
            tokenize=False,
            add_generation_prompt=True,
            enable_thinking=False,
        )
        tokens = len(tokenizer(whole)["input_ids"])
        if tokens > PROMPT_TOKENS:
            raise InputError(
                f"prompt {name}: expected at most {PROMPT_TOKENS} tokens, of which the network "
                f"reads no more, found {tokens}"
            )
