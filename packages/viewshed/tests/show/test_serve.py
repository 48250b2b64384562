"""The page to try: files from its own page alone, pages from its own address alone."""

import http.client
import json
import re
import socket
import struct
import threading
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest

from viewshed.cli._options import DEFAULT_READING
from viewshed.estimators import load_estimator
from viewshed.io.samples import junction_path
from viewshed.show.view import serve
from viewshed.show.view.serve import MAX_FILE_BYTES, RefusedFileError, serving


@pytest.fixture
def port() -> Iterator[int]:
    """A server whose pages repeat what was sent; a file ``bad`` is refused."""

    def page_of(name: str, content: bytes) -> tuple[bytes, str]:
        if name == "bad":
            raise RefusedFileError("bad: is no sweep")
        return f"<p>{name}</p>".encode() + content, "seen"

    with serving(0, page_of) as server:
        thread = threading.Thread(target=server.serve_forever, args=(0.01,))
        thread.start()
        yield server.server_address[1]
        server.shutdown()
        thread.join()


def ask(port: int, method: str, path: str, body: bytes | None = None, **headers: str) -> tuple[int, str]:
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=20)
    own = {"Host": f"127.0.0.1:{port}"} | {name.replace("_", "-"): value for name, value in headers.items()}
    connection.request(method, path, body, own)
    answer = connection.getresponse()
    text = answer.read().decode()
    connection.close()
    assert answer.headers["X-Content-Type-Options"] == "nosniff"
    assert answer.headers["Cache-Control"] == "no-store"
    return answer.status, text


def test_a_dropped_file_becomes_a_page(port: int) -> None:
    own = {"Origin": f"http://127.0.0.1:{port}", "X_File_Name": "..%2F..%2Fetc%2Fa%20b.bin"}
    status, text = ask(port, "POST", "/file", b"points", **own)
    assert status == 200
    place = json.loads(text)["page"]
    assert json.loads(text)["said"] == "seen"
    assert re.fullmatch(r"/page/[0-9a-f]{16}", place)
    assert ask(port, "GET", place) == (200, "<p>a_b.bin</p>points")  # no path comes from outside
    assert ask(port, "POST", "/file", b"x", **{**own, "X_File_Name": "bad"}) == (422, "bad: is no sweep")
    for _ in range(4):  # few pages are kept
        ask(port, "POST", "/file", b"more", **own)
    assert ask(port, "GET", place)[0] == 404


@pytest.mark.parametrize(
    ("method", "path", "headers", "status"),
    [
        ("POST", "/file", {}, 403),
        ("POST", "/file", {"Origin": "http://evil.example"}, 403),
        ("POST", "/file", {"Origin": "null"}, 403),
        ("GET", "/", {"Host": "evil.example"}, 421),
        ("POST", "/file", {"Host": "evil.example", "Origin": "http://evil.example"}, 421),
        ("GET", "/page/../../etc/passwd", {}, 404),
        ("GET", "/%2e%2e/drop.html", {}, 404),
        ("PUT", "/file", {}, 501),
    ],
)
def test_others_get_nothing(port: int, method: str, path: str, headers: dict[str, str], status: int) -> None:
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=20)
    connection.request(method, path, b"x" if method != "GET" else None, {"Host": f"127.0.0.1:{port}"} | headers)
    assert connection.getresponse().status == status
    connection.close()


def test_a_file_that_is_too_large_is_refused_before_it_is_read(port: int) -> None:
    headers = {"Host": f"localhost:{port}", "Origin": f"http://localhost:{port}"}
    for length, status in ((str(MAX_FILE_BYTES + 1), 413), ("-1", 400), ("1e3", 400)):
        connection = http.client.HTTPConnection("127.0.0.1", port, timeout=20)
        connection.putrequest("POST", "/file", skip_host=True)
        for name, value in {**headers, "Content-Length": length}.items():
            connection.putheader(name, value)
        connection.endheaders()
        assert connection.getresponse().status == status
        connection.close()


def test_a_browser_that_goes_before_its_file_came_is_no_fault(port: int, capfd: pytest.CaptureFixture[str]) -> None:
    with socket.create_connection(("127.0.0.1", port)) as gone:
        own = f"Host: 127.0.0.1:{port}\r\nOrigin: http://127.0.0.1:{port}\r\nContent-Length: 9"
        gone.sendall(f"POST /file HTTP/1.1\r\n{own}\r\n\r\nhalf".encode())
        gone.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))  # a reset
    ask(port, "GET", "/")  # the one before is taken by then
    for thread in threading.enumerate():
        if "process_request_thread" in thread.name:
            thread.join(20)
    assert capfd.readouterr().err == ""


def test_it_listens_on_loopback_alone(port: int) -> None:
    assert ask(port, "GET", "/")[1].startswith("<!DOCTYPE html>")
    with serving(0, lambda *_: (b"", "")) as server:
        assert server.server_address[0] == "127.0.0.1"


def test_the_command_makes_the_page_that_view_writes(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    made: list[Any] = []

    class Ended:
        """A server that ends at once."""

        server_address = ("127.0.0.1", 1)

        def __enter__(self) -> "Ended":
            return self

        def __exit__(self, *_: object) -> None: ...

        def serve_forever(self) -> None: ...

    def kept(_: int, page_of: Any) -> Ended:
        made.append(page_of)
        return Ended()

    monkeypatch.setattr(serve, "serving", kept)
    import_module("viewshed.cli.view")._serve_page(DEFAULT_READING, load_estimator("shadow_map", grid="indoor"))
    [page_of] = made
    content, said = page_of("junction.pcd.bin.gz", junction_path().read_bytes())
    page = content.decode()
    assert said.startswith("junction.pcd.bin.gz: visible ")
    assert page.count('class="about"') == 1
    assert "<title>junction.pcd.bin.gz</title>" in page
    with pytest.raises(RefusedFileError, match=r"^a\.csv: text must have"):
        page_of("a.csv", b"hello")
