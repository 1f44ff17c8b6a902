"""A call in a process of its own: nothing that ran before it takes its time or its memory."""

from __future__ import annotations

import multiprocessing
from collections.abc import Callable
from multiprocessing.connection import Connection
from typing import Any

LEAVE_S = 10.0
"""How long a process may take to end after its answer."""


def call(function: Callable[..., Any], *arguments: Any) -> Any:
    """Call a function of a module in a fresh process and give what it returns.

    Raises
    ------
    RuntimeError
        With the error's name and message if it raised, or the exit code if the process died.
    """
    context = multiprocessing.get_context("spawn")
    here, there = context.Pipe()
    process = context.Process(target=_answer, args=(there, function, arguments))
    process.start()
    there.close()
    try:
        answer, error = here.recv()
    except EOFError:
        process.join()
        raise RuntimeError(f"its process ended with code {process.exitcode}") from None
    except BaseException:
        process.terminate()
        raise
    finally:
        process.join(LEAVE_S)
        if process.is_alive():  # threads of a library that do not end
            process.kill()
            process.join()
        here.close()
    if error:
        raise RuntimeError(error)
    return answer


def _answer(
    connection: Connection, function: Callable[..., Any], arguments: tuple[Any, ...]
) -> None:
    try:
        connection.send((function(*arguments), ""))
    except Exception as error:  # whoever asked is to know, whatever it was
        words = " ".join(str(error).split())
        connection.send((None, f"{type(error).__name__}: {words}"))
