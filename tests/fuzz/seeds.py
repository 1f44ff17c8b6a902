"""Sound files to begin with: every format, in the variants that are read.

A seed is a folder of files of which one, `target`, is to be damaged. All are made here.
"""

from __future__ import annotations

import io
import json
import struct
import tempfile
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR
import tifffile
from numpy.typing import NDArray
from PIL import Image, ImageCms
from PIL.PngImagePlugin import PngInfo

from fuzz.damage import png_of
from pbrfit.io import images
from pbrfit.io.color import encode_srgb
from pbrfit.scene.scene import Scene
from pbrfit.synthetic import make_scene

_RNG = np.random.default_rng(11)
HEIGHT, WIDTH = 12, 24
"""Of the pictures; twice as wide as high, so that they are panoramas too."""


@dataclass(frozen=True)
class Seed:
    """A folder whose file `target` is damaged; `files` are its contents by relative path."""

    name: str
    target: str
    files: dict[str, bytes]

    @property
    def data(self) -> bytes:
        """Of the target."""
        return self.files[self.target]

    def damaged(self, data: bytes) -> Seed:
        """The same folder with other content of the target."""
        return replace(self, files={**self.files, self.target: data})


def _single(name: str, data: bytes, target: str | None = None) -> Seed:
    target = target or f"file.{name.split()[0]}"
    return Seed(name, target, {target: data})


def _noise(channels: int, kind: Any = np.uint8) -> NDArray[Any]:
    y, x = np.mgrid[:HEIGHT, :WIDTH] / WIDTH
    smooth = np.stack([x, y, 1 - x, 0.5 + x / 2], axis=-1)[..., :channels]
    mixed = 0.8 * smooth + 0.2 * _RNG.random(smooth.shape)
    if np.issubdtype(kind, np.integer):
        return np.asarray(mixed * np.iinfo(kind).max).astype(kind)
    return np.asarray(mixed * 3).astype(kind)


def profile() -> bytes:
    """An ICC profile of sRGB."""
    return bytes(ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes())


def _exif() -> bytes:
    exif = Image.Exif()
    exif[0x0112] = 6
    exif[0x8769] = {0xA405: 28}
    return exif.tobytes()


def _pil(image: Image.Image, form: str, **options: Any) -> bytes:
    buffer = io.BytesIO()
    image.save(buffer, form, **options)
    return buffer.getvalue()


def png() -> Iterator[Seed]:
    """PNG of all colour types, 1 to 16 bits, with profiles, EXIF and text."""
    rgb = Image.fromarray(_noise(3))
    yield _single("png rgb8", _pil(rgb, "PNG"))
    yield _single("png rgb8 icc exif", _pil(rgb, "PNG", icc_profile=profile(), exif=_exif()))
    yield _single("png rgba8", _pil(Image.fromarray(_noise(4)), "PNG"))
    yield _single("png grey8", _pil(rgb.convert("L"), "PNG"))
    yield _single("png grey alpha", _pil(rgb.convert("LA"), "PNG"))
    yield _single("png grey1", _pil(rgb.convert("1"), "PNG"))
    yield _single("png palette", _pil(rgb.quantize(13), "PNG", transparency=b"\x80\xff"))
    yield _single("png rgb16", bytes(images.encode_png(_noise(3, np.uint16), tag="srgb")))
    yield _single("png grey16", bytes(images.encode_png(_noise(1, np.uint16), tag="linear")))
    yield _single("png interlaced", interlaced(_noise(1)[..., 0]))


def interlaced(grey: NDArray[np.uint8]) -> bytes:
    """Adam7, which Pillow reads but does not write: passes made by hand."""
    passes = ((0, 0, 8, 8), (4, 0, 8, 8), (0, 4, 4, 8), (2, 0, 4, 4), (0, 2, 2, 4), (1, 0, 2, 2),
              (0, 1, 1, 2))  # fmt: skip
    rows = (b"\0" + r.tobytes() for x, y, dx, dy in passes for r in grey[y::dy, x::dx] if r.size)
    pixels = zlib.compress(b"".join(rows))
    return png_of(grey.shape[::-1], (b"IDAT", pixels), interlaced=1)


def jpeg() -> Iterator[Seed]:
    """JPEG, baseline and progressive, grey, with restarts, a profile and EXIF."""
    rgb = Image.fromarray(np.tile(_noise(3), (4, 2, 1)))
    yield _single("jpg rgb", _pil(rgb, "JPEG", quality=90))
    yield _single("jpg full colour", _pil(rgb, "JPEG", subsampling=0, icc_profile=profile()))
    yield _single("jpg progressive", _pil(rgb, "JPEG", progressive=True, exif=_exif()))
    yield _single("jpg grey", _pil(rgb.convert("L"), "JPEG"))
    yield _single("jpg restarts", _pil(rgb, "JPEG", restart_marker_blocks=2))


def tiff() -> Iterator[Seed]:
    """TIFF in strips and tiles, in the compressions and sample types that are read."""

    def written(pixels: NDArray[Any], **options: Any) -> bytes:
        buffer = io.BytesIO()
        options = {"photometric": "rgb" if pixels.shape[-1] == 3 else "minisblack", **options}
        tifffile.imwrite(buffer, pixels, **options)
        return buffer.getvalue()

    rgb = _noise(3)
    yield _single("tif rgb8", written(rgb))
    yield _single("tif rgb16", written(_noise(3, np.uint16), rowsperstrip=4))
    yield _single("tif float", written(_noise(3, np.float32)))
    yield _single("tif half", written(_noise(3, np.float16)))
    yield _single("tif grey", written(rgb[..., 0]))
    yield _single("tif tiled", written(np.tile(rgb, (2, 1, 1)), tile=(16, 16)))
    planes = np.moveaxis(rgb, -1, 0)
    yield _single("tif planar", written(planes, photometric="rgb", planarconfig="separate"))
    yield _single("tif big", written(rgb, bigtiff=True))
    image = Image.fromarray(rgb)
    for name in ("tiff_lzw", "tiff_deflate", "packbits", "jpeg"):
        info = {317: 2} if name == "tiff_lzw" else {}
        data = _pil(image, "TIFF", compression=name, tiffinfo=info)
        yield _single(f"tif {name}", data)
    exif = _pil(image, "TIFF", icc_profile=profile(), exif=_exif())
    yield _single("tif icc exif", exif)


def hdr() -> Iterator[Seed]:
    """Radiance HDR, flat and in runs."""
    rgbe = np.dstack([_noise(3), np.full((HEIGHT, WIDTH), 130, np.uint8)])
    header = f"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\nEXPOSURE=1.5\n\n-Y {HEIGHT} +X {WIDTH}\n"
    yield _single("hdr flat", header.encode() + rgbe.tobytes())
    rows = b""
    for row in rgbe:
        rows += b"\x02\x02" + struct.pack(">H", WIDTH)
        for channel in range(3):
            rows += bytes([WIDTH]) + row[:, channel].tobytes()
        rows += bytes([128 + WIDTH, 130])
    yield _single("hdr runs", header.replace("RADIANCE", "RGBE").encode() + rows)


def _exr_file(header: dict[str, Any], channels: dict[str, Any]) -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "file.exr"
        header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage} | header
        OpenEXR.File(header, channels).write(str(path))
        return path.read_bytes()


def exr() -> Iterator[Seed]:
    """EXR in all compressions and sample types, scan lines and tiles, parts and layers."""
    half, single = _noise(3, np.float16), _noise(3, np.float32)
    for name in ("NO", "RLE", "ZIPS", "ZIP", "PIZ", "PXR24", "B44", "B44A", "DWAA", "DWAB"):
        compression = getattr(OpenEXR, f"{name}_COMPRESSION")
        pixels = single if name in ("RLE", "PXR24", "DWAB") else half
        yield _single(f"exr {name}", _exr_file({"compression": compression}, {"RGB": pixels}))
    ids = _noise(1, np.uint32)[..., 0] >> 8
    layers = {"Y": half[..., 0].copy(), "id.Y": ids, "a.Y": single[..., 0].copy()}
    yield _single("exr layers", _exr_file({}, layers))
    tiles = OpenEXR.TileDescription()
    tiles.xSize = tiles.ySize = 16
    tiled = {"type": OpenEXR.tiledimage, "tiles": tiles}
    yield _single("exr tiled", _exr_file(tiled, {"RGBA": _noise(4, np.float32)}))
    yield _single("exr tiled PIZ", _exr_file(
        {**tiled, "compression": OpenEXR.PIZ_COMPRESSION}, {"RGB": half}))  # fmt: skip

    def window(x: int, y: int, width: int, height: int) -> Any:
        return np.array([x, y], np.int32), np.array([x + width - 1, y + height - 1], np.int32)

    windows = {"dataWindow": window(-3, 2, WIDTH, HEIGHT), "displayWindow": window(0, 0, 32, 16)}
    yield _single("exr windows", _exr_file(windows, {"RGB": single}))
    primaries = (0.713, 0.293, 0.165, 0.83, 0.128, 0.044, 0.32168, 0.33767)
    yield _single("exr acescg", _exr_file({"chromaticities": primaries}, {"RGB": half}))
    yield _single("exr named", _exr_file({"colorInteropID": "lin_ap1_scene"}, {"RGB": half}))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "file.exr"
        kind = {"type": OpenEXR.scanlineimage}
        parts = [
            OpenEXR.Part(dict(kind), {"RGB": single}, "beauty"),
            OpenEXR.Part(dict(kind), {"depth.Y": single[..., 0].copy()}, "depth"),
        ]
        OpenEXR.File(parts).write(str(path))
        yield _single("exr parts", path.read_bytes())


def normals() -> Iterator[Seed]:
    """Maps of normals and depth as other tools write them."""
    scene = _scene()
    x, y, z = np.moveaxis(scene.normals.astype(np.float32), -1, 0)
    sigma = np.full(x.shape, 3.0, np.float32)
    planes = {"X": x, "Y": y, "Z": z, "uncertainty.Y": sigma}
    yield _single("exr normals", _ours(planes), "normals.exr")
    yield _single("exr depth", _ours({"Z": 3 - z}), "depth.exr")
    codes = np.rint((scene.normals + 1) / 2 * 255).astype(np.uint8)
    yield _single("png normals", bytes(images.encode_png(codes, tag=None)), "normals.png")
    for name, array in (("normals", scene.normals), ("depth", 3.0 - z)):
        for kind in (np.float32, np.float64):
            buffer = io.BytesIO()
            np.save(buffer, np.asarray(array).astype(kind))
            yield _single(f"npy {name} {kind.__name__}", buffer.getvalue(), f"{name}.npy")


def _ours(channels: dict[str, NDArray[Any]], half: bool = False) -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        images.write_exr(Path(folder) / "file.exr", channels, half)
        return (Path(folder) / "file.exr").read_bytes()


def _scene() -> Scene:
    return make_scene("room", size=16, lights=3, held_out=1)


def scene_folder() -> Iterator[Seed]:
    """A scene folder with all that one may hold; each of its files once as the target."""
    scene = _scene()
    full = Scene(
        images=(scene.images / scene.images.max()).astype(np.float32),
        normals=scene.normals,
        fov=scene.fov,
        segments=scene.segments,
        lighting=None if scene.truth is None else scene.truth.lighting,
        weights=np.linspace(0.5, 1, scene.images[..., 0].size).reshape(scene.images.shape[:3]),
        normal_sigma=np.full(scene.images.shape[1:3], 3.0),
        names=scene.names,
        truth=scene.truth,
    )
    files = _files(lambda folder: full.save(folder))
    codes = np.rint(255 * encode_srgb(np.clip(full.images[0], 0, 1))).astype(np.uint8)
    files["images/photo.jpg"] = _pil(Image.fromarray(codes), "JPEG", quality=95, exif=_exif())
    files["images/scan.png"] = bytes(images.encode_png(codes, tag="srgb"))
    mask = np.full(codes.shape[:2], 255, np.uint8)
    mask[:3] = 0
    files["mask.png"] = bytes(images.encode_png(mask, tag=None))
    files["scene.toml"] = (
        f'fov = {full.fov}\ncolor_space = "linear"\nnormals = "opengl"\nnormals_frame = "camera"\n'
        "world_to_camera = [[1, 0, 0], [0, 0.8, -0.6], [0, 0.6, 0.8]]\n"
    ).encode()
    for name in ("lighting.json", "weights.exr", "truth/lighting.json"):
        del files[name]  # of three pictures, where there are five now
    for target in sorted(files):
        yield Seed(f"scene {target}", target, files)
    known = _files(lambda folder: full.save(folder))
    for target in ("lighting.json", "weights.exr", "truth/lighting.json"):
        yield Seed(f"scene {target}", target, known)


def _files(write: Callable[[Path], object]) -> dict[str, bytes]:
    """What `write` leaves in a folder."""
    with tempfile.TemporaryDirectory() as parent:
        folder = Path(parent) / "folder"
        write(folder)
        return {
            path.relative_to(folder).as_posix(): path.read_bytes()
            for path in sorted(folder.rglob("*"))
            if path.is_file()
        }


def lamps() -> Iterator[Seed]:
    """The same three lamps in every form in which they are read."""
    places = [(0.1, 0.2, 0.97), (-0.3, 0.1, 0.95), (0.0, -0.4, 0.92)]
    named = [(f"light_{i}.png", place) for i, place in enumerate(places)]
    lines = [f"{name} {x} {y} {z}" for name, (x, y, z) in named]
    table = [f"{name},{x},{y},{z}" for name, (x, y, z) in named]
    of_json: list[dict[str, Any]] = [
        {"picture": name, "direction": place, "color": [1.0, 0.9, 0.8]} for name, place in named
    ]
    of_json[0] = {"picture": "light_0.png", "position": [0.1, 0.2, 1.5]}
    texts = {
        "lights.lp": "3\n" + "\n".join(lines),
        "lights.csv": "picture,x,y,z\n" + "\n".join(table),
        "light_directions.txt": "\n".join(f"{x} {y} {z}" for x, y, z in places),
        "lights.json": json.dumps({"version": 1, "lamps": of_json}),
    }
    for target, written in texts.items():
        yield _single(target, written.encode(), target)


def result_folder() -> Iterator[Seed]:
    """A result with uncertainty and refined normals; each file that is read once as the target."""
    from pbrfit import decompose
    from pbrfit.result.refinement import Refinement

    scene = _scene()
    fit = decompose(scene, iterations=5, uncertainty=True)
    refined = replace(
        fit,
        refinement=Refinement("on", True, "asked for", {"mean_change_degrees": 1.5}),
        given_normals=fit.normals,
    )
    files = _files(refined.save)
    del files["preview.png"]  # never read
    for target in sorted(files):
        yield Seed(f"result {target}", target, files)


def prompts() -> Iterator[Seed]:
    """Catalogues of prompts."""
    from pbrfit.acquire.prompts import shipped_text

    yield _single("toml shipped", shipped_text().encode())
    small = 'preamble = "Keep."\nnegative = ""\n[[lighting]]\nname = "dusk"\ntext = "At dusk."\n'
    yield _single("toml small", small.encode())


def journal() -> Iterator[Seed]:
    """A journal of a run of `pbrfit generate`: entries, one without its JSON, what it was about."""
    about = {"photo": {"sha256": "0" * 64, "size": [24, 12], "pixels_sha256": "1" * 64},
             "settings": {"model": "some", "steps": 4}}  # fmt: skip
    request = {"name": "dusk", "prompt": "At dusk.", "negative": "", "seed": 1}
    record = {"seconds": 1.5, "model": "some"}
    told = PngInfo()
    content = {"about": about, "request": request, "record": record}
    told.add_itxt("pbrfit", json.dumps(content), zip=True)
    picture = _pil(Image.fromarray(_noise(3)), "PNG", pnginfo=told)
    entry = {"about": about, "request": request, "refused": "", "record": record, "sha256": None}
    files = {
        "run.json": json.dumps(about, indent=1).encode(),
        "dusk-1.json": json.dumps(entry, indent=1).encode(),
        "dusk-1.png": picture,
        "orphan-2.png": picture,
    }
    for target in ("run.json", "dusk-1.json", "orphan-2.png"):
        yield Seed(f"journal {target}", target, files)


def records() -> Iterator[Seed]:
    """A record of a suite's task."""
    from fuzz.task import TASK, write_record

    yield Seed("record", "records/task.json", _files(lambda folder: write_record(folder, TASK)))
