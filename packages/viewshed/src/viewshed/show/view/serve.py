"""A page to try, served to this machine alone: drop a point file on it and see the view.

It listens on the loopback interface. Other web pages that the same browser has open can send requests there as well,
and an attacker's name may resolve to it: a request must name this very address as its host, and as its origin where it
sends a file.
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
"""A larger file is refused before it is read."""

_PAGES_KEPT = 4

_SILENT_S = 30.0
"""A connection that sends nothing for so long is closed."""

_HEADERS = {
    "Cache-Control": "no-store",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "SAMEORIGIN",
}


class RefusedFileError(ValueError):
    """A file that is no sweep; the message is for the one who dropped it."""


@dataclass(slots=True)
class _Pages:
    """The newest pages by address, and what makes one of a file's name and bytes, one at a time."""

    page_of: Callable[[str, bytes], tuple[bytes, str]]
    made: dict[str, bytes] = field(default_factory=dict)
    lock: Lock = field(default_factory=Lock)

    def add(self, name: str, content: bytes) -> dict[str, str]:
        """Return the address of a new page and what is said beside it; the oldest page is forgotten."""
        with self.lock:
            page, said = self.page_of(name, content)
            address = f"/page/{secrets.token_hex(8)}"
            self.made[address] = page
            while len(self.made) > _PAGES_KEPT:
                del self.made[next(iter(self.made))]
        return {"page": address, "said": said}


@contextmanager
def serving(port: int, page_of: Callable[[str, bytes], tuple[bytes, str]]) -> Iterator[ThreadingHTTPServer]:
    """Yield a server of the page to try, at a port of this machine alone; it answers in ``serve_forever``.

    Args:
        port: of the server; 0 for any that is free.
        page_of: turns the name and bytes of a dropped file into a page, and what to say beside it.

    Raises:
        OSError: the port is taken.
    """
    pages = _Pages(page_of)

    class Handler(_Handler):
        kept = pages

    server = ThreadingHTTPServer(("127.0.0.1", port), Handler)
    server.daemon_threads = True
    try:
        yield server
    finally:
        server.server_close()


class _Handler(BaseHTTPRequestHandler):
    kept: _Pages
    timeout = _SILENT_S
    server_version = "viewshed"
    sys_version = ""

    def handle(self) -> None:
        """Answer; a browser that goes meanwhile is no fault."""
        with suppress(ConnectionError):
            super().handle()

    def do_GET(self) -> None:
        """Answer with the page to try, or one that was made."""
        if not self._is_ours():
            return
        page = _drop_page() if self.path == "/" else self.kept.made.get(self.path)
        if page is None:
            self._say(HTTPStatus.NOT_FOUND, "no such page")
        else:
            self._send(HTTPStatus.OK, "text/html; charset=utf-8", page)

    def do_POST(self) -> None:
        """Make a page of the file that is sent, and answer with its address."""
        if not self._is_ours():
            return
        if self.headers.get("Origin") != f"http://{self.headers['Host']}":
            self._say(HTTPStatus.FORBIDDEN, "files are taken from this page alone")
            return
        size = self.headers.get("Content-Length", "")
        if not re.fullmatch(r"\d{1,12}", size) or self.path != "/file":
            self._say(HTTPStatus.BAD_REQUEST, "a file must come to /file with its length")
            return
        if int(size) > MAX_FILE_BYTES:
            self._say(HTTPStatus.REQUEST_ENTITY_TOO_LARGE, f"a file must be at most {MAX_FILE_BYTES} bytes, got {size}")
            return
        content = self.rfile.read(int(size))
        name = re.sub(r"[^\w.-]", "_", unquote(self.headers.get("X-File-Name", "")).rpartition("/")[2])[-80:].lstrip(
            "."
        )
        try:
            answer = self.kept.add(name or "file", content)
        except RefusedFileError as error:
            self._say(HTTPStatus.UNPROCESSABLE_ENTITY, str(error))
            return
        self._send(HTTPStatus.OK, "application/json", json.dumps(answer).encode())

    def _is_ours(self) -> bool:
        """Whether the request names this server as its host; anything else is answered with a refusal."""
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
        """Print nothing: a terminal has the line of each sweep."""


def _drop_page() -> bytes:
    return resources.files("viewshed.show.view").joinpath("drop.html").read_bytes()
