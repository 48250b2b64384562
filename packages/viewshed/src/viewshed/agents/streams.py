"""What a receiver remembers of each key, and the file that lets the next receiver know what this one has taken."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from viewshed._files import write_atomic
from viewshed.agents.view_message import MAX_EPOCH, MAX_T_NS

KEPT_AHEAD_NS = 500_000_000
"""The file names a time so far behind the newest message, so that it is written twice a second at most."""

_MAX_FILE_BYTES = 1_000_000


@dataclass(slots=True)
class Bucket:
    """Tokens that come back at a constant rate."""

    rate: float
    size: float
    tokens: float
    at_ns: int

    def level(self, now_ns: int) -> float:
        """Return the tokens that are there at a time of a clock that never goes back."""
        self.tokens = min(self.size, self.tokens + self.rate * (now_ns - self.at_ns) / 1e9)
        self.at_ns = now_ns
        return self.tokens


@dataclass(slots=True)
class Stream:
    """The messages of one key."""

    budget: Bucket  # seconds of work that forged messages under this key may cost
    epoch: int = -1  # greatest epoch that was signed with it, -1 for none
    newest: int = -1  # greatest sequence number of that epoch, -1 for none since the receiver began
    newest_ns: int | None = None  # nothing is taken that is stamped earlier; None where nothing is known of the key
    kept_ns: int = -1  # time that the file names
    signatures: dict[int, bytes] = field(default_factory=dict)  # of the newest messages, by their numbers


def read_state(path: Path) -> dict[bytes, tuple[int, int]]:
    """Return epoch and time of each key id; nothing where there is no file yet.

    Raises:
        ValueError: it is no such file.
        OSError: it cannot be read.
    """
    if not path.exists():
        return {}
    try:
        if path.stat().st_size > _MAX_FILE_BYTES:
            raise ValueError("it is too large")
        found = {bytes.fromhex(key): (epoch, t_ns) for key, (epoch, t_ns) in json.loads(path.read_bytes()).items()}
        for epoch, t_ns in found.values():
            if type(epoch) is not int or type(t_ns) is not int or epoch > MAX_EPOCH or not 0 <= t_ns <= 2 * MAX_T_NS:
                raise ValueError("it holds other numbers")
    except (ValueError, TypeError, AttributeError, RecursionError) as error:
        raise ValueError(f"state must be a file that a receiver wrote, got {path} ({error}); remove it") from error
    return found


def write_state(path: Path, streams: Mapping[bytes, Stream]) -> None:
    """Write epoch and time of each key, so that what was taken is not taken by the next receiver.

    Raises:
        OSError: it cannot be written.
    """
    found = {}
    for key_id, stream in streams.items():
        if stream.newest_ns is not None:
            # A key that nobody has used since the file was read keeps its time.
            ahead_ns = KEPT_AHEAD_NS if stream.newest >= 0 else 0
            found[key_id.hex()] = (stream.epoch, stream.newest_ns + ahead_ns)
    write_atomic(path, json.dumps(found).encode())
    for key_id, stream in streams.items():
        stream.kept_ns = found.get(key_id.hex(), (-1, -1))[1]
