"""Workflows: actions by commit, least rights, artifacts before strangers, the oldest packages."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
WORKFLOWS = sorted((ROOT / ".github" / "workflows").glob("*.yml"))
if not WORKFLOWS:
    pytest.skip("no workflows in a source distribution", allow_module_level=True)

PINNED = re.compile(r"[\w.-]+/[\w.-]+@[0-9a-f]{40} # v\d+(\.\d+){2}")

every = pytest.mark.parametrize("workflow", WORKFLOWS, ids=[path.name for path in WORKFLOWS])


def jobs(workflow: Path) -> dict[str, str]:
    """Text of each job by name."""
    text = workflow.read_text("utf-8").partition("\njobs:\n")[2]
    parts = re.split(r"^  (\w+):\n", text, flags=re.MULTILINE)
    return dict(zip(parts[1::2], parts[2::2], strict=True))


def steps(job: str) -> list[str]:
    return job.partition("    steps:\n")[2].split("      - ")[1:]


@every
def test_actions_are_pinned_by_commit_with_their_version(workflow: Path) -> None:
    used = re.findall(r"uses: *(.*)", workflow.read_text("utf-8"))
    assert used
    assert [one for one in used if not PINNED.fullmatch(one)] == []


def test_an_action_is_the_same_everywhere() -> None:
    pins: dict[str, set[str]] = {}
    for workflow in WORKFLOWS:
        for name, pin in re.findall(r"uses: *(.*)@(.*)", workflow.read_text("utf-8")):
            pins.setdefault(name, set()).add(pin)
    assert {name: found for name, found in pins.items() if len(found) > 1} == {}


@every
def test_jobs_read_and_only_the_publishing_one_proves_who_it_is(workflow: Path) -> None:
    head = workflow.read_text("utf-8").partition("\njobs:\n")[0]
    assert "\npermissions:\n  contents: read\n" in f"{head}\n"
    for name, job in jobs(workflow).items():
        assert ("id-token: write" in job) == (name == "publish")
        assert "write" not in job.replace("id-token: write", "")
        if name == "publish":
            assert "run:" not in job
            assert "actions/checkout@" not in job


@every
def test_checkouts_leave_no_credentials(workflow: Path) -> None:
    found = [s for job in jobs(workflow).values() for s in steps(job) if "actions/checkout@" in s]
    assert found
    assert all("persist-credentials: false" in step for step in found)


def test_wheels_are_handed_over_before_packages_of_others_are_there() -> None:
    for name in ("wheel", "sdist"):
        found = steps(jobs(ROOT / ".github" / "workflows" / "wheels.yml")[name])
        kept = next(i for i, step in enumerate(found) if "actions/upload-artifact@" in step)
        assert not [step for step in found[:kept] if "pip" in step]
        assert [step for step in found[kept:] if "pip" in step]


def test_there_are_wheels_for_every_platform_and_the_free_threaded_python() -> None:
    job = jobs(ROOT / ".github" / "workflows" / "wheels.yml")["wheel"]
    found = set(re.findall(r"name: (\S+), runner", job))
    linux = {f"{libc}linux-{kind}" for libc in ("many", "musl") for kind in ("x86_64", "aarch64")}
    assert found == linux | {"macos-x86_64", "macos-arm64", "windows-x64", "windows-arm64"}
    assert re.search(r'python: \["3\.11", "3\.\d+t"\]', job)


def test_the_oldest_packages_are_those_that_are_allowed() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
    pins = dict(re.findall(r"^([\w-]+)==(\S+)$", (ROOT / "tests/oldest.txt").read_text(), re.M))
    recipe = (ROOT / "packaging" / "conda" / "recipe.yaml").read_text("utf-8")
    cargo = tomllib.loads((ROOT / "Cargo.toml").read_text("utf-8"))["package"]
    assert f'version: "{cargo["version"]}"' in recipe
    for requirement in project["dependencies"]:
        name, _, least = requirement.partition(">=")
        assert pins[name] == least + ".0" * (2 - least.count("."))
        assert f"- {name.replace('matplotlib', 'matplotlib-base')} >={least}\n" in recipe
