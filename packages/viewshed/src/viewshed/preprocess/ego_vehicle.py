"""The vehicle that carries the sensor: where its own returns lie, however the sensor is turned on it."""

from __future__ import annotations

from viewshed import _core

EGO_BOX_M = _core.EGO_LENGTH_M, _core.EGO_WIDTH_M
"""Half length and half width of the vehicle below the sensor."""

EGO_HEIGHTS_M = _core.LEAST_EGO_HEIGHT_M, _core.MOST_EGO_HEIGHT_M
"""Sensor heights at which such a vehicle is assumed; lower ones are robots, higher ones stand at the roadside."""
