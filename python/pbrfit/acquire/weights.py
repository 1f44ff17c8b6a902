"""Networks loaded, from a local folder or the Hugging Face Hub: every way it fails is one line.

A name is looked for in the local cache first, so that what was once loaded is used as it is, with
or without a network; only what is not there is downloaded.
"""

from __future__ import annotations

import importlib.util
import logging
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from typing import Any, Literal

from pbrfit._core import InputError
from pbrfit.values.checks import one_of

log = logging.getLogger("pbrfit")

Device = Literal["auto", "cpu", "cuda", "mps"]
Precision = Literal["auto", "float32", "bfloat16", "float16"]
Offload = Literal["none", "model", "sequential"]


@dataclass(frozen=True)
class Placement:
    """Where a network computes, resolved: nothing is "auto" any more."""

    device: str
    """One of "cpu", "cuda" and "mps"."""
    dtype: str
    """One of "float32", "bfloat16" and "float16"."""
    offload: str
    """What waits in the processor's memory: "none"; "model", every part but the one that computes;
    "sequential", every layer but the one that computes, which is slow."""

    @property
    def torch_dtype(self) -> Any:
        """The `torch.dtype` of that name."""
        import torch

        return getattr(torch, self.dtype)


@dataclass(frozen=True, eq=False)
class Loaded:
    """A network and where it came from."""

    network: Any
    """What the loader returned."""
    record: dict[str, Any]
    """For records, as JSON: ``model`` as asked for, ``source`` ("folder" or "hub") and
    ``revision``, the commit on the Hub, or None where there is none."""


def need(extra: str, *modules: str) -> None:
    """Check that modules can be imported, without importing them, which may take seconds.

    `extra` is the set of optional packages that brings them, as `pyproject.toml` names it. Raises
    InputError if one is missing: one line with the command that installs it.
    """
    missing = [name for name in modules if importlib.util.find_spec(name) is None]
    if missing:
        raise InputError(
            f"expected the Python package{'s' if len(missing) > 1 else ''} {', '.join(missing)}, "
            f"found none: pip install 'pbrfit[{extra}]'"
        )


def versions(*packages: str) -> dict[str, str]:
    """Versions of installed packages, for records of how something was made."""
    there = [name for name in packages if importlib.util.find_spec(name) is not None]
    return {name: metadata.version(name) for name in there}


def placement(
    device: str = "auto",
    dtype: str = "auto",
    offload: str = "none",
    *,
    what: str = "the network",
    half: str = "bfloat16",
) -> Placement:
    """Choose where and how precisely to compute; imports torch.

    ``auto`` takes CUDA, else Apple's MPS, else the processor with a warning; and on a GPU `half`,
    on the processor float32. Large networks are released in bfloat16; those made from Stable
    Diffusion run in float16, whose numbers are eight times as fine. Raises InputError if an option
    is none of those there are, the device is not there, or there is nothing to offload from.
    """
    one_of("device", device, Device)
    one_of("dtype", dtype, Precision)
    one_of("offload", offload, Offload)
    import torch

    there = {"cpu": True, "cuda": torch.cuda.is_available()}
    there["mps"] = torch.backends.mps.is_available()
    if device == "auto":
        device = next(name for name in ("cuda", "mps", "cpu") if there[name])
        if device == "cpu" and offload == "none":
            log.warning("no GPU found: %s runs on the processor, which is slow", what)
    if not there[device]:
        kind = "NVIDIA GPU that PyTorch can use" if device == "cuda" else "Apple GPU"
        raise InputError(f"device: expected an {kind}, found none; cpu works without one, slowly")
    if device == "cpu" and offload != "none":
        raise InputError(
            f"offload: expected a GPU to take parts off with {offload!r}, found none; leave it out"
        )
    if dtype == "auto":
        dtype = "float32" if device == "cpu" else half
    return Placement(device, dtype, offload)


def load(kind: str, model: str, *, loader: Callable[..., Any], marker: str) -> Loaded:
    """Load a network of a `kind`, for messages, from a local folder or the Hugging Face Hub.

    `model` is a folder as `save_pretrained` leaves it, or OWNER/NAME on the Hub. `loader` is a
    `from_pretrained`, with what else it needs bound to it; it is called with the name or folder and
    ``local_files_only``, and an `InputError` of its own passes through. `marker` is a file that
    every folder of this kind has: "model_index.json" of a pipeline, "config.json" of a single
    network. Raises InputError if it is in neither place and cannot be downloaded, or cannot be
    loaded: one line that says which and where it was looked for.
    """
    from huggingface_hub import constants

    folder = Path(model).expanduser()
    local = bool(model) and folder.is_dir()
    if local and not (folder / marker).is_file():
        raise InputError(f"{folder}: expected {kind} with a {marker}, found none")
    if not local and not _is_hub_name(model):
        raise InputError(f"{model}: expected a folder with {kind}, or OWNER/NAME, found neither")
    cache, final = constants.HF_HUB_CACHE, local or constants.is_offline_mode()
    place = "" if local else f" in {cache}"
    if local or _commit(model, marker) is not None:
        # A download that was cut off leaves a cache that lacks files; then the Hub has the rest.
        try:
            with _no_bars():
                network = loader(str(folder) if local else model, local_files_only=True)
        except InputError:
            raise
        except Exception as error:
            if final or _out_of_memory(error):
                raise _failed(kind, model, error, place) from error
        else:
            return _loaded(network, model, None if local else _commit(model, marker))
    if final:
        raise InputError(
            f"{kind}: expected the weights {model} in {cache}, found none, and HF_HUB_OFFLINE "
            f"forbids to download them: run once without it, or `hf download {model}` where there "
            "is a network, or give a local folder"
        )
    log.warning("%s: downloading %s to %s", kind, model, cache)
    try:
        network = loader(model, local_files_only=False)  # gigabytes: with bars
    except InputError:
        raise
    except Exception as error:
        if _about_files(error):
            raise _not_downloaded(kind, model, error) from error
        raise _failed(kind, model, error, place) from error
    return _loaded(network, model, _commit(model, marker))


def place(network: Any, where: Placement, *, what: str) -> None:
    """Move a diffusers pipeline to its device, or set up that its parts are moved when needed.

    Raises InputError if it does not fit in the GPU's memory.
    """
    with memory_in_words(what):
        if where.offload == "model":
            network.enable_model_cpu_offload(device=where.device)
        elif where.offload == "sequential":
            network.enable_sequential_cpu_offload(device=where.device)
        else:
            network.to(where.device)


@contextmanager
def memory_in_words(
    what: str,
    remedies: str = "a smaller --max-size, --offload model or sequential, --dtype bfloat16",
) -> Iterator[None]:
    """Turn running out of memory, on a GPU or not, into one line that says what helps.

    Raises InputError in place of the error of PyTorch or Python.
    """
    try:
        yield
    except (RuntimeError, MemoryError) as error:
        if not _out_of_memory(error):
            raise
        raise InputError(f"{what}: out of memory; what helps: {remedies}") from error


def _out_of_memory(error: Exception) -> bool:
    if not isinstance(error, RuntimeError):
        return isinstance(error, MemoryError)
    import torch

    # The processor's allocator and MPS raise a plain RuntimeError.
    said = str(error)
    return isinstance(error, torch.OutOfMemoryError) or any(
        words in said for words in ("can't allocate memory", "out of memory")
    )


@contextmanager
def _no_bars() -> Iterator[None]:
    """Without the bars over parts, that libraries draw even where stderr is no terminal."""
    libraries = [importlib.import_module("transformers.utils.logging")]
    if importlib.util.find_spec("diffusers") is not None:
        libraries.append(importlib.import_module("diffusers.utils.logging"))
    shown = [library for library in libraries if library.is_progress_bar_enabled()]
    for library in shown:
        library.disable_progress_bar()
    try:
        yield
    finally:
        for library in shown:
            library.enable_progress_bar()


def _failed(kind: str, model: str, error: Exception, place: str) -> InputError:
    """One line of what a library says of a damaged or foreign checkpoint, whatever its type."""
    if _out_of_memory(error):
        return InputError(f"{kind}: out of memory while loading {model}")
    return InputError(f"{model}: expected {kind}{place} that can be loaded: {_first_line(error)}")


def _chain(error: BaseException) -> list[BaseException]:
    """An error and those that it came from."""
    chain: list[BaseException] = []
    link: BaseException | None = error
    while link is not None and link not in chain:
        chain.append(link)
        link = link.__cause__ or link.__context__
    return chain


def _about_files(error: Exception) -> bool:
    """Whether files could not be had: others are there and cannot be used."""
    clients = ("huggingface_hub", "httpx", "requests")
    return any(
        isinstance(link, OSError) or type(link).__module__.partition(".")[0] in clients
        for link in _chain(error)
    )


def _not_downloaded(kind: str, model: str, error: Exception) -> InputError:
    from huggingface_hub import constants, errors

    # diffusers says in each case that a file is missing; what the Hub or the network said is below.
    chain = _chain(error)
    if any(isinstance(link, errors.GatedRepoError) for link in chain):
        return InputError(
            f"{kind}: {model} is given out on conditions: accept them at "
            f"https://huggingface.co/{model} and log in with `hf auth login`"
        )
    if any(isinstance(link, errors.RepositoryNotFoundError) for link in chain):
        return InputError(
            f"{model}: expected {kind} in a local folder or on the Hub, found neither of that name"
        )
    return InputError(
        f"{kind}: expected the weights {model} in {constants.HF_HUB_CACHE}, found none, and could "
        f"not download them: {_first_line(chain[-1])}"
    )


def _first_line(error: BaseException) -> str:
    said = str(error).strip()
    return " ".join(said.splitlines()[0].split()) if said else type(error).__name__


def _loaded(network: Any, model: str, commit: str | None) -> Loaded:
    source = "folder" if commit is None else "hub"
    return Loaded(network, {"model": model, "source": source, "revision": commit})


def _commit(model: str, marker: str) -> str | None:
    """The commit of the cached snapshot; None if there is none."""
    from huggingface_hub import try_to_load_from_cache

    path = try_to_load_from_cache(model, marker)
    # …/models--OWNER--NAME/snapshots/COMMIT/marker
    return Path(path).parent.name if isinstance(path, str) else None


def _is_hub_name(model: str) -> bool:
    from huggingface_hub.utils import HFValidationError, validate_repo_id

    try:
        validate_repo_id(model)
    except HFValidationError:
        return False
    return model.count("/") == 1 and not model.startswith((".", "~"))
