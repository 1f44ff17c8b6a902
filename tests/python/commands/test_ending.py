"""A process that is told to end does so while a call keeps the interpreter, and leaves nothing."""

from __future__ import annotations

import contextlib
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from pbrfit.ending import SIGNALS
from processes import running
from scene_files import known, tree

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="Windows has no such signals")

PATIENCE = 60.0
"""Seconds, for a machine under heavy load."""

FOREVER = "sum(range(10**15))"
"""A call that keeps the interpreter lock, and during which Python hears of no signal."""

BEGIN = """
import signal, sys, time
from pathlib import Path
from pbrfit import _core, ending
from pbrfit.batch.place import of_batch
from pbrfit.io.output import FolderForm, new_file, new_folder, undisturbed, unfinished
for heard in (1, 2, 3): signal.signal(heard, signal.SIG_DFL)  # where tests run under nohup, or "&"
ending.watch()
here, old = Path(sys.argv[1]), FolderForm(holds=("old.txt",))
def ready(): print("ready", flush=True)
def told(grace, number):
    signal.set_wakeup_fd(_core.end_when_told(grace, "word", [number]), warn_on_full_buffer=False)
"""

UNFINISHED = {
    "a folder with new parents": (
        "with new_folder(here / 'a' / 'b' / 'out') as folder:\n"
        " (folder / 'deep').mkdir(); (folder / 'deep' / 'half.txt').write_text('half')\n"
    ),
    "a folder that replaces another": (
        "with new_folder(here / 'old', overwrite=True, form=old) as folder:\n"
        " (folder / 'half.txt').write_text('half')\n"
    ),
    "a batch": (
        "with of_batch(here / 'a' / 'b') as batch:\n"
        " with new_folder(here / 'a' / 'b' / 'out', temporaries=batch) as folder:\n"
        "  (folder / 'half.txt').write_text('half')\n "
    ),
    "a batch that replaces": (
        "with of_batch(here) as batch:\n"
        " with new_folder(here / 'old', overwrite=True, temporaries=batch, form=old) as folder:\n"
        "  (folder / 'half.txt').write_text('half')\n "
    ),
    "a file": ("with new_file(here / 'a' / 'out.txt') as file:\n file.write_text('half')\n"),
    "a file that replaces another": (
        "with new_file(here / 'old' / 'old.txt', overwrite=True) as file:\n"
        " file.write_text('half')\n"
    ),
    "between the renames": (
        "with unfinished(here / 'new', aside=(here / 'aside', here / 'old')):\n"
        " (here / 'old').rename(here / 'aside')\n"
        " (here / 'new').mkdir()\n"
    ),
    "after the renames": (
        "with unfinished(here / 'new', aside=(here / 'aside', here / 'old')):\n"
        " (here / 'aside').mkdir(); (here / 'aside' / 'older.txt').write_text('older')\n"
    ),
}


@contextlib.contextmanager
def ready(script: str, folder: Path) -> Iterator[subprocess.Popen[str]]:
    """A process that has said "ready"."""
    with running(sys.executable, "-c", BEGIN + script, folder) as process:
        assert known(process.stdout).readline() == "ready\n", process.communicate(timeout=PATIENCE)
        yield process


@pytest.fixture
def here(tmp_path: Path) -> Path:
    (tmp_path / "old").mkdir()
    (tmp_path / "old" / "old.txt").write_text("old")
    return tmp_path


@pytest.mark.slow
@pytest.mark.parametrize("work", UNFINISHED)
@pytest.mark.parametrize("number", SIGNALS)
def test_what_is_unfinished_goes_away_while_a_call_keeps_the_interpreter(
    here: Path, work: str, number: signal.Signals
) -> None:
    before = tree(here)
    # Between "ready" and the call Python may have its turn: then the call goes on all the same.
    script = "for one in ending.SIGNALS: signal.signal(one, lambda *_: None)\n"
    with ready(script + UNFINISHED[work] + f" ready(); {FOREVER}\n", here) as process:
        process.send_signal(number)
        _, stderr = process.communicate(timeout=PATIENCE)
    assert process.returncode == 128 + number
    assert stderr == "pbrfit: interrupted; no unfinished result was left behind\n"
    assert tree(here) == before


def test_the_second_signal_does_not_wait(here: Path) -> None:
    script = (
        "told(1e9, signal.SIGINT)\n"
        "signal.signal(signal.SIGINT, lambda *_: None)\n"
        f"with new_folder(here / 'out'):\n ready(); {FOREVER}\n"
    )
    with ready(script, here) as process:
        process.send_signal(signal.SIGINT)
        with pytest.raises(subprocess.TimeoutExpired):
            process.wait(1.0)
        process.send_signal(signal.SIGINT)
        assert process.wait(PATIENCE) == 130
    assert "out" not in tree(here)


def test_renames_that_belong_together_are_waited_for(here: Path) -> None:
    script = (
        "import threading\n"
        "def late():\n"
        " with new_folder(here / 'out') as folder:\n"
        "  (folder / 'whole.txt').write_text('whole')\n"
        "  rename = Path.rename\n"
        "  def slow(self, target): time.sleep(0.1); return rename(self, target)\n"
        "  Path.rename = slow\n"
        "  told(0.05, signal.SIGTERM)\n"
        "  ready()\n"
        "  signal.raise_signal(signal.SIGTERM)\n"
        "signal.signal(signal.SIGTERM, lambda *_: None)\n"
        "late()\n"
        "time.sleep(60)\n"
    )
    with ready(script, here) as process:
        assert process.wait(PATIENCE) == 128 + signal.SIGTERM
    # Python had its turn before the process was ended, in the middle of what belongs together.
    assert tree(here)["out/whole.txt"] == "whole"
    assert not list(here.glob(".pbrfit-*"))


def test_a_forked_child_ends_without_its_parent(here: Path) -> None:
    script = (
        "import os\n"
        "signal.signal(signal.SIGTERM, lambda *_: os._exit(3))\n"
        "child = os.fork()\n"
        "if not child: time.sleep(60)\n"
        "time.sleep(0.2)\n"
        "os.kill(child, signal.SIGTERM)\n"
        "assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 3\n"
        "ready()\n"
        "time.sleep(2 * ending.GRACE)\n"
    )
    with ready(script, here) as process:
        assert process.wait(PATIENCE) == 0


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_the_command_says_so_once(here: Path, number: signal.Signals) -> None:
    script = (
        "from pbrfit import cli\n"
        "from pbrfit.commands import decompose\n"
        "def fit(*_):\n"
        " with new_folder(here / 'a' / 'out'):\n"
        "  ready(); time.sleep(60)\n"
        "decompose.run = fit\n"
        "sys.argv = ['pbrfit', 'decompose', 'x', '--out', 'y']; cli.run()\n"
    )
    with ready(script, here) as process:
        process.send_signal(number)
        _, stderr = process.communicate(timeout=PATIENCE)
    assert process.returncode == 128 + number
    assert stderr == "pbrfit: interrupted; no unfinished result was left behind\n"
    assert tree(here) == {"old": "", "old/old.txt": "old"}
