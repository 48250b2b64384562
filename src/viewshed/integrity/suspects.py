"""Suspect cells as polygons, for others to draw."""

from __future__ import annotations

import json

from viewshed.integrity.report import IntegrityReport
from viewshed.polygons import polygon_of_mask


def suspects_geojson(report: IntegrityReport) -> bytes:
    """Return a GeoJSON Feature in UTF-8: suspect cells as a MultiPolygon in ``level``, metres; score and alarm beside.

    Coordinates are metres in the ``level`` frame (x forward, y left), not degrees, as in the other exports.
    """
    from shapely.geometry import mapping

    told = {"monitor": report.monitor, "score": report.score, "threshold": report.threshold, "alarm": report.alarm}
    frame = {
        "name": "level",
        "coordinates": "metres in level frame, not WGS84",
        "axes": "x forward, y left of the sensor",
    }
    shape = mapping(polygon_of_mask(report.suspect, report.grid))
    feature = {"type": "Feature", "viewshed:frame": frame, "properties": told, "geometry": shape}
    return json.dumps(feature, allow_nan=False).encode()
