"""The page about a result: what is on it, how large it is, and what it does without pictures."""

from __future__ import annotations

import base64
import dataclasses
import errno
import functools
import itertools
import json
import math
import os
import re
import shutil
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np
import pytest

from browser import Visit, launched, visit, wait_until
from command_runs import done, refused
from left_out_pictures import EXCUSE, EXPLAINED, SENTENCE, UNEXPLAINED
from page_reader import Page, decoded, written
from pbrfit import InputError, Materials, Result, Scene, decompose
from pbrfit.io.color import decode_srgb, encode_srgb
from pbrfit.kernel import sh_basis
from pbrfit.model.reflection import Model, render
from pbrfit.report import budget, lights, originals, write_report
from pbrfit.report.html import document, text_of
from pbrfit.report.page import REFLECTION
from pbrfit.report.verdict import CLASSES
from pbrfit.result.advice import next_steps
from pbrfit.result.camera import Camera
from pbrfit.result.differences import PALETTE, WHITE
from pbrfit.result.verdict import ROUGH_MAX
from pbrfit.synthetic import make_scene
from pbrfit.transport.decision import Transport
from refined import refined
from relit import shaded_ball
from result_files import CONTRADICTED
from scene_files import known, lights_of, truth_of, write_exr

if TYPE_CHECKING:
    from playwright.sync_api import Browser

SIZE = 20
AWKWARD = "a <b> & \"c\" 'd'"


@functools.cache
def room() -> Scene:
    return make_scene("room", size=SIZE, lights=3, noise=0.01, held_out=1)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with `scene`, which has ground truth, and its `result`."""
    base = tmp_path_factory.mktemp("report")
    room().save(base / "scene")
    done("decompose", base / "scene", "--out", base / "result", "--iterations", 4)
    return base


@pytest.fixture(scope="module")
def unfitted(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same without a step of a fit, so that there is no history to be drawn."""
    base = tmp_path_factory.mktemp("unfitted")
    room().save(base / "scene")
    done("decompose", base / "scene", "--out", base / "result", "--iterations", 0)
    return base


@pytest.fixture(scope="module")
def page(folder: Path) -> Page:
    return written(Result.load(folder / "result"), folder / "page.html")


@functools.cache
def of_arrays() -> tuple[Scene, Result]:
    scene = dataclasses.replace(room(), truth=None)
    return scene, decompose(scene, iterations=0, priors=None)


def in_memory(**changes: object) -> tuple[Scene, Result]:
    if not changes:
        return of_arrays()
    scene = dataclasses.replace(of_arrays()[0], **changes)  # type: ignore[arg-type]
    return scene, decompose(scene, iterations=0, priors=None)


def test_the_page_says_what_its_maps_are_maps_of(folder: Path, tmp_path: Path, page: Page) -> None:
    found = Result.load(folder / "result")
    other: Model = "paper" if found.model == "principled" else "principled"
    of_other = written(dataclasses.replace(found, model=other), tmp_path / "page.html")
    for shown, model in ((page, found.model), (of_other, other)):
        assert f"reflection model{model}" in shown.text
        assert REFLECTION[model] in shown.text
    assert REFLECTION[found.model] not in of_other.text


def test_ids_are_unique_and_nothing_refers_to_anything_outside(page: Page) -> None:
    ids = [e.attributes["id"] for e in page.elements if "id" in e.attributes]
    assert len(set(ids)) == len(ids)
    for element in page.elements:
        for name in ("src", "href", "srcset", "poster", "action"):
            target = element.attributes.get(name, "#")
            assert target.startswith(("data:", "#")), f"{element.tag} {name}={target[:60]}"
            if name == "href" and target.startswith("#") and target != "#":
                assert target[1:] in ids
        assert not re.search(r"url\(\s*['\"]?(?!data:)", element.attributes.get("style", ""))
    for style in page.all("style"):
        assert not re.search(r"@import|url\(\s*['\"]?(?!data:)", style.text)


def test_the_sections_are_there_with_links_to_them(page: Page) -> None:
    sections = [e.attributes["id"] for e in page.all("section")]
    assert sections == ["summary", "maps", "pictures", "lights", "history", "origin"]
    assert [h.text for h in page.all("h1")] == ["Materials from 3 pictures"]
    # The view stands above them, and only the first is unfolded.
    folds = [
        "open" in element.attributes
        for before, element in itertools.pairwise(page.elements)
        if before.tag == "section"
    ]
    assert folds == [True, *[False] * 5]
    assert page.content.index('class="relight-view"') < page.content.index("<main>")


def test_each_map_has_a_verdict_in_words_and_its_reason_one_click_away(
    page: Page, folder: Path
) -> None:
    uncertainty = known(Result.load(folder / "result").uncertainty)
    chips = [e for e in page.all("details") if "verdict" in e.attributes.get("class", "")]
    for chip, (name, one) in zip(chips, uncertainty.verdicts.items(), strict=True):
        assert " ".join(chip.text.split()).startswith(f"{name}: {one.level}Expected error")
        assert one.error_in_words in chip.text
        assert CLASSES[one.level] in chip.attributes["class"]
        for why in (one.cause, one.remedy):
            assert why[1:] in chip.text
    assert "A small residual does not mean that the maps are right" in page.text


def test_the_head_says_how_left_out_pictures_are_explained(unfitted: Path, tmp_path: Path) -> None:
    result = Result.load(unfitted / "result")
    reduced = {"size": "averaged down from 80 × 80 to 20 × 20 pixels"}
    result = dataclasses.replace(result, assumed={**result.assumed, **reduced})
    for name, held_out, said in (("a", EXPLAINED, SENTENCE), ("b", UNEXPLAINED, EXCUSE)):
        shown = written(dataclasses.replace(result, held_out=held_out), tmp_path / f"{name}.html")
        [header] = shown.all("header")
        told = " ".join(header.text.split())
        assert f"{said[0].upper()}{said[1:]}." in told
        assert f"Next: {next_steps(result)[0]}." in told
        assert "20 px fit: averaged down from 80 × 80 to 20 × 20 pixels." in told
        assert [link.attributes["href"] for link in shown.all("a") if link.text][:1] == ["#choice"]
        text = shown.content.split('id="choice"')[1].split("</section>")[0]
        for one in held_out.candidates:
            chosen = " (chosen)" if one.what == held_out.chosen else ""
            assert f"<td>{one.what}{chosen}</td>" in text
            assert f'<data value="{one.error!r}">' in text
        assert text.count("(chosen)") == text.count("<b>") == 1
        assert f'<data value="{held_out.nearest_picture!r}">8.4' in text
        assert "light of the 3 left-out pictures was fitted" in text
        assert "open" not in shown.content.split('id="choice"')[1].split(">")[1]
    without = written(dataclasses.replace(result, held_out=None), tmp_path / "c.html")
    assert 'id="choice"' not in without.content
    assert "not fitted to" not in without.text


def contrast(*colors: str) -> float:
    codes = np.array([[int(one[i : i + 2], 16) for i in (1, 3, 5)] for one in colors])
    low, high = sorted((decode_srgb(codes / 255) @ lights.LUMINANCE).tolist())
    return float((high + 0.05) / (low + 0.05))


def test_colours_can_be_read_in_both_themes() -> None:
    """By WCAG 2.2: 1.4.3 for every text on every ground, 1.4.11 for the edges of controls."""
    pairs = re.findall(r"--([a-z-]+): light-dark\((\S+), (\S+)\);", text_of("themes.css"))
    for of in (1, 2):
        colors = {one[0]: one[of] for one in pairs}
        for ground in (colors[name] for name in ("ground", "stage", "raised", "control")):
            for name in ("text", "quiet", "accent", "usable", "rough", "poor", "pass", "fail"):
                assert contrast(colors[name], ground) >= 4.5, name
            assert contrast(colors["edge"], ground) >= 3.0
        assert contrast(colors["on-accent"], colors["accent"]) >= 4.5


def test_style_sheets_know_every_property_they_use() -> None:
    folder_of_styles = Path(budget.__file__).parent
    known = set(re.findall(r"--([a-z0-9-]+):", text_of("themes.css")))
    known |= {"w", "h", "share", "look", "filled"}
    for path in folder_of_styles.rglob("*.css"):
        used = set(re.findall(r"var\(--([a-z0-9-]+)\)", path.read_text("utf-8")))
        assert {name for name in used if not name.startswith("relight-")} <= known, path
        # Colours stand in the themes; black and white with their shadows are those of pictures.
        if path.name not in ("viewer.css", "themes.css"):
            assert not re.search(r"#[0-9a-f]{6}\b", path.read_text("utf-8")), path


def test_every_picture_says_what_it_is_and_how_large(page: Page) -> None:
    tiles = [e.attributes["src"] for e in page.all("img") if not e.attributes["alt"]]
    assert len(tiles) == 3  # the filmstrip's, whose names stand below
    for element in page.all("img"):
        # The view stretches its picture, and the plot is no raster.
        if "width" in element.attributes and "image/png" in element.attributes["src"]:
            size = int(element.attributes["width"]), int(element.attributes["height"])
            assert decoded(element).size == size


def test_numbers_are_those_of_result_json(page: Page, folder: Path) -> None:
    content = json.loads((folder / "result" / "result.json").read_text("utf-8"))
    expected = [
        *content["metrics"].values(),
        *(content[key] for key in ("fov", "iterations", "evaluations", "seconds")),
        content["uncertainty"]["noise"],
        *content["uncertainty"]["median_deviation"].values(),
        *(one["expected_error"] for one in content["uncertainty"]["verdicts"].values()),
    ]
    assert len(content["metrics"]) == 6
    for value in expected:
        assert value in page.values
    for texts in (content["assumed"].items(), content["options"].items()):
        for name, _ in texts:
            assert name in page.text
    for line in [content["stop_reason"], *content["left_out"], *content["assumed"].values()]:
        assert line in page.text
    for name, digest in content["inputs"].items():
        assert name in page.text
        assert digest in page.text


def test_maps_are_drawn_pixel_by_pixel(page: Page, folder: Path) -> None:
    result = Result.load(folder / "result")
    truth = truth_of(Scene.load(folder / "scene"))
    for which, materials in (("recovered", result.materials), ("true", truth.materials)):
        albedo = np.asarray(page.picture(f"Map of the {which} albedo"))
        np.testing.assert_array_equal(albedo, np.rint(255 * encode_srgb(materials.albedo)))
        for name in ("roughness", "metallic"):
            grey = np.asarray(page.picture(f"Map of the {which} {name}"))
            np.testing.assert_array_equal(grey, np.rint(255 * getattr(materials, name)))
    normals = np.asarray(page.picture("Normals as colours"))
    np.testing.assert_array_equal(normals, np.rint(255 * (0.5 + 0.5 * result.normals)))


def test_errors_and_deviations_have_the_colours_of_the_scale(page: Page, folder: Path) -> None:
    result = Result.load(folder / "result")
    truth = truth_of(Scene.load(folder / "scene"))
    shares = {
        "Absolute error of roughness": np.abs(result.roughness - truth.materials.roughness),
        "Standard deviation of roughness": known(result.uncertainty).deviation.roughness,
    }
    for alt, values in shares.items():
        found = np.asarray(page.picture(alt).convert("RGB"))
        steps = np.rint(250 * np.clip(np.log10(np.maximum(values, 1e-9)) / 3 + 1, 0, 1))
        expected = np.rint(255 * PALETTE[steps.astype(int)])
        if "deviation" in alt:
            expected[values == 0] = 255
            expected[values > ROUGH_MAX["roughness"]] = (214, 94, 0)
        np.testing.assert_array_equal(found, expected)


def test_each_picture_stands_beside_its_reconstruction_with_its_own_error(
    page: Page, folder: Path
) -> None:
    result, scene = Result.load(folder / "result"), Scene.load(folder / "scene")
    for name, light, image in zip(scene.names, result.lighting, scene.images, strict=True):
        rendered = render(result.materials, result.normals, light, result.fov)
        difference = rendered - image
        rms = np.sqrt(np.mean(np.square(image, dtype=np.float64)))
        rmse = np.sqrt(np.mean(np.square(difference)))
        high = np.percentile(np.sqrt(np.mean(np.square(difference), axis=-1)) / rms, 95)
        for value in (rms, rmse, rmse / rms, high):
            assert min(abs(found - value) for found in page.values) <= 1e-9 * value, name
        white = np.percentile(image, 98)
        for what, pixels in (("Picture", image), ("Reconstruction of", rendered)):
            shown = np.asarray(page.picture(f"{what} {name}")).astype(float)
            expected = 255 * encode_srgb(np.clip(pixels / white, 0, 1))
            assert np.abs(shown - expected).max() <= 1
        assert page.picture(f"Residual of {name}").mode == "P"
    order = [e.attributes["alt"] for e in page.all("img") if "Picture " in e.attributes["alt"]]
    assert order == [f"Picture {name}" for name in scene.names]


@pytest.mark.parametrize("points", [4, 5])
def test_a_history_of_five_points_is_a_plot(folder: Path, tmp_path: Path, points: int) -> None:
    result = Result.load(folder / "result")
    history = dataclasses.replace(result.history, rows=result.history.rows[:1] * points)
    page = written(dataclasses.replace(result, history=history), tmp_path / "page.html")
    plots = [e for e in page.all("img") if e.attributes["src"].startswith("data:image/svg")]
    assert len(plots) == (points == 5)
    for data in (plot.attributes["src"].partition("base64,")[2] for plot in plots):
        assert ET.fromstring(base64.b64decode(data)).tag.endswith("svg")


def test_the_same_result_gives_the_same_page(page: Page, folder: Path, tmp_path: Path) -> None:
    again = written(Result.load(folder / "result"), tmp_path / "again.html")
    assert again.content == page.content


def test_a_scene_that_is_gone_is_said_and_its_pictures_are_not_shown(
    unfitted: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    shutil.copytree(unfitted / "result", tmp_path / "result")
    found = written(Result.load(tmp_path / "result"), tmp_path / "page.html")
    assert "The scene folder scene is gone, has changed since, or cannot be read." in found.text
    assert len(caplog.records) == 1
    alts = [e.attributes["alt"] for e in found.all("img")]
    assert "Reconstruction of light_00" in alts
    assert not [alt for alt in alts if alt.startswith(("Picture", "Residual", "Map of the true"))]
    result = Result.load(tmp_path / "result")
    assert result.metrics["recon_rmse"] in found.values
    away = dataclasses.replace(known(result.source), path=Path("/gone/with \udcff"))  # no UTF-8
    odd = written(dataclasses.replace(result, source=away), tmp_path / "odd.html")
    assert "The scene folder with \ufffd is gone, has changed since, or cannot be read." in odd.text
    unknown = dataclasses.replace(result, source=None)  # as of earlier versions
    found = written(unknown, tmp_path / "unknown.html")
    assert "The result does not say where its pictures are." in found.text


@pytest.mark.parametrize("what", ["scene.toml", "images/light_01.exr", "more"])
def test_a_scene_that_has_changed_is_not_taken_for_the_one_it_was(
    unfitted: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture, what: str
) -> None:
    for name in ("scene", "result"):
        shutil.copytree(unfitted / name, tmp_path / name)
    scene = tmp_path / "scene"
    if what == "scene.toml":
        (scene / what).write_text("fov = 50.0\n")
    elif what == "more":
        write_exr(scene / "images" / "light_09.exr", 0.9 * room().images[1])
        shutil.rmtree(scene / "truth")
    else:
        write_exr(scene / what, 0.9 * room().images[1])
    found = written(Result.load(tmp_path / "result"), tmp_path / "page.html")
    assert "The scene folder scene is gone, has changed since" in found.text
    assert "Picture light_00" not in str(found.all("img"))
    assert "expected the scene that the result was made from" in caplog.text

    # Whoever names it gets no page with something else instead.
    out = tmp_path / "other.html"
    line = refused("report", tmp_path / "result", "--out", out, "--scene", scene)
    named = "images/light_09.exr" if what == "more" else what
    assert line.startswith(f"pbrfit: {scene}: expected the scene that the result was made from")
    assert named in line
    assert not out.exists()


def test_a_scene_that_may_not_be_looked_at_is_said(
    unfitted: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    scene, look = (unfitted / "scene").resolve(), Path.stat

    def closed(path: Path, **options: bool) -> os.stat_result:
        if path == scene:
            raise PermissionError(errno.EACCES, "Permission denied", str(path))
        return look(path, **options)

    result = Result.load(unfitted / "result")
    monkeypatch.setattr(Path, "stat", closed)
    found = written(result, tmp_path / "page.html")
    assert "The scene folder scene is gone, has changed since, or cannot be read." in found.text


def test_a_scene_can_be_named_or_given_as_arrays(unfitted: Path, tmp_path: Path) -> None:
    shutil.copytree(unfitted / "result", tmp_path / "result")
    of_scene = ("--out", tmp_path / "named.html", "--scene", unfitted / "scene")
    done("report", tmp_path / "result", *of_scene)
    assert "Picture light_00" in (tmp_path / "named.html").read_text("utf-8")
    scene, result = in_memory()
    found = written(result, tmp_path / "page.html", scene)
    assert "Picture light_00" in str(found.all("img"))
    assert found.all("h1")[0].text == "Materials from 3 pictures"
    for other, message in (
        (dataclasses.replace(scene, names=("a", "b", "c")), "pictures a, b, c"),
        (dataclasses.replace(scene, mask=np.eye(SIZE, dtype=bool)), "other pixels are valid"),
        (make_scene("room", size=8, lights=3), "8 × 8 pixels instead of 20 × 20"),
    ):
        with pytest.raises(InputError, match=message):
            originals.find(result, other)


def test_without_truth_and_uncertainty_there_is_neither(tmp_path: Path) -> None:
    scene, result = in_memory()
    found = written(dataclasses.replace(result, uncertainty=None), tmp_path / "page.html", scene)
    assert [h.text for h in found.all("h3")][:1] == ["Recovered"]
    for word in ("Ground truth", "Error", "Uncertainty"):
        assert word not in [h.text for h in found.all("h3")]
    assert "The uncertainty of the maps was not estimated" in found.text


def test_names_are_text_whatever_they_hold(tmp_path: Path) -> None:
    scene, result = in_memory(
        names=(AWKWARD, "<script>alert(1)<b>", "ß€漢"),
        assumed={AWKWARD: "</p><b>", "turned": "\u202egnp.exe\u2066\u200e\u061c\x1b[2J\udcff"},
        inputs={"images/</td>.exr": "0" * 64},
    )
    found = written(result, tmp_path / "page.html", scene)
    assert f"Picture {AWKWARD}" in [e.attributes["alt"] for e in found.all("img")]
    assert AWKWARD in found.text
    assert "<script>alert(1)<b>" in found.text
    assert "images/</td>.exr" in found.text
    assert "\ufffdgnp.exe\ufffd\ufffd\ufffd\ufffd[2J\ufffd" in found.content
    assert "alert(1)" not in "".join(
        e.text for e in found.all("script") if "type" not in e.attributes
    )


def test_a_script_that_got_into_a_page_does_not_run(chromium: Browser, tmp_path: Path) -> None:
    """Were text ever not escaped, its scripts would still be none of the page's."""
    intruder = (
        "<script>document.title = 'taken'</script>"
        '<img src="x:" alt="" onerror="document.title = \'taken\'">'
        '<img src="https://example.invalid/secret" alt="">'
    )
    file = tmp_path / "page.html"
    file.write_text(document("Title", f"<h1>Title</h1>{intruder}"), encoding="utf-8")
    with visit(chromium, file) as visited:
        assert visited.page.title() == "Title"
        refused = [one for one in visited.troubles if "Content Security Policy" in one]
        assert len(refused) >= 3
        assert any("example.invalid" in one for one in refused)


def test_pixels_outside_the_mask_are_transparent(tmp_path: Path) -> None:
    mask = np.ones((SIZE, SIZE), bool)
    mask[3:9, 4:15] = False
    scene, result = in_memory(mask=mask)
    found = written(result, tmp_path / "page.html", scene)
    assert np.array_equal(
        np.asarray(found.picture("Mask of the pixels that were fitted")) > 0, mask
    )
    for alt in (
        "Map of the recovered albedo",
        "Map of the recovered roughness",
        "Standard deviation of metallic",
        "Residual of light_01",
        "Reconstruction of light_01",
    ):
        alpha = np.asarray(found.picture(alt).convert("RGBA"))[..., 3]
        assert np.array_equal(alpha, np.where(mask, 255, 0)), alt
    assert found.picture("Picture light_01").mode == "RGB"  # shown as a whole


def test_samples_without_weight_are_white_in_the_residual_and_counted(tmp_path: Path) -> None:
    weights = np.ones((3, SIZE, SIZE))
    weights[1, :5] = 0
    scene, result = in_memory(weights=weights)
    found = written(result, tmp_path / "page.html", scene)
    codes = np.asarray(found.picture("Residual of light_01"))
    assert (codes[:5] == WHITE).all()
    assert not (codes[5:] == WHITE).any()
    assert 0.25 in found.values
    assert "25 % of the samples left out" in found.text
    light = scene.lighting or result.lighting
    rendered = render(result.materials, result.normals, light[1], result.fov)[5:]
    rmse = np.sqrt(np.mean(np.square(rendered - scene.images[1, 5:])))
    assert min(abs(value - rmse) for value in found.values) <= 1e-9 * rmse


def test_grey_pictures_and_one_picture_of_known_light(tmp_path: Path) -> None:
    made = make_scene("room", size=SIZE, lights=2)
    grey = np.repeat(made.images[:1, ..., :1], 3, axis=-1)
    light = np.repeat(lights_of(made)[:1, :, :1], 3, axis=-1)
    scene = Scene(images=grey, normals=made.normals, lighting=light)
    result = decompose(scene, iterations=2)
    found = written(result, tmp_path / "page.html", scene)
    assert found.all("h1")[0].text == "Materials from one picture"
    assert len([e for e in found.all("img") if e.attributes["alt"].startswith("Panorama")]) == 1


def test_flat_normals_are_doubted(tmp_path: Path) -> None:
    result = in_memory()[1]
    flat = np.broadcast_to([0.0, 0.0, 1.0], result.normals.shape)
    of_flat = dataclasses.replace(result, normals=flat)
    refined_flat = dataclasses.replace(refined(result), given_normals=flat)
    for name, of in (("a", of_flat), ("b", refined_flat)):
        whose = "normals" if of.given_normals is None else "given normals"
        text = written(of, tmp_path / f"{name}.html").text
        assert f"Warning: all {whose} face the camera" in text


@pytest.mark.parametrize(
    ("camera", "doubt"),
    [
        (Camera(60.0, "assumed"), "the field of view is a guess, 60 degrees"),
        (Camera(62.0, "fitted", 4.9), ""),
        (Camera(62.0, "fitted", 5.1), "hardly known, 62 ± 5 degrees, fitted"),
        (CONTRADICTED, "60 degrees, given, but the pictures fit far better with about 88 ± 2"),
    ],
)
def test_a_field_of_view_that_pictures_doubt_is_said(
    camera: Camera, doubt: str, tmp_path: Path
) -> None:
    result = dataclasses.replace(in_memory()[1], camera=camera)
    text = written(result, tmp_path / "page.html").text
    assert ("Warning: the field of view is" in text) == bool(doubt)
    assert doubt in text


def test_lights_that_are_mostly_negative_are_doubted(tmp_path: Path) -> None:
    scene, result = in_memory()
    lamp = np.zeros((16, 3))
    lamp[[0, 2]] = [[1.0], [6.0]]  # 1 + 10.4 z, in units of its mean
    doubted = dataclasses.replace(result, lighting=np.stack([lamp, lamp, result.lighting[2]]))
    text = written(doubted, tmp_path / "page.html", scene).text
    # ∫ max(±(1 + a z), 0) dz over [-1, 1] is (a ± 1)²/2a.
    a = 6 * np.sqrt(3)
    share = ((a - 1) / (a + 1)) ** 2
    assert f"negative light is {100 * share:.0f} % of the positive" in text


def test_an_existing_page_needs_overwrite(unfitted: Path, tmp_path: Path) -> None:
    out = tmp_path / "page.html"
    out.write_text("mine")
    line = refused("report", unfitted / "result", "--out", out)
    assert line.startswith(f"pbrfit: {out}: expected a file that does not exist yet")
    assert out.read_text() == "mine"
    said = done("report", unfitted / "result", "--out", out, "--overwrite")
    assert said.startswith(f"{out}: ")
    assert out.read_text("utf-8").startswith("<!doctype html>")
    assert [path.name for path in tmp_path.iterdir()] == ["page.html"]


def test_what_is_no_result_and_no_page_is_refused(unfitted: Path, tmp_path: Path) -> None:
    (tmp_path / "folder.html").mkdir()
    for name in ("page.png", "page", "folder.html"):
        out = tmp_path / name
        line = refused("report", unfitted / "result", "--out", out, "--overwrite")
        assert f"{out}: expected" in line
    for wrong in (unfitted / "scene", tmp_path / "nothing"):
        assert str(wrong) in refused("report", wrong, "--out", tmp_path / "page.html")
    assert [path.name for path in tmp_path.iterdir()] == ["folder.html"]


def noise(size: int, pictures: int) -> tuple[Scene, Result]:
    """Nothing but noise, which no PNG makes smaller; not fitted, so that it takes no time."""
    random = np.random.default_rng(3)
    shape = (size, size)
    materials = Materials(random.random((*shape, 3)), random.random(shape), random.random(shape))
    normals = random.normal(size=(*shape, 3)) * 0.2
    normals[..., 2] = 1.0
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    names = tuple(f"p{i:03d}" for i in range(pictures))
    light = 0.1 * random.normal(size=(pictures, 16, 3))
    light[:, 0] = 2.0
    scene = Scene(
        images=random.random((pictures, *shape, 3), dtype=np.float32), normals=normals, names=names
    )
    like = dataclasses.replace(in_memory()[1], uncertainty=None, segments=None)
    return scene, dataclasses.replace(
        like,
        materials=materials,
        lighting=light,
        normals=normals,
        mask=scene.valid,
        pictures=names,
    )


@pytest.mark.slow
def test_a_page_of_large_noisy_pictures_stays_below_the_limit(tmp_path: Path) -> None:
    scene, result = noise(1024, 16)
    out = tmp_path / "page.html"
    found = written(result, out, scene)
    assert 10_000_000 < out.stat().st_size <= budget.LIMIT == 20_000_000
    assert "averaged down from 1024 × 1024" in found.text
    pictures = [e for e in found.all("img") if e.attributes["alt"].startswith("Picture")]
    assert len(pictures) == 16


@pytest.mark.slow
def test_pictures_that_do_not_fit_are_left_out_evenly_and_said(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    scene, result = noise(130, 24)
    monkeypatch.setattr(budget, "LIMIT", 2_500_000)
    out = tmp_path / "page.html"
    found = written(result, out, scene)
    assert out.stat().st_size <= 2_500_000
    alts = [e.attributes["alt"] for e in found.all("img")]
    shown = [alt.split()[-1] for alt in alts if alt.startswith("Picture")]
    assert 2 < len(shown) < 24
    assert f"{len(shown)} of 24 pictures are shown, evenly spread, and {24 - len(shown)} left" in (
        found.text
    )
    assert (shown[0], shown[-1]) == ("p000", "p023")
    steps = np.diff([int(name[1:]) for name in shown])
    assert steps.max() - steps.min() <= 1
    # The tables have all of them.
    assert [cell.text for cell in found.all("td") if cell.text in result.pictures] == [
        *result.pictures,
        *result.pictures,
    ]


@pytest.mark.parametrize(("azimuth", "elevation"), [(0, 0), (90, 0), (-120, 35), (10, -80)])
def test_the_main_direction_of_light_from_one_direction(azimuth: float, elevation: float) -> None:
    a, e = math.radians(azimuth), math.radians(elevation)
    direction = (math.sin(a) * math.cos(e), math.sin(e), math.cos(a) * math.cos(e))
    light = lights.measure(np.outer(sh_basis(np.array(direction)), (2.0, 1.0, 0.5)))
    assert light.azimuth == pytest.approx(azimuth, abs=1e-9)
    assert light.elevation == pytest.approx(elevation, abs=1e-9)
    assert light.directed == pytest.approx(1.0)
    assert light.color == pytest.approx((1.0, 0.5, 0.25))
    assert light.negative == pytest.approx(0.445, abs=2e-3)  # a sum of four bands rings


@pytest.fixture(scope="module")
def chromium() -> Iterator[Browser]:
    with launched() as browser:
        yield browser


@pytest.fixture
def visited(folder: Path, page: Page, chromium: Browser) -> Iterator[Visit]:
    """The page in a browser, in which nothing may go wrong."""
    assert page.elements
    with visit(chromium, folder / "page.html") as found:
        yield found
    assert found.troubles == []


@pytest.mark.parametrize(("width", "height"), [(390, 844), (1400, 900)])
@pytest.mark.parametrize("scheme", ["dark", "light"])
def test_a_browser_shows_the_page_without_complaint(
    folder: Path,
    page: Page,
    chromium: Browser,
    width: int,
    height: int,
    scheme: Literal["dark", "light"],
) -> None:
    assert page.elements
    with visit(chromium, folder / "page.html", width=width, height=height) as visited:
        visited.page.emulate_media(color_scheme=scheme)
        visited.page.wait_for_selector('.relight-view[data-state="ready"]')
        ground = visited.page.evaluate("getComputedStyle(document.body).backgroundColor")
        assert ground == ("rgb(18, 19, 21)" if scheme == "dark" else "rgb(251, 251, 250)")
        # The first screen is the picture, its verdicts and its lights.
        first = visited.page.evaluate(
            """() => ['.relight-canvas', '.verdict:last-of-type summary', '.relight-hand']
                .map((name) => document.querySelector(name).getBoundingClientRect().bottom)"""
        )
        assert max(first) <= height
        visited.page.evaluate(
            "document.querySelectorAll('section details').forEach((e) => { e.open = true; })"
        )
        inside = visited.page.evaluate("document.documentElement.scrollWidth")
        broken = visited.page.evaluate(
            "[...document.querySelectorAll('main img')].filter((i) => !i.naturalWidth).length"
        )
        assert visited.page.evaluate("document.images.length") > 20
        visited.page.wait_for_timeout(300)
    assert visited.troubles == []
    assert inside <= width
    assert broken == 0


def test_the_theme_is_chosen_by_a_button_and_remembered(visited: Visit) -> None:
    ground = "getComputedStyle(document.documentElement).colorScheme"
    visited.page.emulate_media(color_scheme="dark")
    assert visited.page.evaluate(ground) == "dark"
    button = visited.page.get_by_role("button", name="Light or dark theme")
    button.click()
    assert visited.page.evaluate(ground) == "light"
    visited.page.reload()
    assert visited.page.evaluate(ground) == "light"
    button.click()
    assert visited.page.evaluate(ground) == "dark"
    visited.page.emulate_media(media="print")
    assert visited.page.evaluate(ground) == "light"


def test_a_link_unfolds_its_section_and_verdicts_close(visited: Visit) -> None:
    lights = visited.page.locator("#lights details").first
    assert lights.get_attribute("open") is None
    visited.page.evaluate("location.hash = 'lights'")
    wait_until(visited.page, "document.querySelector('#lights details').open")
    visited.page.evaluate("window.scrollTo(0, 0)")
    chips = visited.page.locator("details.verdict")
    chips.nth(0).locator("summary").click()
    chips.nth(1).locator("summary").click()
    assert [chips.nth(i).get_attribute("open") for i in range(3)] == [None, "", None]
    visited.page.keyboard.press("Escape")
    assert chips.nth(1).get_attribute("open") is None


@pytest.mark.parametrize(("height", "width"), [(600, 2), (2, 600)])
def test_narrow_pictures_neither_stretch_the_page_nor_vanish(
    chromium: Browser, tmp_path: Path, height: int, width: int
) -> None:
    rng = np.random.default_rng(0)
    normals = np.zeros((height, width, 3))
    normals[..., 2] = 1
    images = rng.random((2, height, width, 3)).astype(np.float32)
    result = decompose(Scene(images, normals, fov=0.0), iterations=1, uncertainty=False)
    write_report(result, tmp_path / "page.html")
    with visit(chromium, tmp_path / "page.html") as opened:
        opened.page.evaluate(
            "document.querySelectorAll('section details').forEach((e) => { e.open = true; })"
        )
        sizes = opened.page.evaluate(
            "[...document.querySelectorAll('.zoom img')].map((e) => e.clientHeight)"
        )
        assert 0 < max(sizes) <= 768
        stage = known(opened.page.locator(".relight-stage").bounding_box())
        assert min(stage["width"], stage["height"]) > 50


def test_pictures_are_enlarged_by_key_and_closed_again(visited: Visit) -> None:
    visited.page.evaluate("document.querySelector('#maps details').open = true")
    button = visited.page.get_by_role("button", name="Enlarge: Map of the recovered albedo")
    button.focus()
    visited.page.keyboard.press("Enter")
    dialog = visited.page.locator("dialog.enlarged")
    assert dialog.is_visible()
    assert dialog.locator("img").get_attribute("alt") == "Map of the recovered albedo"
    visited.page.keyboard.press("Escape")
    assert not dialog.is_visible()


def told_of_surroundings(transport: Transport, path: Path) -> str:
    """What a page says of what surrounds a ball."""
    shown = written(dataclasses.replace(shaded_ball(), transport=transport), path)
    return shown.content.split('id="surroundings"')[1].split("</section>")[0]


@pytest.mark.slow
def test_surroundings_are_drawn(tmp_path: Path, page: Page) -> None:
    assert 'id="surroundings"' not in page.content
    why = "left-out pictures are explained better"
    text = told_of_surroundings(Transport("occlusion", why), tmp_path / "page.html")
    assert text.count("image/svg+xml") == 1
    assert text.count("Relit by") == 8  # four pictures, and what their buttons do
    assert f"block light ({why})" in text
    assert "things up to" in text
    assert "floor" in text


def test_surroundings_that_were_left_out_are_told(tmp_path: Path) -> None:
    scores = {"left_out_occlusion": -3.9, "left_out_pixels": 400.0}
    why = "left-out pictures are explained no better with surroundings"
    none = Transport("none", why, None, scores)
    text = told_of_surroundings(none, tmp_path / "page.html")
    assert why in text
    assert "<svg" not in text
    assert "all light reaches every surface" in text


def test_depth_is_a_map_with_its_range(tmp_path: Path, page: Page) -> None:
    assert "Map of the depth" not in page.content
    scene, result = in_memory()
    depth = np.broadcast_to(np.linspace(2, 4, SIZE, dtype=np.float32), (SIZE, SIZE)).copy()
    depth[3, 4] = np.nan
    shown = written(dataclasses.replace(result, depth=depth), tmp_path / "page.html", scene)
    [image] = [one for one in shown.all("img") if one.attributes["alt"] == "Map of the depth"]
    pixels = np.asarray(decoded(image).convert("RGBA")).astype(int)
    assert pixels[3, 4, 3] == 0  # transparent where it is unknown
    assert (np.diff(pixels[0, :, 1]) >= 0).all()  # from blue, near, to yellow, far
    assert "; transparent where unknown" in shown.text
    assert "depth24" in shown.text.replace(" ", "")  # the key, from 2 to 4
    one_distance = dataclasses.replace(result, depth=np.full_like(depth, 3.0))
    assert "Map of the depth" in written(one_distance, tmp_path / "flat.html", scene).content
