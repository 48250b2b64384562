"""The picture shows boxes where they are: forward is up, left is left."""

import io

import numpy as np
from PIL import Image
from tests.objects.scenes import car, seen

from viewshed.detections import ObjectKind
from viewshed.objects.detector import Detector
from viewshed_lab.studies.detection_picture import KIND_COLORS, draw_detections


def test_a_car_ahead_to_the_left_is_drawn_up_left() -> None:
    leveled = seen(*car(20.0, 10.0))
    true = np.array([[-20.0, -10.0, 0.75, 4.4, 1.8, 1.5, 0.0]])
    png = draw_detections(leveled, Detector().detect(leveled), true, side=400)
    pixels = np.asarray(Image.open(io.BytesIO(png)))[40:420]
    row, column = np.argwhere((pixels == KIND_COLORS[ObjectKind.CAR]).all(axis=-1)).mean(axis=0)
    assert row < 150
    assert column < 190
    row, column = np.argwhere((pixels == (190, 226, 190)).all(axis=-1)).mean(axis=0)
    assert row > 250
    assert column > 240
