"""RGB-X (Zeng et al., SIGGRAPH 2024): one map of one picture for each prompt.

The published checkpoint is a Stable Diffusion 2 whose U-Net sees eight channels, the noisy map's
four and the picture's four, and predicts v. diffusers has no pipeline for it, so the sampling is
here, after what the authors' own does (github.com/zheng95z/rgbx, commit 168f2d7):

- the picture goes in linear, in [-1, 1], its latent the mode of the encoder's Gaussian, scaled;
- prompts "Albedo (diffuse basecolor)", "Roughness", "Metallicness", without guidance;
- DDIM with the betas rescaled to zero terminal SNR and trailing steps, 50 of them;
- the longer side is 1000 pixels, both sides multiples of 8;
- what comes out is linear (their gamma is for looking at it), scalars are its first channel.

The authors say that the published checkpoint's metallicity differs from that of the paper.
"""

from __future__ import annotations

from functools import partial
from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pbrfit.acquire import weights
from pbrfit.acquire.padding import resized
from pbrfit.io.color import decode_srgb
from pbrfit.model.materials import Materials

MODEL = "zheng95z/rgb-to-x"

PROMPTS = {
    "albedo": "Albedo (diffuse basecolor)",
    "roughness": "Roughness",
    "metallic": "Metallicness",
}

STEPS = 50
WHAT = "RGB-X"


class RgbToX:
    """The networks, loaded: `model`, `device` and errors are as of `MarigoldIID`.

    `longer_side`, in pixels, is that of the picture that the network sees.
    """

    def __init__(
        self,
        model: str = MODEL,
        *,
        device: str = "auto",
        longer_side: int = 1000,
    ) -> None:
        weights.need("diffusion", "torch", "diffusers", "transformers")
        where = weights.placement(device, "auto", what=WHAT, half="float16")
        loader = partial(_load, where.torch_dtype)
        self._parts = weights.load(WHAT, model, loader=loader, marker="model_index.json").network
        self._device, self._dtype = where.device, where.torch_dtype
        self._longer_side = longer_side
        with weights.memory_in_words(WHAT, "another --device"):
            for network in (self._parts.text_encoder, self._parts.autoencoder, self._parts.unet):
                network.to(self._device).eval()

    def maps(self, srgb8: NDArray[np.uint8], *, seed: int, steps: int | None) -> Materials:
        """Maps of a picture (H, W, 3); `seed` of the noise, `steps` of the sampler (None = 50)."""
        height, width = srgb8.shape[:2]
        factor = self._longer_side / max(height, width)
        block = 2 ** (len(self._parts.autoencoder.config.block_out_channels) - 1)
        size = tuple(max(block, round(s * factor / block) * block) for s in (height, width))
        linear = resized(decode_srgb(srgb8 / 255.0), (size[0], size[1]))
        with weights.memory_in_words(WHAT, "another --device"):
            found = {
                name: resized(self._map(linear, prompt, seed, steps or STEPS), (height, width))
                for name, prompt in PROMPTS.items()
            }
        return Materials(found["albedo"], found["roughness"][..., 0], found["metallic"][..., 0])

    def _map(
        self, linear: NDArray[np.float32], prompt: str, seed: int, steps: int
    ) -> NDArray[np.float32]:
        """(H, W, 3) in [0, 1]: what the network answers to one prompt."""
        import torch

        parts = self._parts
        scale = parts.autoencoder.config.scaling_factor
        with torch.no_grad():
            words = parts.tokenizer(
                prompt,
                padding="max_length",
                max_length=parts.tokenizer.model_max_length,
                truncation=True,
                return_tensors="pt",
            )
            text = parts.text_encoder(words.input_ids.to(self._device))[0]
            picture = torch.from_numpy(2 * linear - 1).permute(2, 0, 1)[None]
            picture = picture.to(self._device, self._dtype)
            seen = parts.autoencoder.encode(picture).latent_dist.mode() * scale
            # On the processor, so that a seed means the same everywhere.
            noise = torch.randn(seen.shape, generator=torch.Generator().manual_seed(seed))
            # In float32 whatever the networks compute in: the steps add up.
            latent = noise.to(self._device) * parts.scheduler.init_noise_sigma
            parts.scheduler.set_timesteps(steps, device=self._device)
            for time in parts.scheduler.timesteps:
                noisy = parts.scheduler.scale_model_input(latent, time)
                predicted = parts.unet(
                    torch.cat([noisy.to(seen), seen], dim=1), time, encoder_hidden_states=text
                ).sample
                latent = parts.scheduler.step(predicted.float(), time, latent).prev_sample
            decoded = parts.autoencoder.decode((latent / scale).to(seen)).sample[0]
        shown = (decoded.float() / 2 + 0.5).clamp(0, 1)
        return np.ascontiguousarray(shown.permute(1, 2, 0).cpu().numpy())


def _load(dtype: Any, model: str, **options: Any) -> SimpleNamespace:
    """Parts of the checkpoint, each as its library loads it."""
    from diffusers import AutoencoderKL, DDIMScheduler, UNet2DConditionModel
    from transformers import CLIPTextModel, CLIPTokenizer

    def part(kind: Any, subfolder: str, **more: Any) -> Any:
        return kind.from_pretrained(model, subfolder=subfolder, **options, **more)

    return SimpleNamespace(
        tokenizer=part(CLIPTokenizer, "tokenizer"),
        text_encoder=part(CLIPTextModel, "text_encoder", dtype=dtype),
        autoencoder=part(AutoencoderKL, "vae", dtype=dtype),
        unet=part(UNet2DConditionModel, "unet", dtype=dtype),
        scheduler=part(
            DDIMScheduler, "scheduler", rescale_betas_zero_snr=True, timestep_spacing="trailing"
        ),
    )
