"""Beam tables as text, exactly: an archive carries those of its own sensors."""

from __future__ import annotations

import json
from functools import lru_cache
from typing import Any

from viewshed.sensors import LidarModel, lidar_model, sensor_names

_LISTS = ("elevation", "azimuth_offset", "origin_m")
_SINGLES = ("name", "azimuth_columns", "min_range_m", "max_range_m", "source")


@lru_cache(maxsize=256)
def text_of_model(model: LidarModel) -> str:
    """Return a beam table as one line of JSON, angles in radians; equal tables give equal text."""
    table: dict[str, Any] = {key: getattr(model, key) for key in _SINGLES}
    table |= {key: getattr(model, key).tolist() for key in _LISTS}
    return json.dumps(table, sort_keys=True, ensure_ascii=False)


@lru_cache(maxsize=256)
def model_of_text(text: str) -> LidarModel:
    """Return the beam table in a line of :func:`text_of_model`; one that travels with the package is that very object.

    Raises:
        ValueError: the text is not such a line, or the table is not valid.
    """
    shipped = _shipped().get(text)
    if shipped is not None:
        return shipped
    try:
        table = json.loads(text)
        return LidarModel(**{key: table[key] for key in (*_SINGLES, *_LISTS)})
    except (KeyError, TypeError) as error:
        raise ValueError(f"a beam table must have the keys {', '.join((*_SINGLES, *_LISTS))}: {error}") from error


@lru_cache(maxsize=1)
def _shipped() -> dict[str, LidarModel]:
    return {text_of_model(model): model for model in map(lidar_model, sensor_names())}
