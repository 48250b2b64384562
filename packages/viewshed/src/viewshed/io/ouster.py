"""Ouster captures: pcap and the sensor's metadata in the ``.json`` beside it."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from viewshed.geometry import Rigid
from viewshed.io._columns import IDENTITY, Columns
from viewshed.io._input import InputFile, one_line
from viewshed.io.ouster_packets import OusterDecoder, OusterMetadata
from viewshed.io.velodyne import udp_payloads

_METADATA_BYTES = 1_000_000


def metadata_path(path: str) -> Path:
    """Return where the metadata of a capture lies: the same name with ``.json``.

    >>> metadata_path("drive/a.pcap.gz").as_posix()
    'drive/a.json'
    """
    file = Path(path)
    return (file.with_suffix("") if file.suffix.lower() == ".gz" else file).with_suffix(".json")


def read_ouster(source: InputFile, frame: Rigid | None) -> Iterator[Columns]:
    """Yield the revolutions of an Ouster capture, in the sensor's frame; incomplete ones only where there is no other.

    Ring 0 is the lowest beam; azimuth is the encoder's angle of the column, without the beams' own offsets.
    """
    content = source.content()
    metadata = read_metadata(metadata_path(source.path))
    decoder = OusterDecoder(metadata, IDENTITY if frame is None else frame)
    return decoder.revolutions(payload for _, payload in udp_payloads(content))


def read_metadata(path: Path) -> OusterMetadata:
    """Return the metadata in a file.

    Raises:
        ValueError: it is not there, too large, or no metadata.
    """
    try:
        with path.open("rb") as file:
            raw = file.read(_METADATA_BYTES + 1)
    except OSError as error:
        raise ValueError(f"an Ouster capture needs its metadata in {path.name}: {error.strerror}") from error
    if len(raw) > _METADATA_BYTES:
        raise ValueError(f"{path.name} must be at most {_METADATA_BYTES} bytes of Ouster metadata")
    try:
        return OusterMetadata.parse(raw.decode("utf-8"))
    except ValueError as error:
        raise ValueError(f"{path.name} must be Ouster metadata: {one_line(error)}") from error
