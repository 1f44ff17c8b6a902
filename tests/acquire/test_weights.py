"""Where networks are looked for, and what is said when they are not there."""

from __future__ import annotations

import logging
import re
import shutil
import threading
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import pytest
from PIL import Image

from pbrfit._core import InputError
from pbrfit.acquire import weights
from pbrfit.acquire.generators import Request
from pbrfit.acquire.generators.flux2_klein import MODEL, Flux2Klein
from pbrfit.acquire.photo import Photo, read_photo

FILE = "/{repo_id}/resolve/{revision}/{filename}"
COMMIT = "0123456789abcdef0123456789abcdef01234567"
LEFT = Request("left", "Blue light from the left.", "moved objects", 3)


@pytest.fixture
def photo(tmp_path: Path) -> Photo:
    Image.new("RGB", (64, 64), (200, 100, 50)).save(tmp_path / "photo.png")
    return read_photo(tmp_path / "photo.png")


def refusal(photo: Photo, **options: Any) -> str:
    """The one line of a network that cannot be used."""
    with pytest.raises(InputError) as caught:
        Flux2Klein(device="cpu", **options).generate(photo, LEFT)
    assert "\n" not in str(caught.value)
    return str(caught.value)


@pytest.fixture
def cached(tiny_flux2_klein: Path, hub_cache: Path) -> Path:
    """The tiny checkpoint where the Hub's client keeps the real one; removed afterwards."""
    repository = hub_cache / f"models--{MODEL.replace('/', '--')}"
    shutil.copytree(tiny_flux2_klein, repository / "snapshots" / COMMIT)
    (repository / "refs").mkdir()
    (repository / "refs" / "main").write_text(COMMIT)
    return repository


@pytest.fixture(autouse=True)
def empty_cache(hub_cache: Path) -> None:
    shutil.rmtree(hub_cache, ignore_errors=True)


def test_offline_without_weights_says_which_and_where(photo: Photo, hub_cache: Path) -> None:
    said = refusal(photo)
    assert said.startswith(
        f"FLUX.2 Klein: expected the weights {MODEL} in {hub_cache}, found none, and HF_HUB_OFFLINE"
    )
    assert f"hf download {MODEL}" in said


@pytest.mark.usefixtures("cached")
def test_a_checkpoint_in_the_cache_is_used_without_a_network(photo: Photo) -> None:
    record = Flux2Klein(steps=1, device="cpu").generate(photo, LEFT).record
    assert record["model"] == MODEL
    assert record["source"] == "hub"
    assert record["revision"] == COMMIT


def test_a_cache_that_lacks_files_is_named(cached: Path, photo: Photo, hub_cache: Path) -> None:
    shutil.rmtree(cached / "snapshots" / COMMIT / "transformer")
    assert refusal(photo).startswith(f"{MODEL}: expected FLUX.2 Klein in {hub_cache} that can")


@pytest.mark.parametrize("model", ["/nowhere/at/all", "./klein", "klein", "a/b/c", "~/klein", ""])
def test_neither_a_folder_nor_a_name_is_refused(model: str, photo: Photo, tmp_path: Path) -> None:
    said = refusal(photo, model=model)
    assert "expected a folder with FLUX.2 Klein, or OWNER/NAME" in said
    said = refusal(photo, model=str(tmp_path))
    assert "expected FLUX.2 Klein with a model_index.json, found" in said


def no_gpu(monkeypatch: pytest.MonkeyPatch) -> None:
    import torch

    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    monkeypatch.setattr(torch.backends.mps, "is_available", lambda: False)


def test_a_gpu_that_is_not_there_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    no_gpu(monkeypatch)
    with pytest.raises(InputError, match="device: expected an NVIDIA GPU that PyTorch can use"):
        weights.placement("cuda")
    with pytest.raises(InputError, match="device: expected an Apple GPU, found none"):
        weights.placement("mps")
    with pytest.raises(InputError, match="offload: expected a GPU to take parts off with 'model'"):
        weights.placement("auto", offload="model")


def test_without_a_gpu_the_processor_is_taken_with_a_warning(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    no_gpu(monkeypatch)
    with caplog.at_level(logging.WARNING, logger="pbrfit"):
        assert weights.placement(what="FLUX") == weights.Placement("cpu", "float32", "none")
    assert caplog.messages == ["no GPU found: FLUX runs on the processor, which is slow"]
    caplog.clear()
    weights.placement("cpu", what="FLUX")  # who asks for it knows
    assert caplog.messages == []


@pytest.mark.parametrize(
    "error",
    [
        MemoryError(),
        RuntimeError("[enforce fail at alloc_cpu.cpp] DefaultCPUAllocator: can't allocate memory"),
        RuntimeError("MPS backend out of memory (MPS allocated: 9 GB)"),
    ],
)
def test_every_kind_of_memory_that_runs_out_is_one_line(error: Exception) -> None:
    with (
        pytest.raises(InputError, match="network: out of memory; what helps"),
        weights.memory_in_words("network"),
    ):
        raise error
    with (
        pytest.raises(RuntimeError, match="shapes differ"),  # another error is left as it is
        weights.memory_in_words("network"),
    ):
        raise RuntimeError("shapes differ")


class HubThatRefuses(BaseHTTPRequestHandler):
    """Answers as the Hub does where there is nothing to have."""

    status, code = 404, "RepoNotFound"

    def do_GET(self) -> None:
        self.send_response(self.status)
        self.send_header("X-Error-Code", self.code)
        self.send_header("Content-Length", "0")
        self.end_headers()

    do_HEAD = do_GET  # noqa: N815 - named by http.server

    def log_message(self, *_: object) -> None:
        pass


@pytest.fixture
def hub(monkeypatch: pytest.MonkeyPatch) -> Iterator[type[HubThatRefuses]]:
    """The Hub's client online, with a Hub on loopback."""
    from huggingface_hub import constants

    handler = type("Handler", (HubThatRefuses,), {})
    server = ThreadingHTTPServer(("127.0.0.1", 0), handler)
    thread = threading.Thread(target=server.serve_forever, daemon=True)
    thread.start()
    endpoint = f"http://127.0.0.1:{server.server_port}"
    monkeypatch.setattr(constants, "HF_HUB_OFFLINE", False)
    monkeypatch.setattr(constants, "ENDPOINT", endpoint)
    monkeypatch.setattr(constants, "HUGGINGFACE_CO_URL_TEMPLATE", endpoint + FILE)
    yield handler
    server.shutdown()
    server.server_close()
    thread.join()


@pytest.mark.parametrize(
    ("status", "code", "expected"),
    [
        (404, "RepoNotFound", rf"{MODEL}: expected FLUX.2 Klein in a local folder or on the Hub"),
        (403, "GatedRepo", rf"{MODEL} is given out on conditions: accept them at https://hugging"),
        (404, "EntryNotFound", r"expected the weights .*, found none, and could .*404 Not Found"),
    ],
)
def test_what_the_hub_answers_is_one_line(
    status: int, code: str, expected: str, hub: type[HubThatRefuses], photo: Photo
) -> None:
    hub.status, hub.code = status, code
    assert re.search(expected, refusal(photo))


@pytest.mark.parametrize(
    ("error", "expected"),
    [
        (MemoryError(), "FLUX: out of memory while loading owner/name"),
        (ValueError("header too large"), "owner/name: expected FLUX in .* that can be loaded: hea"),
    ],
)
@pytest.mark.usefixtures("hub")
def test_weights_that_are_there_and_cannot_be_used_are_not_said_to_be_missing(
    error: Exception, expected: str
) -> None:
    def loader(*_: object, **__: object) -> object:
        raise error

    with pytest.raises(InputError, match=expected):
        weights.load("FLUX", "owner/name", loader=loader, marker="config.json")


@pytest.mark.usefixtures("hub")
def test_no_connection_is_one_line(
    photo: Photo, hub_cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from huggingface_hub import constants

    nobody = "http://127.0.0.1:1"
    monkeypatch.setattr(constants, "ENDPOINT", nobody)
    monkeypatch.setattr(constants, "HUGGINGFACE_CO_URL_TEMPLATE", nobody + FILE)
    monkeypatch.setattr("time.sleep", lambda _: None)  # the client tries again after longer pauses
    said = refusal(photo)
    assert f"expected the weights {MODEL} in {hub_cache}, found none, and could not" in said
    assert "Connection refused" in said
