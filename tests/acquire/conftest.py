"""Tests of the networks: offline, on the processor, with tiny ones that are made on the spot."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest

from acquire.image_service import KEY, Answer, Reply, Serve, Service, running
from acquire.tiny_pipelines import save_tiny_flux2_klein

# Read when the libraries are imported, so before any test is. A cache of their own, so that what
# somebody once downloaded cannot help, and nothing of it is touched.
_CACHE = tempfile.mkdtemp(prefix="pbrfit-tests-")
os.environ["HF_HOME"] = _CACHE
os.environ["HF_HUB_OFFLINE"] = "1"
os.environ["HF_HUB_DISABLE_TELEMETRY"] = "1"
# Threads gain nothing on tiny networks, and wait for each other where processors are shared.
os.environ["OMP_NUM_THREADS"] = "1"
for name in ("HF_HUB_CACHE", "HUGGINGFACE_HUB_CACHE", "TRANSFORMERS_CACHE", "HF_TOKEN"):
    os.environ.pop(name, None)

THIRD_PARTY = ("torch", "torchvision", "diffusers", "transformers", "accelerate", "huggingface_hub")


def pytest_configure(config: pytest.Config) -> None:
    """Warnings are errors, but for those that the libraries raise in their own code."""
    for library in THIRD_PARTY:
        config.addinivalue_line("filterwarnings", rf"ignore:::{library}(\.|$)")


@pytest.fixture(scope="session", autouse=True)
def hub_cache() -> Iterator[Path]:
    """Where checkpoints of the Hub are looked for: an empty folder at first."""
    yield Path(_CACHE) / "hub"
    shutil.rmtree(_CACHE, ignore_errors=True)


@pytest.fixture(scope="session")
def tiny_flux2_klein(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A base checkpoint."""
    return save_tiny_flux2_klein(tmp_path_factory.mktemp("klein"))


@pytest.fixture(scope="session")
def tiny_distilled_flux2_klein(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A checkpoint that says that it is distilled."""
    return save_tiny_flux2_klein(tmp_path_factory.mktemp("distilled"), distilled=True)


@pytest.fixture
def serve(monkeypatch: pytest.MonkeyPatch) -> Iterator[Serve]:
    """Start a service that the client is led to."""
    with ExitStack() as stack:

        def start(*replies: Reply | Answer) -> Service:
            service = Service(*replies)
            monkeypatch.setenv("OPENAI_BASE_URL", stack.enter_context(running(service)))
            monkeypatch.setenv("OPENAI_API_KEY", KEY)
            return service

        yield start
