"""Commands in this process: what they say when they end well, and the one line of a refusal."""

from __future__ import annotations

import io
import math
import re
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass
from unittest import mock

from pbrfit.commands import progress
from scene_files import Argument, run


@dataclass(frozen=True)
class Ran:
    """Exit code, stdout and stderr."""

    code: int
    out: str
    err: str


def ran(*arguments: Argument) -> Ran:
    """Run a command and keep what it says, without the lines that tell that it takes long."""
    out, err = io.StringIO(), io.StringIO()
    never = mock.patch.object(progress, "LINE_EVERY", math.inf)  # however busy the machine is
    with never, redirect_stdout(out), redirect_stderr(err):
        code = run(*arguments)
    return Ran(code, out.getvalue(), err.getvalue())


def done(*arguments: Argument) -> str:
    """What a command prints that has to end well."""
    found = ran(*arguments)
    assert found.code == 0, found.err
    return found.out


def refused(*arguments: Argument) -> str:
    """What a command says that has to refuse its input: nothing on stdout, one line on stderr."""
    found = ran(*arguments)
    assert (found.code, found.out) == (2, "")
    assert re.fullmatch(r"pbrfit.*\n", found.err)
    return found.err
