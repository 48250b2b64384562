"""Optics: how well a sensor measures what its beams meet, for each sensor of the beam tables."""

from __future__ import annotations

from dataclasses import dataclass

from viewshed.sensors import LidarModel

_FINEST_STEP_M = 0.002
_REACH_SHARE = 0.6


@dataclass(frozen=True, slots=True)
class Optics:
    """How well a sensor measures ranges and how weak a return it still detects.

    Raises:
        ValueError: a number is out of range.
    """

    # standard deviation of the range of a strong return, in meters; an offset that a beam keeps is none
    sigma_m: float = 0.01
    # range at which a target of 10 % reflectivity that faces the sensor is detected every second time; infinite for a
    # sensor that detects everything
    reach_m: float = 70.0
    missing_share: float = 0.01  # beams that return nothing for no visible reason, of all

    def __post_init__(self) -> None:
        if not (0 <= self.sigma_m < 1 and self.reach_m > 0 and 0 <= self.missing_share < 1):
            raise ValueError(
                f"optics must have sigma_m in [0, 1), reach_m positive and missing_share in [0, 1), got {self}"
            )


OPTICS: dict[str, Optics] = {
    "HDL-32E": Optics(0.005, 80.0, 0.010),
    "HDL-64E": Optics(0.010, 110.0, 0.010),
    "VLP-16": Optics(0.007, 70.0, 0.010),
    "VLP-32C": Optics(0.007, 120.0, 0.010),
    "Pandar40P": Optics(0.006, 150.0, 0.010),
    "Pandar64": Optics(0.006, 150.0, 0.010),
    "OT128": Optics(0.010, 200.0, 0.005),
    "XT32": Optics(0.005, 90.0, 0.005),
    "OS0-32": Optics(0.009, 22.0, 0.010),
    "OS0-64": Optics(0.009, 22.0, 0.010),
    "OS0-128": Optics(0.009, 22.0, 0.010),
    "OS1-32": Optics(0.009, 45.0, 0.010),
    "OS1-32 gradient": Optics(0.009, 45.0, 0.010),
    "OS1-64": Optics(0.009, 45.0, 0.010),
    "OS1-128": Optics(0.009, 45.0, 0.010),
    "VLS-128": Optics(0.010, 220.0, 0.010),
    "PandarQT64": Optics(0.010, 20.0, 0.010),
    "QT128": Optics(0.010, 20.0, 0.010),
    "Pandar128": Optics(0.010, 200.0, 0.010),
    "AT128": Optics(0.010, 200.0, 0.010),
    "XT16": Optics(0.005, 80.0, 0.005),
    "OS2-32": Optics(0.009, 80.0, 0.010),
    "OS2-64": Optics(0.009, 80.0, 0.010),
    "OS2-128": Optics(0.009, 80.0, 0.010),
    "RS-LiDAR-16": Optics(0.010, 90.0, 0.010),
    "RS-LiDAR-32": Optics(0.010, 120.0, 0.010),
    "Helios-5515": Optics(0.010, 110.0, 0.010),
    "Bpearl": Optics(0.010, 30.0, 0.010),
    "Ruby Plus": Optics(0.010, 240.0, 0.010),
    "Livox Mid-360": Optics(0.020, 40.0, 0.010),
    "Livox Mid-40": Optics(0.020, 90.0, 0.010),
    "Livox Mid-70": Optics(0.020, 90.0, 0.010),
    "Livox Avia": Optics(0.020, 190.0, 0.010),
    "Livox Horizon": Optics(0.020, 90.0, 0.010),
    "Livox HAP": Optics(0.020, 150.0, 0.010),
    "CARLA": Optics(0.0, float("inf"), 0.0),
    "CARLA 256": Optics(0.0, float("inf"), 0.0),
}
"""By the name of the beam table; the page on measurement says which numbers are makers' and which were tuned."""


def optics_of(model: LidarModel) -> Optics:
    """Return the optics of a sensor: its row of :data:`OPTICS`, else a reach of 0.6 of its maximum range.

    >>> from viewshed.sensors import lidar_model
    >>> optics_of(lidar_model("hdl64e")).sigma_m
    0.01
    """
    known = OPTICS.get(model.name)
    return Optics(reach_m=_REACH_SHARE * model.max_range_m) if known is None else known


def step_of(model: LidarModel) -> float:
    """Return the meters of one step of range: 2 mm, doubled until 16 bits reach the maximum range.

    >>> from viewshed.sensors import lidar_model
    >>> step_of(lidar_model("hdl32e")), step_of(lidar_model("vlp32c"))
    (0.002, 0.004)
    """
    step_m = _FINEST_STEP_M
    while model.max_range_m > 65_535 * step_m:
        step_m *= 2
    return step_m
