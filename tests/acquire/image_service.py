"""A service on loopback that answers `POST /v1/images/edits` as it is told to."""

from __future__ import annotations

import base64
import email.parser
import email.policy
import io
import json
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

Pixels = NDArray[np.uint8]

USAGE = {
    "input_tokens": 1200,
    "input_tokens_details": {"text_tokens": 200, "image_tokens": 1000},
    "output_tokens": 4000,
    "total_tokens": 5200,
}


@dataclass(frozen=True)
class Answer:
    """Status, headers and body; a body of None cuts the connection."""

    status: int
    body: bytes | None
    headers: dict[str, str] = field(default_factory=dict)


@dataclass
class Call:
    """One request: its path, its headers, and the parts of its form by name."""

    path: str
    headers: dict[str, str]
    parts: dict[str, bytes]

    @property
    def text(self) -> dict[str, str]:
        return {name: part.decode() for name, part in self.parts.items() if name != "image"}

    @property
    def image(self) -> Pixels:
        with Image.open(io.BytesIO(self.parts["image"])) as picture:
            assert picture.format == "PNG"
            return np.asarray(picture)


Reply = Callable[[Call], Answer]
Serve = Callable[..., "Service"]

KEY = "sk-this-is-the-secret-0123456789"


def picture(pixels: Pixels, **changes: Any) -> Answer:
    buffer = io.BytesIO()
    Image.fromarray(pixels).save(buffer, "PNG")
    encoded = base64.b64encode(buffer.getvalue()).decode()
    body = {"created": 1, "data": [{"b64_json": encoded}], "usage": USAGE, "quality": "high"}
    return as_json(200, {**body, **changes})


def as_json(status: int, body: object, **headers: str) -> Answer:
    # Without this the client waits for seconds between two tries.
    return Answer(status, json.dumps(body).encode(), {"retry-after-ms": "1", **headers})


def failure(status: int, message: str, code: str | None = None, **more: Any) -> Answer:
    error = {"message": message, "type": "error", "param": None, "code": code, **more}
    return as_json(status, {"error": error})


CUT = Answer(200, None)


class Service:
    """The service: replies in turn, the last one for ever, and what it was asked."""

    def __init__(self, *replies: Reply | Answer) -> None:
        self._replies = list(replies)
        self.calls: list[Call] = []

    def answer(self, call: Call) -> Answer:
        reply = self._replies[min(len(self.calls), len(self._replies) - 1)]
        self.calls.append(call)
        return reply(call) if callable(reply) else reply


def _parts(content_type: str, body: bytes) -> dict[str, bytes]:
    parser = email.parser.BytesParser(policy=email.policy.HTTP)
    message = parser.parsebytes(b"Content-Type: " + content_type.encode() + b"\r\n\r\n" + body)
    found: dict[str, bytes] = {}
    for part in message.iter_parts():
        name = part.get_param("name", header="content-disposition")
        payload = part.get_payload(decode=True)
        assert isinstance(name, str)
        assert isinstance(payload, bytes)
        found[name.removesuffix("[]")] = payload
    return found


@contextmanager
def running(service: Service) -> Iterator[str]:
    """Give the address of the service while it runs."""

    class Handler(BaseHTTPRequestHandler):
        def do_POST(self) -> None:
            body = self.rfile.read(int(self.headers["Content-Length"]))
            headers = {name.lower(): value for name, value in self.headers.items()}
            call = Call(self.path, headers, _parts(headers["content-type"], body))
            answer = service.answer(call)
            if answer.body is None:
                self.close_connection = True
                self.send_response(answer.status)
                self.send_header("Content-Length", "1000")
                self.end_headers()
                self.wfile.write(b'{"created"')
                return
            self.send_response(answer.status)
            self.send_header("Content-Type", "application/json")
            self.send_header("Content-Length", str(len(answer.body)))
            for name, value in answer.headers.items():
                self.send_header(name, value)
            self.end_headers()
            self.wfile.write(answer.body)

        def log_message(self, *_: object) -> None:
            pass

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    thread = threading.Thread(target=server.serve_forever, daemon=True)
    thread.start()
    try:
        yield f"http://127.0.0.1:{server.server_port}/v1"
    finally:
        server.shutdown()
        server.server_close()
        thread.join()
