"""Objects of one agent: detection, tracking by what could be seen, and checks of tracks by the field of view."""

from viewshed.detections import BOX_COLUMNS, Detections, ObjectKind

__all__ = ["BOX_COLUMNS", "Detections", "ObjectKind"]
