"""The run from a photograph to a scene folder: journal, resume, review, what is put in place."""

from __future__ import annotations

import json
import os
import re
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from acquire_run import CATALOGUE, SIZE, Counting, Strict, failing, pixels, refusing, write_photo
from pbrfit._core import InputError
from pbrfit.acquire import depth as depths
from pbrfit.acquire.generation import generate
from pbrfit.acquire.generation_report import GenerationReport
from pbrfit.acquire.generators import Request
from pbrfit.acquire.prompts import Catalogue, Prompt
from pbrfit.scene.depth import compared
from pbrfit.scene.scene import Scene
from scene_files import world


@pytest.fixture
def photo(tmp_path: Path) -> Path:
    return write_photo(tmp_path / "photo.png")


Make = Callable[..., GenerationReport]

AGAIN = pytest.mark.parametrize("again", ["resume", "overwrite"])


@pytest.fixture
def make(tmp_path: Path, photo: Path) -> Make:
    """Run with four pictures, flat normals and no review unless asked."""

    def run(generator: Counting, **options: Any) -> GenerationReport:
        options = {"photo": photo, "out": tmp_path / "scene", "catalogue": CATALOGUE, **options}
        options = {"count": 4, "normals": "flat", "fov": 50.0, **options}
        options = {"review": "reviewer" in options, **options}
        return generate(options.pop("photo"), options.pop("out"), generator=generator, **options)

    return run


def reviewed(scene: Path) -> dict[str, Any]:
    content: dict[str, Any] = json.loads((scene / "review.json").read_text(encoding="utf-8"))
    return content


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def asked(generator: Counting) -> list[str]:
    return [request.name for request in generator.asked]


def test_a_scene_folder_holds_the_pictures_the_photo_normals_and_why(
    make: Make, tmp_path: Path
) -> None:
    report = make(Counting())
    scene = tmp_path / "scene"
    made = ["generation", "images", "normals.exr", "review.json", "review.png", "scene.toml"]
    assert names(scene) == made
    assert names(scene / "images") == [*(f"light_{k}.png" for k in range(4)), "photo.png"]
    loaded = Scene.load(scene)
    assert loaded.fov == 50.0
    assert len(loaded.images) == 5
    assert [picture.request.seed for picture in report.accepted] == [0, 1, 2, 3]
    assert reviewed(scene)["totals"] == {
        "asked_for": 4, "accepted": 4, "left_out": 0, "attempts": 4,
        "seconds": 0.0, "usage": {"tokens": 40},
    }  # fmt: skip


@pytest.mark.parametrize(
    ("normals", "depth", "source"),
    [
        ("normals.npy", None, "depth-anything"),
        ("normals.npy", "noisy.npy", "file"),
        ("normals.npy", "normals", "normals"),
        ("normals.npy", "none", None),
        ("depth:true.npy", None, "file"),
    ],
)
def test_depth_is_made_beside_normals_and_agrees_with_them(
    make: Make,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    normals: str,
    depth: str | None,
    source: str | None,
) -> None:
    true, directions = world("room", 3, SIZE, SIZE, 50.0)[:2]
    noisy = true * np.exp(0.05 * np.random.default_rng(0).normal(size=true.shape))
    for name, array in {"true": true, "noisy": noisy, "normals": directions}.items():
        np.save(tmp_path / f"{name}.npy", array)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(depths, "by_depth_anything", lambda *_, **__: (1 / noisy, False, {}))
    make(Counting(), normals=normals, depth=depth)
    record, found = reviewed(tmp_path / "scene")["depth"], Scene.load(tmp_path / "scene").depth
    assert (record and record["source"]) == source
    assert (found is None) == (source is None)
    assert found is None or compared(found, directions, 50.0)[0] < 5  # the noisy one's: 40


def test_pictures_are_in_the_scene_bit_by_bit_and_the_photo_where_it_is_wanted(
    make: Make, tmp_path: Path, photo: Path
) -> None:
    make(Counting())
    scene = tmp_path / "scene"
    np.testing.assert_array_equal(pixels(scene / "images" / "photo.png"), pixels(photo))
    received = pixels(scene / "generation" / "light_2-2.png")
    np.testing.assert_array_equal(pixels(scene / "images" / "light_2.png"), received)
    make(Counting(), with_photo=False, overwrite=True)
    assert "photo.png" not in names(scene / "images")


@pytest.mark.parametrize("stop", [KeyboardInterrupt(), InputError("service: gone"), MemoryError()])
@pytest.mark.parametrize("after", [0, 2])
def test_a_run_that_stops_keeps_what_came_and_resume_asks_for_the_rest(
    make: Make, tmp_path: Path, stop: BaseException, after: int
) -> None:
    first, scene = Counting(before=failing(after, stop)), tmp_path / "new" / "scene"
    told = InputError if after and isinstance(stop, Exception) else type(stop)
    with pytest.raises(told) as stopped:
        make(first, out=scene)
    if after == 0:
        assert "--resume" not in str(stopped.value)
        assert not (tmp_path / "new").exists()
        return
    kept = r"2 answers are kept in .*generation, and --resume goes on"
    assert re.search(kept, str(stopped.value))
    assert names(scene) == ["generation"]
    nowhere = {"out": scene, "normals": str(tmp_path / "no_such.exr")}
    with pytest.raises((InputError, OSError), match=r"no_such\.exr"):  # changes nothing
        make(Counting(quality="other"), overwrite=True, **nowhere)
    with pytest.raises(FileExistsError, match=r"found a run that has not ended; --resume goes on"):
        make(Counting(), out=scene)
    second = Counting()
    make(second, out=scene, resume=True)
    assert asked(first) == ["light_0", "light_1"]
    assert asked(second) == ["light_2", "light_3"]
    assert len(Scene.load(scene).images) == 5
    with pytest.raises(FileExistsError, match=r"found a scene; --resume goes on"):
        make(second, out=scene)
    assert len(second.asked) == 2
    make(Counting(), out=tmp_path / "at once")
    for path in (scene / "images").iterdir():
        assert path.read_bytes() == (tmp_path / "at once" / "images" / path.name).read_bytes()


def test_what_a_killed_run_worked_in_goes_away_and_is_no_scene(make: Make, tmp_path: Path) -> None:
    left = tmp_path / "scene" / ".pbrfit-generate-0123456789ab"
    (left / "images").mkdir(parents=True)
    make(Counting())
    assert not left.exists()


@pytest.mark.skipif(os.name != "posix", reason="no such lock")
@AGAIN
def test_a_second_run_at_the_same_time_pays_for_nothing(make: Make, again: str) -> None:
    second = Counting()

    def at_once(calls: int, request: Request) -> None:
        del request
        if calls == 1:
            with pytest.raises(InputError, match=r"scene: expected no other run at work there"):
                make(second, **{again: True})

    first = Counting(before=at_once)
    make(first)
    assert len(first.asked) == 4
    assert second.asked == []


@AGAIN
def test_pictures_that_somebody_added_are_not_taken_away(
    make: Make, tmp_path: Path, again: str
) -> None:
    make(Counting())
    own = tmp_path / "scene" / "images" / "mine.png"
    own.write_bytes((tmp_path / "photo.png").read_bytes())
    with pytest.raises(FileExistsError, match=r"mine.png: expected only pictures that"):
        make(Counting(), **{again: True})
    assert own.exists()
    own.rename(own.with_name(".DS_Store"))
    make(Counting(), **{again: True})


def test_more_pictures_and_further_prompts_reuse_those_that_are_there(
    make: Make, tmp_path: Path
) -> None:
    make(Counting(), count=3)
    longer = Catalogue("Keep all.", (*CATALOGUE.lighting[:4], Prompt("new", "New.")), "no")
    more, again = Counting(), Counting()
    make(more, count=5, catalogue=longer, resume=True)
    assert asked(more) == ["light_3", "new"]
    assert len(names(tmp_path / "scene" / "images")) == 6
    changed = Catalogue("Keep all.", (Prompt("light_0", "Dusk."), *longer.lighting[1:]), "no")
    make(again, count=5, catalogue=changed, resume=True)  # a rewritten prompt: the old one stays
    assert [request.prompt for request in again.asked] == ["Keep all. Dusk."]
    assert {"light_0-0.png", "light_0-0-2.png"} <= set(names(tmp_path / "scene" / "generation"))


@pytest.mark.parametrize(
    ("quality", "options", "message"),
    [
        ("better", {}, r"found quality 'good' \(now 'better'\); --overwrite"),
        ("good", {"photo": "other.png"}, "found another photo"),
        ("good", {"max_size": 80}, r"found photo of 160 × 160 pixels \(now 80 × 80\)"),
        ("good", {"color_space": "linear"}, "found photo read in another colour space"),
    ],
)
def test_resume_of_something_else_says_what_differs(
    make: Make, tmp_path: Path, quality: str, options: dict[str, Any], message: str
) -> None:
    write_photo(tmp_path / "other.png", 80)
    photo = write_photo(tmp_path / "large.png", 160)
    make(Counting(), photo=photo)
    options = {**options, "photo": tmp_path / options.get("photo", "large.png")}
    with pytest.raises(InputError, match=message):
        make(Counting(quality=quality), resume=True, **options)


def test_overwrite_takes_other_settings_and_keeps_what_was_received(
    make: Make, tmp_path: Path
) -> None:
    make(Counting())
    received = set(names(tmp_path / "scene" / "generation"))
    other = Counting(quality="better")
    make(other, overwrite=True)
    assert len(other.asked) == 4
    assert received < set(names(tmp_path / "scene" / "generation"))
    back = Counting()
    make(back, overwrite=True)
    assert back.asked == []


def test_a_folder_of_somebodys_pictures_is_never_touched(make: Make, tmp_path: Path) -> None:
    theirs = tmp_path / "scene" / "images" / "mine.png"
    theirs.parent.mkdir(parents=True)
    theirs.write_bytes(b"dear to me")
    for flags in ({}, {"overwrite": True}, {"resume": True}):
        with pytest.raises(FileExistsError, match=r"expected an empty folder, or one of `pbrfit"):
            make(Counting(), **flags)
    assert theirs.read_bytes() == b"dear to me"
    assert names(tmp_path / "scene") == ["images"]


def test_a_refused_prompt_is_left_out_and_never_asked_for_again(make: Make, tmp_path: Path) -> None:
    report = make(Counting(before=refusing("light_1")), reviewer=Strict())
    assert [picture.request.name for picture in report.left_out] == ["light_1"]
    [picture] = [each for each in reviewed(tmp_path / "scene")["pictures"] if not each["accepted"]]
    assert picture["reason"] == "refused by moderation: not this one"
    assert picture["file"] is None
    assert picture["attempts"][0]["received"] is None
    again = Counting()
    report = make(again, resume=True)
    assert again.asked == []
    assert [picture.request.name for picture in report.left_out] == ["light_1"]


def test_what_the_review_refuses_is_asked_for_with_another_seed(make: Make, tmp_path: Path) -> None:
    generator = Counting()
    make(generator, reviewer=Strict(alone=[1, 2]))
    assert [request.seed for request in generator.asked] == [0, 1, 1001, 2001, 2, 3]
    picture = reviewed(tmp_path / "scene")["pictures"][1]
    assert [attempt["accepted"] for attempt in picture["attempts"]] == [False, False, True]
    assert picture["attempts"][0]["reason"] == "refused by alone"
    assert picture["attempts"][0]["checks"][0] == {
        "name": "alone", "value": 2.0, "bound": 1.0, "passed": False, "note": "refused by alone",
    }  # fmt: skip
    assert [check["name"] for check in picture["attempts"][2]["together"]] == ["company"]


def test_a_picture_that_stays_refused_is_left_out_after_so_many_attempts(
    make: Make, tmp_path: Path
) -> None:
    generator = Counting()
    report = make(generator, reviewer=Strict(alone=[0, 1]), regenerate=1)
    assert [request.seed for request in generator.asked] == [0, 1000, 1, 2, 3]
    assert [picture.reason for picture in report.left_out] == ["refused by alone"]
    assert "light_0.png" not in names(tmp_path / "scene" / "images")
    assert {"light_0-0.png", "light_0-1000.png"} <= set(names(tmp_path / "scene" / "generation"))


def test_what_does_not_agree_with_the_others_is_asked_for_again_and_judged_with_them(
    make: Make,
) -> None:
    generator, reviewer = Counting(), Strict(company=[(0, 2), (1, 2), (2, 2)])
    report = make(generator, reviewer=reviewer)
    assert [request.seed for request in generator.asked] == [0, 1, 2, 3, 1002, 2002]
    assert reviewer.rounds == 4
    assert [picture.reason for picture in report.left_out] == ["refused by company"]


def test_a_generator_that_has_no_other_pictures_is_asked_once(make: Make) -> None:
    generator = Counting(retries=False)
    report = make(generator, reviewer=Strict(alone=[1], company=[(0, 0)]))
    assert len(generator.asked) == 4
    assert [picture.request.name for picture in report.left_out] == ["light_0", "light_1"]
    again = Counting(retries=False)
    make(again, reviewer=Strict(alone=[1], company=[(0, 0)]), resume=True)
    assert again.asked == []


def test_too_few_pictures_are_no_scene_and_the_review_says_why(make: Make, tmp_path: Path) -> None:
    expected = (
        "scene: expected at least 2 pictures for a scene, found 1 with the photo; left out were "
        "light_0: refused by alone; light_1: refused by alone; and 2 more"
    )
    with pytest.raises(InputError, match=expected):
        make(Counting(), reviewer=Strict(alone=range(12)), regenerate=0)
    scene = tmp_path / "scene"
    assert names(scene) == ["generation", "review.json", "review.png"]
    assert reviewed(scene)["totals"]["accepted"] == 0
    make(Counting(), overwrite=True)
    before = {path: path.read_bytes() for path in scene.iterdir() if path.is_file()}
    with pytest.raises(InputError, match=expected):  # an earlier scene stays as it is
        make(Counting(), reviewer=Strict(alone=range(12)), regenerate=0, overwrite=True)
    assert before == {path: path.read_bytes() for path in before}


def test_a_broken_journal_is_told(make: Make, tmp_path: Path) -> None:
    make(Counting())
    entry = tmp_path / "scene" / "generation" / "light_1-1.json"
    received = entry.with_suffix(".png").read_bytes()
    entry.with_suffix(".png").write_bytes(b"other")
    with pytest.raises(InputError, match=r"light_1-1.png: expected the picture as it was received"):
        make(Counting(), resume=True)
    entry.with_suffix(".png").write_bytes(received)
    lacking = json.loads(entry.read_text())
    del lacking["about"]
    for text in ("", "[]", '{"about": 1}', "{\xe9", json.dumps(lacking)):
        entry.write_text(text, encoding="latin-1")
        with pytest.raises(InputError, match=r"light_1-1.json: expected (an entry of a gen|UTF-8)"):
            make(Counting(), resume=True)


def test_what_cannot_be_shows_before_any_picture(make: Make, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    true, directions = world("room", 3, SIZE, SIZE, 50.0)[:2]
    given = [str(tmp_path / "inverse.npy"), str(tmp_path / "normals.npy")]
    for path, array in zip(given, (1 / true, directions), strict=True):
        np.save(path, array)
    no_place = r"scene: expected a place where a folder can be made"
    of_photo = Catalogue("", (Prompt("photo", "Day."), Prompt("night", "Night.")), "")
    cases: list[tuple[dict[str, Any], str]] = [
        ({"normals": str(tmp_path / "no_such.exr")}, r"no_such\.exr"),
        ({"depth": given[0], "normals": given[1]}, "depth: expected distances, found inverse"),
        ({"depth": given[0]}, "depth: expected normals beside it, found flat ones"),
        ({"out": tmp_path / "file" / "scene"}, no_place),
        ({"catalogue": of_photo, "count": 2}, "photo: expected another name"),
    ]
    if Path("/proc/self").is_dir():
        cases.append(({"out": Path("/proc/scene")}, no_place))
    for options, message in cases:
        generator = Counting()
        with pytest.raises((InputError, OSError), match=message):
            make(generator, **options)
        assert generator.asked == []
        assert not (tmp_path / "scene").exists()


@pytest.mark.skipif(sys.platform != "linux", reason="file names are UTF-8 there")
def test_names_that_are_not_ascii_are_kept(make: Make, tmp_path: Path, photo: Path) -> None:
    for k, name in enumerate(("фото.png", strange := os.fsdecode(b"caf\xe9.png"))):
        scene = tmp_path / "Küche" / f"Szene {k}"
        photo = photo.rename(tmp_path / name)
        make(Counting(), photo=photo, out=scene)
        assert reviewed(scene)["photo"]["file"] == name
        assert len(Scene.load(scene).images) == 5
    with pytest.raises(InputError, match=r"expected names in UTF-8, found 'caf"):
        make(Counting(), photo=photo, catalogue=Catalogue("", (Prompt(strange, "Day."),), ""))


def test_transparent_pixels_are_masked(make: Make, tmp_path: Path, photo: Path) -> None:
    with Image.open(photo) as opaque:
        picture = opaque.convert("RGBA")
    alpha = np.full((picture.height, picture.width), 255, dtype=np.uint8)
    alpha[:, :10] = 0
    picture.putalpha(Image.fromarray(alpha))
    picture.save(tmp_path / "cut.png")
    make(Counting(), photo=tmp_path / "cut.png")
    assert not Scene.load(tmp_path / "scene").valid[:, :10].any()
    assert Scene.load(tmp_path / "scene").valid[:, 10:].all()
