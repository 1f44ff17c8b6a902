"""GPT-Image-2 by OpenAI's client against a real server on loopback."""

from __future__ import annotations

import base64
import io
import json
import logging
import struct
import traceback
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from acquire.image_service import (
    CUT,
    KEY,
    USAGE,
    Answer,
    Call,
    Serve,
    Service,
    as_json,
    failure,
    picture,
    running,
)
from pbrfit._core import InputError
from pbrfit.acquire.generators import Refused, Request
from pbrfit.acquire.generators.gpt_image import GptImage
from pbrfit.acquire.photo import Photo, read_photo

ASK = Request("lamp_left", "Light from a lamp at the left.", "people, text.", 7)


def photo(folder: Path, width: int = 128, height: int = 96) -> Photo:
    """Patches of 4 pixels over ramps, so that a pixel that moves is seen."""
    down, right = np.mgrid[:height, :width]
    noise = np.random.default_rng(1).integers(0, 60, (height, width))[down // 4, right // 4]
    pixels = np.stack([down * 190 // height, right * 190 // width, 60 + 0 * down], axis=-1)
    path = folder / "photo.png"
    Image.fromarray((pixels + noise[..., None]).astype(np.uint8)).save(path)
    return read_photo(path)


@pytest.fixture(autouse=True)
def key(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OPENAI_API_KEY", KEY)


def inverted(call: Call) -> Answer:
    return picture(255 - call.image)


def error_of(photo: Photo, generator: GptImage | None = None) -> str:
    """The one line that a failure comes to, checked to be one and to hold no part of the key."""
    with pytest.raises(InputError) as caught:
        (generator or GptImage()).generate(photo, ASK)
    whole = "".join(traceback.format_exception(caught.value))
    assert KEY not in whole
    assert "secret" not in whole
    message = str(caught.value)
    assert "\n" not in message
    return message


def test_what_comes_back_lies_on_the_photo_pixel_by_pixel(tmp_path: Path, serve: Serve) -> None:
    serve(inverted)
    # A size that is a whole number of blocks and large enough: nothing is scaled.
    taken = photo(tmp_path, 1008, 752)
    generated = GptImage().generate(taken, ASK)
    np.testing.assert_array_equal(generated.pixels, 255 - taken.srgb8())


def test_the_upload_holds_what_the_api_asks_for(tmp_path: Path, serve: Serve) -> None:
    service = serve(inverted)
    taken = photo(tmp_path, 1008, 752)
    GptImage(quality="medium").generate(taken, ASK)
    [call] = service.calls
    assert call.path == "/v1/images/edits"
    assert call.text == {
        "model": "gpt-image-2",
        "prompt": "Light from a lamp at the left.\n\nAvoid: people, text.",
        "size": "1008x752",
        "quality": "medium",
        "n": "1",
    }
    np.testing.assert_array_equal(call.image, taken.srgb8())
    assert call.headers["authorization"] == f"Bearer {KEY}"


def test_usage_is_recorded_as_it_came(tmp_path: Path, serve: Serve) -> None:
    serve(inverted)
    record = GptImage().generate(photo(tmp_path), ASK).record
    assert record["usage"] == USAGE
    assert record["seed"] is None
    assert json.loads(json.dumps(record)) == record
    service = serve(lambda call: picture(call.image, usage=None))
    record = GptImage().generate(photo(tmp_path), Request("a", "Evening.", "", 0)).record
    assert record["usage"] is None
    assert service.calls[0].text["prompt"] == "Evening."  # no negative prompt: nothing is added


@pytest.mark.parametrize("first", [failure(429, "slow down"), CUT], ids=["429", "cut"])
def test_the_client_asks_again(tmp_path: Path, serve: Serve, first: Answer) -> None:
    service = serve(first, inverted)
    GptImage(max_retries=1).generate(photo(tmp_path), ASK)
    assert len(service.calls) == 2


QUOTA = failure(429, "You exceeded your current quota", "insufficient_quota")


@pytest.mark.parametrize(
    ("answer", "retries", "words"),
    [
        (QUOTA, 2, ("429", "exceeded your current quota")),
        (failure(500, "The server had an error"), 1, ("a failure there (500), 2 times",)),
        (CUT, 1, ("a broken connection, 2 times",)),
        (failure(400, "Invalid size '7x7'.", "invalid"), 0, ("status 400: ", "Invalid size")),
        (failure(403, f"No access with {KEY}"), 0, ("No access with ***",)),
    ],
    ids=["quota", "server", "cut", "no refusal of a prompt", "quotes the key"],
)
def test_a_failure_is_told_after_all_tries(
    tmp_path: Path, serve: Serve, answer: Answer, retries: int, words: tuple[str, ...]
) -> None:
    service = serve(answer)
    message = error_of(photo(tmp_path), GptImage(max_retries=retries))
    assert all(word in message for word in words), message
    assert len(service.calls) == 1 + retries


MODERATION = {"moderation_stage": "output", "categories": ["violence"]}


@pytest.mark.parametrize(
    ("details", "told"),
    [
        ({"moderation_details": MODERATION}, r"moderation \(output; .*: violence\).*Reject"),
        ({}, "moderation: Rejected"),
    ],
)
def test_a_refusal_by_moderation_tells_what_is_known(
    tmp_path: Path, serve: Serve, details: dict[str, Any], told: str
) -> None:
    words = "Rejected by the safety system."
    service = serve(failure(400, words, "moderation_blocked", **details))
    with pytest.raises(Refused, match=told):
        GptImage().generate(photo(tmp_path), ASK)
    assert len(service.calls) == 1


def test_a_refused_key_is_named_and_not_shown(tmp_path: Path, serve: Serve) -> None:
    serve(failure(401, f"Incorrect API key provided: {KEY[:8]}***{KEY[-4:]}.", "invalid_api_key"))
    message = error_of(photo(tmp_path))
    assert message.startswith("OPENAI_API_KEY: ")
    assert "401" in message
    assert KEY[:8] not in message
    assert KEY[-4:] not in message


def test_a_service_that_is_not_there_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("OPENAI_BASE_URL", "http://somebody:password@127.0.0.1:9/v1")
    message = error_of(photo(tmp_path), GptImage(max_retries=0))
    assert message.startswith("127.0.0.1:9: ")
    assert "password" not in message


@pytest.mark.parametrize(
    "answer",
    [
        Answer(200, b"<html>not JSON</html>"),
        Answer(200, b"[]"),
        Answer(200, b"{"),
        as_json(200, {"created": 1}),
        as_json(200, {"created": 1, "data": []}),
        as_json(200, {"created": 1, "data": [{}]}),
        as_json(200, {"created": 1, "data": [{"b64_json": "!!"}]}),
        as_json(200, {"created": 1, "data": [{"b64_json": "aGVsbG8="}]}),
    ],
    ids=["html", "list", "broken", "no data", "empty", "no picture", "no base64", "no PNG"],
)
def test_an_answer_without_a_picture_is_told(tmp_path: Path, serve: Serve, answer: Answer) -> None:
    serve(answer)
    assert "expected a picture, found an answer without one" in error_of(photo(tmp_path))


def damaged_png() -> bytes:
    """A PNG whose data end in the middle, at a chunk whose name is none."""
    buffer = io.BytesIO()
    Image.fromarray(np.zeros((64, 64, 3), dtype=np.uint8)).save(buffer, "PNG")
    png = buffer.getvalue()
    at = png.index(b"IDAT") + 4
    return png[: at - 8] + struct.pack(">I", 9) + png[at - 4 : at + 9] + bytes(8) + b"\0\1\2\3"


@pytest.mark.parametrize(
    ("content", "told"),
    [
        (damaged_png(), "SyntaxError: broken PNG file"),
        (b"BM" + bytes(100), "no PNG, JPEG, WEBP"),
    ],
    ids=["a broken chunk", "of another format"],
)
def test_a_picture_that_cannot_be_read_is_told(
    tmp_path: Path, serve: Serve, content: bytes, told: str
) -> None:
    serve(as_json(200, {"data": [{"b64_json": base64.b64encode(content).decode()}]}))
    assert told in error_of(photo(tmp_path))


@pytest.mark.parametrize("status", [301, 302, 307, 308])
def test_a_redirection_takes_neither_photo_nor_key_along(
    tmp_path: Path, serve: Serve, status: int
) -> None:
    other = Service(inverted)
    with running(other) as address:
        serve(as_json(status, {}, Location=f"{address}/images/edits"))
        message = error_of(photo(tmp_path))
    assert f"a redirection ({status}), which is not followed" in message
    assert other.calls == []


def test_what_a_terminal_would_obey_is_not_passed_on(tmp_path: Path, serve: Serve) -> None:
    said = "\x1b[2J\x1b]0;owned\x07 Paid\u202egnp.exe"
    serve(failure(400, said))
    assert error_of(photo(tmp_path)).isprintable()
    details = {"moderation_stage": said, "categories": [said] * 100}
    serve(failure(400, said, "moderation_blocked", moderation_details=details))
    with pytest.raises(Refused) as refused:
        GptImage().generate(photo(tmp_path), ASK)
    assert str(refused.value).isprintable()
    assert len(str(refused.value)) < 2000


def test_a_picture_of_the_same_shape_is_scaled_and_another_refused(
    tmp_path: Path, serve: Serve
) -> None:
    serve(lambda call: picture(call.image[::2, ::2]), picture(np.zeros((1024, 1024, 3), np.uint8)))
    taken = photo(tmp_path, 1008, 752)
    generated = GptImage().generate(taken, ASK)
    assert generated.pixels.shape == taken.srgb8().shape
    assert generated.record["size"] == [1008, 752]
    assert generated.record["size_given"] == [504, 376]
    with pytest.raises(Refused, match=r"1008 × 752 pixels, as was asked for, found 1024 × 1024"):
        GptImage().generate(taken, ASK)


@pytest.mark.parametrize(
    ("name", "values", "expected"),
    [
        ("OPENAI_API_KEY", ("sk-ключ", "sk-two words", "sk-two\nlines"), "expected ASCII"),
        *(
            ("OPENAI_BASE_URL", (value,), "expected http:// or https://")
            for value in ("", "localhost", "ftp://x", "http://", "http://x:port/v1", "http://[::")
        ),
    ],
)
def test_a_key_or_an_address_that_is_none_is_told_and_no_key_shown(
    monkeypatch: pytest.MonkeyPatch, name: str, values: tuple[str, ...], expected: str
) -> None:
    for value in values:
        monkeypatch.setenv(name, value)
        with pytest.raises(InputError, match=f"^{name}: {expected}") as told:
            GptImage().check()
        assert "sk-" not in str(told.value)


def test_without_a_key_nothing_is_asked(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, serve: Serve
) -> None:
    service = serve(inverted)
    monkeypatch.delenv("OPENAI_API_KEY")
    with pytest.raises(InputError, match=r"OPENAI_API_KEY: expected a key .* found none"):
        GptImage().check()
    with pytest.raises(InputError, match="OPENAI_API_KEY"):
        GptImage().generate(photo(tmp_path), ASK)
    assert service.calls == []
    with pytest.raises(InputError, match=r"quality: expected one of low, .*found 'best'"):
        GptImage(quality="best")


def test_the_key_is_in_no_setting_record_or_log(
    tmp_path: Path, serve: Serve, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.DEBUG)
    serve(failure(429, "wait"), inverted)
    generator = GptImage()
    generated = generator.generate(photo(tmp_path), ASK)
    seen = json.dumps([generator.settings(), generated.record]) + repr(generator) + caplog.text
    assert caplog.text
    assert KEY not in seen
