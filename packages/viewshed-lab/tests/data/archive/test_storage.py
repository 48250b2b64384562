"""A store holds whole files by name, in a folder and in an object store alike."""

import errno
import http.server
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path

import pyarrow.fs as pafs
import pytest

from viewshed_lab.data.archive.storage import Storage


@pytest.fixture(params=["folder", "file", pytest.param("s3", marks=pytest.mark.slow)])
def store(request: pytest.FixtureRequest, tmp_path: Path) -> Storage:
    if request.param == "folder":
        return Storage.of(tmp_path / "new folder é" / "deep")
    if request.param == "file":
        return Storage.of(f"file://{tmp_path}/of/uri")
    return Storage.of(f"s3://data/{tmp_path.name}/deep?{request.getfixturevalue('s3')}")


def test_write_read_list_delete(store: Storage) -> None:
    assert store.names() == []
    contents = {"b.parquet": bytes(range(256)) * 9, "a/1.json": b"{}", "a.json": b"", "a/é 2": b"x"}
    for name, content in contents.items():
        store.write(name, content)
    assert store.names() == ["a.json", "a/1.json", "a/é 2", "b.parquet"]
    assert {name: store.read(name) for name in contents} == contents
    store.write("a/1.json", b"replaced")
    assert store.read("a/1.json") == b"replaced"
    store.delete("a/1.json")
    store.clear_drafts()
    assert store.names() == ["a.json", "a/é 2", "b.parquet"]


def test_a_missing_file_is_named(store: Storage) -> None:
    store.write("there", b"1")
    for act in (store.read, store.delete, store.open):
        with pytest.raises(FileNotFoundError) as raised:
            act("not/there")
        assert str(raised.value) == f"{store.place}/not/there: no such file"


@pytest.mark.parametrize("name", ["", "/etc/passwd", "../up", "a/../../up", "a\\b", "."])
def test_names_stay_inside(name: str, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="name must be relative and stay inside"):
        Storage.of(tmp_path).write(name, b"1")


KILLED = """
import os, sys, threading, time
from viewshed_lab.data.archive.storage import Storage

def kill_soon():
    time.sleep(0.3)
    os.kill(os.getpid(), 9)

store = Storage.of(sys.argv[1])
if store.folder is None:  # in the middle of sending
    threading.Thread(target=kill_soon, daemon=True).start()
else:  # between writing the draft and moving it
    os.fsync = lambda file: os.kill(os.getpid(), 9)
store.write("shard", b"new" * 50_000_000)
"""


def test_a_killed_writer_leaves_the_old_file(store: Storage) -> None:
    store.write("shard", b"old")
    ended = subprocess.run([sys.executable, "-c", KILLED, store.uri], check=False)
    assert ended.returncode == -signal.SIGKILL
    assert store.names() == ["shard"]
    assert store.read("shard") == b"old"
    assert store.folder is None or len(list(store.folder.iterdir())) == 2
    store.clear_drafts()
    assert store.folder is None or [path.name for path in store.folder.iterdir()] == ["shard"]


@pytest.mark.parametrize(
    ("number", "words"),
    [(errno.ENOSPC, "the disk is full; free some space"), (errno.EROFS, "read-only; choose another place"),
     (errno.EACCES, "no permission"), (errno.EDQUOT, "the quota is used up")],
)  # fmt: skip
def test_a_disk_that_refuses(number: int, words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(_: int) -> None:
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr("os.fsync", refuse)
    with pytest.raises(OSError, match=words) as raised:
        Storage.of(tmp_path).write("x.parquet", b"1")
    assert str(raised.value).startswith(f"{tmp_path}/x.parquet: ")
    assert raised.value.errno == number
    assert list(tmp_path.iterdir()) == []


def test_a_file_where_the_folder_must_be(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    store = Storage.of(tmp_path / "file")
    with pytest.raises(OSError, match=r"file/x: a file is where a folder must be; choose another place"):
        store.write("x", b"1")
    with pytest.raises(OSError, match=r"file: a file is where a folder must be; choose another place"):
        store.names()


@pytest.fixture
def refusing() -> Iterator[str]:
    """Options of an S3 server that lets nobody in."""

    class Refusing(http.server.BaseHTTPRequestHandler):
        def _refuse(self) -> None:
            self.send_response(403)
            self.send_header("Content-Length", "0")
            self.end_headers()

        do_GET = do_HEAD = do_PUT = do_POST = _refuse  # noqa: N815 - the library calls these names

        def log_message(self, *_: object) -> None:
            pass

    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), Refusing)
    thread = threading.Thread(target=server.serve_forever)
    thread.start()
    yield f"endpoint_override=127.0.0.1:{server.server_port}&scheme=http&region=us-east-1"
    server.shutdown()
    thread.join()
    server.server_close()


def test_no_credentials_and_no_secret_in_the_message(refusing: str) -> None:
    store = Storage.of(f"s3://AKIAKEY:hush@data/x?{refusing}")
    for act in (lambda: store.write("y", b"1"), lambda: store.read("y"), store.names):
        with pytest.raises(OSError, match=r"^s3://data/x.*ACCESS_DENIED.*; give credentials that may") as raised:
            act()
        assert "hush" not in str(raised.value) + repr(store)
        assert "\n" not in str(raised.value)


@pytest.mark.parametrize(
    ("place", "words"),
    [("", "place must be a folder or a URI"), ("hdfs://a/b", "begin with file, s3, gs, gcs, abfs, abfss, got hdfs://"),
     ("s3:///b", "Missing bucket"), ("s3://b/c?color=red", "s3://b/c: .*color"), ("file://far/x", "hostname")],
)  # fmt: skip
def test_places_that_are_refused(place: str, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        Storage.of(place)


@pytest.mark.parametrize(
    ("place", "kind", "shown"),
    [("gs://anonymous@bucket/a?retry_limit_seconds=5", pafs.GcsFileSystem, "gs://bucket/a"),
     ("gcs://bucket/a/", pafs.GcsFileSystem, "gcs://bucket/a"),
     ("abfss://box@account.dfs.core.windows.net/a", pafs.AzureFileSystem, "abfss://box@account.dfs.core.windows.net/a"),
     ("abfs://box@account.dfs.core.windows.net/a", pafs.AzureFileSystem, "abfs://box@account.dfs.core.windows.net/a")],
)  # fmt: skip
def test_other_places_are_understood(place: str, kind: type, shown: str) -> None:
    """Neither has a server here that a URI could lead to: nothing is read or written."""
    store = Storage.of(place)
    assert isinstance(store._files, kind)
    assert store.place == shown
