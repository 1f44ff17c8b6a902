"""A FLUX.2 Klein pipeline of 0.6 MB with random weights, saved as the real one is.

Every part is of the class of the real checkpoint and has its shape, only narrow: four-level
autoencoder, Qwen3 with the 28 layers of which the pipeline reads three, double- and single-stream
blocks. What it paints is noise, but it depends on the photo, both prompts and the seed.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from pbrfit.acquire.prompts import read_prompts

SPECIAL = ["<|endoftext|>", "<|im_start|>", "<|im_end|>"]

CHAT = (
    "{% for message in messages %}<|im_start|>{{ message['role'] }}\n{{ message['content'] }}"
    "<|im_end|>\n{% endfor %}{% if add_generation_prompt %}<|im_start|>assistant\n{% endif %}"
)


def save_tiny_flux2_klein(folder: Path, *, distilled: bool = False, seed: int = 0) -> Path:
    """Make it and `save_pretrained` it in `folder`."""
    import torch
    from diffusers import (
        AutoencoderKLFlux2,
        FlowMatchEulerDiscreteScheduler,
        Flux2KleinPipeline,
        Flux2Transformer2DModel,
    )
    from transformers import Qwen3Config, Qwen3ForCausalLM

    torch.manual_seed(seed)
    transformer = Flux2Transformer2DModel(
        in_channels=16,
        num_layers=1,
        num_single_layers=1,
        attention_head_dim=16,
        num_attention_heads=2,
        joint_attention_dim=48,  # three layers of 16
        timestep_guidance_channels=16,
        axes_dims_rope=(4, 4, 4, 4),
        guidance_embeds=False,
    )
    with torch.no_grad():  # as it is initialised, what goes in hardly shows in what comes out
        for parameter in transformer.parameters():
            parameter *= 2
    autoencoder = AutoencoderKLFlux2(
        block_out_channels=(4, 4, 4, 4), layers_per_block=1, latent_channels=4, norm_num_groups=1
    )
    tokenizer = _tokenizer(folder / "tokenizer")
    text_encoder = Qwen3ForCausalLM(
        Qwen3Config(
            vocab_size=len(tokenizer),
            hidden_size=16,
            intermediate_size=16,
            num_hidden_layers=28,
            num_attention_heads=2,
            num_key_value_heads=1,
            head_dim=8,
            max_position_embeddings=1024,
        )
    )
    pipeline = Flux2KleinPipeline(
        scheduler=FlowMatchEulerDiscreteScheduler(use_dynamic_shifting=True),
        vae=autoencoder.eval(),
        text_encoder=text_encoder.eval(),
        tokenizer=tokenizer,
        transformer=transformer.eval(),
        is_distilled=distilled,
    )
    checkpoint = folder / "checkpoint"
    pipeline.save_pretrained(checkpoint)
    return checkpoint


def _tokenizer(folder: Path) -> Any:
    """Qwen2's tokenizer, byte pairs learnt from the prompts that ship: about a word each."""
    from tokenizers import ByteLevelBPETokenizer
    from transformers import Qwen2TokenizerFast

    catalogue = read_prompts()
    texts = [catalogue.negative, *(catalogue.full(prompt) for prompt in catalogue.lighting)]
    learnt = ByteLevelBPETokenizer()
    learnt.train_from_iterator(texts, vocab_size=600, special_tokens=SPECIAL, show_progress=False)
    folder.mkdir(parents=True)
    learnt.save_model(str(folder))
    tokenizer = Qwen2TokenizerFast(
        vocab=str(folder / "vocab.json"),
        merges=str(folder / "merges.txt"),
        pad_token=SPECIAL[0],
        additional_special_tokens=SPECIAL[1:],
    )
    tokenizer.chat_template = CHAT
    return tokenizer
