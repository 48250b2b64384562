"""Messages of an agent to others: each answer as a signed message of ``viewshed.agents``, as bytes."""

from __future__ import annotations

from array import array
from dataclasses import dataclass

import numpy as np
from std_msgs.msg import UInt8MultiArray

from viewshed.agents.signing import SigningKey, sign_message
from viewshed.agents.view_message import SensorFacts, ViewMessage
from viewshed.pipeline import Answer

POSE_STD_M, POSE_STD = 0.1, 0.01
"""Assumed standard deviations of poses whose source states none: meters, and radians."""

AHEAD_MS = 500
"""Receivers accept messages of clocks that are ahead by at most this."""

POSE_COVARIANCE = np.diag([POSE_STD_M**2] * 3 + [POSE_STD**2] * 3)


@dataclass(slots=True)
class ViewSigner:
    """Signs the answers of an agent."""

    key: SigningKey  # private key of the agent
    frame: str  # frame of the poses
    _epoch: int = -1
    _sequence: int = 0

    def message(self, answer: Answer) -> UInt8MultiArray:
        """Return an answer as a signed message."""
        estimate, objects = answer.estimate, answer.objects
        if estimate is None or estimate.world_from_level is None or estimate.t_ns is None:
            raise ValueError("what is shared with others must have a pose and a time, got none for this sweep")
        basis = estimate.basis
        # The epoch, the first time in milliseconds, increases with each restart and must not be later than messages. If
        # the clock was so far ahead that receivers refused messages, and is then corrected, a new epoch begins.
        t_ms = estimate.t_ns // 1_000_000
        if self._epoch < 0 or t_ms < self._epoch - AHEAD_MS:
            self._epoch, self._sequence = t_ms, 0
        self._sequence += 1
        message = ViewMessage(
            agent=self.key.agent,
            sequence=self._sequence,
            t_ns=estimate.t_ns,
            frame=self.frame,
            world_from_level=estimate.world_from_level,
            pose_covariance=POSE_COVARIANCE,
            sensor=SensorFacts(answer.agent[:32], float("nan") if basis is None else basis.sensor_height_m),
            view=estimate,
            detections=None if objects is None else objects.detections,
            report=None if answer.report is None else answer.report.now,
            epoch=self._epoch,
        )
        return UInt8MultiArray(data=array("B", sign_message(message, self.key)))
