"""What an agent tells others: each answer as a signed message of ``viewshed.messages``, as bytes."""

from __future__ import annotations

import time
from array import array
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from std_msgs.msg import UInt8MultiArray

from viewshed.messages.signing import SigningKey, VerifyingKey, sign_message
from viewshed.messages.view_message import SensorFacts, SharedTracks, ViewMessage
from viewshed.pipeline import Answer

POSE_STD_M, POSE_STD = 0.1, 0.01
"""Standard deviations of poses whose source tells none: meters, and radians."""

POSE_COVARIANCE = np.diag([POSE_STD_M**2] * 3 + [POSE_STD**2] * 3)


@dataclass(slots=True)
class Speaker:
    """Signs what an agent saw.

    Attributes:
        key: private key of the agent.
        frame: name of the map that poses are in.
    """

    key: SigningKey
    frame: str
    _sequence: int = field(default_factory=lambda: round(1e3 * time.time()))  # greater than before a restart

    def message(self, answer: Answer) -> UInt8MultiArray:
        """Return an answer as a signed message.

        Raises:
            ValueError: there is no estimate, or no pose or time of it.
        """
        estimate, objects = answer.estimate, answer.objects
        if estimate is None or estimate.world_from_level is None or estimate.t_ns is None:
            raise ValueError("what is told to others must have a pose and a time, got none for this sweep")
        basis = estimate.basis
        self._sequence += 1
        told = ViewMessage(
            agent=self.key.agent,
            sequence=self._sequence,
            t_ns=estimate.t_ns,
            frame=self.frame,
            world_from_level=estimate.world_from_level,
            pose_covariance=POSE_COVARIANCE,
            sensor=SensorFacts(answer.agent[:32], float("nan") if basis is None else basis.sensor_height_m),
            view=estimate,
            detections=None if objects is None else objects.detections,
            tracks=None if objects is None else SharedTracks.of(objects.explained.trusted()),
            report=None if answer.report is None else answer.report.now,
        )
        return UInt8MultiArray(data=array("B", sign_message(told, self.key)))


def read_signing_key(agent: str, path: str) -> SigningKey:
    """Return the private key of an agent in a file: 64 hexadecimal digits.

    Raises:
        ValueError: the file holds something else.
        OSError: it cannot be read.
    """
    return SigningKey(agent, _key_bytes(path))


def read_verifying_keys(agents: list[str], paths: list[str]) -> tuple[VerifyingKey, ...]:
    """Return the public keys of agents, a file of 64 hexadecimal digits each.

    Raises:
        ValueError: there is another number of files, or one holds something else.
        OSError: one cannot be read.
    """
    if len(agents) != len(paths) or len(set(agents)) != len(agents) or not agents:
        raise ValueError(f"keys must be one file for each agent, got {len(paths)} for {', '.join(agents) or 'none'}")
    return tuple(VerifyingKey(agent, _key_bytes(path)) for agent, path in zip(agents, paths, strict=True))


def _key_bytes(path: str) -> bytes:
    text = Path(path).read_text(encoding="ascii").strip()
    try:
        found = bytes.fromhex(text)
    except ValueError:
        found = b""
    if len(found) != 32:
        raise ValueError(f"a key must be 64 hexadecimal digits, got {len(text)} characters in {path}")
    return found
