"""Labels and calibration of KITTI's object set."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from viewshed.datasets.number_text import named_texts, numbers_of, rigid_named, rigid_of, text_lines
from viewshed.datasets.source import ObjectBox
from viewshed.geometry import Rigid
from viewshed.io.source import one_line

_IGNORED = "DontCare"
_NUMBERS = 14


def velodyne_from_camera(calibration: Path) -> Rigid:
    """Return the transform from the rectified camera (x right, y down, z forward) to the LiDAR.

    The inverse of ``R0_rect * Tr_velo_to_cam``, as in the readme of KITTI's development kit.

    Raises:
        OSError: the file cannot be read.
        ValueError: it lacks one of the two, or that is not rigid.
    """
    texts = named_texts(calibration)
    where = f"{calibration}, R0_rect"
    rectification = rigid_of(numbers_of(texts.get("R0_rect", ""), 9, where).reshape(3, 3), np.zeros(3), where)
    return (rectification @ rigid_named(calibration, "Tr_velo_to_cam")).inverse()


def read_labels(labels: Path, calibration: Path) -> tuple[ObjectBox, ...]:
    """Return the labeled objects in the LiDAR's frame; regions marked ``DontCare`` are left out.

    Raises:
        OSError: a file cannot be read.
        ValueError: one is damaged.
    """
    if labels.is_file() and labels.stat().st_size == 0:  # a frame without objects
        return ()
    frame = velodyne_from_camera(calibration)
    lines = ((f"{labels}, line {number + 1}", line) for number, line in enumerate(text_lines(labels)))
    return tuple(_box(line, where, frame) for where, line in lines if line.strip() and not line.startswith(_IGNORED))


def _box(line: str, where: str, velodyne_from_camera: Rigid) -> ObjectBox:
    """Return the box of a line: type, truncated, occluded, alpha, 4 of the image, height, width, length, x, y, z, ry.

    (x, y, z) is the middle of the bottom in the camera's frame, ry turns about its y axis, which points down.
    """
    category, _, rest = line.partition(" ")
    *_, height, width, length, x, y, z, turn = numbers_of(rest, _NUMBERS, where)
    c, s = np.cos(turn), np.sin(turn)
    camera_from_box = Rigid(np.array([[c, s, 0.0], [0.0, 0.0, -1.0], [-s, c, 0.0]]), np.array([x, y - height / 2.0, z]))
    try:
        return ObjectBox(velodyne_from_camera @ camera_from_box, (length, width, height), category)
    except ValueError as error:
        raise ValueError(one_line(f"{where}: {error}")) from error
