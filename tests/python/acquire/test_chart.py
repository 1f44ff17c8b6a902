"""A ColorChecker in a picture: drawn in perspective by a camera whose colours are not Rec.709's."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from pbrfit import InputError, Scene
from pbrfit.acquire import chart
from pbrfit.acquire.chart import PATCHES, SIDE, read_chart
from pbrfit.cli import main
from pbrfit.io import images
from pbrfit.io.color import encode_srgb
from pbrfit.scene.options import ReadOptions

TO_REC709 = np.array([[1.3, -0.2, -0.1], [-0.1, 1.2, -0.1], [0.05, -0.3, 1.25]])
EXPOSURE = 0.6
SIZE = (250, 350)
CORNERS = np.array([[75.0, 50], [275, 60], [262, 190], [67, 180]])
REFLECTANCES = chart._from_lab(np.array(list(PATCHES.values())))


def drawn(exposure: float = EXPOSURE) -> NDArray[np.float64]:
    """The chart as that camera sees it."""
    square = np.array([[0.0, 0], [1, 0], [1, 1], [0, 1]])
    a = [[u, v, 1, 0, 0, 0, -x * u, -x * v] for (u, v), (x, _) in zip(square, CORNERS, strict=True)]
    a += [
        [0, 0, 0, u, v, 1, -y * u, -y * v] for (u, v), (_, y) in zip(square, CORNERS, strict=True)
    ]
    to_picture = np.append(np.linalg.solve(a, CORNERS.T.ravel()), 1.0).reshape(3, 3)
    rows, columns = np.indices(SIZE)
    places = np.stack([columns, rows, np.ones(SIZE)], axis=-1) @ np.linalg.inv(to_picture).T
    across = places[..., 0] / places[..., 2] * (5 + SIDE)
    down = places[..., 1] / places[..., 2] * (3 + SIDE)
    i, j = np.floor(across).astype(int), np.floor(down).astype(int)
    patch = (i >= 0) & (i < 6) & (j >= 0) & (j < 4) & (across - i < SIDE) & (down - j < SIDE)
    shown = np.full((*SIZE, 3), 0.02)
    shown[patch] = REFLECTANCES[(6 * j + i)[patch]]
    return np.asarray(exposure * shown @ np.linalg.inv(TO_REC709).T)


def written(path: Path, linear: NDArray[np.float64]) -> images.Picture:
    codes = np.rint(65535 * encode_srgb(linear.clip(0, 1))).astype(np.uint16)
    images.write_png(path, codes, "srgb")
    return images.read_picture(path)


def test_the_matrix_and_the_exposure_are_found(tmp_path: Path) -> None:
    picture = written(tmp_path / "chart.png", drawn())
    matrix, said = read_chart(tmp_path / "chart.png", picture, CORNERS)
    np.testing.assert_allclose(EXPOSURE * matrix, TO_REC709, atol=2e-3)
    assert said == "a ColorChecker, mean colour difference 0.0 (CIE 1976; 9.8 without)"


@pytest.mark.parametrize(
    ("exposure", "corners", "expected"),
    [
        (1.3, CORNERS, "expected no clipped patch, found .*white"),
        (EXPOSURE, CORNERS[[1, 2, 3, 0]], "whose last row goes from white to black, found"),
        (EXPOSURE, CORNERS[[2, 3, 0, 1]], "whose last row goes from white to black, found"),
        (EXPOSURE, CORNERS + 200, r"corners of a ColorChecker within 350 × 250 pixels, found \[\["),
    ],
)
def test_what_is_no_chart_is_refused(
    tmp_path: Path, exposure: float, corners: NDArray[np.float64], expected: str
) -> None:
    path = tmp_path / "chart.png"
    picture = written(path, drawn(exposure))
    with pytest.raises(InputError, match=f"chart.png: expected .*{expected}|{expected}"):
        read_chart(path, picture, corners)


@pytest.mark.parametrize("turn", range(4))
def test_a_chart_is_sought_in_any_turn(tmp_path: Path, turn: int) -> None:
    pytest.importorskip("cv2")
    large = drawn().repeat(3, axis=0).repeat(3, axis=1)
    picture = written(tmp_path / "chart.png", np.rot90(large, turn))
    matrix, _ = read_chart(tmp_path / "chart.png", picture, None)
    np.testing.assert_allclose(EXPOSURE * matrix, TO_REC709, atol=5e-3)


def test_an_even_picture_has_no_chart(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    picture = written(tmp_path / "chart.png", np.full((*SIZE, 3), 0.3))
    monkeypatch.setitem(sys.modules, "cv2", None)
    with pytest.raises(InputError, match=r"chart\.png: expected --chart-corners, or the Python"):
        read_chart(tmp_path / "chart.png", picture, None)


def scene(folder: Path) -> tuple[Path, list[NDArray[np.float64]]]:
    """A folder of two pictures by that camera, and what they show."""
    rng = np.random.default_rng(0)
    shown = [rng.uniform(0.05, 0.5, (8, 9, 3)) for _ in range(2)]
    (folder / "images").mkdir(parents=True)
    for k, linear in enumerate(shown):
        written(folder / "images" / f"{k}.png", EXPOSURE * linear @ np.linalg.inv(TO_REC709).T)
    facing = np.broadcast_to(np.array([0, 0, 1], np.float32), (8, 9, 3))
    channels: dict[str, Any] = {"XYZ"[k]: facing[..., k] for k in range(3)}
    images.write_exr(folder / "normals.exr", channels)
    return folder, shown


def test_a_chart_corrects_all_pictures(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder, shown = scene(tmp_path / "scene")
    path = tmp_path / "chart.png"
    matrix, _ = read_chart(path, written(path, drawn()), CORNERS)
    rows = tuple(map(tuple, matrix.tolist()))
    read = Scene.load(folder, ReadOptions(color_matrix=rows))
    np.testing.assert_allclose(read.images, shown, atol=2e-3)
    assert read.assumed["color matrix"].endswith("after that")
    told = f"color_matrix = {[list(row) for row in rows]}\n"
    (folder / "scene.toml").write_text(told, encoding="utf-8")
    np.testing.assert_array_equal(Scene.load(folder).images, read.images)
    (folder / "scene.toml").unlink()
    corners = ",".join(map("{:g}".format, CORNERS.ravel()))
    assert main(["inspect", str(folder), "--chart", str(path), "--chart-corners", corners]) == 0
    assert "chart.png: a ColorChecker, mean colour difference 0.0" in capsys.readouterr().err
    assert main(["inspect", str(folder), "--chart-corners", corners]) == 2


@pytest.mark.parametrize("rows", [((1, 0, 0),) * 3, ((1, 0), (0, 1)), ((float("nan"),) * 3,) * 3])
def test_a_matrix_that_cannot_be_undone_is_refused(rows: Any) -> None:
    with pytest.raises(InputError, match=r"color_matrix: expected (three rows|shape \(3, 3\))"):
        ReadOptions(color_matrix=rows)
