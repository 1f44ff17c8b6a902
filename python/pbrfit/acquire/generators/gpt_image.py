"""GPT-Image-2 through OpenAI's client: the photo is sent to OpenAI, and every picture costs money.

The key comes from the environment and is kept nowhere else: not in settings, not in records, not in
messages. An answer leads neither photo nor key elsewhere. Facts about the API are of OpenAI's image
generation guide and of the client's own documentation (openai 3.52).
"""

from __future__ import annotations

import base64
import os
import time
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, NoReturn
from urllib.parse import urlsplit

from pbrfit._core import InputError
from pbrfit.acquire.generators import Generated, Refused, Request, requests_from
from pbrfit.acquire.padding import GPT_IMAGE_2, Frame, frame, read_srgb8, resized_srgb8
from pbrfit.acquire.photo import Photo
from pbrfit.acquire.prompts import Catalogue
from pbrfit.acquire.weights import need
from pbrfit.io import images
from pbrfit.values.arrays import Codes
from pbrfit.values.checks import one_of
from pbrfit.values.quoting import listed, shown

if TYPE_CHECKING:
    import openai

KEY = "OPENAI_API_KEY"
"""Where the key is looked for, and nowhere else."""

ADDRESS = "OPENAI_BASE_URL"
"""Where the client looks for another service than OpenAI's."""

QUALITIES = ("low", "medium", "high", "auto")

SAME_SHAPE = 0.01
"""A picture of another size whose sides are in the proportion that was asked for, up to this, is
scaled. Services that stand in for OpenAI's may round sizes their own way."""


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
    max_retries: int = 4
    """After 408, 409, 429, 5xx and broken connections, by the client, with growing pauses."""
    timeout: float = 600.0
    """Seconds for one answer: generous, as a request that is given up is billed all the same."""

    name = "gpt-image-2"
    retries = True

    def __post_init__(self) -> None:
        one_of("quality", self.quality, QUALITIES)

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
        """Ask for one picture and read it.

        Raises Refused if the service's moderation refuses the prompt, the photo or what came out,
        or the picture's shape is not the one that was asked for; InputError if the key is refused,
        the service is out of reach or out of quota after all retries, or no picture can be read.
        """
        import openai

        around = frame(photo.size, GPT_IMAGE_2)
        sent = images.encode_png(around.to_model(photo.srgb8()), tag=None)
        height, width = around.padded
        prompt = request.prompt
        if request.negative:
            prompt += f"\n\nAvoid: {request.negative.rstrip('. ')}."
        start = time.monotonic()
        try:
            answer = self._client.images.edit(
                model=self.model,
                image=("photo.png", sent, "image/png"),
                prompt=prompt,
                size=f"{width}x{height}",
                quality=self.quality,
                n=1,
            )
        except openai.OpenAIError as error:
            self._explain(error)
        except ValueError as error:  # of an answer that is no JSON
            raise self._without_picture(error) from None
        seconds = time.monotonic() - start
        pixels, given = self._picture(answer, around)
        return Generated(
            pixels=pixels,
            record={
                "model": self.model,
                "service": self._service,
                "seed": None,  # the API takes none
                "size": [width, height],
                "size_given": given,
                "quality": answer.quality if answer.quality in QUALITIES else self.quality,
                "seconds": round(seconds, 3),
                "usage": answer.usage and answer.usage.to_dict(exclude_none=True),
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
        return openai.OpenAI(
            api_key=key,
            max_retries=self.max_retries,
            timeout=self.timeout,
            http_client=openai.DefaultHttpxClient(follow_redirects=False),
        )

    @property
    def _service(self) -> str:
        """Host and port: a URL may carry a password."""
        parts = urlsplit(str(self._client.base_url))
        return f"{parts.hostname}:{parts.port}" if parts.port else str(parts.hostname)

    def _picture(self, answer: Any, around: Frame) -> tuple[Codes, list[int]]:
        """The picture in an answer at the photo's size, and the (width, height) it came in."""
        try:
            pixels = read_srgb8(base64.b64decode(answer.data[0].b64_json, validate=True))
        except (AttributeError, LookupError, TypeError, ValueError) as error:
            raise self._without_picture(error) from None
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

    def _without_picture(self, error: Exception) -> InputError:
        found = f"found an answer without one that can be read: {shown(error)}"
        return InputError(f"{self._service}: expected a picture, {found}")

    def _explain(self, error: openai.OpenAIError) -> NoReturn:
        """Say what went wrong; the chain of errors, which holds the request, is cut off."""
        import openai

        body = getattr(error, "body", None)
        said = str(body.get("message") if isinstance(body, dict) else error)
        said = shown(" ".join(said.replace(self._client.api_key, "***").split()))
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
            cause: BaseException = error
            while cause.__cause__ is not None:
                cause = cause.__cause__
            problem = f"a broken connection, {tries} times ({type(cause).__name__})"
        elif isinstance(error, openai.RateLimitError):
            problem = f"too many requests or no credit left (429), {tries} times: {said}"
        elif isinstance(error, openai.InternalServerError):
            problem = f"a failure there ({error.status_code}), {tries} times: {said}"
        elif isinstance(error, openai.APIStatusError) and error.response.has_redirect_location:
            problem = f"a redirection ({error.status_code}), which is not followed"
        elif isinstance(error, openai.APIStatusError):
            problem = f"status {error.status_code}: {said}"
        else:
            problem = said
        raise InputError(f"{self._service}: expected a picture, found {problem}") from None


def _check_address(address: str) -> None:
    """Refuse what is no web address; the message does not show it, for it may hold a password."""
    try:
        parts = urlsplit(address.strip())
        sound = parts.scheme in ("http", "https") and bool(parts.hostname) and parts.port != 0
    except ValueError:
        sound = False
    if not sound:
        raise InputError(f"{ADDRESS}: expected http:// or https:// and a host, found neither")


def _refusal(body: object, said: str) -> str:
    """Why moderation refused, with the stage and the categories where the service tells them."""
    details = body.get("moderation_details") if isinstance(body, dict) else None
    if not isinstance(details, dict):
        return f"refused by moderation: {said}"
    stage = shown(details.get("moderation_stage", "unknown"))
    named = details.get("categories")
    categories = listed(map(str, named)) if isinstance(named, list) else ""
    return f"refused by moderation ({stage}; categories: {categories or 'none named'}): {said}"
