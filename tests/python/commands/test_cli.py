"""The command line: what each command does, prints, writes and returns."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from importlib.metadata import version
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np
import pytest

from command_runs import Ran, done, ran, refused
from pbrfit import InputError, Result, Scene, cli, decompose
from pbrfit.commands.decompose import MOST_USED
from pbrfit.io import images
from pbrfit.model.lighting import Lighting
from pbrfit.result.options import Priors
from pbrfit.synthetic import make_scene
from processes import NOBODY, with_rights
from result_files import FILES, KEYS, WITH_REPORT
from scene_files import FORMATS, LIGHTS, SIZE, room, run, write_folder

FEW = ("--iterations", 0)


def outcome(out: Path) -> Any:
    return json.loads((out / "result.json").read_text("utf-8"))


@pytest.mark.parametrize("form", ["float EXR", "JPEG"])
def test_decompose_tells_what_it_read(tmp_path: Path, form: str) -> None:
    suffix, _, _, color = FORMATS[form]
    folder, out = write_folder(tmp_path / "scene", form), tmp_path / "out"
    found = ran("decompose", folder, "--out", out, *FEW)
    assert found.err == ""  # no progress bar where stderr is no terminal
    assert re.search(rf"{out}: 3 pictures of 16 × 16, model paper, ", found.out)
    assert sorted(path.name for path in out.iterdir()) == WITH_REPORT
    facts = outcome(out)
    assert list(facts) == KEYS
    assert facts["version"] == version("pbrfit")
    assert facts["assumed"]["color"].startswith(color)
    assert facts["assumed"]["fov"] == "60 degrees, from scene.toml"
    assert f"images/light_00{suffix}" in facts["inputs"]
    assert all(re.fullmatch("[0-9a-f]{64}", value) for value in facts["inputs"].values())
    assert Result.load(out).metrics["recon_rmse"] < 0.1
    assert sorted(path.name for path in tmp_path.iterdir()) == ["out", "scene"]


def test_decompose_says_what_it_assumed(tmp_path: Path) -> None:
    folder, out = write_folder(tmp_path / "scene", "8-bit PNG", fov=None), tmp_path / "out"
    fit = ("decompose", folder, "--out", out, "--iterations", 1)
    message = ran(*fit, "--max-size", 8).err
    assert "WARNING" in message
    assert f"{folder}: field of view unknown, so it is fitted (--fov gives it)" in message
    assumed = outcome(out)["assumed"]
    assert assumed["fov"].endswith("degrees, fitted")
    assert outcome(out)["camera"]["how"] == "fitted"
    assert assumed["size"] == "averaged down from 16 × 16 to 8 × 8 pixels"
    assert "% overexposed" in assumed["exposure"]  # the room's brightest pixel is 255
    assert assumed["encoding"] == "8-bit PNG"
    arguments = ("--fov", 40, "--color-space", "linear", "--code-range", "0,255", "--overwrite")
    assert ran(*fit, *arguments).err == ""
    assumed = outcome(out)["assumed"]
    assert assumed["fov"].startswith("40 degrees, asked for")
    assert assumed["color"] == "linear (as asked for)"
    assert "exposure" not in assumed
    assert outcome(out)["fov"] == 40
    assert ran(*fit, "--overwrite", "--quiet") == Ran(0, "", "")
    assert "none: expected a scene folder" in refused(  # errors are shown
        "decompose", tmp_path / "none", "--out", tmp_path / "new", "--quiet"
    )


@pytest.mark.parametrize(
    ("arguments", "options"),
    [
        ((), {"sh_order": 3, "metallic": None, "robust": "auto", "equal_exposures": None}),
        (("--metallic", "free", "--exposures", "as-is"), {"equal_exposures": False}),
        (("--robust", "none", "--exposures", "equal"), {"robust": "none"}),
        (("--sh-order", 2, "--metallic", 0), {"sh_order": 2, "metallic": 0.0}),
        (("--mono-light", "--no-priors"), {"mono_light": True}),
    ],
)
def test_what_is_asked_for_is_done_and_told(
    folder: Path, tmp_path: Path, arguments: Any, options: dict[str, Any]
) -> None:
    out = tmp_path / "out"
    said = done("decompose", folder, "--out", out, *FEW, *arguments, "--verbose")
    facts = outcome(out)
    assert options.items() <= facts["options"].items()
    assert all(f"\nleft out: {entry}\n" in said for entry in facts["left_out"])
    assert all(f" s  {stage['name']}" in said for stage in facts["stages"])
    lighting = Result.load(out).lighting
    assert lighting[:, 9:].any() == (options.get("sh_order") != 2)
    assert (lighting[..., 0] == lighting[..., 2]).all() == ("mono_light" in options)


def test_a_result_is_replaced_only_when_asked(folder: Path, tmp_path: Path) -> None:
    fit = ("decompose", folder, "--out", out := tmp_path / "out", "--iterations")
    done(*fit, 1)
    before = {path.name: path.read_bytes() for path in out.iterdir()}
    assert f"{out}: expected a folder that does not exist yet" in refused(*fit, 2)
    (folder / "images").rename(folder / "away")
    assert run(*fit, 2, "--overwrite") == 2
    assert {path.name: path.read_bytes() for path in out.iterdir()} == before
    (folder / "away").rename(folder / "images")
    done(*fit, 2, "--overwrite")
    assert outcome(out)["iterations"] == 2
    assert sorted(path.name for path in tmp_path.iterdir()) == ["out", "scene"]


@pytest.fixture
def scenes(tmp_path: Path) -> Path:
    for name in ("one", "two"):
        write_folder(tmp_path / "scenes" / name)
    (tmp_path / "scenes" / "notes").mkdir()
    return tmp_path / "scenes"


def test_equal_names_and_taken_outputs_are_refused_before_any_work(
    tmp_path: Path, scenes: Path
) -> None:
    write_folder(tmp_path / "more" / "two")
    out = tmp_path / "out"
    said = refused("decompose", scenes, tmp_path / "more" / "two", "--out", out, *FEW)
    assert "expected different names, found two twice" in said
    assert not out.exists()
    (out / "two").mkdir(parents=True)
    said = refused("decompose", scenes, "--out", out, *FEW)
    assert f"{out / 'two'}: expected a folder that does not exist yet" in said
    assert not (out / "one").exists()


def test_inspect_tells_facts_and_writes_only_the_preview(folder: Path, tmp_path: Path) -> None:
    assert "\nleft out          nothing\n" in done("inspect", folder)
    mask = np.full((SIZE, SIZE), 255, np.uint8)
    mask[:4] = 0
    images.write_png(folder / "mask.png", mask, tag=None)
    preview = tmp_path / "preview.png"
    output = ran("inspect", folder, "--preview", preview)
    assert (output.code, output.err) == (0, "")
    picture = folder / "images" / "light_00.exr"
    before = picture.read_bytes()
    said = refused("inspect", folder, "--preview", picture)
    assert f"{picture}: expected a file that does not exist yet" in said
    assert "--overwrite: goes with --preview" in refused("inspect", folder, "--overwrite")
    assert picture.read_bytes() == before
    for line in (
        "pictures          3 of 16 × 16 pixels",
        "mask              192 pixels used, 75.0 %",
        "facing away       0.0 % of the normals",
        "segments          none",
        "colour            three channels",
        "lights            unknown, will be fitted",
        "ground truth      none",
        "assumed color     linear Rec.709",
        "assumed normals   normals.exr, opengl axes, camera space",
        "assumed fov       60 degrees, from scene.toml",
        f"unknowns          {5 * 192 + 48 * LIGHTS}",
        "time needed       about ",
        "memory needed     about ",
    ):
        assert f"\n{line}" in f"\n{output.out}"
    assert images.read_data(preview).shape[2] == 3
    assert sorted(path.name for path in tmp_path.iterdir()) == ["preview.png", "scene"]


def test_synth_with_textures(tmp_path: Path) -> None:
    scene, maps = tmp_path / "scene", tmp_path / "maps"
    arguments = ("--scene", "detailed", "--size", 8, "--lights", 2, "--textures", maps)
    assert f"{maps}: expected a folder of texture maps, found none" in refused(
        "synth", scene, *arguments
    )
    maps.mkdir()
    for name in ("clay_albedo", "clay_roughness"):
        images.write_png(maps / f"{name}.png", np.full((4, 4, 3), 120, dtype=np.uint8), tag=None)
    assert f"{scene}: detailed, 2 pictures and ground truth" in done("synth", scene, *arguments)
    made = make_scene("detailed", size=8, lights=2, textures=maps)
    np.testing.assert_array_equal(Scene.load(scene).images, made.images.astype(np.float32))
    assert "textures: expected the kind detailed with them, found room" in refused(
        "synth", tmp_path / "other", "--scene", "room", "--textures", maps
    )


def test_synth_then_decompose(tmp_path: Path) -> None:
    scene = tmp_path / "scene"
    arguments = ("--scene", "spheres", "--size", 8, "--lights", 3, "--noise", 0.01, "--seed", 5)
    assert f"{scene}: spheres, 3 pictures and ground truth" in done("synth", scene, *arguments)
    made = make_scene("spheres", size=8, lights=3, noise=0.01, seed=5)
    loaded = Scene.load(scene)
    np.testing.assert_array_equal(loaded.images, made.images.astype(np.float32))
    assert len(list((scene / "truth" / "relight").glob("*.exr"))) == 16
    assert "expected a folder that does not exist yet" in refused("synth", scene)
    assert run("synth", scene, *arguments, "--overwrite", "--sh-order", 2) == 0
    table = done("decompose", scene, "--out", tmp_path / "out", *FEW)
    for name in ("residual", "albedo", "albedo, scaled", "roughness", "metallic", "relight"):
        assert re.search(rf"^{name} +\d\.\d{{4}}  RMSE$", table, re.MULTILINE)
    history = Result.load(tmp_path / "out").history
    assert history.columns[5:] == ("albedo_rmse", "roughness_rmse", "metallic_rmse")


def test_normals_from_flat(folder: Path, tmp_path: Path) -> None:
    assert "normals.exr: expected no normals yet, found some" in refused(
        "normals", folder, "--from", "flat"
    )
    (folder / "normals.exr").rename(folder / "normals.png")  # to be replaced, so never read
    assert run("normals", folder, "--from", "flat", "--overwrite") == 0
    assert not (folder / "normals.png").exists()
    scene = Scene.load(folder)
    np.testing.assert_array_equal(scene.normals, np.broadcast_to([0, 0, 1], (SIZE, SIZE, 3)))
    assert run("normals", tmp_path / "none") == 2


THREE_PRIORS = ("--prior", "smoothness=0.1", "--prior", "monochrome=1", "--prior", "sparsity=1e-3")


@pytest.mark.parametrize(
    ("arguments", "within", "checked"),
    [
        (("--seed", 1), "12 of 12 within", {"loss        albedo": 3, "loss        metallic": 3}),
        (
            ("--sh-order", 2, "--metallic", 0),
            "9 of 9 within",
            {"loss        albedo": 3, "loss        metallic": 0},
        ),
        (("--exposures", "equal"), "12 of 12 within 0.0001\n", {}),
        (THREE_PRIORS, "24 of 24 within", {"smoothness": 6, "monochrome": 3, "sparsity": 3}),
        ((*THREE_PRIORS, "--mono-light"), "within", {"monochrome": 0}),
    ],
)
def test_check_gradients(
    folder: Path, arguments: Any, within: str, checked: dict[str, int]
) -> None:
    said = done("check-gradients", folder, *arguments)
    assert within in said
    for name, count in checked.items():
        assert said.count(f"\n{name} ") == count


@pytest.mark.parametrize(
    ("prior", "complaint"),
    [
        ("cohesin=1", "expected NAME=WEIGHT with one of material, cohesion, smoothness"),
        ("cohesion=", "and a weight of 0 or more, found 'cohesion='"),
    ],
)
def test_unusable_priors_are_named(folder: Path, prior: str, complaint: str) -> None:
    assert complaint in refused("check-gradients", folder, "--prior", prior)


def test_penalties_that_the_solver_does_not_know_are_refused(folder: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    assert refused("decompose", folder, "--out", out, "--prior", "sparsity=0.1") == (
        "pbrfit: prior sparsity: expected --solver lbfgsb, which alone knows it, found "
        "gauss-newton\n"
    )
    assert not out.exists()
    with pytest.raises(InputError, match=r"^prior cohesion: expected --solver lbfgsb"):
        decompose(room(), priors=Priors(cohesion=1.0))


@pytest.mark.slow
def test_demo(tmp_path: Path) -> None:
    out = tmp_path / "demo"
    assert "roughness" in done("demo", out, "--size", 8, "--lights", 3, *FEW)
    made = ["relit.png", "relit.webp", "report.html", "result", "scene"]
    assert sorted(path.name for path in out.iterdir()) == made
    assert sorted(path.name for path in (out / "result").iterdir()) == FILES
    assert Result.load(out / "result").metrics["relight_rmse"] > 0
    assert run("demo", out) == 2
    again = ("--sh-order", 2, "--overwrite", "--quiet")
    assert ran("demo", out, "--size", 8, "--lights", 3, *FEW, *again) == Ran(0, "", "")
    for folder in (out / "result", out / "scene" / "truth"):
        assert not Lighting.load(folder / "lighting.json").coefficients[:, 9:].any()


def test_version_as_a_module() -> None:
    command = [sys.executable, "-m", "pbrfit", "--version"]
    found = subprocess.run(command, capture_output=True, text=True, check=True)
    assert (found.stdout, found.stderr) == (f"pbrfit {version('pbrfit')}\n", "")


def test_alone_it_says_what_to_type() -> None:
    assert [line.split()[0] for line in done().splitlines()] == ["pbrfit"] * 3


def test_pictures_are_decomposed_without_a_verb(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By default the result is named as the folder, and never replaces anything."""
    monkeypatch.chdir(tmp_path)
    assert f"{Path('scene-pbrfit', 'report.html')}: open it in a browser\n" in done(folder, *FEW)
    assert sorted(path.name for path in Path("scene-pbrfit").iterdir()) == WITH_REPORT
    for again in (("scene",), sorted((folder / "images").iterdir())):
        assert "scene-pbrfit: expected a folder that does not exist yet, found" in refused(*again)
    done("scene", *FEW, "--overwrite", "--no-report", "--quiet")
    assert sorted(path.name for path in Path("scene-pbrfit").iterdir()) == FILES
    assert done("scene", *FEW, "--resume").startswith("scene-pbrfit: kept")
    monkeypatch.setattr("pbrfit.batch.scenes.write_report", mock.Mock(side_effect=MemoryError))
    assert "scene-pbrfit: no report: not enough memory" in ran("scene", *FEW, "--overwrite").err
    assert sorted(path.name for path in Path("scene-pbrfit").iterdir()) == FILES
    write_folder(tmp_path / "both" / "one")
    write_folder(tmp_path / "two")
    done("both/one", "two", *FEW)
    assert sorted(path.name for path in Path(f"{tmp_path.name}-pbrfit").iterdir()) == ["one", "two"]
    assert "none/of/them: expected a scene folder, found nothing" in refused("none/of/them")


def test_one_photograph_is_told_about_generate(tmp_path: Path) -> None:
    photo = tmp_path / "one.png"
    images.write_png(photo, np.full((8, 8, 3), 99, np.uint8), tag=None)
    for given in (photo, tmp_path):
        assert "found one photograph, of which `pbrfit generate PHOTO" in refused(given)


def test_help_shows_the_most_used_options_and_help_all_every_one() -> None:
    said = [done("decompose", how) for how in ("--help", "--help-all")]
    few, every = (set(re.findall(r"^  (?:-h, )?--([a-z-]+)", text, re.MULTILINE)) for text in said)
    assert few == {name.replace("_", "-") for name in (*MOST_USED, "help")} < every
    assert f"--help-all shows {len(every - few)} more options" in said[0]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ("fit x", "invalid choice: 'fit' (choose from decompose, "),
        ("decompos x", "invalid choice: 'decompos'; did you mean decompose? see"),
        ("--versoin", "pbrfit: unrecognized option --versoin; did you mean --version? see"),
        ("decompose", "the following arguments are required: PHOTOS"),
        ("decompose s --out o --solver adam", "--solver: invalid choice: 'adam'"),
        ("decompose s --out o --solver gaus-newton", "; did you mean gauss-newton? see"),
        # Said before anything that it leads to, such as a missing --out.
        ("decompose s --ot o", "pbrfit decompose: unrecognized option --ot; did you mean --out?"),
        ("decompose s --out o --frobnicate", "unrecognized option --frobnicate; see"),
        ("decompose s --out o --metallic 0.5", "--metallic: invalid choice: '0.5'"),
        ("decompose s --out o --code-range 250", "--code-range: expected LOW,HIGH, whole"),
        ("normals s --from guess", "expected marigold, pictures, flat, depth:FILE or a file"),
    ],
)
def test_wrong_usage_is_one_line(arguments: str, message: str) -> None:
    line = refused(*arguments.split())
    assert message in line
    assert line.endswith("--help\n")


# Input that cannot be used, through the command: test_scene_folder.py has all kinds of it.


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((), "scene: expected pictures under different lights, found 3 equal ones"),
        (("--fov", "nan"), "fov: expected 0 or degrees"),
        (("--iterations", -1), "iterations: expected a whole number, 0 or more, found -1"),
        (("--jobs", -3), "argument --jobs: expected 1 or more, found -3"),
        (("--patience", "nan"), "argument --patience: expected 0 or more, found nan"),
        (("--white", "1,1,0"), "white: expected a pixel x,y, 0 or more, and perhaps an albedo"),
        (("--threads", -1), "threads: expected 0"),
        (
            ("--same-lamp", "--light", "sh"),
            "--same-lamp: goes with --light lamps or auto, found sh",
        ),
        (("--verbose", "--quiet"), "--verbose: goes with neither --quiet nor --json"),
    ],
)
def test_unusable_input_is_one_line_and_leaves_nothing(
    folder: Path, arguments: Any, message: str
) -> None:
    for path in (folder / "images").iterdir() if not arguments else ():
        images.write_exr(path, {c: np.zeros((SIZE, SIZE)) for c in "RGB"})
    out = folder.parent / "new" / "out"
    assert message in refused("decompose", folder, "--out", out, *arguments)
    assert [path.name for path in folder.parent.iterdir()] == ["scene"]


def test_places_that_cannot_be_written_show_before_the_work(folder: Path) -> None:
    places = [folder / "scene.toml" / "out", folder / "scene.toml"]
    if Path("/proc/self").is_dir():
        places.append(Path("/proc/out"))
    for out in places:
        said = refused("decompose", folder, "--out", out, "--iterations", 10**9)
        assert str(out) in said
    preview = folder / "scene.toml" / "preview.png"
    assert "preview.png" in ran("inspect", folder, "--preview", preview).err


def in_shell(tmp_path: Path, words: str) -> tuple[int, str, str]:
    """Exit code, stdout and stderr of a line for the shell, in which `$pbrfit` is the command."""
    command = ["bash", "-c", words.replace("$pbrfit", f"{sys.executable} -m pbrfit")]
    if "ulimit -u" in words:  # which does not hold for root; for nobody, then, who may read all
        rights = "-all,+dac_override"
        options = ("--ambient-caps", rights, "--reuid", str(NOBODY), "--clear-groups")
        command = [*with_rights(rights, *options), *command]
    found = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    return found.returncode, found.stdout, found.stderr


needs_shell = pytest.mark.skipif(sys.platform != "linux", reason="made for Linux")


@needs_shell
@pytest.mark.slow
@pytest.mark.parametrize("closed", [">&-", "2>&-", ">&- 2>&-"])
def test_closed_streams_change_no_exit_code(tmp_path: Path, closed: str) -> None:
    write_folder(tmp_path / "scene")
    fit = f"$pbrfit decompose scene --out out --iterations 2 --refine-normals off {closed}"
    code, _, errors = in_shell(tmp_path, fit)
    assert code == 0
    assert "Traceback" not in errors
    assert in_shell(tmp_path, f"$pbrfit inspect nothing {closed}")[0] == 2


@needs_shell
def test_whoever_reads_no_more_is_no_failure(tmp_path: Path) -> None:
    write_folder(tmp_path / "scene")
    words = "$pbrfit inspect scene | true; exit ${PIPESTATUS[0]}"
    assert in_shell(tmp_path, words) == (0, "", "")
    code, _, errors = in_shell(tmp_path, "$pbrfit inspect scene >/dev/full")
    assert (code, errors) == (2, "pbrfit: [Errno 28] No space left on device\n")
    fit = "$pbrfit decompose scene --out out --iterations 2 --refine-normals off >/dev/full"
    assert in_shell(tmp_path, fit)[0] == 0  # the table is no output
    assert (tmp_path / "out" / "result.json").exists()


@needs_shell
@pytest.mark.parametrize(
    ("limit", "said"),
    [
        ("-v 350000", "address space (ulimit -v, ulimit -d): expected 512 MiB of memory or more, "),
        ("-s 128", "stack (ulimit -s): expected 4096 KiB of memory or more, found 128 KiB\n"),
        ("-n 15", "open files (ulimit -n): expected 16 or more, found 15\n"),
        ("-u 1", "threads and processes (ulimit -u): expected more, found Resource temporarily"),
        ("-c 0; export SOURCE_DATE_EPOCH=x", "SOURCE_DATE_EPOCH: expected whole seconds since "),
        ("-c 0; ln -s out out", "{}/out: expected a file or folder, found a link to itself\n"),
        ("-c 0; mkdir x; cd x; rmdir ../x", "{}/x: expected the working folder, found it removed"),
    ],
)
def test_too_little_for_the_libraries_is_one_line(tmp_path: Path, limit: str, said: str) -> None:
    write_folder(tmp_path / "scene")
    code, out, errors = in_shell(tmp_path, f"ulimit {limit}; $pbrfit decompose scene --out out")
    assert (code, out) == (2, "")
    assert errors.startswith(f"pbrfit: {said.format(tmp_path)}")
    assert errors.count("\n") == 1
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("part", "error"),
    [
        ("concurrent.futures.process._ExecutorManagerThread.start", RuntimeError),
        ("multiprocessing.queues.Queue._start_thread", RuntimeError),  # by the manager's thread
        ("multiprocessing.util.spawnv_passfds", BlockingIOError),
    ],
)
def test_too_few_threads_are_one_line(
    scenes: Path, part: str, error: type[Exception], capsys: pytest.CaptureFixture[str]
) -> None:
    expected = "pbrfit: threads and processes (ulimit -u): expected more, found"
    with mock.patch(part, side_effect=error("can't start new thread")):
        said = refused("decompose", scenes, "--out", scenes / "out", "--jobs", 2, "--quiet")
    assert said == f"{expected} can't start new thread\n"
    failing = mock.patch("pbrfit.ending.watch", side_effect=BlockingIOError("none"))
    with failing, mock.patch("sys.argv", ["pbrfit", "inspect", "x"]), pytest.raises(SystemExit):
        cli.run()
    assert capsys.readouterr().err == f"{expected} none\n"


def test_an_interruption_while_modules_load_is_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    loading = mock.patch("pbrfit.cli._parser", side_effect=KeyboardInterrupt)
    with loading, mock.patch("sys.argv", ["pbrfit", "--help"]), pytest.raises(SystemExit) as ended:
        cli.run()
    assert (ended.value.code, capsys.readouterr().err) == (130, "pbrfit: interrupted\n")


@needs_shell
@pytest.mark.slow
def test_a_small_soft_limit_of_the_stack_is_raised(tmp_path: Path) -> None:
    write_folder(tmp_path / "scene")
    words = "ulimit -S -s 128; $pbrfit decompose scene --out out --iterations 2 --quiet"
    assert in_shell(tmp_path, words) == (0, "", "")
