"""Signals that end a process: a command unwinds, and where it cannot, its process ends anyway.

Python hears of a signal between two of its own instructions. A call into the core, numpy or a
library may take seconds, so a thread of the core watches as well: half a second after the signal it
takes away what is unfinished (`pbrfit.io.output.unfinished`) and ends the process, whoever keeps
the interpreter (`rust/runtime/ending.rs`).
"""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager

from pbrfit import _core

GRACE = 0.5
"""Seconds that a command has to unwind."""

SIGNALS = tuple(
    getattr(signal, name)
    for name in ("SIGINT", "SIGTERM", "SIGHUP", "SIGQUIT", "SIGXCPU")
    if hasattr(signal, name)
)
"""That end a command: Ctrl-C; a request; a terminal that closes; Ctrl-\\; `ulimit -t`."""

WORD = "interrupted; no unfinished result was left behind"
"""What users are told if the command has nothing better to say."""


class Terminated(SystemExit):
    """A signal but Ctrl-C, as an exception that unwinds the stack."""


@contextmanager
def unwinding_when_told(*, watched: bool) -> Iterator[None]:
    """Let `SIGNALS` unwind the stack as Ctrl-C does, so that nothing half written stays behind.

    If `watched`, by `watch`, only the first signal unwinds. Another one would interrupt what the
    first has brought about; the watcher ends the process at once.
    """
    if threading.current_thread() is not threading.main_thread():
        yield  # only the main thread is told
        return
    told = False

    def end(number: int, _frame: object) -> None:
        nonlocal told
        if told and watched:
            return
        told = True
        raise KeyboardInterrupt if number == signal.SIGINT else Terminated(128 + number)

    usual = signal.SIG_DFL, signal.default_int_handler  # others: who began us wants no end by it
    before = {n: signal.signal(n, end) for n in SIGNALS if signal.getsignal(n) in usual}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def watch() -> None:
    """End this process within `GRACE` after one of `SIGNALS`, at once after a second one.

    For the whole of a process, from its main thread. On Windows it does nothing.
    """
    number = _core.end_when_told(GRACE, f"pbrfit: {WORD}", list(SIGNALS))
    if number is None:
        return
    signal.set_wakeup_fd(number, warn_on_full_buffer=False)
    # A forked child writes into the same file: its signals would end this process.
    os.register_at_fork(after_in_child=_forget_watcher)


def _forget_watcher() -> None:
    if threading.current_thread() is threading.main_thread():
        signal.set_wakeup_fd(-1)
