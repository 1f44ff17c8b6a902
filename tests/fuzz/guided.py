"""`python -m fuzz.guided`: inputs that libFuzzer finds, led by the branches they cover.

Python readers run under atheris, one target for each file that we parse ourselves; the picture
decoders run in the programs of `rust/`. Each target begins with the sound files. What fails is kept
as a file, and is read once more when it is named after the target.
"""

from __future__ import annotations

import argparse
import os
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
PROGRAMS = ROOT / "target" / "fuzz"
"""Where cargo leaves the programs of `rust/`; below, in the folder of the system."""

PYTHON = {
    "scene.toml": ("scene", "scene.toml"),
    "lighting.json": ("result", "lighting.json"),
    "history.csv": ("result", "history.csv"),
    "result.json": ("result", "result.json"),
    "prompts.toml": ("prompts", "file.toml"),
    **{name: ("lamps", name) for name in ("lights.lp", "lights.csv", "lights.json")},
    "journal": ("journal", "dusk-1.json"),
    "run.json": ("journal", "run.json"),
    "orphan.png": ("journal", "orphan-2.png"),
    "record": ("record", "records/task.json"),
    "npy": ("maps", "normals.npy"),
    "panorama.hdr": ("hdr", "file.hdr"),
    "picture.jpg": ("jpeg", "file.jpg"),
}
"""Targets under atheris: the reader, and the file of its folders that is damaged. The last two are
for what is Python around the decoders: panoramas, EXIF, profiles."""

RUST = {"exr": ("exr",), "raster": ("png", "jpeg", "tiff", "hdr"), "icc": ()}
"""Programs of `rust/`, and the readers whose sound files they begin with."""

# libFuzzer's clock is that of the wall, so a busy machine needs more than the 5 s of `worker`.
LIMITS = ("-timeout=20", "-rss_limit_mb=3000", "-print_final_stats=1", "-verbosity=1")


@dataclass(frozen=True)
class Outcome:
    """What a target came to: runs, covered branches of how many, and what failed."""

    name: str
    runs: int
    covered: int
    branches: int
    failure: str


def main(arguments: Sequence[str] | None = None) -> int:
    """Exit code: 0 if nothing failed."""
    from fuzz.worker import fast_folder

    options = _options(arguments)
    with fast_folder():
        if options.target is None:
            return _fuzz(options)
        return subprocess.run([*_command(options.target), *options.files], check=False).returncode


def _fuzz(options: argparse.Namespace) -> int:
    names = options.only or [*PYTHON, *RUST]
    if find_spec("atheris") is None:
        print("no atheris: going on without the Python targets")
        names = [name for name in names if name not in PYTHON]
    with ThreadPoolExecutor(options.jobs) as pool:
        outcomes = list(pool.map(lambda name: _run(name, options), names))
    print(f"{'target':16}{'runs':>10}{'branches covered':>20}")
    for one in outcomes:
        covered = f"{one.covered} of {one.branches}" if one.branches else str(one.covered)
        print(f"{one.name:16}{one.runs:10}{covered:>20}  {one.failure or 'ok'}")
    return 1 if any(one.failure for one in outcomes) else 0


def _options(arguments: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m fuzz.guided", description=__doc__)
    parser.add_argument("--seconds", type=int, default=60, help="for each target")
    parser.add_argument("--jobs", type=int, default=2, help="targets at the same time")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", nargs="+", choices=[*PYTHON, *RUST], help="only these targets")
    parser.add_argument("--out", type=Path, default=Path("out/fuzz"), help="for what fails")
    parser.add_argument("--target", choices=[*PYTHON, *RUST], help="read FILE again")
    parser.add_argument("files", nargs="*", type=Path, metavar="FILE")
    return parser.parse_args(arguments)


def _run(name: str, options: argparse.Namespace) -> Outcome:
    """Let libFuzzer work on a target in a process of its own."""
    corpus = options.out / "corpus" / name
    shutil.rmtree(corpus, ignore_errors=True)  # equal seeds, equal beginnings
    corpus.mkdir(parents=True)
    for k, data in enumerate(_sound(name)):
        (corpus / f"sound-{k}").write_bytes(data)
    prefix = options.out / f"{name}-"
    limits = [*LIMITS, f"-max_total_time={options.seconds}", f"-seed={options.seed}"]
    command = [*_command(name), *limits, f"-artifact_prefix={prefix}", f"-dict={_words(options)}"]
    done = subprocess.run(
        [*command, str(corpus)], capture_output=True, text=True, errors="replace", check=False
    )
    output = done.stdout + done.stderr
    (options.out / f"{name}.log").write_text(output, encoding="utf-8")

    def last(pattern: str) -> int:
        found = re.findall(pattern, output)
        return int(found[-1]) if found else 0

    failure = ""
    if done.returncode != 0:
        kept = re.findall(r"Test unit written to (\S+)", output)
        failure = f"failed: {kept[-1] if kept else options.out / f'{name}.log'}"
    return Outcome(
        name,
        last(r"stat::number_of_executed_units: *(\d+)"),
        last(r"cov: (\d+)"),
        last(r"\((\d+) (?:inline 8-bit counters|PCs)\)"),
        failure,
    )


def _command(name: str) -> list[str]:
    if name in PYTHON:
        return [sys.executable, "-c", f"from fuzz.guided import begin; begin({name!r})"]
    found = sorted(PROGRAMS.glob(f"*/release/{name}"))
    if not found:
        raise SystemExit(f"{PROGRAMS}: expected the program {name}; make test-fuzz builds it")
    return [str(found[0])]


def _sound(name: str) -> list[bytes]:
    from fuzz import seeds
    from fuzz.readers import READERS

    if name == "icc":
        return [seeds.profile()]
    readers = {reader.name: reader for reader in READERS}
    if name in PYTHON:
        reader, target = PYTHON[name]
        return [seed.data for seed in readers[reader].seeds() if seed.target == target]
    return [seed.data for reader in RUST[name] for seed in readers[reader].seeds()]


def _words(options: argparse.Namespace) -> Path:
    """Words that libFuzzer may put in."""
    from fuzz.damage import VALUES

    path: Path = options.out / "words.dict"
    short = [value.encode("utf-8", "surrogatepass") for value in VALUES if 0 < len(value) < 60]
    lines = ["".join(f"\\x{byte:02x}" for byte in value) for value in short]
    text = "".join(f'"{line}"\n' for line in lines)
    # Several targets begin at the same time.
    temporary = path.with_suffix(f".{os.getpid()}-{id(options)}")
    temporary.write_text(text, encoding="ascii")
    temporary.replace(path)
    return path


def begin(name: str) -> None:
    """Be the process of a target under atheris, which ends it without a word to Python."""
    import atheris

    with atheris.instrument_imports(include=["pbrfit", "tomllib"]):
        one = _one(*PYTHON[name])
    atheris.Setup(sys.argv, one)
    atheris.Fuzz()


def _one(reader_name: str, target: str) -> Callable[[bytes], None]:
    """What is called with each input; raises if it comes to something wrong."""
    from fuzz.cases import place
    from fuzz.readers import READERS
    from fuzz.worker import outcome

    [reader] = [reader for reader in READERS if reader.name == reader_name]
    base = next(seed for seed in reader.seeds() if seed.target == target)
    folder = Path(tempfile.mkdtemp())
    file = place(base, folder)

    def one(data: bytes) -> None:
        file.write_bytes(data)
        _, problem = outcome(lambda: reader.read(folder, file), folder, file)
        if problem is not None:
            raise RuntimeError(problem)

    return one


if __name__ == "__main__":
    sys.exit(main())
