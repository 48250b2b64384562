"""Storage of a data set's files: a folder, or a prefix of an object store."""

from __future__ import annotations

import contextlib
import errno
import os
import re
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING
from urllib.parse import urlsplit

from viewshed._extras import needed_for
from viewshed._files import write_atomic
from viewshed.io._input import one_line

if TYPE_CHECKING:
    import pyarrow as pa
    import pyarrow.fs as pafs


SCHEMES = ("file", "s3", "gs", "gcs", "abfs", "abfss")
"""Allowed schemes of a URI."""

_MAX_REQUESTS = 16  # at a time
_DRAFT = re.compile(r"\..+\.[0-9a-f]{12}\.part")  # temporary files of viewshed._files

_REPAIRS = {
    r"NO_SUCH_BUCKET|NoSuchBucket|no such bucket|[Bb]ucket.*(not found|does not exist)": "create the bucket first",
    r"ACCESS_DENIED|INVALID_ACCESS_KEY|SIGNATURE|AUTHENTICATION|[Cc]redential|HTTP status 40[13]":
        "give credentials that may read and write there",
    r"NETWORK_CONNECTION|curlCode|[Cc]ould not resolve|[Cc]onnect": "check the network, region and endpoint_override",
}  # fmt: skip

_LOCAL_REPAIRS = {
    errno.ENOSPC: "the disk is full; free some space and start again, finished files are kept",
    errno.EDQUOT: "the quota is used up; free some space and start again, finished files are kept",
    errno.EROFS: "the file system is read-only; choose another place",
    errno.EACCES: "no permission; choose another place or change its permissions",
    errno.EPERM: "no permission; choose another place or change its permissions",
    errno.ENOTDIR: "a file is where a folder must be; choose another place",
    errno.EEXIST: "a file is where a folder must be; choose another place",
    errno.ENAMETOOLONG: "the name is too long; choose a shorter one",
}


@dataclass(frozen=True, slots=True)
class Storage:
    """Files by name below one location; small enough to send to other processes and machines.

    Failures to list, read, write or delete raise an OSError whose one line names the file and, if known, the repair.
    """

    uri: str = field(repr=False)  # with options, which may hold secrets; show :attr:`place` instead

    @classmethod
    def of(cls, place: str | os.PathLike[str]) -> Storage:
        """Return the storage of a folder (created on the first write) or of a URI with one of :data:`SCHEMES`.

        >>> Storage.of("s3://bucket/sweeps?region=eu-central-1").place
        's3://bucket/sweeps'

        Raises:
            ValueError: the scheme is unknown, or the URI or its options are wrong.
        """
        text = os.fspath(place)
        scheme, separator, rest = text.partition("://")
        if not separator:
            if not text:
                raise ValueError("place must be a folder or a URI, got an empty text")
            return cls(Path(text).absolute().as_uri())
        if scheme.lower() not in SCHEMES:
            raise ValueError(f"place must be a folder or begin with {', '.join(SCHEMES)}, got {scheme}://…")
        store = cls(f"{scheme.lower()}://{rest}")
        _opened(store.uri)
        return store

    @property
    def place(self) -> str:
        """The folder or the URI, for messages: without options and credentials."""
        if self.folder is not None:
            return str(self.folder)
        parts = urlsplit(self.uri)
        account = f"{parts.username}@" if parts.scheme.startswith("abfs") and parts.username else ""
        return f"{parts.scheme}://{account}{parts.hostname or ''}{parts.path}".rstrip("/")

    @property
    def folder(self) -> Path | None:
        """The folder, or None for an object store."""
        return Path(_opened(self.uri)[1]) if self.uri.startswith("file:") else None

    def read(self, name: str) -> bytes:
        """Return the content of a file."""
        with self.open(name) as file, _named(self, name):
            return bytes(file.read())

    def open(self, name: str) -> pa.NativeFile:
        """Return a seekable file for ``pyarrow.parquet``; close it after use."""
        with _named(self, name):
            return self._files.open_input_file(self._path(name))

    def write(self, name: str, content: bytes) -> None:
        """Write or replace a file, atomically."""
        path = self._path(name)
        with _named(self, name):
            if self.folder is not None:
                Path(path).parent.mkdir(parents=True, exist_ok=True)
                write_atomic(path, content)
                return
            try:
                stream = self._files.open_output_stream(path)
                stream.write(content)  # an object appears only when its stream is closed, so not after a failure
                stream.close()
            except FileNotFoundError as error:
                raise OSError(f"{one_line(error, 200)}: no such bucket") from error

    def names(self) -> list[str]:
        """Return the sorted names of all files except partial ones; [] if the location does not exist."""
        return [name for name in self._listed() if not _is_draft(name)]

    def delete(self, *names: str) -> None:
        """Delete files, several at a time: an object store answers many requests in the time of one."""

        def delete(name: str, path: str) -> None:
            with _named(self, name):
                self._files.delete_file(path)

        paths = {name: self._path(name) for name in names}
        with ThreadPoolExecutor(_MAX_REQUESTS) as pool:
            list(pool.map(delete, paths, paths.values()))

    def clear_drafts(self) -> None:
        """Delete partial files of killed writers (object stores have none); no other writer may be active."""
        if self.folder is None:
            return
        self.delete(*(name for name in self._listed() if _is_draft(name)))

    def _listed(self) -> list[str]:
        with needed_for("a data set in an archive"):
            import pyarrow.fs as pafs
        root = _opened(self.uri)[1]
        with _named(self, ""):
            infos = self._files.get_file_info(pafs.FileSelector(root, recursive=True, allow_not_found=True))
        files = (info for info in infos if info.type == pafs.FileType.File)
        return sorted(str(PurePosixPath(info.path).relative_to(root)) for info in files)

    @property
    def _files(self) -> pafs.FileSystem:
        return _opened(self.uri)[0]

    def _path(self, name: str) -> str:
        parts = PurePosixPath(name).parts
        if not parts or name.startswith("/") or ".." in parts or "\\" in name:
            raise ValueError(f"name must be relative and stay inside {self.place}, got {name!r}")
        return "/".join([_opened(self.uri)[1].rstrip("/"), *parts])


@lru_cache(maxsize=64)
def _opened(uri: str) -> tuple[pafs.FileSystem, str]:
    with needed_for("a data set in an archive"):
        import pyarrow.fs as pafs
    try:
        files, root = pafs.FileSystem.from_uri(uri)
    except (ValueError, OSError) as error:  # pyarrow.ArrowInvalid is a ValueError
        parts = urlsplit(uri)
        raise ValueError(f"{parts.scheme}://{parts.hostname or ''}{parts.path}: {one_line(error, 200)}") from error
    return files, str(root)


def _is_draft(name: str) -> bool:
    return _DRAFT.fullmatch(PurePosixPath(name).name) is not None


@contextlib.contextmanager
def _named(store: Storage, name: str) -> Iterator[None]:
    """Reword an OSError as one line that names the file and, if known, the repair; keep its type and errno."""
    with needed_for("a data set in an archive"):
        import pyarrow as pa
    where = f"{store.place}/{name}" if name else store.place
    try:
        yield
    except OSError as error:
        named = type(error)(f"{where}: {_repair(error, store.folder is not None)}")
        named.errno = error.errno
        raise named from error
    except pa.ArrowException as error:  # raised by Azure's client
        raise OSError(f"{where}: {_repair(error, False)}") from error


def _repair(error: Exception, local: bool) -> str:
    if isinstance(error, FileNotFoundError):
        return "no such file"
    if local and isinstance(error, OSError):
        return _LOCAL_REPAIRS.get(error.errno or 0, one_line(error, 200))
    advice = [repair for pattern, repair in _REPAIRS.items() if re.search(pattern, str(error))]
    return "; ".join([one_line(error, 200), *advice[:1]])
