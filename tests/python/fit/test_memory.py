"""What is said about memory before a fit, against what fits take."""

from __future__ import annotations

import dataclasses
import logging
import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import pbrfit
from pbrfit._core import InputError
from pbrfit.fit import compare, memory
from pbrfit.fit.compare import Choice
from pbrfit.fit.left_out import Explanation
from pbrfit.fit.memory import FitMemory
from pbrfit.fit.parameters import ParameterLayout
from pbrfit.fit.settings import TRANSPORT_WHOLE_PIXELS_MAX, WHOLE_PIXELS_MAX
from pbrfit.result.options import SOLVERS, Solver

GIB = 2**30

FIT = """
import sys

import pbrfit
from pbrfit.batch.process_memory import forget_peak, status_kib
from pbrfit.fit import memory
from pbrfit.fit.parameters import ParameterLayout
from pbrfit.synthetic import make_scene

solver, refine, threads = *sys.argv[1:3], int(sys.argv[3])


def room(size, lights):
    found = make_scene("room", size=size, lights=lights, noise=0.01, held_out=1)
    return pbrfit.Scene(images=found.images, normals=found.normals, fov=found.fov)

scene = room(256, 16)
pbrfit.decompose(room(16, 4), iterations=3)  # imports
forget_peak()
before = status_kib("VmRSS")
options = {"solver": solver, "refine_normals": refine, "light": "sh", "iterations": 30}
pbrfit.decompose(scene, threads=threads, **options)
layout, refines = ParameterLayout.of(scene), refine == "on"
said = memory.of_fit(layout, solver, held=0, refine_normals=refines, threads=threads)
print(1024 * (status_kib("VmHWM") - before), said.further)
"""


def scene_of(size: int, pictures: int) -> pbrfit.Scene:
    normals = np.zeros((size, size, 3))
    normals[..., 2] = 1
    images = np.random.default_rng(0).random((pictures, size, size, 3), dtype=np.float32)
    return pbrfit.Scene(images=images, normals=normals, fov=30.0)


def taken_and_said(script: str, *arguments: str) -> tuple[int, int]:
    """The two numbers that a process of its own prints."""
    command = [sys.executable, "-c", script, *arguments]
    found = subprocess.run(command, check=True, capture_output=True, text=True).stdout.split()
    return int(found[0]), int(found[1])


def needed_by(scene: pbrfit.Scene, solver: Solver = "gauss-newton", **way: Any) -> FitMemory:
    layout = ParameterLayout.of(scene)
    return memory.of_fit(layout, solver, held=memory.bytes_of(scene), **way)


@pytest.fixture
def system(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A system of our own, which says nothing yet."""
    monkeypatch.setattr(memory, "ROOT", tmp_path)
    monkeypatch.delattr(os, "sysconf")
    return tmp_path


def write(path: Path, text: str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)


class TestAvailable:
    def test_is_unknown_where_the_system_says_nothing(self, system: Path) -> None:
        assert not list(system.iterdir())
        assert memory.available() is None

    def test_is_what_the_machine_has_left(self, system: Path) -> None:
        write(system / "proc/meminfo", "MemTotal: 9000 kB\nMemFree: 5 kB\nMemAvailable: 4000 kB\n")
        assert memory.available() == 4000 * 1024

    @pytest.mark.parametrize("limited", ["jobs/mine", "jobs", "."])
    def test_is_what_the_nearest_to_its_limit_of_all_groups_allows(
        self, system: Path, limited: str
    ) -> None:
        write(system / "proc/meminfo", f"MemAvailable: {8 * 2**20} kB\n")
        write(system / "proc/self/cgroup", "0::/jobs/mine\n")
        for folder in ("jobs/mine", "jobs", "."):
            of_group = system / "sys/fs/cgroup" / folder
            most = 3 * GIB if folder == limited else "max"
            write(of_group / "memory.max", f"{most}\n")
            write(of_group / "memory.current", f"{2 * GIB}\n")
            write(of_group / "memory.stat", f"anon 7\ninactive_file {GIB // 2}\n")
        assert memory.available() == 3 * GIB - 2 * GIB + GIB // 2

    def test_knows_groups_of_the_first_version(self, system: Path) -> None:
        write(system / "proc/self/cgroup", "5:cpu:/a\n4:memory:/of/a/container\n0::/\n")
        of_group = system / "sys/fs/cgroup/memory"
        write(of_group / "memory.limit_in_bytes", f"{4 * GIB}\n")
        write(of_group / "memory.usage_in_bytes", f"{GIB}\n")
        assert memory.available() == 3 * GIB

    def test_is_nothing_in_a_group_beyond_its_limit(self, system: Path) -> None:
        write(system / "proc/self/cgroup", "0::/\n")
        write(system / "sys/fs/cgroup/memory.max", "1000")
        write(system / "sys/fs/cgroup/memory.current", "2000")
        assert memory.available() == 0

    @pytest.mark.skipif(sys.platform != "linux", reason="other systems may not say")
    def test_of_this_machine_is_between_nothing_and_all(self) -> None:
        free = memory.available()
        assert free is not None
        assert 0 < free <= os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")


class TestCheck:
    def needed(self, further: float) -> FitMemory:
        return FitMemory(scene=GIB, fit=round(further))

    def test_refuses_a_fit_that_there_is_no_memory_for(
        self, system: Path, caplog: pytest.LogCaptureFixture
    ) -> None:
        write(system / "proc/meminfo", f"MemAvailable: {3 * 2**20} kB\n")
        memory.check("lbfgsb", self.needed(3 * GIB))
        caplog.clear()
        with pytest.raises(InputError) as refused:
            memory.check("lbfgsb", self.needed(3 * GIB + 1e9))
        assert str(refused.value) == (
            "solver lbfgsb: expected 3.9 GiB of memory to be available, found 3.0 GiB; use smaller "
            "or fewer pictures; solver gauss-newton needs less"
        )
        assert not caplog.records
        with pytest.raises(InputError, match=r"^solver gauss-newton: .* or fewer pictures$"):
            memory.check("gauss-newton", self.needed(4 * GIB))

    def test_says_what_a_large_fit_needs(
        self, system: Path, caplog: pytest.LogCaptureFixture
    ) -> None:
        write(system / "proc/meminfo", f"MemAvailable: {3 * 2**20} kB\n")
        with caplog.at_level(logging.WARNING, "pbrfit"):
            memory.check("gauss-newton", self.needed(GIB))
            assert not caplog.records
            memory.check("gauss-newton", self.needed(1.5 * GIB))
        expected = "solver gauss-newton needs about 1.5 GiB of memory; 3.0 GiB are available"
        assert [record.getMessage() for record in caplog.records] == [expected]

    def test_refuses_nothing_where_the_memory_is_unknown(
        self, system: Path, caplog: pytest.LogCaptureFixture
    ) -> None:
        assert not list(system.iterdir())
        memory.check("lbfgsb", self.needed(1e15))
        assert "available" not in caplog.text


class TestRefiningNormals:
    """With less memory than refining takes."""

    @pytest.fixture
    def scene(self, system: Path) -> pbrfit.Scene:
        scene = scene_of(16, 4)
        held = needed_by(scene).further
        both = needed_by(scene, refine_normals=True).further
        assert held < both
        write(system / "proc/meminfo", f"MemAvailable: {(held + both) // 2048} kB\n")
        return scene

    def test_is_left_out_where_it_is_optional(
        self, scene: pbrfit.Scene, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        turned = Choice(Explanation(None, "sh", 0.0, "none", free_normals=True), None)
        monkeypatch.setattr(compare, "choose", lambda *_, **__: turned)
        found = pbrfit.decompose(scene, iterations=2, uncertainty=False).refinement
        assert not found.refined
        assert re.fullmatch(r"it needs .* of memory, and .* are available", found.why)

    def test_is_refused_where_it_was_asked_for(self, scene: pbrfit.Scene) -> None:
        with pytest.raises(InputError, match=r"; refine_normals off needs \d+ MiB less$"):
            pbrfit.decompose(scene, iterations=2, refine_normals="on")


TABLES = """
import sys

import numpy as np

import pbrfit
from pbrfit.batch.process_memory import forget_peak, status_kib
from pbrfit.fit import memory
from pbrfit.fit.objective import Objective
from pbrfit.fit.parameters import ParameterLayout
from pbrfit.fit.transport import Surrounded
from pbrfit.transport.decision import Transport
from pbrfit.transport.scenery import Scenery

kind, model = sys.argv[1:]
size = 192
images = np.random.default_rng(0).random((16, size, size, 3), dtype=np.float32)
depth = np.ones((size, size), np.float32)
depth[60:90, 60:90] = 0.8
normals = np.zeros((size, size, 3))
normals[..., 2] = 1
scene = pbrfit.Scene(images=images, normals=normals, fov=50.0, depth=depth)
surrounded = Surrounded(
    scene, Transport(kind), Scenery(depth, normals, scene.valid, None, scene.fov)
)

objective = Objective(scene, model=model)
surrounded.tables(objective, np.arange(100, dtype=np.uint64), rays=8)  # imports
vars(surrounded).pop("images", None)
forget_peak()
before = status_kib("VmRSS")
objective = objective.among(surrounded.tables(objective, rays=8))
layout = ParameterLayout.of(scene)
said = memory.of_fit(layout, "gauss-newton", held=0, transport=kind, model=model)
print(1024 * (status_kib("VmHWM") - before), said.tables)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="other systems do not tell the peak")
def test_tables_of_surroundings_take_what_is_said() -> None:
    taken, said = taken_and_said(TABLES, "bounce", "principled")
    assert 0.8 * said < taken < 1.25 * said


class TestTablesInPlans:
    def plan(self, pixels: int, transport: Any = "auto") -> memory.Plan:
        layout = dataclasses.replace(
            ParameterLayout.of(scene_of(8, 3)), valid=np.broadcast_to(np.True_, (1, pixels))
        )
        return memory.plan(
            layout, "gauss-newton", held=0, refine_normals=False, transport=transport
        )

    @pytest.mark.usefixtures("system")
    def test_scenes_with_them_go_to_tiles_earlier(self) -> None:
        most = TRANSPORT_WHOLE_PIXELS_MAX
        assert not self.plan(most).tiled
        assert self.plan(most + 1).tiled
        assert not self.plan(most + 1, "none").tiled
        assert self.plan(WHOLE_PIXELS_MAX + 1, "none").tiled

    def test_advice_is_to_do_without(self, system: Path) -> None:
        write(system / "proc/meminfo", "MemAvailable: 10 kB\n")
        needed = self.plan(1000).needed
        with pytest.raises(InputError, match=r"; transport none needs \d+ MiB less$"):
            memory.check("gauss-newton", needed)


class TestPrediction:
    def test_keeps_gauss_newton_below_eight_times_the_pictures(self) -> None:
        """16 pictures, two threads: at most 8 times their own bytes, and 4 MP within 8 GiB."""
        size, pictures = 512, 16
        scene = scene_of(size, pictures)
        needed = needed_by(scene, threads=2)
        own = pictures * size**2 * 12
        assert needed.peak < 8 * own
        assert needed.peak * (2048 / size) ** 2 < 8 * GIB
        assert needed_by(scene, "lbfgsb", threads=2).peak > 1.5 * needed.peak

    @pytest.mark.parametrize("solver", SOLVERS)
    def test_counts_refining_normals_apart(self, solver: Solver) -> None:
        """2 MP with 16 pictures within 8 GiB."""
        size = 512
        scene = scene_of(size, 16)
        held = needed_by(scene, solver)
        refined = needed_by(scene, solver, refine_normals=True)
        assert held.refining == 0
        assert refined.peak == held.peak + refined.refining
        if solver == "gauss-newton":
            assert refined.peak * 2e6 / size**2 < 8 * GIB

    @pytest.mark.slow
    @pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
    @pytest.mark.parametrize(
        "arguments",
        [
            ("gauss-newton", "off", "2"),
            ("gauss-newton", "off", "4"),
            ("gauss-newton", "on", "2"),
            ("lbfgsb", "off", "2"),
        ],
        ids=" ".join,
    )
    def test_covers_what_a_process_takes(self, arguments: tuple[str, ...]) -> None:
        taken, said = taken_and_said(FIT, *arguments)
        assert 0.7 * said < taken <= said
