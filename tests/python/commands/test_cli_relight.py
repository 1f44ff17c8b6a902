"""`pbrfit relight`: what it writes and says, and what it refuses."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np
import OpenEXR
import pytest
from numpy.typing import NDArray
from PIL import Image, ImageSequence

from command_runs import Ran, done, ran, refused
from pbrfit import DirectionalLight, Environment, Result, relight
from pbrfit.display import tone
from pbrfit.display.tone import ToneMap
from pbrfit.io import images
from pbrfit.model.lamps import Lamps
from pbrfit.model.lighting import Lighting, rotated
from pbrfit.result.relighting import specular_enhanced
from relit import ball, fitted, shaded_ball
from scene_files import Argument, known, run, write_exr, write_folder, write_hdr
from under_lamps import ball_under_lamps

Array = NDArray[np.floating[Any]]


@pytest.fixture(scope="module")
def folders(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the result folders `room` and `ball`, the latter with a mask."""
    folder = tmp_path_factory.mktemp("results")
    made = fitted()
    made.save(folder / "room")
    ball(made).save(folder / "ball")
    return folder


@pytest.fixture(scope="module")
def lamps(folders: Path) -> Path:
    """A ball with far lamps."""
    ball_under_lamps().save(folders / "lamps")
    return folders / "lamps"


@pytest.fixture(scope="module")
def deep(folders: Path) -> Path:
    """A ball on a floor, with depth."""
    shaded_ball().save(folders / "deep")
    return folders / "deep"


@pytest.fixture(scope="module")
def room(folders: Path) -> Path:
    return folders / "room"


def exr(path: Path) -> Array:
    return images.read_picture(path).pixels


def sky(height: int = 16) -> Array:
    """A panorama with a lamp right of the centre over a dim sky."""
    pixels = np.full((height, 2 * height, 3), 0.1)
    pixels[height // 2 - 1 : height // 2 + 1, 3 * height // 2 - 1 : 3 * height // 2 + 1] = 40.0
    return pixels


@pytest.fixture
def pano(tmp_path: Path) -> Path:
    write_exr(tmp_path / "pano.exr", sky())
    return tmp_path / "pano.exr"


def said(text: str) -> dict[str, str]:
    """Topic to sentence of what was printed."""
    return {line[:12].strip(): line[12:] for line in text.splitlines()}


def written(result: Path, tmp_path: Path, *arguments: Argument) -> Array:
    """The pixels that the command writes; it says nothing."""
    out = tmp_path / "out.exr"
    command = ("relight", result, *arguments, "--out", out, "--overwrite", "--quiet")
    assert ran(*command) == Ran(0, "", "")
    return exr(out)


def test_a_hard_light_as_linear_exr(room: Path, tmp_path: Path) -> None:
    out = tmp_path / "new" / "out.exr"
    facts = said(done("relight", room, "--light", "30,40", "--color", "1,0.5,2", "--out", out))
    expected = relight(Result.load(room), DirectionalLight(30, 40, (1, 0.5, 2)))
    np.testing.assert_array_equal(exr(out), expected.astype(np.float32))
    assert facts["light"] == "hard, from azimuth 30, elevation 40, color 1, 0.5, 2"
    assert facts["written"] == f"{out}: 16 × 16, linear Rec.709, float32"
    assert [path.name for path in out.parent.iterdir()] == ["out.exr"]
    header = OpenEXR.File(str(out)).header()
    np.testing.assert_allclose(np.ravel(header["chromaticities"])[:2], [0.64, 0.33], rtol=1e-6)


def test_surroundings_throw_shadows_unless_told_otherwise(deep: Path, tmp_path: Path) -> None:
    loaded = Result.load(deep)
    found = {}
    for flags in ((), ("--no-shadows",)):
        out = tmp_path / f"{len(flags)}.exr"
        text = done("relight", deep, "--light", "-80,45", *flags, "--out", out)
        assert ("triangles" in said(text)["shadows"]) == (not flags)
        found[flags] = exr(out)
        expected = relight(loaded, DirectionalLight(-80, 45), shadows=not flags)
        shown = found[flags][..., :3][loaded.mask]
        np.testing.assert_allclose(shown, expected[loaded.mask], rtol=1e-6, atol=1e-7)
    assert found[()].mean() < found["--no-shadows",].mean()


def test_the_command_lights_as_the_library_does(room: Path, pano: Path, tmp_path: Path) -> None:
    result, light = Result.load(room), Environment(sky())
    one, hdr = tmp_path / "one.json", tmp_path / "pano.hdr"
    Lighting(("one",), result.lighting[:1]).save(one)
    write_hdr(hdr, sky())
    named = ("--sh", room / "lighting.json", "--picture", "light_01")
    arguments: tuple[Argument, ...]
    expected: Any
    for arguments, expected, error in (
        (("--env", pano, "--rotate", "-90"), Environment(sky(), -90), 1e-6),
        (("--env", hdr), light, 1e-2),
        (named, result.lighting[1], 1e-7),
        ((*named, "--rotate", 90), rotated(result.lighting[1], 90), 1e-7),
        (("--sh", one), result.lighting[0], 1e-7),
        (("--light", "-.5,-1e1"), DirectionalLight(-0.5, -10), 1e-7),
        (("--light=-40,30",), DirectionalLight(-40, 30), 1e-7),
        (("--light", " -40, 30"), DirectionalLight(-40, 30), 1e-7),
        (("--light", "30,40", "--softness", 12), DirectionalLight(30, 40, softness=12), 1e-7),
    ):
        radiance = relight(result, expected)
        found = written(room, tmp_path, *arguments)
        np.testing.assert_allclose(found, radiance, rtol=0, atol=error * np.abs(radiance).max())


def test_a_turntable_s_exposure_is_that_of_its_brightest_quarter(
    folders: Path, pano: Path, tmp_path: Path
) -> None:
    out = tmp_path / "out.webp"
    facts = said(done("relight", folders / "ball", "--env", pano, "--turntable", 8, "--out", out))
    result = Result.load(folders / "ball")
    light = Environment.read(pano)
    whites = [np.nanpercentile(relight(result, light.turned(90 * k)), 98) for k in range(4)]
    exposure = round(-np.log2(max(whites)), 1)
    assert facts["shown"].startswith(f"exposure {exposure:g} EV (by itself)")


@pytest.mark.parametrize(
    ("exposure", "tone_map"), [(0.0, "none"), (-1.5, "none"), (2.0, "neutral"), (None, "neutral")]
)
def test_png_is_encoded_for_a_screen_and_says_so(
    room: Path, tmp_path: Path, exposure: float | None, tone_map: ToneMap
) -> None:
    """By default at an exposure that is found."""
    out = tmp_path / "out.png"
    asked = () if exposure is None else ("--exposure", exposure, "--tone-map", tone_map)
    light = ("--light", "20,30", "--color", "9,9,9")
    facts = said(done("relight", room, *light, *asked, "--out", out))
    radiance = relight(Result.load(room), DirectionalLight(20, 30, (9, 9, 9)))
    found = round(-float(np.log2(np.percentile(radiance, 98))), 1)
    ev = found if exposure is None else exposure
    shown = np.rint(255 * tone.encoded(radiance, ev, tone_map))
    with Image.open(out) as picture:
        assert picture.mode == "RGB"
        assert "srgb" in picture.info
        np.testing.assert_array_equal(np.asarray(picture), shown)
    clipped = 100 * np.mean((shown == 255).any(axis=-1))
    assert facts["shown"].startswith(
        f"exposure {ev:g} EV{' (by itself)' * (exposure is None)}, tone map {tone_map}; "
        f"{clipped:.1f} % of the pixels are clipped"
    )
    assert facts["written"] == f"{out}: 16 × 16, sRGB, 8 bits"


def test_another_exposure_is_suggested_where_little_can_be_seen(room: Path, tmp_path: Path) -> None:
    def hint(*arguments: str | float) -> str:
        out = ("--out", tmp_path / "out.png", "--overwrite")
        return said(done("relight", room, *arguments, *out)).get("hint", "")

    light = ("--light", "0,20", "--color")
    assert hint(*light, "1,1,1") == ""
    assert hint(*light, "1e-6,1e-6,1e-6") == hint(*light, "1e9,1e9,1e9") == ""  # by itself
    little = "little can be seen; without --exposure, one is chosen"
    assert hint(*light, "1e-6,1e-6,1e-6", "--exposure", 0) == little
    assert hint(*light, "1e9,1e9,1e9", "--exposure", 0, "--tone-map", "none") == little
    assert hint(*light, "0,0,0") == "no light reaches the surfaces that the camera sees"


def test_outside_the_mask_is_transparent(folders: Path, tmp_path: Path) -> None:
    mask = Result.load(folders / "ball").mask
    light = ("--light", "20,30", "--quiet")
    assert run("relight", folders / "ball", *light, "--out", tmp_path / "out.exr") == 0
    channels = images.read_channels(tmp_path / "out.exr")
    assert set(channels) == {"R", "G", "B", "A"}
    np.testing.assert_array_equal(channels["A"], mask)
    for name in "RGB":
        assert np.isfinite(channels[name]).all()
        assert (channels[name][~mask] == 0).all()
    for name in ("out.png", "out.webp", "out.gif", "turn.png"):
        turntable = () if name == "out.png" else ("--turntable", 2)
        assert run("relight", folders / "ball", *light, *turntable, "--out", tmp_path / name) == 0
        with Image.open(tmp_path / name) as picture:
            for frame in ImageSequence.Iterator(picture):
                rgba = np.asarray(frame.convert("RGBA"))
                np.testing.assert_array_equal(rgba[..., 3], 255 * mask)
                if name.endswith(".png"):
                    assert (rgba[~mask] == 0).all()


def test_frames_in_a_folder(room: Path, tmp_path: Path) -> None:
    out = tmp_path / "frames"
    turn = ("relight", room, "--light", "-30,20", "--out", out, "--turntable")
    facts = said(done(*turn, 5))
    assert sorted(path.name for path in out.iterdir()) == [f"frame_000{k}.exr" for k in range(5)]
    result = Result.load(room)
    for k in range(5):
        expected = relight(result, DirectionalLight(-30 + 360 * k / 5, 20))
        np.testing.assert_array_equal(exr(out / f"frame_000{k}.exr"), expected.astype(np.float32))
    assert facts["written"].startswith(f"{out}: 16 × 16, 5 frames, 72 degrees apart")
    assert run(*turn, 3) == 2
    done(*turn, 3, "--overwrite")
    assert len(list(out.iterdir())) == 3
    assert [path.name for path in tmp_path.iterdir()] == ["frames"]


@pytest.mark.parametrize(("suffix", "kind"), [(".webp", "WEBP"), (".png", "PNG"), (".gif", "GIF")])
def test_animations(room: Path, tmp_path: Path, suffix: str, kind: str) -> None:
    out, folder = tmp_path / f"out{suffix}", tmp_path / "frames"
    light = ("--light", "10,20", "--turntable", 6, "--exposure", -0.5, "--quiet")
    fps = ("relight", room, *light, "--fps", 20, "--out", out)
    needed = 4 * 6 * 16 * 16
    with mock.patch("pbrfit.commands.relight.available", return_value=needed - 1):
        assert "MiB of memory for 6 frames, found" in refused(*fps)
    with mock.patch("pbrfit.commands.relight.available", return_value=needed):
        assert run(*fps) == 0
    assert run("relight", room, *light, "--format", "png", "--out", folder) == 0
    frames = sorted(folder.iterdir())
    assert [path.name for path in frames] == [f"frame_000{k}.png" for k in range(6)]
    with Image.open(out) as picture:
        assert picture.format == kind
        assert picture.n_frames == 6  # type: ignore[attr-defined]
        for path, frame in zip(frames, ImageSequence.Iterator(picture), strict=True):
            found = np.asarray(frame.convert("RGB"), dtype=np.int64)
            assert frame.info["loop"] == 0
            assert frame.info["duration"] == 50
            expected = np.asarray(Image.open(path), dtype=np.int64)
            if suffix == ".gif":
                assert np.abs(found - expected).max() < 16  # 256 colours for 256 pixels
            else:
                np.testing.assert_array_equal(found, expected)
    assert out.stat().st_mode & 0o777 == (folder / "frame_0000.png").stat().st_mode & 0o777


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((), "expected --picture NAME, because it holds 2 lights, found left, right"),
        (("--picture", "up"), "expected a light of up (--picture), found left, right"),
    ],
)
def test_one_of_several_lights_has_to_be_named(
    room: Path, tmp_path: Path, arguments: tuple[str, ...], message: str
) -> None:
    path = tmp_path / "light.json"
    Lighting(("left", "right"), np.zeros((2, 16, 3))).save(path)
    text = refused("relight", room, "--sh", path, *arguments, "--out", tmp_path / "out.exr")
    assert f"{path}: {message}" in text
    assert list(tmp_path.iterdir()) == [path]


def test_what_is_no_result_folder(folders: Path, tmp_path: Path) -> None:
    def message(path: Path) -> str:
        text = refused("relight", path, "--light", "0,0", "--out", tmp_path / "out.exr")
        assert f"{path}: expected a result folder, as pbrfit decompose writes it, found " in text
        return text

    assert "found nothing" in message(tmp_path / "absent")
    (tmp_path / "file").write_text("")
    assert "found a file" in message(tmp_path / "file")
    scene = write_folder(tmp_path / "scene")
    assert "found a scene folder: run pbrfit decompose" in message(scene)
    assert f"found a folder of results: name one of them, such as {folders / 'ball'}" in message(
        folders
    )
    (tmp_path / "empty").mkdir()
    assert "found one without result.json and materials.exr" in message(tmp_path / "empty")
    shutil.copytree(folders / "room", tmp_path / "damaged")
    (tmp_path / "damaged" / "lighting.json").unlink()
    assert "found one without lighting.json" in message(tmp_path / "damaged")
    assert not (tmp_path / "out.exr").exists()


def test_what_is_read_is_not_overwritten(room: Path, pano: Path) -> None:
    materials = room / "materials.exr"
    (pano.parent / "frame_0000.exr").touch()
    before = [path.read_bytes() for path in (pano, materials)]
    for light, out, kind in (
        (("--env", pano), pano, "file"),
        (("--light", "0,0"), materials, "file"),
        (("--env", pano, "--turntable", 2), pano.parent, "folder"),  # of frames
    ):
        said = refused("relight", room, *light, "--out", out, "--overwrite")
        assert f"expected a {kind} apart from the result's and the light's" in said
    assert [path.read_bytes() for path in (pano, materials)] == before


@pytest.mark.parametrize(
    ("out", "arguments", "message"),
    [
        ("out.exr", ("--exposure", 1), "--exposure: expected a file for a screen"),
        ("out.exr", ("--tone-map", "neutral"), "--tone-map: expected a file for a screen"),
        ("out", ("--turntable", 2, "--exposure", 1), "such as .png (--format png), found EXR"),
        ("out.jpg", (), "expected a file that ends in .exr (linear) or .png (for a screen), found"),
        ("out", (), "found no suffix; a folder needs --turntable N"),
        ("out.gif", (), "found .gif; .gif needs --turntable N"),
        ("out.exr", ("--turntable", 2), "a folder (no suffix), .gif, .webp or .png (animated)"),
        ("out.png", ("--turntable", 0), "expected 1 or more, found 0"),
        ("out", ("--turntable", 3601), "expected at most 3600 frames, a tenth of a degree apart,"),
        ("out.gif", ("--turntable", 3600, "--exposure", 101), "--exposure: expected -100 to 100"),
        ("out.png", ("--rotate", 90), "--rotate: goes with --env, --sh or --picture"),
        ("out.png", ("--picture", "a"), "--picture: goes with --sh"),
        ("out.png", ("--format", "png"), "--format: goes with --turntable and a folder"),
        ("out.png", ("--fps", 5), "--fps: goes with --turntable and .gif, .webp or .png"),
        ("out.gif", ("--turntable", 2, "--fps", 51), "--fps: expected 1 to 50, found 51"),
        ("out.png", ("--color", "1,1"), "expected R,G,B, finite numbers, found '1,1'"),
        ("out.png", ("--exposure", "nan"), "expected a finite number, found 'nan'"),
        ("out.png", ("--exposure", 101), "--exposure: expected -100 to 100 stops, found 101"),
        ("out.png", ("--sh", "x.json"), "not allowed with argument --light"),
    ],
)
def test_wrong_usage(
    room: Path, tmp_path: Path, out: str, arguments: tuple[str | int, ...], message: str
) -> None:
    assert message in refused(
        "relight", room, "--light", "0,0", *arguments, "--out", tmp_path / out
    )
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("light", ["0", "0,0,0", "left,0", "nan,0", "inf,0", "", None])
def test_lights_that_are_no_angles_or_none(room: Path, tmp_path: Path, light: str | None) -> None:
    given = () if light is None else ("--light", light)
    expected = f"expected AZIMUTH,ELEVATION, finite numbers, found {light!r}"
    if light is None:
        expected = "expected one of --env, --light, --lamp, --sh and --picture, found none"
    assert expected in refused("relight", room, *given, "--out", tmp_path / "out.png")


def test_a_picture_s_own_light_is_shown_again(room: Path, lamps: Path, tmp_path: Path) -> None:
    result, peaks = Result.load(lamps), []
    for of, enhance in ((specular_enhanced(result), ("--enhance", "specular")), (result, ())):
        expected = relight(of, picture=2).astype(np.float32)
        found = written(lamps, tmp_path, "--picture", "c", *enhance)
        np.testing.assert_array_equal(found[result.mask], expected[result.mask])
        peaks.append(np.nanmax(expected) / np.nanmedian(expected))
    assert peaks[0] > 1.2 * peaks[1]
    file = lamps / "lighting.json"
    again = written(lamps, tmp_path, "--sh", file, "--picture", "c")
    np.testing.assert_array_equal(found, again)
    command = ("relight", lamps, "--picture", "c", "--rotate", 10, "--out", tmp_path / "out.png")
    words = f"1 far lamp and ambient SH light, of c in {file}, turned by 10 degrees"
    assert said(done(*command))["light"] == words
    other = Result.load(room)
    own = written(room, tmp_path, "--picture", other.pictures[0])
    assert np.array_equal(own, relight(other, other.lighting[0]).astype("f4"))


def test_a_near_lamp_is_as_bright_as_asked_at_the_middle(deep: Path, tmp_path: Path) -> None:
    out = tmp_path / "out.exr"
    result = Result.load(deep)
    middle = known(result.middle)
    lamp = ("--lamp", "-0.5,1,-0.25", "--color", "2,1,1")
    facts = said(done("relight", deep, *lamp, "--no-shadows", "--out", out))
    away = np.array((-0.5, 1, -0.25)) - middle
    assert facts["light"].startswith(
        f"near, at -0.5, 1, -0.25, which is {np.linalg.norm(away):.3g}"
    )
    near = Lamps(
        np.array([0]),
        np.array([(-0.5, 1, -0.25)]),
        np.array([True]),
        away @ away * np.array([(2.0, 1, 1)]),
    )
    np.testing.assert_allclose(exr(out), relight(result, near, shadows=False), rtol=1e-6)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--lamp", "0,0"), "expected X,Y,Z, finite numbers, found '0,0'"),
        (("--lamp", "0,0,0"), "expected a result with depth for --lamp, found one without"),
        (("--picture", "a", "--softness", 1), "--softness: goes with --light or --lamp"),
        (("--lamp", "0,0,0", "--rotate", 3), "--rotate: goes with --env, --sh or --picture"),
        (("--lamp", "0,0,0", "--light", "0,0"), "not allowed with argument"),
        (("--picture", "d"), "expected a light of d (--picture), found a, b, c"),
        (("--picture", "a", "--color", "1,1,1"), "--color: goes with --light or --lamp"),
        (("--lamp", "0,0,0", "--turntable", 3), "far ones to be turned, found near ones"),
    ],
)
def test_lights_that_cannot_be(
    lamps: Path, deep: Path, arguments: tuple[str | int, ...], message: str, tmp_path: Path
) -> None:
    result, out = (deep, "out.gif") if "--turntable" in arguments else (lamps, "out.png")
    assert message in refused("relight", result, *arguments, "--out", tmp_path / out)
    assert list(tmp_path.iterdir()) == []


def test_far_lamps_of_a_picture_go_around(lamps: Path, tmp_path: Path) -> None:
    done("relight", lamps, "--picture", "a", "--turntable", 2, "--out", tmp_path / "frames")
    first, second = (exr(tmp_path / "frames" / f"frame_000{k}.exr") for k in range(2))
    np.testing.assert_array_equal(first, written(lamps, tmp_path, "--picture", "a"))
    assert second[..., :3].mean() < first[..., :3].mean()  # from behind, ambient light is left
