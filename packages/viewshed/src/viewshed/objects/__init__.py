"""Objects of one agent: boxes in a sweep, tracks that know what could be seen, and whether they can be explained."""

from viewshed.detections import BOX_COLUMNS, Detections, ObjectKind

__all__ = ["BOX_COLUMNS", "Detections", "ObjectKind"]
