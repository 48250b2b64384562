"""The firing pattern of a moving sensor, against the simulator's own beams."""

import numpy as np
from tests.data.labeling.scene import MODEL, Shot

from viewshed.geometry import Rigid
from viewshed.sweep import Sweep
from viewshed_lab.data.labeling.beam_image import AT_REST, BeamImage, StampedPose, beam_image, drift_of


def _image(drive: list[Shot], **changes: object) -> BeamImage:
    moments = [StampedPose(one.sweep.world_from_sensor, one.sweep.t_ns) for one in drive[3:6]]
    return beam_image(drive[4].sweep.replace(**changes), np.eye(3), drift_of(*moments))


def test_every_beam_begins_and_points_as_it_did(drive: list[Shot]) -> None:
    scan = drive[4].scan
    to_level = Rigid.from_yaw(scan.world_from_sensor.yaw).rotation
    image = _image(drive)
    assert image.direction.shape == scan.direction.shape
    assert np.abs(image.direction - scan.direction @ to_level).max() < 4e-4
    assert np.abs(image.origin_m - scan.origin_m @ to_level).max() < 0.02
    missing = ~image.returned
    assert 0.01 < missing.mean() < 0.6
    assert np.abs(image.direction - scan.direction @ to_level)[missing].max() < 2e-4


def test_rings_are_found_where_they_are_not_told(drive: list[Shot]) -> None:
    known, found = _image(drive), _image(drive, ring=None)
    assert found.pixels.shape == known.pixels.shape
    assert (found.pixels == known.pixels).mean() > 0.97


def test_a_return_that_jittered_into_the_next_pixel_goes_back_to_the_empty_one() -> None:
    azimuth = ((np.arange(720) + 0.5) / 720 - 0.5) * 2 * np.pi
    azimuth[300] = azimuth[301] - 0.001
    slope = np.tan(MODEL.elevation[12])
    points = np.stack([9 * np.cos(azimuth), 9 * np.sin(azimuth), np.full(720, 9 * slope)], axis=-1)
    image = beam_image(Sweep(points, ring=np.full(720, 12)), np.eye(3), AT_REST)
    assert image.pixels.shape == (720, 13)
    assert sorted(image.pixels[:, 12].tolist()) == list(range(720))
    assert image.pixels[299, 12] == 299
