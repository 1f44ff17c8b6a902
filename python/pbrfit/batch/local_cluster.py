"""A dask cluster of this machine, for this process alone.

Whoever may speak to a scheduler or a worker has it run code, so these listen on the loopback
interface, speak TLS, and take only those who have the certificate that is made for each cluster and
kept in memory. dask starts a web server beside each, with or without pages; here there is none.
"""

from __future__ import annotations

import logging
from typing import Any

from distributed import Nanny, Scheduler, SpecCluster, Worker
from distributed.security import Security

HOST = "127.0.0.1"


class _NoPages:
    """In the place of what makes dask's web servers."""

    def start_http_server(self, *_: object, **__: object) -> None:
        """Start none."""


class LocalScheduler(_NoPages, Scheduler):  # type: ignore[misc]
    """A scheduler without a web server."""


class LocalWorker(_NoPages, Worker):  # type: ignore[misc]
    """A worker without a web server."""


def start(workers: int) -> Any:
    """Start a scheduler and so many workers, of one thread each.

    Raises ImportError without the package `cryptography`, which makes the certificate.
    """
    security = Security.temporary()
    common = {"host": HOST, "protocol": "tls://", "security": security}
    worker = {
        "cls": Nanny,
        "options": {
            **common,
            "worker_class": LocalWorker,
            "nthreads": 1,
            "memory_limit": 0,  # tasks are not begun beyond what there is
            "silence_logs": logging.CRITICAL,
        },
    }
    return SpecCluster(
        scheduler={"cls": LocalScheduler, "options": {**common, "port": 0, "dashboard": False}},
        workers=dict.fromkeys(range(workers), worker),
        security=security,
        silence_logs=logging.CRITICAL,
    )
