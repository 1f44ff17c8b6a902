"""GPT-Image-2 through OpenAI's client: the photo is sent to OpenAI, and every picture costs money.

The key comes from the environment and is kept nowhere else: not in settings, not in records, not in
messages. Facts about the API are of OpenAI's image generation guide and of the client's own
documentation (openai 3.52).
"""

from __future__ import annotations

import base64
import binascii
import io
import os
import time
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, NoReturn
from urllib.parse import urlsplit

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from pbrfit._core import InputError
from pbrfit.acquire.generators import Generated, Refused, Request, requests_from
from pbrfit.acquire.padding import GPT_IMAGE_2, Frame, frame, resized_srgb8
from pbrfit.acquire.photo import Photo
from pbrfit.acquire.prompts import Catalogue
from pbrfit.acquire.weights import need
from pbrfit.io import images

if TYPE_CHECKING:
    import openai
    from openai.types import ImagesResponse

KEY = "OPENAI_API_KEY"
"""Where the key is looked for, and nowhere else."""

ADDRESS = "OPENAI_BASE_URL"
"""Where the client looks for another service than OpenAI's."""

QUALITIES = ("low", "medium", "high", "auto")

TIMEOUT = 600.0
"""Seconds for one picture. A request that is given up is billed all the same, so it is generous."""

RETRIES = 4
"""How often the client asks again after 408, 409, 429, 5xx and broken connections."""

SAME_SHAPE = 0.01
"""A picture of another size whose sides are in the proportion that was asked for, up to this, is
scaled. Services that stand in for OpenAI's may round sizes their own way."""

PRICES = dict.fromkeys(
    (
        "gpt-image-2",
        "gpt-image-2-2026-04-21",
        "gpt-image-2.5-sunburst",
        "gpt-image-2.5-flare",
    ),
    (5.0, 8.0, 30.0),
)
"""US dollars for a million tokens of text in, of pictures in, of pictures out; no discounts."""

PRICES_AS_OF = "2026-09"
"""When OpenAI's page had these prices. Its bill counts; ours is an estimate."""


@dataclass(frozen=True)
class GptImage:
    """Pictures by `images.edit` of OpenAI's API.

    The API takes no seed and no negative prompt. Every call gives another picture, so a request's
    seed only tells calls apart; what is to be avoided is said at the end of the prompt.
    """

    model: str = "gpt-image-2"
    """Any of the models that take free sizes."""
    quality: str = "high"
    """One of `QUALITIES`; decides most of the price."""
    max_retries: int = RETRIES
    """By the client, with growing pauses."""
    timeout: float = TIMEOUT
    """Seconds for one answer."""

    name = "gpt-image-2"
    retries = True

    def __post_init__(self) -> None:
        if self.quality not in QUALITIES:
            raise InputError(
                f"quality: expected one of {', '.join(QUALITIES)}, found {self.quality!r}"
            )

    def settings(self) -> dict[str, Any]:
        """What decides about the pictures."""
        return {"generator": self.name, "model": self.model, "quality": self.quality}

    def check(self) -> None:
        """See that the client and a key are there; asks the service for nothing.

        Raises InputError if the extra or the key is missing, or the key or the service's address is
        none.
        """
        _ = self._client

    def plan(self, catalogue: Catalogue, count: int, seed: int) -> list[Request]:
        """The first `count` prompts of the catalogue; see `requests_from`.

        The service has no seeds, so all requests have the first: a lighting that is put in front of
        others does not make them other requests.
        """
        return [replace(request, seed=seed) for request in requests_from(catalogue, count, seed)]

    def generate(self, photo: Photo, request: Request) -> Generated:
        """Ask for one picture.

        Raises Refused if the service's moderation refuses the prompt, the photo or what came out;
        InputError if the key is refused, the service is out of reach or out of quota after all
        retries, or answers with something that is no picture of the size that was asked for.
        """
        import openai

        around = frame(photo.size, GPT_IMAGE_2)
        sent = images.encode_png(around.to_model(photo.srgb8()), tag=None)
        height, width = around.padded
        start = time.monotonic()
        try:
            answer = self._client.images.edit(
                model=self.model,
                image=("photo.png", sent, "image/png"),
                prompt=_with_negative(request),
                size=f"{width}x{height}",
                quality=self.quality,
                n=1,
            )
        except openai.OpenAIError as error:
            self._explain(error)
        except ValueError:  # what the client lets through of a body that is no JSON
            raise InputError(
                f"{self._service}: expected a picture, found an answer that is no JSON"
            ) from None
        pixels, given = self._picture(answer, around)
        usage = answer.usage.model_dump(mode="json", exclude_none=True) if answer.usage else None
        return Generated(
            pixels=pixels,
            record={
                "model": self.model,
                "service": self._service,
                "seed": None,  # the API takes none
                "size": [width, height],
                "size_given": given,
                "quality": answer.quality or self.quality,
                "seconds": round(time.monotonic() - start, 3),
                "usage": usage,
                "cost_usd": cost(self.model, usage),
                "prices_as_of": PRICES_AS_OF,
            },
        )

    @cached_property
    def _client(self) -> openai.OpenAI:
        need("openai", "openai")
        import openai

        key = os.environ.get(KEY, "").strip()
        if not key:
            raise InputError(
                f"{KEY}: expected a key of OpenAI's API in the environment, found none"
            )
        if not (key.isascii() and key.isprintable()) or " " in key:
            raise InputError(f"{KEY}: expected ASCII without blanks, found other characters")
        if ADDRESS in os.environ:  # the client takes an empty one at its word too
            _check_address(os.environ[ADDRESS])
        return openai.OpenAI(api_key=key, max_retries=self.max_retries, timeout=self.timeout)

    @property
    def _service(self) -> str:
        """Host and port: a URL may carry a password."""
        parts = urlsplit(str(self._client.base_url))
        return f"{parts.hostname}:{parts.port}" if parts.port else str(parts.hostname)

    def _picture(
        self, answer: ImagesResponse, around: Frame
    ) -> tuple[NDArray[np.uint8], list[int]]:
        """The picture in an answer at the photo's size, and the (width, height) it came in."""
        # A body that is no JSON arrives as the text it is.
        data = getattr(answer, "data", None)
        encoded = getattr(data[0], "b64_json", None) if isinstance(data, list) and data else None
        if not isinstance(encoded, str):
            raise InputError(f"{self._service}: expected a picture, found an answer without one")
        try:
            with Image.open(io.BytesIO(base64.b64decode(encoded, validate=True))) as picture:
                pixels = np.asarray(picture.convert("RGB"))
        except (binascii.Error, OSError, ValueError, Image.DecompressionBombError):
            raise InputError(
                f"{self._service}: expected a picture, found an answer with one that cannot be read"
            ) from None
        height, width = pixels.shape[:2]
        if (height, width) != around.padded:
            asked = around.padded
            if abs(width / height * asked[0] / asked[1] - 1) > SAME_SHAPE:
                raise Refused(
                    f"{self._service}: expected a picture of {asked[1]} × {asked[0]} pixels, as "
                    f"was asked for, found {width} × {height}: no pixel is sure to be the photo's"
                )
            pixels = resized_srgb8(pixels, asked)
        return around.from_model(pixels), [width, height]

    def _explain(self, error: openai.OpenAIError) -> NoReturn:
        """Say what went wrong; the chain of errors, which holds the request, is cut off."""
        import openai

        body = getattr(error, "body", None)
        said = self._clean(str(body.get("message") if isinstance(body, dict) else error))
        if isinstance(error, openai.BadRequestError) and error.code == "moderation_blocked":
            raise Refused(_refusal(body, said)) from None
        if isinstance(error, openai.AuthenticationError):
            # What the service says here quotes parts of the key.
            raise InputError(
                f"{KEY}: expected a key that {self._service} takes, found one that it refuses (401)"
            ) from None
        tries = self.max_retries + 1
        if isinstance(error, openai.APITimeoutError):
            problem = f"none within {self.timeout:g} s, asked {tries} times"
        elif isinstance(error, openai.APIConnectionError):
            problem = f"a broken connection, {tries} times ({_root(error)})"
        elif isinstance(error, openai.RateLimitError):
            problem = f"too many requests or no credit left (429), {tries} times: {said}"
        elif isinstance(error, openai.InternalServerError):
            problem = f"a failure there ({error.status_code}), {tries} times: {said}"
        elif isinstance(error, openai.APIStatusError):
            problem = f"status {error.status_code}: {said}"
        else:
            problem = said
        raise InputError(f"{self._service}: expected a picture, found {problem}") from None

    def _clean(self, text: str) -> str:
        """One line, not endless, without the key."""
        text = " ".join(text.replace(self._client.api_key, "***").split())
        return text if len(text) <= 300 else text[:299] + "…"


def _check_address(address: str) -> None:
    """Refuse what is no web address; the message does not show it, for it may hold a password."""
    try:
        parts = urlsplit(address.strip())
        sound = parts.scheme in ("http", "https") and bool(parts.hostname) and parts.port != 0
    except ValueError:
        sound = False
    if not sound:
        raise InputError(f"{ADDRESS}: expected http:// or https:// and a host, found neither")


def cost(model: str, usage: dict[str, Any] | None) -> float | None:
    """US dollars for a call, by `PRICES`; None where the model or the tokens are not known."""
    used = usage or {}
    details = used.get("input_tokens_details") or {}
    counts = details.get("text_tokens"), details.get("image_tokens"), used.get("output_tokens")
    tokens = [count for count in counts if isinstance(count, int)]
    if model not in PRICES or len(tokens) < len(counts):
        return None
    of_a_million = [price * count for price, count in zip(PRICES[model], tokens, strict=True)]
    return round(sum(of_a_million) / 1e6, 6)


def _with_negative(request: Request) -> str:
    if not request.negative:
        return request.prompt
    return f"{request.prompt}\n\nAvoid: {request.negative.rstrip('. ')}."


def _refusal(body: object, said: str) -> str:
    """Why moderation refused, with the stage and the categories where the service tells them."""
    details = body.get("moderation_details") if isinstance(body, dict) else None
    if not isinstance(details, dict):
        return f"refused by moderation: {said}"
    stage = details.get("moderation_stage", "unknown")
    categories = ", ".join(str(each) for each in details.get("categories") or ()) or "none named"
    return f"refused by moderation ({stage}; categories: {categories}): {said}"


def _root(error: BaseException) -> str:
    """Name of what broke the connection."""
    while error.__cause__ is not None:
        error = error.__cause__
    return type(error).__name__
