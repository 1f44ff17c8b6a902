"""Networks for maps with random weights, of 1 to 4 MB, saved as the real ones are.

Every part is of the class of the real checkpoint and has its shape, only narrow. What they answer
is noise, but it depends on the picture and the seed.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

TARGETS = {
    "target_names": ["albedo", "material"],
    "albedo": {"prediction_space": "srgb", "up_to_scale": False},
    "material": {
        "prediction_space": "stack",
        "sub_target_names": ["roughness", "metallicity", None],
        "up_to_scale": False,
    },
    "roughness": {"prediction_space": "linear", "up_to_scale": False},
    "metallicity": {"prediction_space": "linear", "up_to_scale": False},
}
"""What prs-eth/marigold-iid-appearance-v1-1 says of itself."""


def picture(height: int, width: int, seed: int = 0) -> NDArray[np.uint8]:
    """Smooth colours."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[:height, :width] / max(height, width)
    waves = [np.sin(a * x + b * y + c) for a, b, c in rng.uniform(-9, 9, (3, 3))]
    return np.rint(127.5 + 127 * np.stack(waves, axis=-1)).astype(np.uint8)


def save_tiny_marigold_normals(folder: Path) -> Path:
    """`MarigoldNormalsPipeline`."""
    parts = _stable_diffusion(in_channels=8, out_channels=4, vocabulary=folder / "words")
    return _save_marigold(folder, "Normals", parts, use_full_z_range=True)


def save_tiny_marigold_depth(folder: Path) -> Path:
    """`MarigoldDepthPipeline`."""
    parts = _stable_diffusion(in_channels=8, out_channels=4, vocabulary=folder / "words")
    return _save_marigold(folder, "Depth", parts, scale_invariant=True, shift_invariant=True)


def save_tiny_depth_anything(folder: Path, *, metric: bool) -> Path:
    """`DepthAnythingForDepthEstimation` with a Dinov2 backbone, for pictures of 70 × 70."""
    import torch
    from transformers import (
        DepthAnythingConfig,
        DepthAnythingForDepthEstimation,
        Dinov2Config,
        DPTImageProcessor,
    )

    torch.manual_seed(0)
    backbone = Dinov2Config(
        image_size=70,
        patch_size=14,
        num_hidden_layers=4,
        hidden_size=32,
        num_attention_heads=4,
        out_features=["stage1", "stage2", "stage3", "stage4"],
        apply_layernorm=True,
        reshape_hidden_states=False,
    )
    config = DepthAnythingConfig(
        backbone_config=backbone,
        patch_size=14,
        reassemble_hidden_size=32,
        reassemble_factors=[4, 2, 1, 0.5],
        neck_hidden_sizes=[8, 8, 16, 16],
        fusion_hidden_size=16,
        head_hidden_size=8,
        depth_estimation_type="metric" if metric else "relative",
        max_depth=20 if metric else 1,
    )
    DepthAnythingForDepthEstimation(config).save_pretrained(folder)
    DPTImageProcessor(
        size={"height": 70, "width": 70},
        keep_aspect_ratio=True,
        ensure_multiple_of=14,
        do_pad=False,
    ).save_pretrained(folder)
    return folder


def save_tiny_marigold_iid(folder: Path, properties: Any = TARGETS) -> Path:
    """`MarigoldIntrinsicsPipeline` with two targets."""
    parts = _stable_diffusion(in_channels=12, out_channels=8, vocabulary=folder / "words")
    return _save_marigold(folder, "Intrinsics", parts, target_properties=properties)


def _save_marigold(folder: Path, kind: str, parts: dict[str, Any], **options: Any) -> Path:
    """A Marigold pipeline that predicts this kind of map in two steps, at 64 pixels."""
    import diffusers

    pipeline = getattr(diffusers, f"Marigold{kind}Pipeline")(
        **parts,
        prediction_type=kind.lower(),
        default_denoising_steps=2,
        default_processing_resolution=64,
        **options,
    )
    pipeline.save_pretrained(folder / "checkpoint")
    return folder / "checkpoint"


def save_tiny_rgbx(folder: Path) -> Path:
    """The folder that zheng95z/rgb-to-x is: parts beside each other, a pipeline nobody has."""
    parts = _stable_diffusion(in_channels=8, out_channels=4, vocabulary=folder / "words")
    for name, part in parts.items():
        part.save_pretrained(folder / "checkpoint" / name)
    index = {"_class_name": "StableDiffusionAOVMatEstPipeline"}
    (folder / "checkpoint" / "model_index.json").write_text(json.dumps(index))
    return folder / "checkpoint"


def save_tiny_sam2(folder: Path) -> Path:
    """`Sam2Model` for pictures of 128 × 128."""
    import torch
    from transformers import (
        Sam2Config,
        Sam2HieraDetConfig,
        Sam2ImageProcessor,
        Sam2MaskDecoderConfig,
        Sam2Model,
        Sam2PromptEncoderConfig,
        Sam2VisionConfig,
    )

    torch.manual_seed(0)
    size, widths = 128, [12, 24, 48, 96]
    backbone = Sam2HieraDetConfig(
        hidden_size=widths[0],
        image_size=[size, size],
        blocks_per_stage=[1, 1, 2, 1],
        embed_dim_per_stage=widths,
        num_attention_heads_per_stage=[1, 1, 2, 4],
        window_size_per_stage=[8, 4, 4, 4],
        global_attention_blocks=[3],
    )
    vision = Sam2VisionConfig(
        backbone_config=backbone,
        backbone_channel_list=widths[::-1],
        backbone_feature_sizes=[[size // s, size // s] for s in (4, 8, 16)],
        fpn_hidden_size=32,
    )
    model = Sam2Model(
        Sam2Config(
            vision_config=vision,
            prompt_encoder_config=Sam2PromptEncoderConfig(hidden_size=32, image_size=size),
            mask_decoder_config=Sam2MaskDecoderConfig(
                hidden_size=32, mlp_dim=64, num_attention_heads=2, iou_head_hidden_dim=32
            ),
        )
    )
    model.save_pretrained(folder)
    processor = Sam2ImageProcessor(
        size={"height": size, "width": size}, mask_size={"height": size // 4, "width": size // 4}
    )
    processor.save_pretrained(folder)
    return folder


def _stable_diffusion(*, in_channels: int, out_channels: int, vocabulary: Path) -> dict[str, Any]:
    """Parts of a Stable Diffusion 2 that predicts v."""
    import torch
    from diffusers import AutoencoderKL, DDIMScheduler, UNet2DConditionModel
    from transformers import CLIPTextConfig, CLIPTextModel, CLIPTokenizer

    torch.manual_seed(0)
    tokenizer = _tokenizer(CLIPTokenizer, vocabulary)
    text_encoder = CLIPTextModel(
        CLIPTextConfig(
            vocab_size=len(tokenizer),
            hidden_size=32,
            intermediate_size=37,
            num_hidden_layers=2,
            num_attention_heads=4,
            max_position_embeddings=77,
            bos_token_id=tokenizer.bos_token_id,
            eos_token_id=tokenizer.eos_token_id,
            pad_token_id=tokenizer.pad_token_id,
        )
    )
    unet = UNet2DConditionModel(
        block_out_channels=(32, 64),
        layers_per_block=1,
        sample_size=8,
        in_channels=in_channels,
        out_channels=out_channels,
        down_block_types=("DownBlock2D", "CrossAttnDownBlock2D"),
        up_block_types=("CrossAttnUpBlock2D", "UpBlock2D"),
        cross_attention_dim=32,
        attention_head_dim=8,
        norm_num_groups=8,
    )
    autoencoder = AutoencoderKL(
        block_out_channels=(8, 8, 8, 8),
        down_block_types=("DownEncoderBlock2D",) * 4,
        up_block_types=("UpDecoderBlock2D",) * 4,
        latent_channels=4,
        norm_num_groups=4,
    )
    with torch.no_grad():  # as it is initialised, what goes in hardly shows in what comes out
        for parameter in autoencoder.parameters():
            parameter *= 2
    return {
        "unet": unet.eval(),
        "vae": autoencoder.eval(),
        "scheduler": DDIMScheduler(
            beta_start=0.00085,
            beta_end=0.012,
            beta_schedule="scaled_linear",
            clip_sample=False,
            prediction_type="v_prediction",
            rescale_betas_zero_snr=True,
            timestep_spacing="trailing",
        ),
        "text_encoder": text_encoder.eval(),
        "tokenizer": tokenizer,
    }


def _tokenizer(kind: Any, folder: Path) -> Any:
    """CLIP's, of single letters."""
    letters = [chr(code) for code in range(33, 127)]
    words = ["<|startoftext|>", "<|endoftext|>", *letters, *(f"{one}</w>" for one in letters)]
    folder.mkdir(parents=True, exist_ok=True)
    vocabulary = {word: i for i, word in enumerate(words)}
    (folder / "vocab.json").write_text(json.dumps(vocabulary))
    (folder / "merges.txt").write_text("#version: 0.2\n")
    return kind(str(folder / "vocab.json"), str(folder / "merges.txt"), model_max_length=77)
