"""Local web server: drop a point file on its page and see the view.

It listens on the loopback interface only. Other web pages in the same browser can send requests there too, and an
attacker's domain may resolve to it (DNS rebinding). So a request must name this address as its host, and an upload must
name it as its origin.
"""

from __future__ import annotations

import json
import re
import secrets
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib import resources
from threading import Lock
from urllib.parse import unquote

MAX_FILE_BYTES = 200_000_000
"""Larger files are refused before they are read."""

_PAGES_KEPT = 4

_TIMEOUT_S = 30.0
"""Connections that send nothing for this long are closed."""

_HEADERS = {
    "Cache-Control": "no-store",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "SAMEORIGIN",
}


class RefusedFileError(ValueError):
    """A file that cannot be read as a sweep; the message is shown to the user."""


@dataclass(slots=True)
class _Pages:
    """The newest pages by address; new ones are made from a file's name and bytes, one at a time."""

    page_of: Callable[[str, bytes], tuple[bytes, str]]
    by_address: dict[str, bytes] = field(default_factory=dict)
    lock: Lock = field(default_factory=Lock)

    def add(self, name: str, content: bytes) -> dict[str, str]:
        """Make a page, drop the oldest one, and return the new page's address and message."""
        with self.lock:
            page, said = self.page_of(name, content)
            address = f"/page/{secrets.token_hex(8)}"
            self.by_address[address] = page
            while len(self.by_address) > _PAGES_KEPT:
                del self.by_address[next(iter(self.by_address))]
        return {"page": address, "said": said}


@contextmanager
def serving(port: int, page_of: Callable[[str, bytes], tuple[bytes, str]]) -> Iterator[ThreadingHTTPServer]:
    """Yield a server on the loopback interface; it answers in ``serve_forever``.

    Args:
        port: of the server; 0 for any free port.
        page_of: converts the name and bytes of a dropped file into a page and a message.

    Raises:
        OSError: the port is taken.
    """
    new_pages = _Pages(page_of)

    class Handler(_Handler):
        pages = new_pages

    server = ThreadingHTTPServer(("127.0.0.1", port), Handler)
    server.daemon_threads = True
    try:
        yield server
    finally:
        server.server_close()


class _Handler(BaseHTTPRequestHandler):
    pages: _Pages
    timeout = _TIMEOUT_S
    server_version = "viewshed"
    sys_version = ""

    def handle(self) -> None:
        """Answer; ignore a browser that disconnects."""
        with suppress(ConnectionError):
            super().handle()

    def do_GET(self) -> None:
        """Send the drop page, or a page made from a file."""
        if not self._is_ours():
            return
        page = _drop_page() if self.path == "/" else self.pages.by_address.get(self.path)
        if page is None:
            self._say(HTTPStatus.NOT_FOUND, "no such page")
        else:
            self._send(HTTPStatus.OK, "text/html; charset=utf-8", page)

    def do_POST(self) -> None:
        """Make a page of the uploaded file, and send its address."""
        if not self._is_ours():
            return
        if self.headers.get("Origin") != f"http://{self.headers['Host']}":
            self._say(HTTPStatus.FORBIDDEN, "files are accepted only from this page")
            return
        size = self.headers.get("Content-Length", "")
        if not re.fullmatch(r"\d{1,12}", size) or self.path != "/file":
            self._say(HTTPStatus.BAD_REQUEST, "a file must be sent to /file with its length")
            return
        if int(size) > MAX_FILE_BYTES:
            self._say(HTTPStatus.REQUEST_ENTITY_TOO_LARGE, f"a file must be at most {MAX_FILE_BYTES} bytes, got {size}")
            return
        content = self.rfile.read(int(size))
        name = re.sub(r"[^\w.-]", "_", unquote(self.headers.get("X-File-Name", "")).rpartition("/")[2])[-80:].lstrip(
            "."
        )
        try:
            answer = self.pages.add(name or "file", content)
        except RefusedFileError as error:
            self._say(HTTPStatus.UNPROCESSABLE_ENTITY, str(error))
            return
        self._send(HTTPStatus.OK, "application/json", json.dumps(answer).encode())

    def _is_ours(self) -> bool:
        """Return whether the request names this server as its host; refuse it otherwise."""
        port = self.server.server_address[1]  # type: ignore[index]
        if self.headers.get("Host") in {f"127.0.0.1:{port}", f"localhost:{port}"}:
            return True
        self._say(HTTPStatus.MISDIRECTED_REQUEST, f"this is http://127.0.0.1:{port}/")
        return False

    def _say(self, status: HTTPStatus, line: str) -> None:
        self._send(status, "text/plain; charset=utf-8", line.encode())

    def _send(self, status: HTTPStatus, kind: str, content: bytes) -> None:
        self.close_connection = True
        self.send_response(status)
        for name, value in {**_HEADERS, "Content-Type": kind, "Content-Length": str(len(content))}.items():
            self.send_header(name, value)
        self.end_headers()
        self.wfile.write(content)

    def log_message(self, format: str, *args: object) -> None:  # noqa: A002
        """Print nothing; the command prints a line for each sweep."""


def _drop_page() -> bytes:
    return resources.files("viewshed.show.view").joinpath("drop.html").read_bytes()
