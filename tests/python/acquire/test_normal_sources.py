"""Normals from depth maps and files, their conventions and weights."""

from __future__ import annotations

import dataclasses
import logging
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from command_runs import done, refused
from pbrfit._core import InputError
from pbrfit.acquire.marigold import mean_and_spread
from pbrfit.acquire.normals import Normals, estimate
from pbrfit.acquire.photo import shown_to_network
from pbrfit.display.tone import encoded
from pbrfit.io import images
from pbrfit.io.normal_files import UNCERTAINTY, Convention, read_normals
from pbrfit.model.depth_normals import from_depth
from pbrfit.model.geometry import angles_between, facing_away, view_directions
from pbrfit.result.metrics import white_of
from pbrfit.scene.scene import Scene
from pbrfit.values.arrays import Array, Floats
from scene_files import LIGHTS, SIZE, known, room, world, write_folder

SIZES = [(97, 131), (131, 97), (64, 64)]


def rays(height: int, width: int, fov: float) -> Array:
    """(H, W, 3) with z = -1: the point at depth z along the axis is z times this."""
    views = view_directions(height, width, fov)
    return np.asarray(-views / views[..., 2:])


def unit(*components: float) -> Array:
    return np.asarray(np.array(components) / np.linalg.norm(components))


@pytest.mark.parametrize("fov", [20.0, 60.0, 120.0])
@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("kind", ["z", "ray", "disparity"])
def test_planes_are_exact_at_any_tilt(fov: float, size: tuple[int, int], kind: Any) -> None:
    for normal in (unit(0, 0, 1), unit(0.5, -0.2, 1), unit(-1, 2, 1.5)):
        r = rays(*size, fov)
        facing = -r @ normal
        seen = facing > 0.01
        z = np.where(seen, 3.0 / np.where(seen, facing, 1.0), 0.0)  # 0: nothing
        along = z * np.linalg.norm(r, axis=-1)
        with np.errstate(divide="ignore"):
            given = {"z": z, "ray": along, "disparity": np.where(seen, 1 / z, 0.0)}[kind]
        normals_found, known = from_depth(7.0 * given, fov=fov, kind=kind)  # up to scale
        np.testing.assert_array_equal(known, seen)
        wrong = angles_between(normals_found, np.broadcast_to(normal, normals_found.shape))
        assert wrong[seen].max() < 1e-5
        assert (normals_found[~seen] == [0, 0, 1]).all()


def test_orthographic_planes_are_exact() -> None:
    height, width = size = (97, 131)
    normal = unit(0.4, -0.3, 1)
    x = (2 * np.arange(width) + 1 - width) / width * 2.5
    y = (height - 1 - 2 * np.arange(height))[:, None] / width * 2.5
    z = 10 + (normal[0] * x + normal[1] * y) / normal[2]
    for kind in ("z", "ray"):  # the same where rays are parallel
        normals_found, _ = from_depth(z, fov=0.0, kind=kind, view_width=5.0)
        assert angles_between(normals_found, np.broadcast_to(normal, (*size, 3))).max() < 1e-6
    with pytest.raises(InputError, match="expected the width of the view"):
        from_depth(z, fov=0.0)
    with pytest.raises(InputError, match="disparity: expected a field of view above 0"):
        from_depth(1 / z, fov=0.0, kind="disparity", view_width=5.0)


@pytest.mark.parametrize(("size", "bound"), [(64, 0.5), (128, 0.13), (256, 0.035)])
def test_a_sphere_is_right_to_second_order(size: int, bound: float) -> None:
    # A ball of radius 1 at a distance of 3 that fills the picture: u is smooth on it, so a quarter
    # of the error is left when pixels are half as large.
    r = rays(size, size, 30.0)
    length = np.linalg.norm(r, axis=-1)
    middle = 3 / length  # distance along the ray to the point nearest to the centre
    off = middle**2 - 8
    distance = middle - np.sqrt(np.where(off > 0, off, np.nan))
    points = r / length[..., None] * distance[..., None]
    normals = points - np.array([0, 0, -3.0])
    normals_found, known = from_depth(distance / length, fov=30.0)
    wrong = angles_between(normals_found, normals)[known]
    assert np.mean(known) > 0.9
    assert np.median(wrong) < bound


@pytest.mark.parametrize("kind", ["room", "furnished"])
@pytest.mark.parametrize("size", [(194, 262), (256, 256)])
def test_rooms_are_right_but_for_what_is_a_pixel_wide(kind: Any, size: tuple[int, int]) -> None:
    z, true, there = world(kind, 5, *size, 60.0)
    normals_found, known = from_depth(z, fov=60.0)
    wrong = angles_between(normals_found, true)[there & known]
    assert np.median(wrong) < 1e-4
    assert wrong.mean() < 1.0
    assert np.mean(wrong > 5) < 0.03
    views = view_directions(*size, 60.0)
    assert not facing_away(normals_found, views)[known].any()


def test_noise_does_not_choose_the_noisier_side() -> None:
    # Slopes from the middle have a variance of 1/2 of the noise, those from a side 13/2: normals of
    # a noisy plane must be as good as central differences make them.
    z = np.full((128, 128), 2.0)
    noisy = z * (1 + 1e-3 * np.random.default_rng(0).normal(size=z.shape))
    found = from_depth(noisy, fov=60.0)[0][48:80, 48:80]  # near the axis
    wrong = angles_between(found, np.array([0, 0, 1.0]))
    # tan θ of each component has the deviation 1e-3 sqrt(1/2) W / (2 tan 30°).
    expected = np.degrees(np.arctan(1e-3 * np.sqrt(0.5) * 128 / (2 * np.tan(np.pi / 6))))
    assert np.sqrt(np.mean(wrong**2) / 2) == pytest.approx(expected, rel=0.05)


def test_holes_in_the_depth_are_no_surface() -> None:
    z = np.full((20, 30), 4.0)
    z[2, 3], z[5, 6], z[8, 9], z[11, 12], z[14, 15] = 0, np.nan, np.inf, 1e10, -1
    normals_found, known = from_depth(z, fov=50.0)
    assert np.count_nonzero(~known) == 5
    assert angles_between(normals_found, np.array([0, 0, 1.0])).max() < 1e-6
    alone = np.full((9, 9), np.nan)
    alone[4, 4] = 1.0  # no neighbour: no slope
    assert not from_depth(alone, fov=50.0)[1].any()


def test_depth_files(tmp_path: Path) -> None:
    z, true, _ = world("room", 3, 48, 64, 60.0)
    path = tmp_path / "z.exr"
    images.write_exr(path, {"depth.Z": z})
    found = estimate(f"depth:{path}", np.zeros((48, 64, 3), np.uint8), fov=60.0)
    assert np.median(angles_between(found.normals, true)) < 1e-3
    assert found.weights is None
    assert found.record["kind"] == "z"
    images.write_exr(path, {"depth.Z": np.where(np.arange(64) < 9, 99 * z.max(), z)})
    weights = known(estimate(f"depth:{path}", np.zeros((48, 64, 3), np.uint8), fov=60.0).weights)
    np.testing.assert_array_equal(np.sign(weights), np.broadcast_to(np.arange(64) >= 9, z.shape))
    smaller = estimate(f"depth:{path}", np.zeros((24, 32, 3), np.uint8), fov=60.0)
    assert smaller.normals.shape == (24, 32, 3)
    np.testing.assert_allclose(np.linalg.norm(smaller.normals, axis=-1), 1)


def test_few_depths_are_told(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    ramp = np.broadcast_to(np.arange(64, dtype=np.uint8)[None] + 100, (64, 64))
    images.write_png(tmp_path / "z.png", np.ascontiguousarray(ramp), tag=None)
    with caplog.at_level(logging.WARNING, "pbrfit"):
        estimate(f"depth:{tmp_path / 'z.png'}", np.zeros((64, 64, 3), np.uint8), fov=60.0)
    assert "only 64 different depths" in caplog.text


def test_depth_files_that_cannot_be_used(tmp_path: Path) -> None:
    shown = np.zeros((16, 16, 3), np.uint8)
    images.write_png(
        tmp_path / "jet.png", np.random.default_rng(0).integers(0, 255, (16, 16, 3), np.uint8), None
    )
    images.write_exr(tmp_path / "wide.exr", {"Z": np.ones((16, 32))})
    np.save(tmp_path / "many.npy", np.ones((3, 16, 16)))
    for name, message in {
        "jet.png": "jet.png: expected depth in one channel, found colours",
        "wide.exr": "wide.exr: expected the pictures' size, 16 × 16 .* found 32 × 16",
        "many.npy": r"many.npy: expected depth \(H, W\), found shape \(3, 16, 16\)",
    }.items():
        with pytest.raises(InputError, match=message):
            estimate(f"depth:{tmp_path / name}", shown, fov=60.0)


def write_map(path: Path, normals: Floats) -> Path:
    images.write_exr(path, {name: normals[..., i] for i, name in enumerate("XYZ")})
    return path


def test_conventions_undo_themselves() -> None:
    turn = np.array([[0.6, 0, 0.8], [0, 1, 0], [-0.8, 0, 0.6]])
    for axes in ("opengl", "directx"):
        for frame in ("camera", "tangent", "world"):
            convention = Convention(axes, frame, turn)
            there = convention.from_camera(room().normals)
            np.testing.assert_allclose(convention.to_camera(there), room().normals, atol=1e-15)
    world_up = Convention("opengl", "world", turn).to_camera(np.array([0.0, 0.0, 1.0]))
    np.testing.assert_allclose(world_up, turn[:, 2])
    with pytest.raises(InputError, match="expected world_to_camera"):
        Convention(frame="world").to_camera(np.ones(3))


def test_tangent_space_is_that_of_a_card(tmp_path: Path) -> None:
    shown = np.zeros((SIZE, SIZE, 3), np.uint8)
    bumps = np.stack(
        [np.full((SIZE, SIZE), 0.6), np.zeros((SIZE, SIZE)), np.full((SIZE, SIZE), 0.8)]
    )
    path = write_map(tmp_path / "n.exr", np.moveaxis(bumps, 0, -1))
    convention = Convention(frame="tangent")
    found = estimate(str(path), shown, fov=60, convention=convention)
    np.testing.assert_allclose(found.normals, np.broadcast_to([0.6, 0, 0.8], (SIZE, SIZE, 3)))
    path = write_map(tmp_path / "n.exr", np.moveaxis(-bumps, 0, -1))
    with pytest.raises(InputError, match=r"expected tangent space, .* found 100 % below"):
        estimate(str(path), shown, fov=60, convention=convention)


def test_larger_files_are_averaged(tmp_path: Path) -> None:
    true = room().normals
    path = write_map(tmp_path / "n.exr", np.repeat(np.repeat(true, 3, 0), 3, 1))
    found = estimate(str(path), np.zeros((SIZE, SIZE, 3), np.uint8), fov=60)
    assert angles_between(found.normals, true).max() < 1e-4
    other_form = np.zeros((SIZE * 2, SIZE, 3), np.uint8)
    too_large = np.zeros((SIZE * 4, SIZE * 4, 3), np.uint8)
    for sized in (other_form, too_large):
        with pytest.raises(InputError, match="or a larger one in the same proportion"):
            estimate(str(path), sized, fov=60)


def test_pixels_without_a_normal_have_no_weight(tmp_path: Path) -> None:
    normals = np.array(room().normals)
    normals[2, 3] = 0
    normals[4, 5] = np.nan
    path = write_map(tmp_path / "n.exr", normals)
    found = estimate(str(path), np.zeros((SIZE, SIZE, 3), np.uint8), fov=60)
    assert np.argwhere(known(found.weights) == 0).tolist() == [[2, 3], [4, 5]]
    assert (found.normals[[2, 4], [3, 5]] == [0, 0, 1]).all()
    nowhere = np.zeros((SIZE, SIZE), bool)
    nowhere[2, 3] = True
    with pytest.raises(InputError, match="expected normals of some pixel of the mask, found none"):
        estimate(str(path), np.zeros((SIZE, SIZE, 3), np.uint8), fov=60, mask=nowhere)


def test_the_spread_of_an_ensemble_is_that_of_its_members() -> None:
    rng = np.random.default_rng(0)
    sigma = np.radians(3.0)  # root mean square angle: two components of sigma/sqrt(2) each
    direction = unit(0.3, -0.2, 1)
    frame = np.linalg.svd(direction[None])[2][1:]
    for count in (2, 3, 10):
        members = []
        for _ in range(count):
            off = rng.normal(scale=sigma / np.sqrt(2), size=(200, 200, 2)) @ frame
            tilted = direction + off
            members.append(tilted / np.linalg.norm(tilted, axis=-1, keepdims=True))
        mean, spread = mean_and_spread(members)
        np.testing.assert_allclose(np.linalg.norm(mean, axis=-1), 1)
        assert np.sqrt(np.mean(spread**2)) == pytest.approx(3.0, rel=0.02)
        wrong = angles_between(mean, np.broadcast_to(direction, mean.shape))
        assert np.sqrt(np.mean(wrong**2)) == pytest.approx(3.0 / np.sqrt(count), rel=0.02)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    made = write_folder(tmp_path / "scene", fov=None)
    (made / "normals.exr").unlink()
    return made


def test_the_command_writes_what_the_scene_reads_back(folder: Path, tmp_path: Path) -> None:
    (folder / "scene.toml").write_text(
        'fov = 50\nnormals = "directx"\nnormals_frame = "world"\n'
        "world_to_camera = [[0.6, 0, 0.8], [0, 1, 0], [-0.8, 0, 0.6]]\n"
    )
    z = np.full((SIZE, SIZE), 3.0)
    z[:, :2] = 0
    path = tmp_path / "z.exr"
    images.write_exr(path, {"depth.Z": z})
    said = done("normals", folder, "--from", f"depth:{path}")
    assert "field of view 50 degrees" in said
    assert "12 % of the pixels have none" in said
    scene = Scene.load(folder)
    assert angles_between(scene.normals, np.array([0, 0, 1.0]))[scene.valid].max() < 1e-4
    assert np.count_nonzero(~scene.valid) == 2 * SIZE

    true = room().normals
    path = write_map(tmp_path / "n.exr", true * [1, -1, 1])
    assert "directx axes, camera space" in done(
        "normals", folder, "--from", path, "--frame", "camera", "--overwrite"
    )
    assert not (folder / "weights.exr").exists()
    assert angles_between(Scene.load(folder).normals, true).max() < 0.01


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--from", "flat", "--ensemble", "3"), "--ensemble: has no meaning with --from flat"),
        (("--depth-kind", "ray"), "--depth-kind: has no meaning with --from marigold"),
        (("--from", "flat", "--convention", "opengl"), "--convention: has no meaning"),
        (("--from", "flat"), "weights.exr: expected no weights yet"),
        # marigold, whose packages may be missing: told before anything is computed
        (("--device", "cpu"), "scene.toml: expected world_to_camera"),
    ],
)
def test_what_the_command_cannot_do_changes_nothing(
    folder: Path, arguments: tuple[str, ...], message: str
) -> None:
    if message.startswith("weights.exr"):
        images.write_exr(folder / "weights.exr", {"Y": np.ones((SIZE, SIZE))})
    (folder / "scene.toml").write_text('normals_frame = "world"\n' * ("--device" in arguments))
    assert message in refused("normals", folder, *arguments)
    assert not (folder / "normals.exr").exists()


def test_uncertainty_is_kept_beside_the_normals(folder: Path) -> None:
    from pbrfit.scene.completion import add_normals

    uncertainty = np.asarray(np.linspace(0, 20, SIZE * SIZE).reshape(SIZE, SIZE), np.float64)
    weights = known(Normals(np.zeros((SIZE, SIZE, 3)), uncertainty).weights)
    paths = add_normals(folder, room().normals, uncertainty=uncertainty, weights=weights)
    assert [path.name for path in paths] == ["normals.exr", "weights.exr"]
    channels = images.read_channels(folder / "normals.exr")
    np.testing.assert_allclose(channels[UNCERTAINTY], uncertainty, rtol=1e-6)
    read = read_normals(folder / "normals.exr").vectors
    np.testing.assert_allclose(read, room().normals, atol=1e-7)
    scene = Scene.load(folder, fov=60)
    expected = np.broadcast_to(weights[..., None], (LIGHTS, SIZE, SIZE, 3))
    np.testing.assert_array_equal(known(scene.weights), expected)
    with pytest.raises(InputError, match="normals: expected shape"):
        add_normals(folder, room().normals[1:], overwrite=True)
    assert dataclasses.replace(room(), weights=known(scene.weights)).valid.all()


def test_normals_that_cannot_be_written_cost_none_that_are_there(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from pbrfit.scene import completion as scene_completion

    def full(*_: object) -> None:
        raise OSError("no space left on device")

    flat = np.broadcast_to([128, 128, 255], (SIZE, SIZE, 3)).astype(np.uint8)
    images.write_png(folder / "normals.png", flat, tag=None)
    images.write_exr(folder / "weights.exr", {"Y": np.ones((SIZE, SIZE))})
    monkeypatch.setattr(scene_completion, "write_normals", full)
    with pytest.raises(OSError, match="no space"):
        scene_completion.add_normals(folder, room().normals, overwrite=True)
    assert (folder / "normals.png").exists()
    assert (folder / "weights.exr").exists()


def test_a_network_is_shown_the_mean_of_all_pictures_or_one_by_name(folder: Path) -> None:
    names, pictures = room().names, room().images
    mean = sum(image / image.mean() for image in pictures)
    for name, what, light in (
        (None, f"the mean of {LIGHTS} pictures", mean),
        (names[1], f"picture {names[1]}", pictures[1]),
    ):
        found, said = shown_to_network(folder, name)
        assert said == what
        expected = np.rint(255 * encoded(light / white_of(light)))
        assert np.abs(found.astype(int) - expected).max() <= 1
    with pytest.raises(InputError, match=f"picture: expected one of {names[0]}"):
        shown_to_network(folder, "other")


def test_how_bright_a_picture_is_does_not_matter_and_black_ones_tell_nothing(folder: Path) -> None:
    first, *others = sorted((folder / "images").iterdir())
    whole, alone = shown_to_network(folder)[0], shown_to_network(folder, room().names[0])[0]
    channels = images.read_channels(first)
    images.write_exr(first, {name: 100 * plane for name, plane in channels.items()})
    assert np.abs(shown_to_network(folder)[0].astype(int) - whole).max() <= 1
    black = dict.fromkeys("RGB", np.zeros((SIZE, SIZE)))
    for path in others:
        images.write_exr(path, black)
    assert np.abs(shown_to_network(folder)[0].astype(int) - alone).max() <= 1
    images.write_exr(first, black)
    with pytest.raises(InputError, match="images: expected radiance above 0, found none"):
        shown_to_network(folder)
