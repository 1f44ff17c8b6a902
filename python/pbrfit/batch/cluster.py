"""Workers of dask.distributed, on machines with shared storage."""

from __future__ import annotations

import logging
from collections.abc import Callable
from concurrent.futures import Executor, Future
from importlib.metadata import version
from typing import Any

from pbrfit._core import InputError
from pbrfit.batch.executors import Workers

ANSWERS_WITHIN = 10
"""Seconds that a scheduler may take to answer, and then its first worker to be there."""


class Cluster(Workers):
    """Workers of a dask cluster, each with one task at a time.

    Workers that come later are used too. A task whose worker is gone is given to another by dask
    itself, up to three times. The address is that of the scheduler, such as ``tcp://host:8786``.
    `jobs` run at the same time; None = as many as there are workers. Raises InputError if dask is
    not installed, or nobody answers.
    """

    def __init__(self, address: str, jobs: int | None = None) -> None:
        try:
            from distributed import Client
            from distributed.comm import get_address_host_port
            from distributed.scheduler import KilledWorker
        except ImportError as error:
            raise InputError(
                f"--cluster: expected dask.distributed, found {error}; "
                "pip install 'pbrfit[cluster]' gets it"
            ) from None
        # What it logs is for those who run the cluster, pages of it; here all ends in one line.
        logging.getLogger("distributed").setLevel(logging.CRITICAL)
        self.deaths = (KilledWorker,)
        self._address, self._jobs = address, jobs
        self._executor: Executor | None = None
        try:
            get_address_host_port(address)  # a client that fails at it never quite ends
            self._client = Client(address, timeout=ANSWERS_WITHIN, set_as_default=False)
            self._client.wait_for_workers(1, timeout=ANSWERS_WITHIN)
        except (OSError, ValueError, TypeError, TimeoutError) as error:
            there = hasattr(self, "_client")
            self.stop()
            expected = "a worker" if there else "a dask scheduler"
            raise InputError(
                f"--cluster {address}: expected {expected} that answers within {ANSWERS_WITHIN} s, "
                f"found none ({' '.join(str(error).split())})"
            ) from None

    def start(self) -> Executor:
        """Give the cluster's executor."""
        self._check()
        if self._executor is None:
            self._executor = _Checking(self._client.get_executor(pure=False))
        return self._executor

    def slots(self) -> int:
        """As many as there are workers, if not fewer were asked for."""
        self._check()
        try:
            workers = len(self._client.nthreads())
        except (OSError, TimeoutError):
            raise self._gone() from None
        return max(1, workers if self._jobs is None else min(workers, self._jobs))

    def stop(self) -> None:
        """Give back what waits. Workers see it by the files of a task."""
        if self._executor is not None:
            self._executor.shutdown(wait=False)
        if hasattr(self, "_client"):
            self._client.close(timeout=ANSWERS_WITHIN)

    def _check(self) -> None:
        if self._client.status != "running":
            raise self._gone()

    def _gone(self) -> ConnectionError:
        return ConnectionError(
            f"--cluster {self._address}: expected the scheduler to stay, found it gone; --resume "
            "goes on from there"
        )


class _Checking(Executor):
    """An executor whose tasks first see whether their worker runs this version of pbrfit."""

    def __init__(self, executor: Executor) -> None:
        self._executor = executor

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        return self._executor.submit(_checked, version("pbrfit"), fn, *args, **kwargs)

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        self._executor.shutdown(wait=wait and not cancel_futures)


def _checked(expected: str, fn: Callable[..., Any], *args: Any, **kwargs: Any) -> Any:
    found = version("pbrfit")
    if found != expected:
        raise InputError(f"expected pbrfit {expected} on all workers, found {found} on one")
    return fn(*args, **kwargs)


def threads_of_worker() -> int:
    """Threads of the dask worker that this runs on."""
    from distributed import get_worker

    return int(get_worker().state.nthreads)
